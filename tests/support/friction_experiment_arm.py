"""A two-joint arm with every friction term of the AUBO paper, swept joint by joint while it warms up."""

from __future__ import annotations

from functools import cache

import numpy as np
import yaml

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import SweepChoices, velocity_sweep
from ident.tasks.experiments import IdentifiedFriction, friction
from sim_drivers.synthetic.measurement import simulate_recording

RATE = 100.0
POSES = {"low": [0.0, 0.0], "high": [1.2, 0.8]}
GIVEN = "coulomb-viscous+power+load+temperature-linear"

TWO_JOINTS = """
name: arm
model:
  mounting: free
  mdh:
    - {joint: j1, alpha: pi/2, d: 0, r: 0.3}
    - {joint: j2, antecedent: j1, alpha: 0, d: 0.4, r: 0.1}
joints:
  - {name: j1, position: [-2.5, 2.5], velocity: 2, acceleration: 8, torque: 100}
  - {name: j2, position: [-2.5, 2.5], velocity: 2, acceleration: 8, torque: 60}
drives:
  - {joint: j1, gain: 10}
  - {joint: j2, gain: 8}
"""
"""Geometry, limits and drives."""

TWO_BODIES = (
    TWO_JOINTS
    + """truth:
  links:
    j1: {mass: 4, com: [0.2, 0.02, 0.02], inertia: [0.02, 0, 0, 0.06, 0, 0.06]}
    j2: {mass: 2, com: [0.15, 0.02, 0.03], inertia: [0.004, 0, 0, 0.03, 0, 0.03]}
"""
)
"""The same with links, for tests that add friction and noise to its `truth`."""

ARM = (
    TWO_JOINTS
    + """truth:
  links:
    j1: {mass: 4, com: [0.2, 0.02, 0.02], inertia: [0.02, 0, 0, 0.06, 0, 0.06]}
    j2: {mass: 2, com: [0.25, 0.02, 0.03], inertia: [0.004, 0, 0, 0.03, 0, 0.03]}
  joints:
    j1: {viscous: 5, coulomb: 4, offset: 0.3, motor_inertia: 0.6, alpha: 1.4, load: 0.01, temperature: [36, -0.11, 0]}
    j2: {viscous: 3, coulomb: 3, offset: -0.2, motor_inertia: 0.3, alpha: 1.3, load: 0.03, temperature: [30, -0.09, 0]}
  noise:
    rate: 100
    torque_std: {j1: 0.05, j2: 0.05}
"""
)


def arm(*, told: bool = False) -> RobotFile:
    """The arm; told, its section `friction` has the terms of its truth, as a simulation needs."""
    content = yaml.safe_load(ARM)
    content["poses"] = POSES
    if told:
        shapes = {"j1": {"exponent": 1.4}, "j2": {"exponent": 1.3}}
        content["friction"] = {"load": "quadratic", "temperature": "linear", "joints": shapes}
    return parse_robot(yaml.safe_dump(content), where="arm", folder=None)


@cache
def sweeps(warmer: float = 10.0, seed: int = 1) -> tuple[Recording, ...]:
    """Both poses, cold and `warmer` [K]; in the second pose something heavier is on the tool."""
    told, recordings = arm(told=True), []
    heavy = parse_robot(told.text.replace("mass: 2", "mass: 3"), where="arm", folder=None)
    check = ArmMotionCheck(told)
    choices = [SweepChoices(pose=name, stroke=1.6, slowest=0.3, speeds=4) for name in POSES]
    motions = [velocity_sweep(told, check, choice).motion for choice in choices]
    for index in range(4):
        motion = motions[index % 2]
        cold = 22.0 + warmer * (index // 2)
        heat = np.linspace(cold, cold + 0.2 * warmer, round(motion.duration * RATE))[:, None] * [1.0, 0.95]
        loaded = heavy if index % 2 else told
        one = simulate_recording(loaded, motion, motion.duration, 10 * seed + index, celsius=heat)
        recordings.append(Recording(arm().text, one.streams))
    return tuple(recordings)


@cache
def experiment() -> IdentifiedFriction:
    """The friction that these recordings tell, of the terms that are given."""
    return friction(sweeps(), friction=GIVEN, delay=0.0)
