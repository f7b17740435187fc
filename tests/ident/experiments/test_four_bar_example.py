"""What the four-bar example prints, in small: without its design and its simulated controller."""

from __future__ import annotations

import pytest

from daq.robot.loader import load_robot
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.models import four_bar

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


def test_the_truth_is_found_from_thirty_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    robot_file = load_robot(four_bar.ARM)
    assert four_bar.closing_error(robot_file) < 1e-10
    model = build_model(robot_file)
    motions = [random_fourier_motion(model, 10.0, seed=seed, candidates=5) for seed in (0, 1)]
    runs = [simulate_recording(robot_file, motion, 30.0, seed=seed, rate=125.0) for seed, motion in enumerate(motions)]
    found, inside = four_bar.compare(robot_file, "random", *runs)
    assert inside >= 0.85 * found.base.count
    assert found.validation.relative_error < 0.02
    assert f"{inside} of {found.base.count} true values" in capsys.readouterr().out
