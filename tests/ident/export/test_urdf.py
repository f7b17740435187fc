"""URDFs: complete ones, and a robot's own with new inertials, against the model that they come from."""

from __future__ import annotations

import functools
import warnings
from xml.etree import ElementTree

import numpy as np
import pytest
from each import each
from exported_arms import exported_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_arms import four_bar_arm, spatial_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import ModelError, RobotFileError
from ident.export import pinocchio_reading
from ident.export.urdf import new_urdf
from ident.export.urdf_edit import edited_urdf
from ident.export.xml_text import comment_text, number, roll_pitch_yaw
from ident.linear_algebra.vectors import rotation_of

OWN = """\
<?xml version="1.0"?>
<!-- written by hand: keep -->
<!-- and this -->
<robot name="hand_written" xmlns:xacro="http://wiki.ros.org/xacro">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"><inertial><mass value="4"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="turn" type="continuous">
    <origin xyz="0 0 0.3" rpy="0 0 0"/> <parent link="base"/> <child link="column"/> <axis xyz="0 0 1"/>
  </joint>
  <link name="column">
    <visual><geometry><mesh filename="package://arm/column.stl"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm/column.stl"/></geometry></collision>
  </link>
  <!-- the shoulder turns -->
  <joint name="flange" type="fixed">
    <origin xyz="0 0.1 0" rpy="1.5708 0 0"/> <parent link="column"/> <child link="bracket"/>
  </joint>
  <link name="bracket"><inertial><mass value="0.7"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0.1 0 0" rpy="0 0.3 0"/> <parent link="bracket"/> <child link="arm"/> <axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" velocity="9" effort="77"/>
    <dynamics damping="9" friction="9"/>
  </joint>
  <link name="arm"><inertial><origin xyz="9 9 9"/><mass value="9"/>
    <inertia ixx="9" ixy="0" ixz="0" iyy="9" iyz="0" izz="9"/></inertial></link>
  <joint name="slide" type="prismatic">
    <origin xyz="0.4 0 0" rpy="0 1.5708 0"/> <parent link="arm"/> <child link="hand"/> <axis xyz="0 1 0"/>
    <limit lower="0" upper="1" velocity="1" effort="50"/>
  </joint>
  <link name="hand"/>
  <joint name="finger_joint" type="prismatic">
    <origin xyz="0 0 0.1" rpy="0.2 0 0"/> <parent link="hand"/> <child link="finger"/> <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" velocity="1" effort="20"/>
  </joint>
  <link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <transmission name="t1"><type>transmission_interface/SimpleTransmission</type>
    <joint name="turn"><hardwareInterface>EffortJointInterface</hardwareInterface></joint></transmission>
  <gazebo reference="arm"><selfCollide>true</selfCollide></gazebo>
</robot>
"""

ROBOT = """\
name: hand_written
model: {urdf: arm.urdf, locked: {finger_joint: 0.03}}
joints:
  - {name: turn, position: [-3, 3], velocity: 2, torque: 80}
  - {name: shoulder, position: [-2, 1], velocity: 2}
  - {name: slide, position: [0.1, 0.6], velocity: 0.5, torque: 40}
"""


def own_arm(urdf: str = OWN) -> RobotFile:
    return parse_robot(ROBOT, where="arm.yaml", folder=None, urdf_text=urdf)


@functools.cache
def robot(name: str) -> RobotFile:
    return {"four_bar": four_bar_arm, "spatial": spatial_arm}.get(name, lambda: load_robot(name))()


@functools.cache
def edited() -> str:
    return edited_urdf(exported_arm(own_arm()), OWN, "arm.urdf")


@pytest.mark.parametrize("name", ["ur5e", "panda", "up6", "aubo_i5", "rocr6", "sr400", "four_bar", "spatial"])
def test_a_complete_urdf_has_the_torques_of_the_model(name):
    arm = exported_arm(robot(name))
    assert pinocchio_reading.torque_error(arm, new_urdf(arm), 1000) < 1e-9


def test_a_robots_own_urdf_has_the_torques_of_the_model():
    assert pinocchio_reading.torque_error(exported_arm(own_arm()), edited(), 1000) < 1e-9


def test_another_body_is_another_torque():
    arm = exported_arm(own_arm())
    heavier = edited().replace(f'<mass value="{number(arm.bodies[1].mass)}"', '<mass value="9"')
    assert heavier != edited()
    assert pinocchio_reading.torque_error(arm, heavier, 20) > 1e-3


def test_meshes_comments_transmissions_and_what_does_not_move_stay():
    text = edited()
    for kept in (
        "<!-- written by hand: keep -->\n<!-- and this -->\n<robot",
        "<!-- the shoulder turns -->",
        'filename="package://arm/column.stl"',
        "<hardwareInterface>EffortJointInterface</hardwareInterface>",
        '<gazebo reference="arm"><selfCollide>true</selfCollide></gazebo>',
        'xmlns:xacro="http://wiki.ros.org/xacro"',
    ):
        assert kept in text
    links = {link.get("name"): link for link in ElementTree.fromstring(text).findall("link")}
    assert float(links["base"].find("inertial/mass").get("value")) == 4.0


def test_what_is_fixed_to_a_moved_link_is_part_of_it():
    root = ElementTree.fromstring(edited())
    links = {link.get("name"): link for link in root.findall("link")}
    assert {name for name, link in links.items() if link.find("inertial") is not None} == {
        "base", "column", "arm", "hand",
    }  # fmt: skip
    finger = next(joint for joint in root.findall("joint") if joint.get("name") == "finger_joint")
    assert finger.get("type") == "fixed"
    position = np.array([float(word) for word in finger.find("origin").get("xyz").split()])
    np.testing.assert_allclose(position, [0, 0.03 * np.cos(0.2), 0.1 + 0.03 * np.sin(0.2)], atol=1e-12)


def test_limits_and_friction_are_those_of_the_robot_file_and_the_model():
    arm, joints = exported_arm(own_arm()), {j.get("name"): j for j in ElementTree.fromstring(edited()).findall("joint")}
    assert joints["turn"].find("limit").attrib == {"velocity": "2", "effort": "80"}  # continuous: no positions
    assert joints["shoulder"].find("limit").attrib == {"lower": "-2", "upper": "1", "velocity": "2", "effort": "77"}
    for index, name in enumerate(("turn", "shoulder", "slide")):
        stated = joints[name].find("dynamics").attrib
        assert float(stated["damping"]) == arm.at_joints.viscous[index]
        assert float(stated["friction"]) == arm.at_joints.coulomb[index]


def test_the_comment_says_what_the_file_lacks():
    comment = edited()[edited().index("identified with dynid") :].partition("-->")[0]
    assert "motor inertia" in comment
    assert "constant offsets" in comment
    assert "finger_joint at 0.03" in comment
    assert "slide" in comment.partition("Right angles")[2]


@each(
    ("old", "new", "message"),
    [
        ('name="slide"', 'name="slider"', "'joints' names 'slide'.*did you mean 'slider'"),
        ('xyz="0.1 0 0" rpy="0 0.3 0"', 'xyz="0.11 0 0" rpy="0 0.3 0"', "joint 'shoulder' is not.*10 mm apart"),
        ('rpy="0 0.3 0"', 'rpy="0 0.31 0"', "joint 'shoulder' is not.*turned by"),
        ('<parent link="bracket"/>', '<parent link="base"/>', "joint 'shoulder' is attached to another link"),
        ('name="slide" type="prismatic"', 'name="slide" type="revolute"', "joint 'slide' slides in one and turns"),
        ("<robot ", "<rowboat ", "not a URDF"),
    ],
)
def test_a_urdf_of_another_arm_is_refused(old, new, message):
    other = OWN.replace(old, new)
    assert other != OWN
    with pytest.raises(RobotFileError, match=message):
        edited_urdf(exported_arm(own_arm()), other, "other.urdf")


def test_what_is_no_urdf_is_refused_when_it_is_read():
    with pytest.raises(ModelError, match="Pinocchio does not read"):
        pinocchio_reading.torque_error(exported_arm(own_arm()), "<robot", 3)


@given(st.tuples(*[st.floats(-3.2, 3.2) | st.sampled_from([0.0, np.pi / 2, -np.pi / 2, 1.5708])] * 3))
@settings(max_examples=200, deadline=None)
def test_angles_give_their_rotation_back_also_at_the_singularity(angles):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rotation = rotation_of(*angles)
        np.testing.assert_allclose(rotation_of(*roll_pitch_yaw(rotation)), rotation, atol=1e-14)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_read_back_as_they_were(value):
    assert float(number(value)) == value


@given(st.text(alphabet="a-> ", max_size=12))
def test_any_text_stands_in_a_comment(text):
    ElementTree.fromstring(f"<a><!--{comment_text([text])}--></a>")
