"""ROS 2 inertial parameters: names, frames, and the bodies read again."""

from __future__ import annotations

import pytest
import yaml
from exported_arms import exported_arm

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import ModelError
from ident.export.ros2_inertial import check_ros2_inertial, has_ur_frames, inertial_names, ros2_inertial
from ident.model.true_parameters import truth_vector

UR_NAMES = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


@pytest.mark.parametrize("name", ["ur5e", "ur10e"])
def test_a_ur_has_the_names_of_its_description_package(name):
    robot_file = load_robot(name)
    arm = exported_arm(robot_file, truth_vector(robot_file))
    content = yaml.safe_load(ros2_inertial(arm))["inertia_parameters"]
    assert {f"{link}_mass" for link in UR_NAMES} < set(content)
    assert set(content["center_of_mass"]) == {f"{link}_cog" for link in UR_NAMES}
    assert set(content["tensor"]) == set(content["rotation"]) == set(UR_NAMES)
    truth = robot_file.robot.truth.links["shoulder_lift_joint"]
    assert content["upper_arm_mass"] == pytest.approx(truth.mass)
    assert list(content["center_of_mass"]["upper_arm_cog"].values()) == pytest.approx(truth.com)
    assert list(content["tensor"]["upper_arm"].values()) == pytest.approx(truth.inertia, abs=1e-12)


def test_the_published_ur5e_lies_in_the_frames_of_the_package():
    """Centres of mass of `config/ur5e/physical_parameters.yaml` of Universal_Robots_ROS2_Description."""
    robot_file = load_robot("ur5e")
    arm = exported_arm(robot_file, truth_vector(robot_file))
    content = yaml.safe_load(ros2_inertial(arm))["inertia_parameters"]["center_of_mass"]
    published = {"shoulder": (0.0, -0.00193, -0.02561), "wrist_1": (0.0, -0.01634, -0.0018)}
    for link, centre in published.items():
        assert [content[f"{link}_cog"][axis] for axis in "xyz"] == pytest.approx(centre, abs=2e-3)


def test_other_arms_and_other_frames_keep_the_names_of_their_joints():
    panda = exported_arm(load_robot("panda"))
    assert inertial_names(panda) == panda.model.link_names
    text = load_robot("ur5e").text.replace(
        "alpha: pi/2, d: 0, theta0: 0, r: 0}", "alpha: -pi/2, d: 0, theta0: 0, r: 0}", 1
    )
    turned = exported_arm(parse_robot(text, where="turned", folder=None))
    assert not has_ur_frames(turned)
    assert "In the frames of the identified arm's joints" in ros2_inertial(turned)


def test_another_number_is_noticed():
    arm = exported_arm(load_robot("panda"))
    text = ros2_inertial(arm)
    check_ros2_inertial(arm, text)
    with pytest.raises(ModelError, match="a different body for panda_joint3"):
        check_ros2_inertial(arm, text.replace(f"panda_joint3_mass: {arm.bodies[2].mass!r}", "panda_joint3_mass: 1.0"))
