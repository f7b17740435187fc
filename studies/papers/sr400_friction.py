"""Fig. 2 of the SR400 paper with a simulated arm: velocity steps of the coupled wrist (docs/measurements/friction.md).

    python -m studies.papers.sr400_friction [SEEDS]

Joints 1, 2, 4 and 7 are locked in the pose in which gravity has the least torque on motors 5 and 6; both wrist motors
turn at constant velocities of either sign. The mean torques of these steps give the six friction parameters of eq. 8
by least squares. Printed are these beside the truth (the paper's Table 4), and the curves of Fig. 2: friction of motor
5 over q̇5 at q̇m6 = 2.4 rad/s, of motor 6 over q̇m6 at q̇5 = −3 rad/s, measured and predicted, with and without the
coupling pair. Each jumps where q̇6 = q̇m6 − q̇5 changes its sign. About half a minute.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Pieces
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from ident.model.regressor import model_torque
from ident.model.true_parameters import true_model, truth_vector
from ident.signals.joint_signals import read_joint_signals
from sim_drivers.synthetic.measurement import simulate_recording

MOTOR_5, MOTOR_6 = 3, 4
NAMES = ("Fs5", "Fv5", "Fs6", "Fv6", "Fsm6", "Fvm6")
SPEEDS = (-3.0, -2.4, -1.8, -1.2, -0.6, 0.6, 1.2, 1.8, 2.4, 3.0)
STEP = 0.8
"""Duration of a step [s]; joint 6 turns by at most 4.8 rad in it."""


@dataclass(frozen=True)
class Steady:
    """A motion of constant velocities through a pose at the middle of the step."""

    pose: FloatArray
    speed: FloatArray
    duration = STEP

    def evaluate(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration (n, N)."""
        position = self.pose[:, None] + self.speed[:, None] * (time - 0.5 * STEP)
        return position, np.repeat(self.speed[:, None], len(time), axis=1), np.zeros_like(position)

    def pieces(self) -> Pieces:
        """The whole step."""
        largest = np.zeros((4, len(self.speed), 1))
        largest[0, :, 0] = np.abs(self.speed)
        return Pieces(np.zeros(1), np.array([STEP]), largest)


def rows(joint_5: float, motor_6: float) -> FloatArray:
    """Rows (2, 6) of eq. 8 for q̇5 and q̇m6, of motors 5 and 6."""
    joint_6 = motor_6 - joint_5
    own = np.array([np.sign(joint_6), joint_6])
    return np.array([[np.sign(joint_5), joint_5, *own, 0.0, 0.0], [0.0, 0.0, *-own, np.sign(motor_6), motor_6]])


def quiet_pose(robot_file: RobotFile) -> FloatArray:
    """The pose (n,) of the arm in which gravity has the least torque on motors 5 and 6 as joint 5 turns."""
    from scipy.optimize import minimize

    model = true_model(robot_file)
    inertial = np.where([p.kind == "inertial" for p in model.parameters], truth_vector(robot_file, model), 0.0)
    limits = np.array([joint.position for joint in robot_file.robot.joints])
    middle, wrist = limits.mean(axis=1), np.linspace(-1.2, 1.2, 13)

    def gravity(free: FloatArray) -> float:
        pose = np.repeat(middle[:, None], len(wrist), axis=1)
        pose[2], pose[5], pose[MOTOR_5] = free[0], free[1], wrist
        still = np.zeros_like(pose)
        return float(np.sum(model_torque(model, None, inertial, pose, still, still)[[MOTOR_5, MOTOR_6]] ** 2))

    starts = [(roll, lift) for roll in (-1.5, 0.0, 1.5) for lift in (2.8, 3.14, 3.5)]
    found = [minimize(gravity, start, bounds=(limits[2], limits[5])) for start in starts]
    best = min(found, key=lambda one: one.fun)
    pose: FloatArray = middle.copy()
    pose[2], pose[5], pose[MOTOR_5], pose[MOTOR_6] = *best.x, 0.0, 0.0
    print(f"pose [rad]: {np.round(pose, 3).tolist()}, gravity at most {np.sqrt(best.fun):.2g} N·m on motors 5 and 6\n")
    return pose


def step(robot_file: RobotFile, pose: FloatArray, joint_5: float, motor_6: float, seed: int) -> FloatArray:
    """Mean torques (2,) of motors 5 and 6 over a step [N·m]."""
    speed = np.zeros(len(pose))
    speed[MOTOR_5], speed[MOTOR_6] = joint_5, motor_6 - joint_5
    recording = simulate_recording(robot_file, Steady(pose, speed), STEP, seed=seed)
    return np.asarray(read_joint_signals(recording, robot_file.robot).torque[:, [MOTOR_5, MOTOR_6]].mean(axis=0))


def main(seeds: int = 1) -> None:
    """Print the parameters and the curves."""
    robot_file = load_robot("sr400")
    pose = quiet_pose(robot_file)
    model = true_model(robot_file)
    values = dict(zip((p.name for p in model.parameters), truth_vector(robot_file, model), strict=True))
    truth = np.array([values[name] for name in NAMES])
    pairs = [(a, b) for a in SPEEDS for b in SPEEDS if a != b]
    system = np.vstack([rows(*pair) for pair in pairs])
    measured = [
        np.concatenate([step(robot_file, pose, *pair, seed=1000 * seed + k) for k, pair in enumerate(pairs)])
        for seed in range(seeds)
    ]
    found = [np.linalg.lstsq(system, torque, rcond=None)[0] for torque in measured]
    residual = measured[0] - system @ found[0]
    inverse = np.linalg.inv(system.T @ system)
    std = np.sqrt(residual @ residual / (len(residual) - len(NAMES)) * np.diag(inverse))
    print(f"| parameter | Table 4, taken for truth | identified ± 95 % ({len(pairs)} steps) |\n|---|---|---|")
    for name, true, value, deviation in zip(NAMES, truth, found[0], std, strict=True):
        print(f"| {name} | {true:.3f} | {value:.3f} ± {1.96 * deviation:.3f} |")
    uncoupled = [0, 1, 4, 5]
    alone = np.zeros(len(NAMES))
    alone[uncoupled] = np.linalg.lstsq(system[:, uncoupled], measured[0], rcond=None)[0]
    for motor, name, speeds, point in (
        (0, "5 over q̇5, q̇m6 = 2.4 rad/s", (*SPEEDS[:-2], 2.25, 2.55, 3.0), lambda speed: (speed, 2.4)),
        (1, "6 over q̇m6, q̇5 = −3 rad/s", SPEEDS[1:], lambda speed: (-3.0, speed)),
    ):
        print(
            f"\n| friction of motor {name} [rad/s] | measured [N·m] | predicted | without the pair |\n|---|---|---|---|"
        )
        for speed in speeds:
            joint_5, motor_6 = point(speed)
            torque = step(robot_file, pose, joint_5, motor_6, seed=7)[motor]
            row = rows(joint_5, motor_6)[motor]
            one, other = row @ found[0], row @ alone
            print(f"| {speed:.2f} | {torque:.2f} | {one:.2f} | {other:.2f} |")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
