"""A URDF as a robot: limits, joints that mimic, tool link; and the robot file that `dynid robot new` writes of it."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.robot.assumptions import assumed_limits, assumptions
from daq.robot.loader import load_robot, parse_robot
from daq.robot.new_robot import new_robot_of_joints, new_robot_of_urdf, unknown_positions
from daq.robot.urdf_robot import UrdfArm, UrdfJoint, read_urdf_arm, robot_text_of_urdf
from drivers.core.errors import RobotFileError

LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="40"/>'
URDF = f"""\
<robot name="arm">
  <link name="base"/><link name="upper"/><link name="wrist"/><link name="flange"/><link name="tool0"/>
  <link name="camera"/><link name="finger"/>
  <joint name="turn" type="continuous"><parent link="upper"/><child link="wrist"/>
    <limit velocity="5" effort="0"/></joint>
  <joint name="swing" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>{LIMIT}</joint>
  <joint name="a" type="fixed"><parent link="wrist"/><child link="flange"/>
    <origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/></joint>
  <joint name="b" type="fixed"><parent link="flange"/><child link="tool0"/><origin xyz="0.2 0 0"/></joint>
  <joint name="c" type="fixed"><parent link="wrist"/><child link="camera"/><origin xyz="1 1 1"/></joint>
  <joint name="grip" type="prismatic"><parent link="base"/><child link="finger"/>{LIMIT}<mimic joint="turn"/></joint>
</robot>
"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    return path


def test_joints_limits_and_tool_come_from_the_urdf(urdf: Path) -> None:
    robot_file = load_robot(urdf)
    robot = robot_file.robot
    assert robot.joint_names == ("swing", "turn")
    assert robot.joints[0].position == (-1.0, 2.0)
    assert (robot.joints[0].velocity, robot.joints[0].torque) == (3.0, 40.0)
    assert robot.joints[1].torque is None  # an effort of 0 is what exporters write where nobody told them
    (loop,) = robot.model.loops
    assert (loop.joint, loop.equation, loop.offset) == ("grip", {"turn": 1.0}, 0.0)
    # tool0 is 0.2 m along the flange's x axis, which points down: 0.1 - 0.2 m.
    np.testing.assert_allclose(robot.workspace.tool, [0, 0, -0.1], atol=1e-9)
    np.testing.assert_allclose(robot.workspace.tool_rotation, [0, math.pi / 2, 0], atol=1e-9)


def test_what_a_urdf_does_not_say_is_assumed_and_stated(urdf: Path) -> None:
    text = "; ".join(assumptions(load_robot(urdf)))
    for words in ("acceleration limit 10 rad/s²", "link tool0", "-2π to 2π of the continuous joints (turn)"):
        assert words in text
    assert assumed_limits(load_robot("ur5e")) == ()


def test_every_joint_without_limits_is_named(urdf: Path) -> None:
    urdf.write_text(URDF.replace('upper="2" velocity="3"', "").replace('velocity="5"', 'velocity="0"'))
    with pytest.raises(RobotFileError, match="dynid robot new") as caught:
        load_robot(urdf)
    assert [one.where.rsplit(": ", 1)[1] for one in caught.value.problems] == ["joint swing", "joint turn"]
    assert "no position and no velocity limit" in caught.value.problems[0].message


@each(
    ("old", "new", "message"),
    [
        ('upper="2"', 'upper="inf"', "not finite"),
        ('upper="2"', 'upper="360"', "looks like degrees"),
        ('xyz="0.2 0 0"', 'xyz="0.2 0"', "not three numbers"),
        ('xyz="0.2 0 0"', 'xyz="0.2 zero 0"', "not a number"),
        ('xyz="0.2 0 0"', 'xyz="1e308 0 0"', "1e+308, which is not within -100 to 100 m"),
        ('xyz="0.2 0 0"', 'xyz="nan 0 0"', "not finite"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "joint swing: has an axis of length 0"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 1e-300"', "joint swing: has an axis of length 0"),
        ('<mimic joint="turn"/>', '<mimic joint="turn" multiplier="1e308"/>', "not within"),
        ("</robot>", '<joint type="revolute"/>' * 200 + "</robot>", "has 203 movable joints; at most 200"),
        ("</robot>", '<link name="x"/>' * 20_000 + "</robot>", "has 20007 links; at most 1000"),
        (
            '<robot name="arm">',
            '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/>',
            "xacro FILE",
        ),
    ],
)
def test_a_wrong_urdf_is_refused_with_its_path(urdf: Path, old: str, new: str, message: str) -> None:
    urdf.write_text(URDF.replace(old, new))
    with pytest.raises(RobotFileError, match=re.escape(message)) as caught:
        load_robot(urdf)
    assert str(caught.value).startswith(str(urdf))


def test_a_mimic_follows_through_others_what_moves_by_itself(urdf: Path) -> None:
    grip = '<mimic joint="turn"/>'
    second = '<mimic joint="grip" multiplier="-2" offset="0.5"/>'
    more = '<link name="f2"/><joint name="grip2" type="prismatic"><parent link="base"/><child link="f2"/>' + LIMIT
    chained = URDF.replace(grip, '<mimic joint="turn" multiplier="3" offset="1"/>')
    urdf.write_text(chained.replace("</robot>", f"{more}{second}</joint></robot>"))
    loops = {loop.joint: (loop.equation, loop.offset) for loop in load_robot(urdf).robot.model.loops}
    assert loops == {"grip": ({"turn": 3.0}, 1.0), "grip2": ({"turn": -6.0}, -1.5)}
    arm = read_urdf_arm(urdf.read_text(), "arm.urdf", where="arm.urdf")
    assert "equation: {turn: -6.0}, offset: -1.5" in new_robot_of_urdf(arm, "arm.urdf")
    for follows in ("nowhere", "grip", "a"):
        urdf.write_text(URDF.replace(grip, f'<mimic joint="{follows}"/>'))
        with pytest.raises(RobotFileError, match="not a joint that moves by itself") as caught:
            load_robot(urdf)
        assert caught.value.where.endswith("joint grip")


tags = st.sampled_from(["robot", "link", "joint", "parent", "child", "limit", "origin", "mimic", "axis"])
values = st.sampled_from(["a", "b", "c", "", "1", "-1", "nan", "1e400", "0 0 1", "revolute", "fixed", "continuous"])
names = st.sampled_from(["name", "type", "link", "xyz", "rpy", "lower", "upper", "velocity", "effort", "joint"])


@st.composite
def elements(draw: st.DrawFn, depth: int = 2) -> str:
    tag = draw(tags)
    attributes = "".join(
        f' {name}="{value}"' for name, value in draw(st.dictionaries(names, values, max_size=4)).items()
    )
    inner = "".join(draw(st.lists(elements(depth - 1), max_size=3))) if depth else ""
    return f"<{tag}{attributes}>{inner}</{tag}>"


@settings(max_examples=20)
@given(st.lists(elements(), max_size=3).map(lambda inner: f"<robot>{''.join(inner)}</robot>") | st.text(max_size=60))
def test_any_xml_is_an_arm_or_refused(xml: str) -> None:
    try:
        arm = read_urdf_arm(xml, "arm.urdf", where="arm.urdf")
        robot_text_of_urdf(arm, "arm.urdf", where="arm.urdf")
    except RobotFileError as error:
        where = error.where
    else:
        where = "arm.urdf" if arm.joints else "no joints"
    assert where.startswith("arm.urdf")


# --- dynid robot new --------------------------------------------------------------------------------------------------

letters = st.characters(exclude_categories=("C", "Zl", "Zp")) | st.sampled_from("./-_: #'\"[]{}e10")
words = st.text(letters, min_size=1, max_size=12).filter(lambda text: "TODO" not in text)
numbers = st.floats(0.001, 40.0)
joints = st.builds(
    UrdfJoint,
    name=words,
    kind=st.sampled_from(["revolute", "continuous", "prismatic"]),
    position=st.none() | numbers.map(lambda number: (-number, number)),
    velocity=st.none() | numbers,
    torque=st.none() | numbers,
)
arms = st.builds(
    UrdfArm,
    name=words,
    joints=st.lists(joints, min_size=1, max_size=4, unique_by=lambda joint: joint.name).map(tuple),
    mimics=st.just(()),
    tool_link=words,
    tool=st.tuples(numbers, numbers, numbers),
    tool_rotation=st.just((0.0, 0.0, math.pi)),
)


@settings(max_examples=20)
@given(arms, words)
def test_a_new_robot_file_of_a_urdf_needs_position_limits_alone(arm: UrdfArm, path: str) -> None:
    text, unknown = new_robot_of_urdf(arm, path), unknown_positions(arm)
    assert [joint.name for joint in arm.joints if joint.position is None] == list(unknown)
    if unknown:
        with pytest.raises(RobotFileError) as caught:
            parse_robot(text, where="arm.yaml", folder=None, urdf_text="")
        assert len(caught.value.problems) == 2 * len(unknown)
        assert all("TODO" in one.message for one in caught.value.problems), [str(one) for one in caught.value.problems]
    robot = parse_robot(text.replace("[TODO, TODO]", "[-1, 1]"), where="arm.yaml", folder=None, urdf_text="").robot
    assert robot.name == arm.name
    assert robot.model.urdf == path
    assert robot.joint_names == tuple(joint.name for joint in arm.joints)
    assert tuple(robot.connections["simulated"].model_extra["nodes"]) == robot.joint_names
    for limits, joint in zip(robot.joints, arm.joints, strict=True):
        assert limits.velocity == pytest.approx(joint.velocity or (0.1 if joint.kind == "prismatic" else 1.0), rel=1e-8)
        assert limits.position == pytest.approx(joint.position or (-1, 1), rel=1e-8)
        assert limits.torque == (joint.torque and pytest.approx(joint.torque, rel=1e-8))
    np.testing.assert_allclose(robot.workspace.tool, arm.tool, atol=1e-8)


@pytest.mark.parametrize("count", [1, 6])
def test_a_new_robot_file_of_rows_is_complete_but_for_its_todos(count: int) -> None:
    text = new_robot_of_joints(count)
    with pytest.raises(RobotFileError) as caught:
        parse_robot(text, where="arm.yaml", folder=None)
    assert len(caught.value.problems) == (4 + 3) * count
    assert all("TODO" in one.message for one in caught.value.problems)
    completed = text.replace("[TODO, TODO]", "[-1, 1]").replace("TODO", "0.5")
    assert parse_robot(completed, where="arm.yaml", folder=None).robot.dof == count
    assert "# drives:\n#   - {joint: j1, gain: TODO" in text


def test_limits_that_are_none_are_left_to_do(urdf: Path) -> None:
    xml = URDF.replace('upper="2"', 'upper="360"').replace('velocity="3"', 'velocity="200"')
    text = new_robot_of_urdf(read_urdf_arm(xml, "arm.urdf", where="arm.urdf"), "arm.urdf")
    assert "position: [TODO, TODO], velocity: 1" in text
    assert "the URDF says [-1.0, 360.0], which cannot be limits in rad; TODO (move): the URDF says 200 rad/s" in text


def test_a_new_robot_is_one_arm_its_gripper_and_what_is_beside_it_are_locked(urdf: Path) -> None:
    head = '<link name="head"/><joint name="look" type="revolute"><parent link="base"/><child link="head"/>'
    hand = '<link name="f1"/><joint name="Finger1" type="prismatic"><parent link="tool0"/><child link="f1"/>'
    limit = '<limit lower="0.5" upper="2" velocity="3" effort="40"/>'
    mimic = '<link name="f2"/><joint name="f2" type="prismatic"><parent link="tool0"/><child link="f2"/>'
    more = f'{head}{limit}</joint>{hand}{limit}</joint>{mimic}{limit}<mimic joint="Finger1" multiplier="-1"/></joint>'
    arm = read_urdf_arm(URDF.replace("</robot>", more + "</robot>"), "arm.urdf", where="arm.urdf", one_arm=True)
    assert [joint.name for joint in arm.joints] == ["swing", "turn"]
    assert dict(arm.locked) == {"look": 0.5, "Finger1": 0.5, "f2": -0.5}
    assert [mimic.name for mimic in arm.mimics] == ["grip"]
    assert arm.tool_link == "tool0"


def test_a_robot_knows_the_files_that_it_comes_from(urdf: Path) -> None:
    assert load_robot("ur5e").files == ()
    assert set(load_robot(urdf).files) == {urdf}
    folder = urdf.parent
    (folder / "frames.dbc").touch()
    other = "connections: {can: {driver: can_frames, dbc: frames.dbc, note: nothing.dbc, period: 3}}\n"
    (folder / "arm.yaml").write_text(
        robot_text_of_urdf(read_urdf_arm(URDF, urdf.name, where="arm"), urdf.name, where="arm") + other
    )
    assert {path.name for path in load_robot(folder / "arm.yaml").files} == {"arm.yaml", "arm.urdf", "frames.dbc"}


def test_what_ros_takes_is_read_though_it_is_no_sound_xml(urdf: Path, tmp_path: Path) -> None:
    path, text = tmp_path / "arm.urdf", urdf.read_text(encoding="utf-8")
    foreign = text.replace("<limit ", '<limit drake:acceleration="much" ').replace(
        "</robot>", '<drake:joint name="none"/></robot>'
    )
    path.write_text("\n \n" + foreign, encoding="utf-8")
    assert foreign != text
    assert load_robot(path).robot.joints == load_robot(urdf).robot.joints
