"""Table 4 of the SR400 paper, from a simulated SR400, free and loaded: python examples/sr400_table4.py [seed [moves]].

Quintic point-to-point motions through random points, every joint moving, 1 kHz, encoder steps and torque noise of the
built-in robot file. The truth is Table 4's X̂ where it prints a value; the rest was chosen (see the file's sources). The
load is Table 3's. Printed: truth, X̂ and 2σ of the free arm, Z_L = X̂ + load by the regrouping, X̂_L and 2σ of the
loaded arm, and how far X̂_L and Z_L are apart in standard deviations of both.
"""

from __future__ import annotations

import sys

import numpy as np

from daq.recording import Recording
from daq.robot import RobotFile, load_robot
from daq.trajectories import PointToPoint
from ident.identify import Identification, IdentifyChoices, identify
from ident.model import INERTIAL, build_model, link_parameters, truth_vector
from sim_drivers.altered_arm import with_load
from sim_drivers.measurement import simulate_recording

LOAD = np.array([0.454, -0.02, -0.09, 0.445, -0.115, 0.065, 0.48, 0.6, 2.0, 10.9])
"""Table 3, in the frame of link 6: XX XY XZ YY YZ ZZ [kg·m²], MX MY MZ [kg·m], M [kg]."""

LIMIT_SHARE = 0.9


def motion(robot_file: RobotFile, seed: int, moves: int) -> PointToPoint:
    """Through random points as fast as the limits allow."""
    generator = np.random.default_rng(seed)
    limits = robot_file.robot.joints
    low, high = np.array([joint.position for joint in limits]).T
    points = generator.uniform(low, high, (moves + 1, len(limits)))
    way = np.abs(np.diff(points, axis=0))
    # A quintic's largest velocity is 15/8 way/T, its largest acceleration 10/√3 way/T².
    by_velocity = 15.0 / 8.0 * way / [LIMIT_SHARE * joint.velocity for joint in limits]
    by_acceleration = np.sqrt(10.0 / np.sqrt(3.0) * way / [LIMIT_SHARE * joint.acceleration for joint in limits])
    return PointToPoint(points, np.maximum(by_velocity, by_acceleration).max(axis=1))


def recorded(robot_file: RobotFile, seed: int, moves: int) -> Recording:
    played = motion(robot_file, seed, moves)
    return simulate_recording(robot_file, played, played.duration, seed)  # type: ignore[arg-type]


def identified(robot_file: RobotFile, seed: int, moves: int) -> Identification:
    run, held_out = recorded(robot_file, seed, moves), recorded(robot_file, seed + 1, moves // 2)
    return identify([run], [held_out], IdentifyChoices(method="wls"))


def main(seed: int = 1, moves: int = 40) -> tuple[Identification, Identification, np.ndarray]:
    """Print the table; the free and the loaded arm's identification, and Z_L."""
    free_arm = load_robot("sr400")
    mass, com = LOAD[9], LOAD[6:9] / LOAD[9]
    about_com = LOAD[:6] - link_parameters(mass, com, [0.0] * 6)[:6]
    loaded_arm = with_load(free_arm, mass, com, about_com)
    free, loaded = identified(free_arm, seed, moves), identified(loaded_arm, seed + 10, moves)
    base = free.base
    truth = base.projection @ truth_vector(free_arm)
    names = [parameter.name for parameter in build_model(free_arm).parameters]
    load = base.projection[:, [names.index(f"{symbol}6") for symbol in INERTIAL]] @ LOAD
    predicted = free.solution.parameters + load
    print(f"{'name':6s} {'truth':>8s} {'X':>8s} {'2 sigma':>8s} {'Z_L':>8s} {'X_L':>8s} {'2 sigma':>8s} {'apart':>6s}")
    for i, name in enumerate(base.names):
        x, x_l = free.solution.parameters[i], loaded.solution.parameters[i]
        two, two_l = 2.0 * free.std[i], 2.0 * loaded.std[i]
        apart = (x_l - predicted[i]) / np.hypot(free.std[i], loaded.std[i])
        kept = "" if i in free.pruned.solution.active else " pruned"
        kept += "" if i in loaded.pruned.solution.active else " pruned-loaded"
        numbers = " ".join(f"{value:8.3f}" for value in (truth[i], x, two, predicted[i], x_l, two_l))
        print(f"{name:6s} {numbers} {apart:6.2f}{kept}")
    for label, found in (("free", free), ("loaded", loaded)):
        print(
            f"{label}: {len(found.pruned.solution.active)} of {base.count} parameters essential; relative error "
            f"{100 * found.fit.relative_error:.2f} %, on another motion {100 * found.validation.relative_error:.2f} %, "
            f"essential model {100 * found.essential_validation.relative_error:.2f} %"
        )
    return free, loaded, predicted


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
