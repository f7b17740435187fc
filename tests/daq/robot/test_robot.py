"""The robot file: what is accepted, and that nothing else than a RobotFileError comes of the rest."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from each import each
from hypothesis import assume, given
from hypothesis import strategies as st
from two_joints import TWO_JOINTS

from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.schema import MdhRow, Robot
from drivers.core.errors import RobotFileError

URDF = """\
<robot name="pendulum">
  <link name="base"><visual><geometry><mesh filename="package://nowhere/base.stl"/></geometry></visual></link>
  <link name="arm"><visual><geometry><mesh filename="missing.dae"/></geometry></visual></link>
  <joint name="hinge" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""
URDF_ROBOT = (
    "name: pendulum\nmodel: {urdf: models/arm.urdf}\njoints:\n  - {name: hinge, position: [-1, 1], velocity: 1}\n"
)


def parse(text: str) -> RobotFile:
    return parse_robot(text, where="arm.yaml", folder=None)


# --- what is accepted -------------------------------------------------------------------------------------------------


def test_a_robot_file_becomes_a_robot() -> None:
    robot = parse(TWO_JOINTS).robot
    assert robot.joint_names == ("j1", "j2")
    assert robot.dof == 2
    assert robot.model.mdh is not None
    assert robot.model.mdh[0].antecedent == "base"
    assert robot.model.mdh[1].alpha == pytest.approx(-math.pi / 2)
    assert robot.model.gravity == (0.0, 0.0, -9.81)
    assert robot.joints[0].torque is None
    assert robot.friction.model == "auto"
    assert robot.friction.base == "coulomb-viscous"


@each(
    ("friction", "model"),
    [
        ("{offset: false}", "auto"),
        ("{joints: {j1: {viscous: false}}}", "auto"),
        ("{model: coulomb-viscous}", "coulomb-viscous"),
        ("{stribeck: true}", "coulomb-viscous"),
        ("{joints: {j2: {load: linear}}}", "coulomb-viscous"),
    ],
)
def test_friction_is_chosen_from_the_data_unless_a_model_or_a_term_is_stated(friction: str, model: str) -> None:
    assert parse(f"{TWO_JOINTS}friction: {friction}\n").robot.friction.model == model


def test_auto_friction_beside_a_stated_term_is_refused() -> None:
    with pytest.raises(RobotFileError, match="auto chooses the terms itself, and 'load' is stated"):
        parse(f"{TWO_JOINTS}friction: {{model: auto, load: linear}}\n")


def test_a_joint_without_a_drive_has_one_of_unknown_gain() -> None:
    robot = parse(TWO_JOINTS).robot
    assert robot.drive("j1").gain == -10.5
    assert robot.drive("j2").gain is None
    assert robot.drive("j2").signal == "current"
    assert robot.drive("j2").inertia


def test_the_text_is_kept_as_it_was_read() -> None:
    text = "# a comment\n" + TWO_JOINTS
    assert parse(text).text == text


def test_a_connection_keeps_the_keys_of_its_driver() -> None:
    robot = parse(TWO_JOINTS + "connections: {wire: {driver: rtde, host: 127.0.0.1, rate: 500}}\n").robot
    assert robot.connections["wire"].driver == "rtde"
    assert robot.connections["wire"].model_extra == {"host": "127.0.0.1", "rate": 500}


def test_a_robot_read_from_a_path_knows_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(TWO_JOINTS, encoding="utf-8")
    assert load_robot(path).folder == tmp_path.resolve()
    assert load_robot(str(path)).robot == parse(TWO_JOINTS).robot


def test_a_file_without_suffix_is_a_path_too(tmp_path: Path) -> None:
    path = tmp_path / "robot"
    path.write_text(TWO_JOINTS, encoding="utf-8")
    assert load_robot(path).robot.name == "arm"


def test_a_relative_urdf_starts_at_the_folder_of_the_robot_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robots" / "models").mkdir(parents=True)
    (tmp_path / "robots" / "models" / "arm.urdf").write_text(URDF, encoding="utf-8")
    (tmp_path / "robots" / "pendulum.yaml").write_text(URDF_ROBOT, encoding="utf-8")
    monkeypatch.chdir(tmp_path)  # the working directory must not matter
    robot_file = load_robot("robots/pendulum.yaml")
    assert robot_file.urdf_text == URDF


def test_meshes_of_a_urdf_need_not_exist(tmp_path: Path) -> None:
    from ident.model.dynamic_model import build_model

    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "arm.urdf").write_text(URDF, encoding="utf-8")
    (joint,) = build_model(parse_robot(URDF_ROBOT, where="arm.yaml", folder=tmp_path)).joints
    assert joint.name == "hinge"
    assert joint.translation.tolist() == [0, 0, 1]


def test_an_absolute_urdf_needs_no_folder(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    assert parse(URDF_ROBOT.replace("models/arm.urdf", str(path))).urdf_text == URDF


def test_a_known_urdf_text_is_not_read_again() -> None:
    assert parse_robot(URDF_ROBOT, where="run.h5", folder=None, urdf_text=URDF).urdf_text == URDF


# --- properties -------------------------------------------------------------------------------------------------------

small = st.floats(0, 10).map(lambda number: round(number, 6))


def parsed_angle(value: Any) -> float:
    return MdhRow.model_validate({"joint": "j", "alpha": value, "d": 0, "r": 0}).alpha


@each("key", ["gamma", "alpha", "theta0"])
def test_every_angle_of_a_row_may_be_a_multiple_of_pi(key: str) -> None:
    row = MdhRow.model_validate({"joint": "j", "alpha": 0, "d": 0, "r": 0} | {key: "-3*pi/4"})
    assert getattr(row, key) == pytest.approx(-0.75 * math.pi)


@given(st.floats(-2 * math.pi, 2 * math.pi))
def test_a_plain_number_is_an_angle_in_radians(number: float) -> None:
    assert parsed_angle(number) == number
    assert parsed_angle(repr(number)) == number


@given(
    sign=st.sampled_from(["", "+", "-"]),
    factor=st.none() | small,
    divisor=st.none() | small.filter(lambda number: number > 1e-5),
    blank=st.sampled_from(["", " ", "  "]),
)
def test_a_multiple_of_pi_is_that_multiple(sign: str, factor: float | None, divisor: float | None, blank: str) -> None:
    text = f"{blank}{sign}{blank}"
    text += "" if factor is None else f"{factor:.6f}{blank}*{blank}"
    text += "pi" if divisor is None else f"pi{blank}/{blank}{divisor:.6f}"
    expected = (-1 if sign == "-" else 1) * (1 if factor is None else factor) * math.pi / (divisor or 1)
    assume(abs(expected) <= 2 * math.pi)
    assert parsed_angle(text) == pytest.approx(expected, rel=1e-12)


@given(st.text(max_size=20))
def test_any_text_is_an_angle_or_refused(text: str) -> None:
    document = yaml.safe_dump(
        {"name": "arm", "model": {"mdh": [{"joint": "j", "alpha": text, "d": 0, "r": 0}]}} | JOINTS
    )
    try:
        robot = parse(document).robot
    except RobotFileError:
        return
    assert robot.model.mdh is not None
    assert math.isfinite(robot.model.mdh[0].alpha)


JOINTS: dict[str, Any] = {"joints": [{"name": "j", "position": [-1, 1], "velocity": 1}]}

keys = st.sampled_from(
    sorted({*Robot.model_fields, *MdhRow.model_fields, "mdh", "urdf", "gravity", "position", "links", "noise"})
)
scalars = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates() | st.binary(max_size=4)
)
trees = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys | scalars, inner, max_size=4),
    max_leaves=12,
)


def robot_or_refusal(text: str) -> None:
    """Nothing but a robot or a RobotFileError, which has a message, comes of any text."""
    message = ""
    try:
        robot_file = parse(text)
    except RobotFileError as error:
        message = error.message
    if message:
        assert len(message) < 1000 + len(text)
    else:
        assert robot_file.robot.dof >= 1


@given(trees)
def test_any_tree_is_a_robot_or_refused(tree: Any) -> None:
    robot_or_refusal(yaml.safe_dump(tree, allow_unicode=True))


@given(st.dictionaries(st.sampled_from(sorted(Robot.model_fields)), trees, max_size=8))
def test_any_mapping_of_the_right_keys_is_a_robot_or_refused(content: dict[str, Any]) -> None:
    robot_or_refusal(yaml.safe_dump({"name": "arm", "model": {"mdh": [1]}} | JOINTS | content))


@given(st.text(max_size=200))
def test_any_text_is_a_robot_or_refused(text: str) -> None:
    robot_or_refusal(text)


pieces = st.sampled_from(
    [*"{}[]:,-?&*!|>'\"%@` \n\t#aj0.e<~", "!!int ", "!!float ", "!!timestamp ", "<<: ", "&a ", "*a "]
)


@given(st.lists(pieces, max_size=40).map("".join))
def test_any_yaml_punctuation_is_a_robot_or_refused(text: str) -> None:
    robot_or_refusal(text)


@given(position=st.integers(0, len(TWO_JOINTS) - 1), piece=st.text(max_size=4), removed=st.integers(0, 12))
def test_a_damaged_file_is_a_robot_or_refused(position: int, piece: str, removed: int) -> None:
    robot_or_refusal(TWO_JOINTS[:position] + piece + TWO_JOINTS[position + removed :])
