"""The tool's pose that `dynid check` prints to compare with the pendant."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from daq.robot.loader import load_robot, parse_robot
from ident.checks.tool_pose import tool_poses
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model


def poses_of(text: str):
    robot_file = parse_robot(text, where="arm.yaml", folder=None)
    return tool_poses(robot_file, build_model(robot_file))


def test_zero_of_a_ur5e_is_what_the_makers_dh_table_gives() -> None:
    """x = a2 + a3, y = -(d4 + d6), z = d1 - d5 (Universal Robots, DH parameters): -0.8172, -0.2329, 0.0628 m."""
    robot_file = load_robot("ur5e")
    zero, home = tool_poses(robot_file, build_model(robot_file))
    np.testing.assert_allclose(zero.position, [-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997], atol=1e-12)
    np.testing.assert_allclose(zero.rotation_vector, [math.pi / 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(zero.rpy, [math.pi / 2, 0, 0], atol=1e-12)
    assert zero.beyond == ()
    # "Home": upright, d1 + |a2| + |a3| + d5 high.
    assert (home.name, home.position[0]) == ("home", pytest.approx(0.0, abs=1e-12))
    assert home.position[2] == pytest.approx(0.1625 + 0.425 + 0.3922 + 0.0997, abs=1e-12)


def test_poses_agree_with_pinocchio_and_with_each_other() -> None:
    import pinocchio as pin

    generator = np.random.default_rng(0)
    text = load_robot("panda").text.replace(
        "\nworkspace:", "\nworkspace:\n  tool: [0.1, 0.2, 0.3]\n  tool_rotation: [0, 0, -pi/4]"
    )
    positions = generator.uniform(-3, 3, (10, 7))
    rows = "".join(f"  p{k}: {position.tolist()}\n" for k, position in enumerate(positions))
    robot_file = parse_robot(f"{text}\nposes:\n{rows}", where="arm.yaml", folder=None)
    assert robot_file.robot.workspace.tool == (0.1, 0.2, 0.3)
    model = build_model(robot_file)
    arm = pinocchio_model(model)
    data = arm.createData()
    for pose in tool_poses(robot_file, model):
        pin.forwardKinematics(arm, data, np.array(pose.joints))
        flange = data.oMi[7]
        np.testing.assert_allclose(pose.position, flange.act(np.array([0.1, 0.2, 0.3])), atol=1e-10)
        rotation = flange.rotation @ Rotation.from_euler("z", -45, degrees=True).as_matrix()
        np.testing.assert_allclose(Rotation.from_rotvec(pose.rotation_vector).as_matrix(), rotation, atol=1e-9)
        np.testing.assert_allclose(Rotation.from_euler("xyz", pose.rpy).as_matrix(), rotation, atol=1e-7)


def test_a_pose_beyond_the_limits_names_the_joints(three_joint) -> None:
    zero, far = poses_of(three_joint.text + "\nposes: {far: [0, 30, 0]}\n")
    assert (zero.beyond, far.beyond) == ((), ("j2",))


@pytest.fixture
def dynid(run_dynid, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return run_dynid


def test_the_command_prints_poses_and_assumptions(dynid, tmp_path) -> None:
    text = load_robot("ur5e").text.replace(", acceleration: 8", "", 1)
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    status, out, _ = dynid("check", "mine.yaml")
    assert status == 0
    for words in ("-817.20", "home", "base parameters: 58, 36 of them inertial", "assumed: acceleration limit 10"):
        assert words in out
    status, out, _ = dynid("check", "mine.yaml", "--json")
    told = json.loads(out)
    assert status == 0
    assert [pose["name"] for pose in told["poses"]] == ["zero", "home"]
    assert told["ok"] is True
    assert len(told["assumed"]) == 3


def test_the_command_lists_every_problem(dynid, tmp_path) -> None:
    text = load_robot("ur5e").text.replace("velocity: 3.14159", "velocity: 180").replace("rate: 500", "rate: TODO")
    (tmp_path / "mine.yaml").write_text(text.replace("model:\n  mdh", "model:\n  gravty: 1\n  mdh"), encoding="utf-8")
    status, out, err = dynid("check", "mine.yaml")
    lines = out.splitlines()
    assert status == 2
    assert all(line.startswith("mine.yaml: ") for line in lines)
    assert f"dynid: mine.yaml: {len(lines)} problems" in err
    assert len(lines) >= 3
    status, out, err = dynid("check", "mine.yaml", "--json")
    told = json.loads(out)
    assert (status, err) == (2, "")
    assert [str(one["where"]) for one in told["problems"]] == [
        line.split(": ")[0] + ": " + line.split(": ")[1] for line in lines
    ]


def test_problems_of_connections_come_together_with_the_files_path(dynid, tmp_path) -> None:
    text = load_robot("ur5e").text.split("\nconnections:")[0]
    text += "\nconnections:\n  a: {driver: rtde, host: x, rat: 5}\n  b: {driver: rtde, host: x, rate: fast}\n"
    (tmp_path / "mine.yaml").write_text(text, encoding="utf-8")
    status, out, _ = dynid("check", "mine.yaml")
    assert status == 2
    first, second = out.splitlines()
    assert first.startswith("mine.yaml: connections.a: ")
    assert second.startswith("mine.yaml: connections.b: ")


def test_a_new_robot_file_is_listed_as_to_do(dynid, tmp_path) -> None:
    status, out, _ = dynid("robot", "new", "--joints", "2", "-o", "arm.yaml", "--json")
    assert status == 0
    told = json.loads(out)
    assert set(told["to_fill_in"]) == {"run", "record", "move", "identify"}
    status, out, err = dynid("check", "arm.yaml")
    assert status == 2
    assert out.splitlines() == [
        *(f"arm.yaml: model.mdh[{row}]: alpha, d, theta0, r: still to be filled in (TODO)" for row in (0, 1)),
        *(f"arm.yaml: joints[{row}]: position, velocity: still to be filled in (TODO)" for row in (0, 1)),
    ]
    assert f"{told['todo']} problems" in err
