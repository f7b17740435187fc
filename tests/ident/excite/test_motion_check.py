"""The check of a motion before it is played: what comes too near is refused by name, what keeps clear is described."""

from __future__ import annotations

import re

import numpy as np
import pytest
from arm_kinds import ARM_KINDS

from daq.motion.motion_check import MotionCheck
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest, slow_move
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import MotionRefusedError
from ident.excite.constraints.workspace import box_distances
from ident.excite.motion_check import ArmMotionCheck
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector

RADIUS, KEPT, UPPER, FORE = 0.04, 0.03, 0.4, 0.35
# Shoulder at 0.5 m, two links in the vertical plane through the first axis.
ARM = f"""
name: arm
model:
  {{mounting}}
  mdh:
    - {{{{joint: pan, alpha: 0, d: 0, r: 0.5}}}}
    - {{{{joint: lift, antecedent: pan, alpha: pi/2, d: 0, r: 0}}}}
    - {{{{joint: elbow, antecedent: lift, alpha: 0, d: {UPPER}, r: 0}}}}
joints:
  - {{{{name: pan, position: [-3, 3], velocity: 2, torque: 50}}}}
  - {{{{name: lift, position: [-3, 3], velocity: 2, torque: 50}}}}
  - {{{{name: elbow, position: [-3, 3], velocity: 2, torque: 50}}}}
workspace:
  tool: [{FORE}, 0, 0]
  link_radius: {RADIUS}
  clearance: {KEPT}
  keep_out: {{keep_out}}
"""


def arm(keep_out: str = "[]", mounting: str = "mounting: free") -> ArmMotionCheck:
    return ArmMotionCheck(parse_robot(ARM.format(mounting=mounting, keep_out=keep_out), where="arm", folder=None))


def box(lower, upper) -> str:
    corners = f"lower: {[float(x) for x in lower]}, upper: {[float(x) for x in upper]}"
    return f"[{{name: 'cra{{te', box: {{{corners}}}}}]"


def joints_of(position):
    """(3, 3, N) shoulder, elbow and tool of poses (3, N), by hand."""
    pan, lift, elbow = position
    out = np.array([np.cos(pan), np.sin(pan), 0 * pan])
    up = np.array([0.0, 0.0, 1.0])[:, None]
    shoulder = 0.5 * up + 0 * out
    middle = shoulder + UPPER * (np.cos(lift) * out + np.sin(lift) * up)
    tool = middle + FORE * (np.cos(lift + elbow) * out + np.sin(lift + elbow) * up)
    return np.array([shoulder, middle, tool])


def some_motion(seed: int) -> PointToPoint:
    points = np.random.default_rng(seed).uniform(-1.2, 1.2, (4, 3)) * [2, 0.6, 1]
    return PointToPoint(points, np.array([3.0, 2.0, 4.0]))


def distances_to(corners, motion: PointToPoint, time):
    """(2, N) of upper arm and forearm, thickness included."""
    from daq.robot.workspace import Box

    shoulder, middle, tool = joints_of(motion.evaluate(time)[0])
    stand = Box(lower=tuple(corners[0]), upper=tuple(corners[1]))
    segments = np.array([shoulder, middle]), np.array([middle, tool])
    return box_distances(*segments, stand).value - RADIUS


def test_it_is_a_check_of_motions() -> None:
    check: MotionCheck = arm()
    assert callable(check.trajectory)


@pytest.mark.parametrize("seed", range(12))
def test_a_motion_is_refused_where_it_comes_nearer_to_a_random_box_than_is_kept(seed) -> None:
    motion, generator = some_motion(seed), np.random.default_rng(seed)
    time = np.linspace(0.0, motion.duration, 9001)
    tool = joints_of(motion.evaluate(time)[0])[2]
    middle = tool[:, generator.integers(9001)] + generator.uniform(-0.3, 0.3, 3)
    half = generator.uniform(0.02, 0.1, 3)
    corners = middle - half, middle + half
    expected = distances_to(corners, motion, time)
    if abs(expected.min() - KEPT) < 2e-3:
        pytest.skip("as near as the tolerance")
    if expected.min() > KEPT:
        (nearest,) = [c for c in arm(box(*corners)).trajectory(motion, "traj").clearances if c.what == "cra{te"]
        assert nearest.distance == pytest.approx(expected.min(), abs=1e-4)
        assert nearest.link == ("lift", "elbow")[int(expected.min(axis=1).argmin())]
        return
    with pytest.raises(MotionRefusedError) as caught:
        arm(box(*corners)).trajectory(motion, "traj")
    assert caught.value.where == "traj"
    assert caught.value.exit_status == 2
    found = re.match(r"link (\w+) (?:enters|comes too near to) cra\{te at ([\d.]+) s", caught.value.message)
    assert found, caught.value.message
    first = time[np.argmax(expected.min(axis=0) < KEPT - 1e-3)]
    assert float(found[2]) == pytest.approx(first, abs=0.01)
    row = ("lift", "elbow").index(found[1])
    assert expected[row, np.searchsorted(time, float(found[2]) + 0.01).clip(0, 9000)] < KEPT


@pytest.mark.parametrize("seed", range(4))
def test_figures_are_those_of_the_forward_kinematics(seed) -> None:
    motion = some_motion(seed)
    figures = arm().trajectory(motion, "traj")
    time = np.linspace(0.0, motion.duration, 30001)
    position, velocity, _ = motion.evaluate(time)
    tool = joints_of(position)[2]
    assert figures.lowest == pytest.approx(tool[2].min(), abs=1e-5)
    assert figures.farthest == pytest.approx(np.linalg.norm(tool, axis=0).max(), abs=1e-5)
    speed = np.linalg.norm(np.diff(tool, axis=1), axis=0).max() / time[1]
    assert figures.tool_speed == pytest.approx(speed, rel=1e-3)
    assert figures.speed_share == pytest.approx(np.abs(velocity).max() / 2.0, rel=1e-4)
    assert figures.duration == motion.duration
    assert (figures.torque_share, figures.torque_joint) == (None, "")


@pytest.mark.parametrize("gravity", [[0, 0, -9.81], [-9.81, 0, 0], [0, 0, 9.81]])
def test_low_is_where_gravity_points(gravity) -> None:
    motion = some_motion(1)
    lowest = arm(mounting=f"gravity: {gravity}\n  mounting: free").trajectory(motion, "traj").lowest
    tool = joints_of(motion.evaluate(np.linspace(0.0, motion.duration, 20001))[0])[2]
    down = np.sign(gravity)
    assert lowest == pytest.approx((-down @ tool).min(), abs=1e-4)


def test_the_table_is_kept_clear_of_and_the_link_named() -> None:
    dip = PointToPoint(np.array([[0, 0.5, 0], [0, -1.0, 0], [0, 0.5, 0]]), np.array([2.0, 2.0]))
    with pytest.raises(MotionRefusedError, match=r"link elbow enters the table at 1\.\d\d s, up to 0\.171 m deep"):
        arm(mounting="mounting: table").trajectory(dip, "traj")
    arm().trajectory(dip, "traj")


def test_a_start_that_is_too_near_may_be_left_but_not_come_nearer() -> None:
    check = arm(mounting="mounting: table")
    limits = parse_robot(ARM.format(mounting="", keep_out="[]"), where="arm", folder=None).robot.joints
    low = -np.arcsin((0.5 - RADIUS - 0.01) / (UPPER + FORE))  # the tool 1 cm above the table
    away = slow_move(np.array([0, low, 0]), np.array([0, 0.3, 0]), limits)
    nearer = slow_move(np.array([0, low, 0]), np.array([0, low - 0.01, 0]), limits)
    figures = check.approach(away)
    assert min(clearance.distance for clearance in figures.clearances) == pytest.approx(0.01, abs=1e-6)
    with pytest.raises(MotionRefusedError, match="too near to the table"):
        check.approach(nearer)
    with pytest.raises(MotionRefusedError, match="too near to the table"):
        check.trajectory(away, "traj")


def test_links_that_meet_are_named() -> None:
    robot_file = load_robot("ur5e")
    folded = np.array([[0, -1.5, 0, 0, 0, 0], [0, -1.5, 3.1, -1.5, 0, 0]])
    with pytest.raises(MotionRefusedError, match=r"link elbow_joint enters link base at \d"):
        ArmMotionCheck(robot_file).trajectory(PointToPoint(folded, np.array([4.0])), "traj")


def test_torque_is_predicted_and_too_much_refused() -> None:
    robot_file = load_robot("ur5e")
    motion = PointToPoint(np.array([[0, -1.5, 0, 0, 0, 0], [0, -0.7, -0.6, 0, 0.5, 0]]), np.array([2.0]))
    figures = ArmMotionCheck(robot_file).trajectory(motion, "traj")
    model = build_model(robot_file)
    from ident.model.regressor import model_torque

    time = np.linspace(0.0, 2.0, 4001)
    count = len(truth_vector(robot_file))
    torque = model_torque(model, tuple(range(count)), truth_vector(robot_file), *motion.evaluate(time))
    limits = np.array([joint.torque for joint in robot_file.robot.joints])
    shares = np.abs(torque / limits[:, None]).max(axis=1)
    assert figures.torque_share == pytest.approx(shares.max(), rel=1e-3)
    assert figures.torque_joint == robot_file.robot.joint_names[int(shares.argmax())]
    weak = parse_robot(robot_file.text.replace("torque: 150}", "torque: 40}"), where="weak", folder=None)
    with pytest.raises(MotionRefusedError, match=r"joint shoulder_lift_joint is predicted to need \d+ % of its torque"):
        ArmMotionCheck(weak).trajectory(motion, "traj")


@pytest.mark.parametrize("name", ARM_KINDS)
def test_every_built_in_robot_has_poses_that_it_may_move_around(name) -> None:
    robot_file = load_robot(name)
    check, limits = ArmMotionCheck(robot_file), robot_file.robot.joints
    low, high = np.array([limit.position for limit in limits]).T
    generator, accepted = np.random.default_rng(0), 0
    for _ in range(20):
        pose = low + (high - low) * generator.uniform(0.2, 0.8, len(limits))
        around = np.clip(pose + generator.uniform(-0.05, 0.05, len(limits)), low, high)
        try:
            check.approach(slow_move(pose, around, limits))
            check.trajectory(slow_move(pose, around, limits), "traj")
            accepted += 1
        except MotionRefusedError:
            continue
    assert accepted >= 2


def test_what_is_repeated_is_looked_at_once_and_what_is_too_long_is_refused():
    series = FourierSeries(60.0, np.array([0.0, 0.3, 0.2]), np.full((3, 1), 0.02), np.zeros((3, 1)))
    once, often = (arm().trajectory(RestToRest(series, periods, 1.0), "traj") for periods in (1, 1000))
    assert often.duration == pytest.approx(60_002.0)
    assert (often.lowest, often.farthest) == pytest.approx((once.lowest, once.farthest))
    assert often.tool_speed == pytest.approx(once.tool_speed, rel=1e-3)
    slow = PointToPoint(np.array([[0.0, 0.3, 0.2], [0.1, 0.3, 0.2]]), np.array([2001.0]))
    with pytest.raises(MotionRefusedError, match="lasts 2001 s without repetition; at most 2000 s"):
        arm().trajectory(slow, "traj")
