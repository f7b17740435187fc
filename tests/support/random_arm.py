"""Random serial arms, from a table-top servo arm to a foundry robot, with bodies, drives and noise of their size."""

from __future__ import annotations

import numpy as np
import yaml

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

MASS_OVER_REACH = 49.0
GRAVITY = 9.81


def random_arm(
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
