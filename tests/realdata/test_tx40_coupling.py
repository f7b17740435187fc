"""The Staubli TX40's coupled wrist, identified as its own researchers do (shared/data/README.md)."""

from __future__ import annotations

from pathlib import Path

import pytest

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.robot.loader import RobotFile, parse_robot
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.signals.pipeline import PreprocessChoices

pytestmark = [pytest.mark.realdata, pytest.mark.usefixtures("estimates_alone", "stated_friction")]

ROBOT = Path(__file__).parents[2] / "examples" / "tx40.yaml"
MOVING = 7.45
SPLIT = 5.2


def robot(data_dir: Path, *, coupled: bool) -> RobotFile:
    text = ROBOT.read_text(encoding="utf-8")
    if not coupled:
        start, end = text.index("  coupling:"), text.index("joints:\n")
        text = (text[:start] + text[end:]).replace(", pair_inertia: true", "")
    return parse_robot(text, where="tx40", folder=data_dir)


def identified(data_dir: Path, *, coupled: bool) -> Identification:
    robot_file = robot(data_dir, coupled=coupled)
    recording = import_file(data_dir / "tx40_t1.npz", robot_file, ImportChoices())
    preprocess = PreprocessChoices(position_cutoff=100, torque_cutoff=25, decimate=50, stop=MOVING)
    plain = ModelChoices(friction="coulomb-viscous")
    choices = IdentifyChoices(
        "ols", plain, preprocess, search_delay=False, split=SPLIT, reversals=0.0, presliding=False
    )
    return identify([recording], [], choices)


def test_the_coupled_wrist_needs_its_columns(data_dir: Path) -> None:
    found = identified(data_dir, coupled=True)
    assert found.base.count == len(found.solution.active) == 61
    assert found.fit.relative_error < 0.051
    assert found.validation.relative_error < 0.083
    values = dict(zip(found.base.names, found.solution.parameters, strict=True))
    std = dict(zip(found.base.names, found.std, strict=True))
    for name in ("Ia5", "Ia6", "Fv5", "Fvm6", "Fs5", "Fsm6"):
        assert values[name] > 2.0 * std[name], name
    plain = identified(data_dir, coupled=False)
    assert plain.base.count == 58
    assert plain.fit.relative_error > 1.5 * found.fit.relative_error
    assert plain.validation.relative_error > 2.0 * found.validation.relative_error
