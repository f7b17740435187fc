"""Drive gains from slow up-and-down runs, with friction that is in no model.

    python -m studies.payload.up_and_down [seeds]

A simulated UR10e whose true gains are hidden, 2.8 kg load. One joint after the other goes there and back, the others at
rest in a few poses, once without and once with the load. To the file's Coulomb and viscous friction is added, in turn:
nothing; Stribeck friction, half of the Coulomb friction more below some 0.05 rad/s; and 5 % of the gravity torque that
the joint carries. Joints at rest are held by static friction, anything between ± their Coulomb friction. Printed for
each: errors of the gains by half sums (`up_and_down`), with the centre of mass known and unknown, and by total
least squares over the model (`drive_gains`), the same recordings and, as that method needs it, recordings in
which all joints move slowly. Some minutes.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import lru_cache
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion, PointToPoint
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray, true_runs
from drivers.core.errors import DynidError
from ident.experiments.gains.drive_gains import identify_gains
from ident.experiments.gains.up_and_down import identify_slow_gains
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.payload.gains import HIDDEN, LOAD, SLOW_DURATION, slow_motion
from studies.synthetic.altered_arms import with_gains
from studies.synthetic.data_mistakes import with_values

RATE = 25.0
SWING = 1.2
MOVE = 20.0
DWELL = 1.0
POSES = np.array(
    [[0.0, -1.2, 0.8, -0.5, 0.7, 0.3], [0.0, -0.9, 1.3, 0.6, -0.8, 1.6], [0.0, -1.7, 0.5, -1.1, 1.4, -1.0]]
)
STRIBECK_SHARE = 0.5
STRIBECK_VELOCITY = 0.05
LOAD_SHARE = 0.05

Friction = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Torque (n, N) that is not in the model, from velocities, gravity torques (n, N) and Coulomb frictions (n, 1)."""

FRICTIONS: dict[str, Friction] = {
    "as the model's": lambda velocity, gravity, coulomb: np.zeros_like(velocity),
    "and Stribeck": lambda velocity, gravity, coulomb: (
        STRIBECK_SHARE * coulomb * np.sign(velocity) * np.exp(-((velocity / STRIBECK_VELOCITY) ** 2))
    ),
    "and 5 % of the load": lambda velocity, gravity, coulomb: LOAD_SHARE * np.abs(gravity) * np.sign(velocity),
}


def one_after_the_other(seed: int) -> PointToPoint:
    """Every joint there and back, the others at rest, in each of the poses."""
    generator = np.random.default_rng(seed)
    points = []
    for pose in POSES:
        middle = pose + generator.uniform(-0.1, 0.1, len(pose))
        points.append(middle)
        for joint in range(len(pose)):
            for side in (0.5, -0.5, 0.5):
                point = middle.copy()
                point[joint] += side * SWING
                points.append(point)
            points.append(middle)
    return PointToPoint(np.array(points), np.full(len(points) - 1, MOVE), DWELL)


@lru_cache(maxsize=2)
def simulated(seed: int, slow: bool) -> tuple[Motion, tuple[tuple[RobotFile, Recording], ...]]:
    """A motion, and the free and the loaded arm, whose gains are hidden, with their runs along it."""
    motion = slow_motion(seed) if slow else one_after_the_other(seed)
    duration = SLOW_DURATION if slow else one_after_the_other(seed).duration
    robot_file = load_robot("ur10e")
    arm = with_gains(robot_file, dict(zip(robot_file.robot.joint_names, HIDDEN, strict=True)))
    arms = arm, with_load(arm, LOAD.mass, LOAD.com or (), LOAD.inertia or ())
    return motion, tuple(
        (each, simulate_recording(each, motion, duration, 2 * seed + index, RATE)) for index, each in enumerate(arms)
    )


def runs(seed: int, slow: bool, friction: Friction) -> list[Recording]:
    """A free and a loaded run with more friction."""
    motion, pair = simulated(seed, slow)
    return [with_friction(arm, run, motion, friction, seed) for arm, run in pair]


def with_friction(arm: RobotFile, recording: Recording, motion: Motion, friction: Friction, seed: int) -> Recording:
    """The recording, its currents with more friction, and with static friction at rest."""
    stream = recording.streams[JOINTS_STREAM]
    position, velocity, _ = motion.evaluate(stream.time)
    still = np.zeros_like(position)
    gravity = model_torque(build_model(arm), None, truth_vector(arm), position, still, still)
    names = arm.robot.joint_names
    coulomb = np.array([arm.robot.truth.joints[name].coulomb for name in names])[:, None]
    more = friction(velocity, gravity, coulomb)
    generator = np.random.default_rng([seed, 9])
    for joint in range(len(names)):
        rests = np.abs(velocity[joint]) < 1e-9
        for start, stop in true_runs(rests):
            more[joint, start:stop] = coulomb[joint] * generator.uniform(-1.0, 1.0)
    gains = np.array([arm.robot.drive(name).gain for name in names])
    return with_values(recording, current=stream.channels["current"].values + (more / gains[:, None]).T)


def cells(results: list[Any]) -> list[str]:
    """Per joint but the first: RMS error, share of the 95 % intervals that hold, and how many seeds have a value."""
    robot = load_robot("ur10e").robot
    true = np.array([robot.drive(name).gain for name in robot.joint_names]) * np.array(HIDDEN)
    identified, texts = [each for each in results if each is not None], []
    for joint in range(1, len(true)):
        errors = np.array([each.values[joint] - true[joint] for each in identified])
        std = np.array([each.std[joint] for each in identified])
        good = np.isfinite(errors)
        if not good.any():
            texts.append("no value")
            continue
        rms = 100.0 * np.sqrt(np.mean(np.square(errors[good]))) / abs(true[joint])
        held = np.mean(np.abs(errors[good]) < WITHIN_95_PERCENT * std[good])
        some = "" if good.sum() == len(results) else f" ({good.sum()} of {len(results)})"
        texts.append(f"{rms:.2f}, {100 * held:.0f} %{some}")
    return texts


def attempt(identify: Callable[..., Any], *arguments: Any) -> Any:
    """The identified gains; None where they were refused."""
    try:
        return identify(*arguments)
    except DynidError as error:
        print(f"    refused: {error.message}", file=sys.stderr)
        return None


def main(seeds: int = 12) -> None:
    """Print a table for each friction."""
    mass, with_com = KnownLoad(LOAD.mass), KnownLoad(LOAD.mass, LOAD.com)
    joints = " | ".join(name.removesuffix("_joint") for name in load_robot("ur10e").robot.joint_names[1:])
    rows: dict[str, dict[str, list[Any]]] = {label: {} for label in FRICTIONS}
    for seed in range(seeds):
        for label, friction in FRICTIONS.items():
            passes, slow = runs(seed, False, friction), runs(seed, True, friction)
            for name, identify, recordings, known in (
                ("half sums, `--com`", identify_slow_gains, passes, with_com),
                ("half sums", identify_slow_gains, passes, mass),
                ("total least squares, the same runs", identify_gains, passes, mass),
                ("total least squares, the same runs, `--com`", identify_gains, passes, with_com),
                ("total least squares, all joints move slowly", identify_gains, slow, mass),
            ):
                rows[label].setdefault(name, []).append(attempt(identify, *recordings, known))
        print(f"# seed {seed}", file=sys.stderr, flush=True)
    for label, of_label in rows.items():
        print(f"\n| friction {label} | {joints} |\n|---|---|---|---|---|---|")
        for name, results in of_label.items():
            print(f"| {name} | {' | '.join(cells(results))} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
