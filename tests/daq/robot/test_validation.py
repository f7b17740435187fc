"""Everything that is wrong with a robot file is told at once, and degrees are recognised."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.robot.loader import parse_robot
from daq.robot.schema import MdhRow
from daq.robot.section import multiple_of_pi
from drivers.core.errors import RobotFileError
from drivers.core.ranges import NUMBER, POSITION_LIMIT, VELOCITY_LIMIT

ARM = """\
name: arm
model:
  mdh:
    - {joint: j1, alpha: A, d: 0, r: 0.3}
    - {joint: j2, antecedent: B, alpha: -pi/2, d: 0.1, theta0: C, r: 0}
joints:
  - {name: j1, position: [D, 3], velocity: E}
  - {name: F, position: [-1.5, 1.5], velocity: 2, torque: 40}
drives:
  - {joint: G, gain: -10.5}
poses: {home: H}
"""
RIGHT = {"A": "0", "B": "j1", "C": "0", "D": "-3", "E": "2", "F": "j2", "G": "j1", "H": "[0, 1]"}
WRONG = {
    "A": ("90", "model.mdh[0].alpha", "90° is pi/2"),
    "B": ("j0", "model", "joint 'j2' has antecedent 'j0'"),
    "C": ("-90", "model.mdh[1].theta0", "-90° is -pi/2"),
    "D": ("-180", "joints[0].position[0]", "-180° is -pi"),
    "E": ("180", "joints[0].velocity", "180 °/s is 3.142"),
    "F": ("j3", "", "'joints' must name the joints of 'model.mdh' in its order: j1, j2; found: j1, j3"),
    "G": ("j9", "", "'drives' names joint 'j9'"),
    "H": ("[0]", "", "'poses.home' has 1 position, but the arm has 2 joints"),
}


def filled(values: dict[str, str]) -> str:
    text = ARM
    for letter, place in {letter: f" {letter}" for letter in RIGHT}.items():
        text = text.replace(place, f" {values[letter]}").replace(f"[{letter},", f"[{values[letter]},")
    return text


def problems(text: str) -> tuple[RobotFileError, ...]:
    with pytest.raises(RobotFileError) as caught:
        parse_robot(text, where="arm.yaml", folder=None)
    assert str(caught.value).startswith(str(caught.value.problems[0])[:30])
    return caught.value.problems


def test_the_right_file_is_right() -> None:
    robot = parse_robot(filled(RIGHT), where="arm.yaml", folder=None).robot
    assert robot.poses == {"home": (0.0, 1.0)}


@given(st.sets(st.sampled_from(sorted(WRONG)), min_size=1))
def test_every_problem_is_told_whatever_else_is_wrong(letters: set[str]) -> None:
    found = problems(filled(RIGHT | {letter: WRONG[letter][0] for letter in letters}))
    for letter in letters:
        _, key, words = WRONG[letter]
        where = f"arm.yaml: {key}" if key else "arm.yaml"
        assert any(one.where == where and words in one.message for one in found), (letter, [str(one) for one in found])
    assert len(found) == len(letters)


@given(st.sets(st.sampled_from(sorted(RIGHT)), min_size=1))
def test_what_is_still_todo_is_listed_each_once(letters: set[str]) -> None:
    found = problems(filled(RIGHT | dict.fromkeys(letters, "TODO")))
    unfilled = [one for one in found if "TODO" in one.message]
    assert len(unfilled) == len(letters)
    assert len({one.where for one in unfilled}) == len(letters)


def test_todo_in_a_text_that_would_be_accepted_is_listed() -> None:
    (problem,) = problems(filled(RIGHT) + "description: TODO, say what it is\n")
    assert problem.where == "arm.yaml: description"


def test_a_todo_behind_an_alias_that_contains_itself_ends() -> None:
    problems("name: &a [TODO, *a]\n" + filled(RIGHT).removeprefix("name: arm\n"))


@given(st.integers(-720, 720))
def test_an_angle_in_degrees_is_spelt_in_the_files_own_words(degrees: int) -> None:
    row = {"joint": "j", "alpha": multiple_of_pi(degrees), "d": 0, "r": 0}
    if abs(degrees) <= 360:
        assert MdhRow.model_validate(row).alpha == pytest.approx(math.radians(degrees), abs=1e-5)
    else:
        assert "pi" in row["alpha"] or float(row["alpha"]) == pytest.approx(math.radians(degrees), rel=1e-5)


@given(st.floats(2 * math.pi + 0.001, NUMBER.most), st.sampled_from([1, -1]))
def test_no_angle_of_a_table_is_beyond_a_turn(angle: float, sign: int) -> None:
    (problem,) = problems(filled(RIGHT | {"A": repr(sign * angle)}))
    assert "looks like degrees" in problem.message


def test_what_is_written_with_pi_is_in_radians_whatever_its_size() -> None:
    text = filled(RIGHT | {"D": "-20*pi", "E": f"{VELOCITY_LIMIT.most}"})
    assert parse_robot(text, where="arm.yaml", folder=None).robot.joints[0].position[0] == pytest.approx(-20 * math.pi)
    (problem,) = problems(filled(RIGHT | {"D": f"-{POSITION_LIMIT.most + 1}"}))
    assert "46" in problem.message


@pytest.mark.parametrize(
    ("key", "value", "words"), [("D", "-400", "-400 mm is -0.4"), ("E", "250", "250 mm/s is 0.25")]
)
def test_limits_of_a_sliding_joint_are_in_metres(tmp_path, key: str, value: str, words: str) -> None:
    """The kinematics say which joint slides: the rows of a table, or a URDF."""
    text = filled(RIGHT | {key: value})
    of_table = text.replace("{joint: j1, alpha: 0", "{joint: j1, type: prismatic, alpha: 0")
    (tmp_path / "arm.urdf").write_text('<robot><joint name="j1" type="prismatic"/></robot>', encoding="utf-8")
    rows = text[text.index("  mdh:") : text.index("joints:\n")]
    for changed in (of_table, text.replace(rows, "  urdf: arm.urdf\n")):
        with pytest.raises(RobotFileError) as caught:
            parse_robot(changed, where="arm.yaml", folder=tmp_path)
        assert words in caught.value.message
        assert not {"°", "rad"} & set(caught.value.message.replace("°", " ° ").split())
