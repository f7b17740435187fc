"""Arms that move under their own controllers are identified from their sensors, truth inside the error bars."""

from __future__ import annotations

import numpy as np
import pytest
from controlled_arm import follow
from loop_arms import four_bar_arm

from daq.robot.loader import RobotFile, load_robot
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot_file", "runs", "motion", "choices", "well_known"),
    [
        (load_robot("ur5e"), ((1, 20.0), (2, 5.0)), {"rate": 250.0}, IdentifyChoices(), ()),
        (
            load_robot("sr400"),
            ((1, 20.0), (2, 4.0)),
            {"rate": 250.0},
            IdentifyChoices(),
            ("ZZR2", "ZZR3", "MXR2", "MYR3", "Fs1", "Fs2", "Fsm6", "Fs6"),
        ),
        (
            four_bar_arm(),
            ((1, 6.0),),
            {"rate": 150.0, "period": 5.0},
            IdentifyChoices(split=5.0, search_delay=False),
            ("Fv1", "Fv2", "Fv5", "Fs1", "Fs2", "Fs5"),
        ),
    ],
    ids=["serial", "closed loop and coupled wrist", "four-bar linkage"],
)
def test_the_truth_of_a_controlled_arm_is_found_from_seconds(
    robot_file: RobotFile,
    runs: tuple[tuple[int, float], ...],
    motion: dict[str, float],
    choices: IdentifyChoices,
    well_known: tuple[str, ...],
) -> None:
    base = base_parameters(build_model(robot_file))
    truth = base.projection @ truth_vector(robot_file)
    recordings = [[follow(robot_file, seed, seconds, **motion)] for seed, seconds in runs]
    found = identify(recordings[0], recordings[1] if len(runs) > 1 else [], choices)
    assert found.validation.relative_error < 0.05
    deviations = np.abs(found.solution.parameters - truth) / found.std
    assert np.mean(deviations <= 1.96) >= 0.85, dict(zip(base.names, deviations, strict=True))
    for name in well_known:
        i = base.names.index(name)
        assert found.std[i] < 0.15 * abs(truth[i]), name
