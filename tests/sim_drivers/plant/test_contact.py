"""Contacts of the simulated arm: forces at joints, the wall, a picked-up body, and the lines that are typed."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from ident.model.dynamic_model import build_model
from ident.model.dynamics.link_jacobian import LinkJacobians, link_end
from sim_drivers.plant.contact import Grasp, Push, Wall, parse_contact
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.servo import ServoArm

UR = load_robot("ur5e")
MODEL = build_model(UR)
TOOL = np.array(UR.robot.workspace.tool)
POSE = np.array([0.3, -1.2, 1.4, -0.6, 0.8, 0.2])


@pytest.mark.parametrize("robot", ["ur5e", "sr400"])
def test_the_jacobian_is_the_derivative_of_the_point(robot: str) -> None:
    file = load_robot(robot)
    model = build_model(file)
    pose = np.array([np.mean(joint.position) + 0.1 for joint in file.robot.joints])
    places, local, step = LinkJacobians(model), np.array([0.03, -0.05, 0.1]), 1e-6
    for link in range(len(model.joints)):
        places.move(pose)
        columns = places.jacobian(link, local)[:3]
        for joint in range(model.dof):
            moved = []
            for sign in (1.0, -1.0):
                places.move(pose + sign * step * np.eye(model.dof)[joint])
                moved.append(places.point(link, local))
            assert columns[:, joint] == pytest.approx((moved[0] - moved[1]) / (2.0 * step), abs=1e-7)


def test_a_push_moves_the_torque_that_holds_the_arm_by_its_lever_and_ends() -> None:
    plant = Plant(UR, seed=1, position=POSE)
    plant.set_target(POSE)
    plant.advance(2.0)
    held = plant.drive_torque.copy()
    plant.contacts.request("push wrist_3_joint 0 0 -40 for 4")
    plant.advance(3.5)
    places = LinkJacobians(MODEL)
    places.move(plant.position)
    lever = places.jacobian(5, link_end(MODEL, 5, TOOL))[:3]
    # Friction takes what is below it, and the slow integral action what is left.
    assert plant.drive_torque[1] - held[1] == pytest.approx(40.0 * lever[2, 1], abs=10.0)
    plant.advance(1.0)
    assert not plant.contacts.present


def test_a_wall_holds_the_tool_point() -> None:
    plant = Plant(UR, seed=1, position=POSE)
    places = LinkJacobians(MODEL)
    places.move(POSE)
    height = float(places.point(5, TOOL)[2])
    down = -np.sign(places.jacobian(5, TOOL)[2, 1]) * np.array([0.0, 0.15, 0.0, 0.0, 0.0, 0.0])
    places.move(POSE + down)
    assert places.point(5, TOOL)[2] < height - 0.05
    plant.contacts.request(f"wall 0 0 {height - 0.02} 0 0 1")
    for share in np.linspace(0.0, 1.0, 200):
        plant.set_target(POSE + share * down)
        plant.advance(0.002)
    places.move(plant.position)
    assert places.point(5, TOOL)[2] > height - 0.05
    plant.set_target(POSE)
    plant.advance(1.0)
    places.move(plant.position)
    assert places.point(5, TOOL)[2] == pytest.approx(height, abs=5e-3)


def test_what_is_picked_up_weighs_until_it_is_released() -> None:
    plant = Plant(UR, seed=1, position=POSE)
    gravity = plant._arm.gravity(POSE)
    plant.contacts.request("pick 2 at 0 0 0.1 after 0.5")
    plant.contacts.request("release after 1")
    plant.advance(0.4)
    assert plant._arm.gravity(POSE) == pytest.approx(gravity)
    plant.advance(0.2)
    loaded = plant._arm.gravity(POSE)
    places = LinkJacobians(MODEL)
    places.move(POSE)
    weight = places.jacobian(5, TOOL + np.array([0.0, 0.0, 0.1]))[2] * 2.0 * 9.81
    assert loaded - gravity == pytest.approx(weight, abs=1e-9)
    plant.advance(0.6)
    assert plant._arm.gravity(POSE) == pytest.approx(gravity)


@pytest.mark.parametrize("robot", ["moteus_rig", "so101"])
def test_an_arm_of_servos_is_pushed_held_by_a_wall_and_loaded(robot: str) -> None:
    file = load_robot(robot)
    model, tool = build_model(file), np.array(file.robot.workspace.tool)
    places, goal = LinkJacobians(model), np.full(len(file.robot.joints), 0.4)
    stiffness = np.array([file.robot.truth.joints[name].servo.stiffness for name in file.robot.joint_names])

    def rested(arm: ServoArm, seconds: float = 1.0) -> np.ndarray:
        for _ in range(round(seconds / arm.step)):
            arm.advance(goal)
        assert np.max(np.abs(arm.velocity)) < 0.01
        return arm.position.copy()

    def moment(arm: ServoArm) -> np.ndarray:
        return stiffness * (goal - arm.position)

    arm = ServoArm(file, goal)
    rested(arm)
    before = moment(arm)
    arm.contacts.request("push 1 3 2 0 for 1.5")
    places.move(rested(arm))
    torque = places.jacobian(0, link_end(model, 0, tool))[:3].T @ [3.0, 2.0, 0.0]
    dry = sum(file.robot.truth.joints[name].coulomb for name in file.robot.joint_names)
    assert np.abs(before - moment(arm) - torque).max() < 2.0 * dry + 0.05
    start = rested(arm, 2.0)
    assert not arm.contacts.present

    places.move(start)
    point, up = places.point(model.tool_link, tool), np.array([0.0, 0.0, 1.0])
    lever = places.jacobian(model.tool_link, tool)[:3]
    goal = goal - 0.3 * np.sign(lever.T @ up)
    for stiff in ("", " 1e5 2000"):
        arm = ServoArm(file, start)
        arm.contacts.request(f"wall {' '.join(map(str, point - 0.02 * up))} {' '.join(map(str, up))}{stiff}")
        places.move(rested(arm, 1.5))
        assert up @ (places.point(model.tool_link, tool) - point) == pytest.approx(-0.02, abs=0.004)

    arm = ServoArm(file, start)
    gravity = arm._arm.gravity(start)
    arm.contacts.request("pick 0.2")
    arm.contacts.request(f"release after {10 * arm.step}")
    arm.advance(goal)
    places.move(start)
    weight = places.jacobian(model.tool_link, tool)[:3].T @ [0.0, 0.0, 0.2 * 9.81]
    assert arm._arm.gravity(start) - gravity == pytest.approx(weight, abs=1e-6)
    for _ in range(10):
        arm.advance(goal)
    assert arm._arm.gravity(start) == pytest.approx(gravity)


def test_lines_are_read() -> None:
    push = parse_contact("push 3 1 2 3 at 0.1 0 0 for 0.5 after 2", MODEL, TOOL, 10.0)
    assert isinstance(push, Push)
    assert (push.link, push.force.tolist(), push.point.tolist(), push.start, push.end) == (
        2,
        [1.0, 2.0, 3.0],
        [0.1, 0.0, 0.0],
        12.0,
        12.5,
    )
    wall = parse_contact("wall 0 0 0.1 0 0 2 1000", MODEL, TOOL, 0.0)
    assert isinstance(wall, Wall)
    assert (wall.normal.tolist(), wall.stiffness) == ([0.0, 0.0, 1.0], 1000.0)
    assert parse_contact("release", MODEL, TOOL, 1.0) == Grasp(0.0, (0.0, 0.0, 0.0), 1.0)


@each(
    "line",
    ["push", "push nothing 0 0 1 for 1", "push 1 0 0 x for 1", "push 1 0 0 nan for 1", "push 1 0 0 1e9 for 1"]
    + ["push 1 0 0 1 for -1", "wall 0 0 0 0 0 0", "wall 0 0 0 0 0 1 1e9", "pick", "pick -1", "pick 1 at 0 0", "hug 1"],
)
def test_other_lines_are_refused(line: str) -> None:
    with pytest.raises(UsageError):
        Plant(UR, seed=1, position=POSE).contacts.request(line)
