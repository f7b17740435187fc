"""`dynid robot new`: a URDF becomes a robot file that can be simulated at once, or is refused in a line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from daq.robot.loader import load_robot
from drivers.core.errors import InputError, RobotFileError, UsageError
from ident.excite.motion_check import ArmMotionCheck
from ident.model.dynamic_model import build_model
from ident.model.dynamics.rigid_arm import rigid_arm
from ident.model.true_parameters import truth_vector
from ident.tasks.new_robot import new_robot_file
from sim_drivers.plant.plant import Plant
from sim_drivers.serving import wire_of


def inertial(mass: float = 2.0, inertia: tuple[float, float, float] = (0.02, 0.02, 0.01)) -> str:
    xx, yy, zz = inertia
    return (
        f'<inertial><origin xyz="0 0 0.2"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    )


def joint(name: str, parent: str, child: str, *, kind: str = "revolute", limit: str = "", body: str = "") -> str:
    stated = limit or '<limit lower="-2" upper="2" velocity="3" effort="60"/>'
    return (
        f'<link name="{child}">{body or inertial()}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>{stated}</joint>'
    )


def arm_of(*joints: str, base: str = '<link name="base"/>') -> str:
    return f'<robot name="arm">{base}{"".join(joints)}</robot>'


PLAIN = arm_of(joint("a", "base", "upper"), joint("b", "upper", "lower"))


def new(tmp_path: Path, xml: str | bytes):
    urdf = tmp_path / "arm.urdf"
    urdf.write_bytes(xml if isinstance(xml, bytes) else xml.encode())
    return new_robot_file(urdf, out=tmp_path / "arm.yaml", overwrite=True)


def test_the_urdfs_bodies_are_the_truth_and_its_poses_can_be_reached(tmp_path: Path) -> None:
    written = new(tmp_path, PLAIN)
    assert written.todo == 0
    robot_file = load_robot(tmp_path / "arm.yaml")
    robot, model = robot_file.robot, build_model(robot_file)
    for name in ("a", "b"):
        assert robot.truth.links[name].mass == 2.0
        assert robot.truth.links[name].com == pytest.approx((0, 0, 0.2))
        assert robot.truth.links[name].inertia == pytest.approx((0.02, 0, 0, 0.02, 0, 0.01))
        assert 0 < robot.truth.joints[name].coulomb < 0.2 * 60
    assert wire_of(robot_file) == "canopen"
    plant = Plant(robot_file, position=np.array(robot.poses["start"]))
    plant.advance(0.2)
    np.testing.assert_allclose(plant.position, robot.poses["start"], atol=0.01)
    assert np.all(ArmMotionCheck(robot_file).clear(np.array(list(robot.poses.values())).T))
    arm = rigid_arm(model, truth_vector(robot_file)[:20], np.zeros(2))
    assert any(np.all(np.abs(arm.gravity(np.array(pose))) < 0.05 * 60) for pose in robot.poses.values())


LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="60"/>'


def test_a_urdf_of_the_wild_runs_or_is_refused_in_one_line(tmp_path: Path) -> None:
    """What is done about each: words of the file, or of the message."""
    two = joint("b", "upper", "lower")
    wild: dict[str, tuple[str | bytes, str]] = {
        "meshes of a package": (
            PLAIN.replace(
                "</link>", '<visual><geometry><mesh filename="package://x/a.dae"/></geometry></visual></link>', 2
            ),
            "name: arm",
        ),
        "no inertia anywhere": (PLAIN.replace(inertial(), ""), "assumed: the URDF states no mass"),
        "mass 0": (PLAIN.replace('value="2.0"', 'value="0"'), "assumed: the URDF states no mass"),
        "an inertia that no body has": (
            PLAIN.replace(inertial(), inertial(inertia=(0.5, 0.01, 0.01))),
            "its inertia is impossible",
        ),
        "a fixed chain": (
            PLAIN.replace(
                "</robot>",
                '<link name="tool0"/>'
                '<joint name="f" type="fixed"><parent link="lower"/>'
                '<child link="tool0"/><origin xyz="0 0 0.1"/></joint></robot>',
            ),
            "link tool0",
        ),
        "continuous": (
            arm_of(joint("a", "base", "upper", kind="continuous", limit="<limit velocity='2' effort='60'/>"), two),
            "continuous: limited to one turn",
        ),
        "sliding": (arm_of(joint("a", "base", "upper", kind="prismatic"), two), "name: a"),
        "no effort, no velocity": (
            PLAIN.replace('velocity="3" effort="60"', 'velocity="0" effort="0"'),
            "states no velocity",
        ),
        "a placeholder of an effort": (PLAIN.replace('effort="60"', 'effort="1"'), "gravity alone needs"),
        "no limits": (PLAIN.replace(LIMIT, ""), "position: [TODO, TODO]"),
        "degrees": (PLAIN.replace('"-2" upper="2"', '"-90" upper="90"'), "cannot be limits in rad"),
        "limits in the wrong order": (PLAIN.replace('"-2" upper="2"', '"2" upper="-2"'), "[TODO, TODO]"),
        "windows": (PLAIN.replace(">", ">\r\n").encode(), "name: arm"),
        "comments": (PLAIN.replace("<joint", "<!-- <joint name='${x}'> --><joint"), "name: arm"),
        "a locked joint called as its link": (
            PLAIN.replace("</robot>", joint("jaw", "lower", "jaw") + "</robot>"),
            "jaw: 0",
        ),
        "a byte order mark": (b"\xef\xbb\xbf" + PLAIN.encode(), "name: arm"),
        "a declaration": (b'<?xml version="1.0" encoding="utf-8"?>\n' + PLAIN.encode(), "name: arm"),
        "below its base": (PLAIN.replace('xyz="0 0 0.4"', 'xyz="0 0 -0.4"'), "mounting: free"),
        "odd names": (PLAIN.replace('"a"', '"on"').replace('"b"', '"1e3"'), 'name: "on"'),
        "two roots": (arm_of(joint("a", "base", "upper"), base='<link name="base"/><link name="other"/>'), "!root"),
        "a joint twice": (arm_of(joint("a", "base", "upper"), joint("a", "upper", "lower")), "!not unique|a"),
        "a link twice": (arm_of(joint("a", "base", "upper"), joint("b", "base", "upper")), "!upper"),
        "a ring": (arm_of(joint("a", "lower", "upper"), joint("b", "upper", "lower")), "!"),
        "no parent": (PLAIN.replace('parent link="base"', 'parent link="nowhere"'), "!nowhere"),
        "not a number": (PLAIN.replace('value="2.0"', 'value="nan"'), "!not finite"),
        "a floating joint": (
            PLAIN.replace("</robot>", joint("free", "lower", "thing", kind="floating") + "</robot>"),
            "!free",
        ),
        "no joint": ('<robot name="a"><link name="b"/></robot>', "!no movable joint"),
        "xacro": (
            PLAIN.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"').replace(
                'value="2.0"', 'value="${m}"'
            ),
            "!xacro",
        ),
        "MJCF": ("<mujoco><worldbody/></mujoco>", "!MJCF"),
        "no XML": ("name: arm", "!not a URDF"),
        "nothing": ("", "!not a URDF"),
        "Latin": (PLAIN.replace('name="arm"', 'name="Gelenk ä"').encode("latin-1"), "!UTF-8"),
    }
    wrong = [f"{case}: {said}" for case, (xml, words) in wild.items() if (said := unlike(tmp_path, xml, words))]
    assert not wrong, "\n".join(wrong)


def unlike(tmp_path: Path, xml: str | bytes, words: str) -> str:
    """What is said or written in place of these words (of a message after !); empty where it is these."""
    try:
        written = new(tmp_path, xml)
    except InputError as error:
        told = words.startswith("!") and any(one in str(error) for one in words[1:].split("|"))
        return "" if told and "\n" not in str(error) else str(error)
    if written.todo:
        with pytest.raises(RobotFileError, match="TODO"):
            load_robot(written.path)
    else:
        Plant(load_robot(written.path)).advance(0.01)
    return "" if words in written.text and bool(written.todo) == bool(written.unknown) else written.text


def test_what_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").write_text("mine")
    for given, count, out, message in (
        (None, None, "x.yaml", "either a URDF or --joints"),
        ("arm.urdf", 3, "x.yaml", "either a URDF or --joints"),
        (None, 0, "x.yaml", "--joints 0 is not from 1 to 50"),
        (None, 3, "x.txt", "not a name for a robot file"),
        (None, 3, "there.yaml", "exists already"),
    ):
        with pytest.raises(UsageError, match=message):
            new_robot_file(given, count, Path(out))
    with pytest.raises(RobotFileError, match=r"arm\.xacro"):
        new_robot_file("arm.xacro", out=Path("x.yaml"))
    assert Path("there.yaml").read_text() == "mine"
    assert new_robot_file(None, 3, Path("there.yaml"), overwrite=True).todo == 21


def test_the_urdf_is_found_from_the_new_file(tmp_path: Path, run_dynid, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robots").mkdir()
    (tmp_path / "arm.urdf").write_text(PLAIN)
    status, out, _ = run_dynid("robot", "new", "arm.urdf", "-o", "robots/mine.yaml")
    assert status == 0
    assert len(out.splitlines()) <= 10
    assert "dynid sim robots/mine.yaml" in out
    assert load_robot(tmp_path / "robots/mine.yaml").urdf_text == PLAIN
    status, out, _ = run_dynid("robot", "new", "arm.urdf", "--json")
    told = json.loads(out)
    assert (status, told["file"], told["todo"]) == (0, "arm.yaml", 0)
    assert {"record", "move", "identify"} == set(told["to_fill_in"])


def test_arms_by_the_name_of_an_installed_description(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for the package robot_descriptions, which clones a repository when a description is imported."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"no file and no robot description is called 'toy_description'.*pip install"):
        new_robot_file("toy_description")
    package = tmp_path / "site" / "robot_descriptions"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "toy.urdf").write_text(PLAIN)
    (package / "toy_description.py").write_text(f"URDF_PATH = {str(package / 'toy.urdf')!r}\n")
    (package / "far_description.py").write_text("raise OSError('git clone failed\\n  could not resolve host')\n")
    (package / "xa_description.py").write_text("XACRO_PATH = 'x'\n")
    (package / "mj_description.py").write_text("MJCF_PATH = 'x'\n")
    monkeypatch.syspath_prepend(package.parent)
    for name, message in (
        ("tou_description", "has no 'tou_description' (did you mean 'toy_description'"),
        ("far_description", "cannot get 'far_description': could not resolve host (it is downloaded"),
        ("xa_description", "is a xacro file, not a URDF"),
        ("mj_description", "is an MJCF file, not a URDF"),
    ):
        with pytest.raises(UsageError) as caught:
            new_robot_file(name)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)
    written = new_robot_file("toy_description")
    assert written.path == Path("toy.yaml")
    assert load_robot(written.path).urdf_text == PLAIN
    for module in [name for name in sys.modules if name.startswith("robot_descriptions")]:
        monkeypatch.delitem(sys.modules, module)
