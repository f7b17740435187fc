"""An arm that moves under its own controller is identified from what its sensors say, truth inside the error bars."""

from __future__ import annotations

import numpy as np
import pytest
from controlled_arm import follow

from daq.robot.loader import load_robot
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import CANDIDATES

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")


@pytest.mark.slow
def test_the_truth_is_found_from_twenty_seconds():
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    runs = ((1, 20.0), (2, 5.0))
    recordings = [[follow(robot_file, seed, seconds, CANDIDATES, rate=250.0)] for seed, seconds in runs]
    found = identify(recordings[0], recordings[1], IdentifyChoices())
    assert found.validation.relative_error < 0.05
    inside = np.abs(found.solution.parameters - truth) <= 1.96 * found.std
    assert np.mean(inside) >= 0.85, [name for name, good in zip(base.names, inside, strict=True) if not good]
