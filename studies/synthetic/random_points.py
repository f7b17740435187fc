"""A point-to-point motion for simulated arms, as an experiment without a designed excitation would play it."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from daq.motion.trajectories import QUINTIC_ACCELERATION, QUINTIC_VELOCITY, PointToPoint
from daq.robot.schema import Robot
from sim_drivers.synthetic.measurement import LIMIT_SHARE


def random_points_motion(robot: Robot, seed: int, moves: int, moving: Collection[str] = ()) -> PointToPoint:
    """Fifth-order moves through random points within the position limits (SR400 .4.3), without a rest between them.

    Each move is as fast as 90 % of the velocity and acceleration limits allow; all joints start and arrive together.

    Args:
        robot: whose joints have limits.
        seed: of the points.
        moves: number of them.
        moving: names of the joints that move, the others still in the middle of their ranges; all where empty.
    """
    limits = robot.joints
    low, high = np.array([joint.position for joint in limits]).T
    points = np.random.default_rng(seed).uniform(low, high, (moves + 1, len(limits)))
    if moving:
        still = [joint.name not in moving for joint in limits]
        points[:, still] = 0.5 * (low + high)[still]
    way = np.abs(np.diff(points, axis=0))
    velocity = np.array([LIMIT_SHARE * joint.velocity for joint in limits])
    acceleration = np.array([LIMIT_SHARE * joint.acceleration for joint in limits])
    durations = np.maximum(QUINTIC_VELOCITY * way / velocity, np.sqrt(QUINTIC_ACCELERATION * way / acceleration))
    return PointToPoint(points, durations.max(axis=1))
