"""Robot files of arms that nobody has drawn: random frames, branches, sliding joints, bodies, motors and friction."""

from __future__ import annotations

import json

import numpy as np

from daq.robot.loader import RobotFile, parse_robot

GRAVITY = 9.81


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
