"""The robot file: what is refused, and in which words: file, key path, what was found, what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest
from each import each
from two_joints import TWO_JOINTS

from daq.robot.loader import builtin_robots, load_robot, parse_robot
from daq.robot.urdf_check import checked_urdf
from drivers.core.errors import RobotFileError

URDF_ROBOT = (
    "name: pendulum\nmodel: {urdf: models/arm.urdf}\njoints:\n  - {name: hinge, position: [-1, 1], velocity: 1}\n"
)


def replaced(old: str, new: str) -> str:
    assert TWO_JOINTS.count(old) == 1, old
    return TWO_JOINTS.replace(old, new)


def refusal(text: str) -> RobotFileError:
    with pytest.raises(RobotFileError) as caught:
        parse_robot(text, where="arm.yaml", folder=None)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert caught.value.where.startswith("arm.yaml")
    return caught.value


ROW_2 = "{joint: j2, antecedent: j1, alpha: -pi/2, d: 0.1, theta0: pi/2, r: 0}"
JOINT_2 = "{name: j2, position: [-1.5, 1.5], velocity: 2, torque: 40}"

# text, where (behind the file's name), words of the message and the hint
REFUSED: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "not YAML": ("name: [arm\nmodel: {}\n", ", line ", ("not valid YAML",)),
    "tab as indentation": ("name: arm\nmodel:\n\tmdh: []\n", ", line 3, column 1", ("not valid YAML", "\\t")),
    "control character": ("name: a\x00rm\n", "", ("not valid YAML", "special characters")),
    "key twice": (replaced("joints:", "name: again\njoints:"), ", line 6, column 1", ("key 'name' appears twice",)),
    "nested key twice": (
        replaced("velocity: 2}", "velocity: 2, velocity: 3}"),
        ", line 7",
        ("'velocity' appears twice",),
    ),
    "impossible date": (TWO_JOINTS + "description: 2026-99-99\n", ", line 11, column 14", ("cannot read the value",)),
    "foreign tag": (TWO_JOINTS + "description: !!python/name:os.system\n", ", line 11", ("could not determine",)),
    "list": ("- name: arm\n", "", ("a robot file is a mapping", "[{'name': 'arm'}]", "dynid robot show")),
    "number": ("42", "", ("a robot file is a mapping", "this is 42")),
    "empty": ("# nothing\n", "", ("a robot file is a mapping", "this is nothing")),
    "unknown key": (
        TWO_JOINTS + "frictoin: {}\n",
        ": frictoin",
        ("unknown key", "connections", "did you mean 'friction'?"),
    ),
    "unknown key of a joint": (
        replaced("velocity: 2}", "velocty: 2}"),
        ": joints[0].velocty",
        ("unknown key", "name, position, velocity", "did you mean 'velocity'?"),
    ),
    "unknown key of an mdh row": (
        replaced("r: 0.3", "r: 0.3, a: 0"),
        ": model.mdh[0].a",
        ("unknown key", "antecedent", "theta0"),
    ),
    "unknown key in a mapping by joint": (
        TWO_JOINTS + "truth: {links: {j1: {mass: 1, comm: [0, 0, 0], inertia: [1, 0, 0, 1, 0, 1]}}}\n",
        ": truth.links.j1.comm",
        ("unknown key", "mass, com, inertia", "did you mean 'com'?"),
    ),
    "key that is a number": (TWO_JOINTS + "1: one\n", ": [1]", ("found 1", "keys should be strings")),
    "missing key": (replaced("name: arm\n", ""), ": name", ("this key is missing",)),
    "missing key in a row": (replaced("d: 0, r: 0.3", "d: 0"), ": model.mdh[0].r", ("this key is missing",)),
    "empty name": (replaced("name: arm", "name: ''"), ": name", ("found ''", "at least 1 character")),
    "wrong type": (
        replaced("velocity: 2}", "velocity: fast}"),
        ": joints[0].velocity",
        ("found 'fast'", "valid number"),
    ),
    "truth value for a number": (
        replaced("d: 0.1", "d: yes"),
        ": model.mdh[1].d",
        ("found true", "should be a number"),
    ),
    "text where a section belongs": (
        replaced("name: arm", "name: arm\ntruth: none"),
        ": truth",
        ("found 'none'", "should be a mapping of keys"),
    ),
    "unknown kind of joint": (
        replaced("alpha: 0,", "alpha: 0, type: helical,"),
        ": model.mdh[0].type",
        ("found 'helical'", "'revolute' or 'prismatic'"),
    ),
    "angle that is no number": (
        replaced("alpha: 0,", "alpha: 90deg,"),
        ": model.mdh[0].alpha",
        ("found '90deg'", "valid number"),
    ),
    "angle divided by zero": (replaced("alpha: 0,", "alpha: pi/0,"), ": model.mdh[0].alpha", ("division by zero",)),
    "neither urdf nor mdh": ("name: arm\nmodel: {}\njoints: []\n", ": model", ("exactly one of 'urdf' and 'mdh'",)),
    "both urdf and mdh": (
        replaced("  mdh:", "  urdf: arm.urdf\n  mdh:"),
        ": model",
        ("exactly one of 'urdf' and 'mdh'",),
    ),
    "no rows": ("name: arm\nmodel: {mdh: []}\njoints: []\n", ": model", ("'mdh' has no rows",)),
    "joint twice in mdh": (replaced("joint: j2,", "joint: j1,"), ": model", ("'mdh' names joint 'j1' twice",)),
    "joint called base": (replaced("joint: j1, alpha", "joint: base, alpha"), ": model", ("a joint is named 'base'",)),
    "antecedent unknown": (
        replaced("antecedent: j1", "antecedent: j0"),
        ": model",
        ("joint 'j2' has antecedent 'j0'", "base, j1"),
    ),
    "antecedent comes later": (
        replaced("joint: j1, alpha", "joint: j1, antecedent: j2, alpha"),
        ": model",
        ("joint 'j1' has antecedent 'j2'", "before it come only: base"),
    ),
    "joints in another order": (
        replaced(f"  - {JOINT_2}\n", "").replace("joints:\n", f"joints:\n  - {JOINT_2}\n"),
        "",
        ("'joints' must name the joints of 'model.mdh' in its order: j1, j2", "found: j2, j1"),
    ),
    "no joints": ("name: arm\nmodel: {urdf: arm.urdf}\njoints: []\n", ": joints", ("found []", "at least 1 item")),
    "joint twice": (
        "name: arm\nmodel: {urdf: arm.urdf}\njoints:\n" + 2 * "  - {name: j, position: [0, 1], velocity: 1}\n",
        "",
        ("'joints' names 'j' twice",),
    ),
    "limits reversed": (
        replaced("[-1.5, 1.5]", "[1.5, -1.5]"),
        ": joints[1]",
        ("[1.5, -1.5]", "not in ascending order"),
    ),
    "limits equal": (replaced("[-1.5, 1.5]", "[1, 1]"), ": joints[1]", ("[1.0, 1.0]", "not in ascending order")),
    "one limit only": (replaced("[-1.5, 1.5]", "[1.5]"), ": joints[1].position[1]", ("entry of the list is missing",)),
    "limit not a number": (replaced("[-1.5, 1.5]", "[.nan, 1.5]"), ": joints[1].position[0]", ("found nan", "finite")),
    "limit infinite": (replaced("[-1.5, 1.5]", "[-.inf, 1.5]"), ": joints[1].position[0]", ("found -inf", "finite")),
    "velocity zero": (replaced("velocity: 2}", "velocity: 0}"), ": joints[0].velocity", ("found 0", "greater than 0")),
    "torque negative": (replaced("torque: 40", "torque: -40"), ": joints[1].torque", ("found -40", "greater than 0")),
    "gravity in mm": (
        replaced("joints:", "  gravity: [0, 0, -9810]\njoints:"),
        ": model",
        ("[0.0, 0.0, -9810.0] m/s²", "check the unit"),
    ),
    "gravity of two numbers": (
        replaced("joints:", "  gravity: [0, -9.81]\njoints:"),
        ": model.gravity[2]",
        ("entry of the list is missing",),
    ),
    "gain zero": (replaced("gain: -10.5", "gain: 0"), ": drives[0]", ("a gain of 0 would erase the signal",)),
    "gain with negative deviation": (
        replaced("gain_std: 0.5", "gain_std: -1"),
        ": drives[0].gain_std",
        ("found -1", "equal to 0"),
    ),
    "unknown signal": (
        replaced("gain: -10.5", "signal: watt"),
        ": drives[0].signal",
        ("found 'watt'", "'voltage', 'torque' or 'magnitude'"),
    ),
    "drive of no joint": (
        replaced("{joint: j1, gain", "{joint: j7, gain"),
        "",
        ("'drives' names joint 'j7'", "only: j1, j2"),
    ),
    "drive twice": (TWO_JOINTS + "  - {joint: j1, gain: 3}\n", "", ("'drives' names 'j1' twice",)),
    "friction of no joint": (
        TWO_JOINTS + "friction: {joints: {j3: {offset: false}}}\n",
        "",
        ("'friction.joints' names joint 'j3'", "only: j1, j2"),
    ),
    "unknown friction model": (
        TWO_JOINTS + "friction: {model: stribeck}\n",
        ": friction.model",
        ("found 'stribeck'", "'none', 'viscous', 'coulomb' or 'coulomb-viscous'"),
    ),
    "truth of no joint": (TWO_JOINTS + "truth: {joints: {j9: {}}}\n", "", ("'truth.joints' names joint 'j9'",)),
    "noise of no joint": (
        TWO_JOINTS + "truth: {noise: {torque_std: {j9: 1}}}\n",
        "",
        ("'truth.noise.torque_std' names joint 'j9'",),
    ),
    "negative mass": (
        TWO_JOINTS + "truth: {links: {j1: {mass: -1, com: [0, 0, 0], inertia: [1, 0, 0, 1, 0, 1]}}}\n",
        ": truth.links.j1.mass",
        ("found -1", "greater than 0"),
    ),
    "locked with mdh": (
        replaced("joints:", "  locked: {j3: 0}\njoints:"),
        ": model",
        ("'locked' works with 'urdf' only",),
    ),
    "unknown length": (
        replaced("model:", "model:\n  lengths: {d2: 0.1}").replace("d: 0.1, theta0", "d: d3, theta0"),
        ": model",
        ("'d: d3' refers to no length of 'lengths'; there are: d2",),
    ),
    "length that is no number": (
        replaced("model:", "model:\n  lengths: {d2: long}").replace("d: 0.1, theta0", "d: d2, theta0"),
        ": model",
        ("the length 'd2' is to be a number, found 'long'",),
    ),
    "loops": (
        replaced("joints:", "  loops: [{}]\njoints:"),
        ": model.loops[0]",
        ("either 'joint' with 'equation', or 'parallelogram'",),
    ),
    "coupling": (
        replaced("joints:", "  coupling: {j2: 1}\njoints:"),
        ": model.coupling.j2",
        ("found 1", "should be a mapping of keys"),
    ),
    "connection without driver": (
        TWO_JOINTS + "connections: {wire: {host: x}}\n",
        ": connections.wire.driver",
        ("this key is missing",),
    ),
    "relative urdf without a place": (URDF_ROBOT, ": model.urdf", ("'models/arm.urdf'", "has no base folder")),
}


@each(("text", "where", "words"), REFUSED.values())
def test_a_bad_file_is_refused_in_its_own_words(text: str, where: str, words: tuple[str, ...]) -> None:
    error = refusal(text)
    assert error.where == f"arm.yaml{where}" or (
        where.startswith(", line") and error.where.startswith(f"arm.yaml{where}")
    )
    for word in words:
        assert word in str(error), str(error)


def test_further_problems_are_counted() -> None:
    error = refusal("name: arm\nmodel: {mdh: [{joint: j1, alpha: a, d: b, r: c}]}\njoints: []\n")
    assert error.where == "arm.yaml: model.mdh[0].alpha"
    assert error.hint == "[rad]; 3 more problems in this file"
    assert [problem.where.removeprefix("arm.yaml: ") for problem in error.problems] == [
        "model.mdh[0].alpha",
        "model.mdh[0].d",
        "model.mdh[0].r",
        "joints",
    ]


def test_a_long_value_is_shortened() -> None:
    assert len(refusal(f"name: {['x' * 5000] * 50}\n").message) < 200


def test_nested_aliases_do_not_fill_the_memory() -> None:
    # Ten aliases a level, twenty levels: written out it would be 1e20 items.
    levels = "".join(f"  a{level}: &a{level} [{', '.join(10 * [f'*a{level - 1}'])}]\n" for level in range(1, 21))
    error = refusal(f"name:\n  a0: &a0 [x]\n{levels}")
    assert error.where == "arm.yaml, line 8, column 7"
    assert "aliases and merge keys stand for more than 1000000 values" in error.message
    merges = "".join(
        f"  a{level}: &a{level} {{<<: [{', '.join(10 * [f'*a{level - 1}'])}]}}\n" for level in range(1, 21)
    )
    assert "aliases and merge keys" in refusal(f"name:\n  a0: &a0 {{x: 1}}\n{merges}").message


@each("number", ["9" * 5000, "0x" + "9" * 5000, "1:" * 5000 + "1", "9" * 5000 + ".5"])
def test_a_number_of_thousands_of_characters_is_named_by_its_line(number: str) -> None:
    error = refusal(f"name: arm\nmodel: {number}\n")
    assert error.where == "arm.yaml, line 2, column 8"
    assert "of 500" in error.message or "of 10001" in error.message


def test_deep_nesting_is_an_error_not_a_crash() -> None:
    assert refusal("name: " + "[" * 5000 + "]" * 5000)


@pytest.mark.parametrize("urdf", ["missing.urdf", ".", "~nobody-of-this-name/arm.urdf"])
def test_a_urdf_that_cannot_be_read_names_the_path(tmp_path: Path, urdf: str) -> None:
    with pytest.raises(RobotFileError, match="cannot read the URDF") as caught:
        parse_robot(URDF_ROBOT.replace("models/arm.urdf", f'"{urdf}"'), where="arm.yaml", folder=tmp_path)
    assert caught.value.where == "arm.yaml: model.urdf"
    assert "robot file's folder" in caught.value.hint


def test_a_urdf_that_is_not_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_bytes(b"\xff\xfe\x00binary")
    with pytest.raises(RobotFileError, match="cannot read the URDF"):
        parse_robot(URDF_ROBOT.replace("models/", ""), where="arm.yaml", folder=tmp_path)


def test_a_missing_robot_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "ur5.yaml"
    with pytest.raises(RobotFileError, match="no such file") as caught:
        load_robot(path)
    assert caught.value.where == str(path)


def test_a_robot_file_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_bytes(b"name: \xff\xfe")
    with pytest.raises(RobotFileError, match="cannot be read"):
        load_robot(path)


def test_a_misspelt_built_in_robot_gets_a_suggestion() -> None:
    with pytest.raises(RobotFileError, match="no built-in robot and no file is called 'ur5'") as caught:
        load_robot("ur5")
    assert caught.value.hint == "did you mean 'ur5e'?"


def test_an_unknown_robot_gets_the_list() -> None:
    with pytest.raises(RobotFileError) as caught:
        load_robot("tractor")
    assert caught.value.hint == f"built-in: {', '.join(builtin_robots())}"


def test_an_arm_of_too_many_joints_is_refused() -> None:
    joint, row = "  - {name: j2, ", "    - {joint: j2, "
    rows = "".join(f"    - {{joint: k{number}, alpha: 0, d: 0, r: 0}}\n" for number in range(60))
    joints = "".join(f"  - {{name: k{number}, position: [-1, 1], velocity: 1}}\n" for number in range(60))
    assert "at most 50" in refusal(TWO_JOINTS.replace(row, rows + row)).message
    assert "at most 50" in refusal(TWO_JOINTS.replace(joint, joints + joint)).message


@each("hidden", ["\\e[2J", "\\0", "\\x9b", "\\u202e", "\\n", "\\t"])
@each("place", ["name: arm", "{name: j1", "connection"])
def test_a_name_that_commands_a_terminal_is_refused(hidden: str, place: str) -> None:
    if place == "connection":
        text = f'{TWO_JOINTS}connections:\n  "r{hidden}": {{driver: rtde}}\n'
    else:
        text = replaced(place, f'{place.replace(": ", ": " + chr(34))}{hidden}"')
    assert "holds " in refusal(text).message
    assert "character" in refusal(text).message


@each("place", ['link name="a"', 'joint name="j"', 'child link="b"'])
def test_a_urdf_with_a_name_that_ends_a_line_is_refused(place: str) -> None:
    xml = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed"><parent link="a"/>'
        '<child link="b"/></joint></robot>'
    )
    checked_urdf(xml, "arm.urdf")
    with pytest.raises(RobotFileError, match=r"holds the character .u000a; change it"):
        checked_urdf(xml.replace(place, place[:-1] + '&#10;"'), "arm.urdf")


def test_an_empty_or_endless_name_is_refused_where_it_stands() -> None:
    for name, words in (("", "without a name"), ("j" * 5000, "has 5000 characters, more than 200")):
        xml = (
            f'<robot name="r"><link name="a"/><link name="b"/><joint name="{name}" type="fixed"><parent link="a"/>'
            '<child link="b"/></joint><material name=""/></robot>'
        )
        with pytest.raises(RobotFileError, match=words):
            checked_urdf(xml, "arm.urdf")
    assert "is empty" in refusal(replaced("{name: j1", '{name: ""')).message
    assert "more than 200" in refusal(replaced("{name: j1", f"{{name: {'j' * 201}")).message


def test_servo_parameters_of_no_joint_are_refused() -> None:
    assert "'servo' names joint 'nobody'" in refusal(TWO_JOINTS + "servo: {nobody: {stiffness: 1}}\n").message
