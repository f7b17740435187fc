"""Robot files of random arms: of any frames, branches and sliding joints, or serial ones as they are built."""

from __future__ import annotations

import json

import numpy as np
import yaml

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

GRAVITY = 9.81
MASS_OVER_REACH = 49.0


def random_arm(seed: int, *, joints: int | None = None, trees: bool = True, sliding: float = 0.3) -> RobotFile:
    """An arm with possible bodies and friction that brakes, as true parameters.

    Half of all lengths are 0 and most angles right ones, as arms are built: so axes meet, lie parallel to each other
    and to gravity. A third of the motors have no inertia, and some joints no friction.

    Args:
        seed: of everything.
        joints: how many; 2 to 7 where None.
        trees: whether some arms have branches.
        sliding: share of sliding joints.
    """
    generator = np.random.default_rng(seed)
    count = int(generator.integers(2, 8)) if joints is None else joints
    names = [f"j{number}" for number in range(1, count + 1)]
    branched = trees and bool(generator.random() < 0.3)
    prismatic = generator.random(count) < sliding
    up = generator.normal(size=3) if generator.random() < 0.2 else np.array([0.0, 0.0, 1.0])
    rows, limits, drives, links, turning = [], [], [], {}, {}
    for index, name in enumerate(names):
        antecedent = "base" if index == 0 else names[int(generator.integers(index)) if branched else index - 1]
        right = generator.random() < 0.8
        angle = 0.5 * np.pi * generator.integers(-1, 3) if right else generator.uniform(-np.pi, np.pi)
        lengths = generator.uniform(-0.6, 0.6, 3) * (generator.random(3) < 0.5)
        row = {"joint": name, "antecedent": antecedent, "alpha": angle, "d": lengths[0], "r": lengths[1]}
        if prismatic[index]:
            row["type"] = "prismatic"
        if branched:
            row |= {"b": lengths[2], "gamma": 0.5 * np.pi * float(generator.integers(-1, 3))}
        rows.append(row)
        travel = (0.4, 1.0, 5.0) if prismatic[index] else (2.8, 2.5, 12.0)
        limits.append(
            {"name": name, "position": [-travel[0], travel[0]], "velocity": travel[1], "acceleration": travel[2]}
        )
        moved = bool(generator.random() < 0.67)
        drives.append({"joint": name, "gain": 1, "signal": "torque", "inertia": moved})
        mass = float(20.0 * 0.6**index * generator.uniform(0.3, 1.5))
        points = generator.normal(scale=0.12 * 0.8**index, size=(6, 3)) * generator.uniform(0.2, 1.0, 3)
        points -= points.mean(axis=0)
        inertia = mass * (np.sum(points**2) * np.eye(3) - points.T @ points) / len(points)
        links[name] = {
            "mass": mass,
            "com": (0.1 * generator.normal(size=3)).tolist(),
            "inertia": inertia[np.triu_indices(3)].tolist(),
        }
        size = mass * (10.0 if prismatic[index] else 1.0)
        turning[name] = {
            "motor_inertia": 0.05 * size * float(generator.uniform(0.2, 2.0)) if moved else 0.0,
            "viscous": 0.2 * size * float(generator.random()),
            "coulomb": 0.3 * size * float(generator.random()),
            "offset": 0.1 * size * float(generator.normal()),
        }
    content = {
        "name": f"random-{seed}",
        "model": {"mdh": rows, "mounting": "free", "gravity": (-GRAVITY * up / np.linalg.norm(up)).tolist()},
        "joints": limits,
        "drives": drives,
        "truth": {
            "links": links,
            "joints": turning,
            "noise": {"rate": 200, "encoder_resolution": 1e-6, "torque_std": dict.fromkeys(names, 0.1)},
        },
    }
    return parse_robot(json.dumps(content, default=float), where=f"random-{seed}", folder=None)


def built_arm(
    seed: int, *, link_side: bool = False, wrist: float = 1.0, sizes: tuple[float, float] = (0.4, 2.8)
) -> RobotFile:
    """An arm of 6 or 7 joints, its mass within the factor of 2.2 of what such arms weigh.

    Args:
        seed: of everything.
        link_side: torque sensors behind the gears, which do not see the motors' inertia.
        wrist: mass of the last three links over what follows from the size.
        sizes: least and greatest reach [m].
    """
    generator = np.random.default_rng([seed, 7])
    dof = int(generator.integers(6, 8))
    reach = float(np.exp(generator.uniform(*np.log(sizes))))
    total = MASS_OVER_REACH * reach**3 * float(np.exp(np.clip(0.5 * generator.standard_normal(), -1.0, 1.0)))
    lengths = reach * generator.uniform(0.8, 1.2, dof) * np.array([0.35, 0.0, 0.5, 0.1, 0.4, 0.08, 0.1][:dof])
    shares = np.array([0.25, 0.3, 0.18, 0.14, 0.07, 0.04, 0.02][:dof]) * generator.uniform(0.6, 1.4, dof)
    masses = 0.8 * total * shares / shares.sum()
    masses[-3:] *= wrist
    rows, links, joints, drives, truths, noise = [], {}, [], [], {}, {}
    for joint in range(dof):
        name = f"j{joint + 1}"
        alpha = 0.0 if joint == 0 else float(generator.choice([-1.0, 1.0])) * np.pi / 2
        parallel = joint == 2 and dof == 6  # an elbow whose axis is the shoulder's
        row = {"joint": name, "alpha": 0.0 if parallel else alpha, "d": float(lengths[joint]) if parallel else 0.0}
        row["r"] = 0.0 if parallel else float(lengths[joint])
        rows.append({**row, **({} if joint == 0 else {"antecedent": f"j{joint}"})})
        following = float(lengths[joint + 1]) if joint + 1 < dof else 0.1 * reach
        radius = 0.06 * reach * float(generator.uniform(0.7, 1.3))
        centre = np.array([0.0, 0.0, 0.0])
        centre[0 if joint == 1 and dof == 6 else 2 if joint == dof - 1 else 1] = 0.4 * following
        centre += 0.3 * radius * generator.standard_normal(3)
        mass = float(masses[joint])
        across, along = mass * (following**2 / 12 + radius**2 / 4), mass * radius**2 / 2
        moments = [across, across, across]
        moments[int(np.argmax(np.abs(centre)))] = along
        links[name] = {"mass": mass, "com": centre.tolist(), "inertia": [moments[0], 0, 0, moments[1], 0, moments[2]]}
        carried = float(np.sum(masses[joint:]))
        beyond = float(np.sum(lengths[joint + 1 :])) + 0.1 * reach
        torque = 2.5 * GRAVITY * carried * 0.5 * beyond + 0.5 * total * reach / 50
        velocity = float(generator.uniform(2.0, 5.0))
        rotor = torque / float(generator.uniform(60.0, 300.0))
        friction = 0.06 * torque * (0.1 if link_side else 1.0)
        joints.append(
            {"name": name, "position": [-2.8, 2.8], "velocity": velocity, "acceleration": 15.0, "torque": torque}
        )
        drives.append({"joint": name, "signal": "torque", "inertia": not link_side})
        truths[name] = {"viscous": friction / velocity, "coulomb": friction, "offset": 0.1 * friction}
        truths[name] |= {} if link_side else {"motor_inertia": rotor}
        noise[name] = 0.01 * torque
    content = {
        "name": f"random{seed}",
        "model": {"mdh": rows, "mounting": "free"},
        "joints": joints,
        "drives": drives,
        "truth": {
            "links": links,
            "joints": truths,
            "noise": {"rate": 100, "encoder_resolution": 2e-5, "torque_std": noise},
        },
    }
    return parse_robot(yaml.safe_dump(content), where=f"random{seed}", folder=None)


def recorded(robot_file: RobotFile, seed: int = 0, duration: float = 12.0) -> Recording:
    """A recording of a random motion of it."""
    motion = random_fourier_motion(build_model(robot_file), 0.6 * duration, seed, candidates=3)
    return simulate_recording(robot_file, motion, duration, seed=seed)
