"""Simulated free and loaded runs of one arm, its drive gains as in the file or hidden."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.altered_arms import with_gains

ROBOT = "ur10e"
LOAD = KnownLoad(2.8, (0.03, -0.02, 0.08), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009))
HIDDEN = dict(zip(load_robot(ROBOT).robot.joint_names, (1.1, 0.9, 1.05, 0.93, 1.1, 0.9), strict=True))
RATE = 125.0
DURATION = 20.0


@lru_cache
def runs(seed: int, hidden: bool = False, everywhere: float = 1.0) -> tuple[Recording, Recording]:
    """A free and a loaded run; gains times `HIDDEN` where requested, and times `everywhere`."""
    robot_file = load_robot(ROBOT)
    factors = {name: everywhere * (factor if hidden else 1.0) for name, factor in HIDDEN.items()}
    return arm_runs(robot_file, factors, LOAD, seed)


def arm_runs(
    robot_file: RobotFile, factors: Mapping[str, float], load: KnownLoad, seed: int
) -> tuple[Recording, Recording]:
    """A free and a loaded run of any simulated arm along the same motion."""
    arm = with_gains(robot_file, factors)
    assert load.com is not None
    assert load.inertia is not None
    motion = random_fourier_motion(build_model(robot_file), DURATION, seed=seed, candidates=3)
    free = simulate_recording(arm, motion, DURATION, seed=2 * seed, rate=RATE)
    loaded = with_load(arm, load.mass, load.com, load.inertia)
    return free, simulate_recording(loaded, motion, DURATION, seed=2 * seed + 1, rate=RATE)
