"""Arms that differ from their robot file."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import RobotFileError, UsageError
from ident.model.parameters import link_parameters
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.altered_arm import with_load, with_payload
from studies.synthetic.altered_arms import with_gains

COM, INERTIA = (0.03, -0.02, 0.08), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009)


def test_a_load_adds_its_parameters_to_those_of_the_last_link():
    robot_file = load_robot("ur10e")
    loaded = with_load(robot_file, 2.8, COM, INERTIA)
    difference = truth_vector(loaded) - truth_vector(robot_file)
    assert difference[50:60] == pytest.approx(link_parameters(2.8, COM, INERTIA), abs=1e-12)
    assert not np.any(difference[:50])
    assert not np.any(difference[60:])


def test_the_text_that_recordings_carry_stays():
    robot_file = load_robot("ur10e")
    assert with_load(robot_file, 2.8, COM, INERTIA).text == robot_file.text
    assert with_gains(robot_file, {"elbow_joint": 2.0}).text == robot_file.text


def test_gains_are_multiplied():
    robot_file = load_robot("ur10e")
    altered = with_gains(robot_file, {"elbow_joint": -0.5}).robot
    assert altered.drive("elbow_joint").gain == pytest.approx(-0.5 * robot_file.robot.drive("elbow_joint").gain)
    assert altered.drive("wrist_1_joint") == robot_file.robot.drive("wrist_1_joint")


def test_what_is_not_there_is_refused():
    robot_file = load_robot("ur10e")
    with pytest.raises(RobotFileError, match="no joint is called 'elbow'"):
        with_gains(robot_file, {"elbow": 2.0})
    with pytest.raises(RobotFileError, match="0 kg"):
        with_load(robot_file, 0.0, COM, INERTIA)


def test_a_payload_is_a_point_mass_in_the_flange_frame() -> None:
    robot_file = load_robot("ur5e")
    loaded = with_payload(robot_file, "2.0@0,0.01,0.05")
    at_flange = np.array([0.0, 0.01, 0.05]) - np.array(robot_file.robot.workspace.tool)
    assert loaded.robot.truth == with_load(robot_file, 2.0, at_flange.tolist(), [0.0] * 6).robot.truth
    assert loaded.text == robot_file.text


@each("text", ["", "2", "2@", "2@0,0", "2@0,0,0,0", "x@0,0,0", "0@0,0,0", "-1@0,0,0", "nan@0,0,0", "1@0,inf,0"])
def test_what_is_no_payload_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not a payload"):
        with_payload(load_robot("ur5e"), text)


@pytest.mark.parametrize("text", ["1e9@0,0,0", "1e-9@0,0,0", "1@1e9,0,0"])
def test_a_payload_beyond_all_arms_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not within"):
        with_payload(load_robot("ur5e"), text)
