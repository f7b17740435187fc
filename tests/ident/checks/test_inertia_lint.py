"""`dynid lint`: each slip in a description is found by name, and a sound description has none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daq.robot.loader import builtin_robots
from drivers.core.errors import RobotFileError
from ident.checks.inertia_lint import lint

# A box of 0.1 x 0.1 x 0.4 m, 3 kg and its inertia, from one joint to the next.
BODY = (
    '<origin xyz="0 0 0.2"/><mass value="3"/><inertia ixx="0.0425" ixy="0" ixz="0" iyy="0.0425" iyz="0" izz="0.005"/>'
)
SHAPE = '<collision><origin xyz="0 0 0.2"/><geometry><box size="0.1 0.1 0.4"/></geometry></collision>'
LIMIT = '<limit lower="-2" upper="2" velocity="3.1" effort="60"/>'


def urdf(second: str = BODY, *, limit: str = LIMIT, third: str = BODY.replace('"3"', '"2"')) -> str:
    text = '<robot name="arm"><link name="base"/>'
    for number, body in enumerate((BODY.replace('"3"', '"4"'), second, third), start=1):
        parent = f"l{number - 1}" if number > 1 else "base"
        text += (
            f'<link name="l{number}"><inertial>{body}</inertial>{SHAPE}</link><joint name="j{number}" type="revolute">'
            f'<parent link="{parent}"/><child link="l{number}"/><origin xyz="0 0 0.4"/>'
            f'<axis xyz="0 1 0"/>{limit}</joint>'
        )
    return text + "</robot>"


def found(tmp_path: Path, text: str) -> set[tuple[str, str, str]]:
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    return {(one.severity, one.check, link) for one in lint(str(path)).findings for link in one.links}


def test_a_sound_urdf_lacks_only_its_rotors(tmp_path: Path) -> None:
    assert found(tmp_path, urdf()) == {("note", "rotor", "arm")}


def test_each_slip_is_found_where_it_is(tmp_path: Path) -> None:
    ten = BODY.replace("0.0425", "0.425").replace("0.005", "0.05")
    thousand = BODY.replace("0.0425", "42.5").replace('"0.005"', '"5"')
    about_origin = BODY.replace('"0.0425"', '"0.1625"')
    cases: dict[str, tuple[str, tuple[str, str]]] = {
        "no mass": (BODY.replace('"3"', '"0"'), ("error", "mass")),
        "triangle": (BODY.replace("0.005", "0.5"), ("error", "triangle")),
        "negative": (BODY.replace("0.005", "-0.005"), ("error", "triangle")),
        "no inertia": (BODY.replace("0.0425", "0").replace("0.005", "0"), ("error", "triangle")),
        "ten times": (ten, ("note", "gyration")),
        "thousand times": (thousand, ("error", "gyration")),
        "a point": (BODY.replace("0.0425", "0.00000425").replace("0.005", "0.0000005"), ("note", "gyration")),
        "about the origin": (about_origin, ("note", "origin")),
        "placeholder": (BODY.replace("0.0425", "0.001").replace("0.005", "0.001"), ("error", "placeholder")),
        "centre elsewhere": (BODY.replace('xyz="0 0 0.2"', 'xyz="0 0 20"'), ("error", "centre")),
        "grams": (BODY.replace('"3"', '"3000"'), ("error", "mass")),
        "a decimal": (BODY.replace('"3"', '"0.03"'), ("note", "decimal-slip")),
        "a copy": (BODY.replace('"3"', '"4"'), ("note", "copied")),
    }
    wrong = {
        name: seen
        for name, (body, expected) in cases.items()
        if (*expected, "l2") not in (seen := found(tmp_path, urdf(body)))
    }
    assert not wrong


def test_limits_that_were_typed_in_and_arms_that_cannot_hold_themselves(tmp_path: Path) -> None:
    placeholders = found(tmp_path, urdf(limit='<limit lower="-2" upper="2" velocity="10" effort="1000"/>'))
    assert {check for _, check, _ in placeholders} == {"limit", "rotor"}
    missing = found(tmp_path, urdf(limit='<limit lower="-2" upper="2" velocity="0" effort="0"/>'))
    assert ("note", "limit", "j2") in missing
    weak = found(tmp_path, urdf(limit='<limit lower="-2" upper="2" velocity="3" effort="8"/>'))
    assert {link for severity, check, link in weak if check == "gravity"} == {"j1", "j2"}


def test_built_in_arms_have_no_errors() -> None:
    wrong = {name: found for name in builtin_robots() if (found := lint(name).untrusted)}
    assert not wrong


def test_the_command_says_whom_to_trust(tmp_path: Path, run_dynid) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(BODY.replace("0.005", "0.5")))
    status, out, _ = run_dynid("lint", path)
    assert status == 1
    assert out.splitlines()[0].startswith("error: l2: no body has the principal moments")
    assert out.splitlines()[-1] == "no controller can trust: l2"
    assert all(line.count(": ") >= 2 for line in out.splitlines()[:-2])
    status, out, _ = run_dynid("lint", "ur5e", "--json")
    assert (status, json.loads(out)["untrusted"]) == (0, [])
    path.write_text(
        '<robot name="a"><link name="b"/><link name="c"/><joint name="j" type="continuous">'
        '<parent link="b"/><child link="c"/></joint></robot>'
    )
    with pytest.raises(RobotFileError, match="states no mass"):
        lint(str(path))
