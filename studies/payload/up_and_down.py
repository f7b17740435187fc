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
from dataclasses import replace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion, PointToPoint
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from ident.experiments.gains.drive_gains import identify_gains
from ident.experiments.gains.up_and_down import identify_slow_gains
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.payload.gains import HIDDEN, LOAD, SLOW_DURATION, slow_motion
from studies.synthetic.altered_arms import with_gains

INTERVAL = 1.96
RATE = 50.0
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


def runs(motion: Motion, duration: float, friction: Friction, seed: int) -> tuple[Recording, Recording]:
    """A free and a loaded run of the arm whose gains are hidden."""
    robot_file = load_robot("ur10e")
    arm = with_gains(robot_file, dict(zip(robot_file.robot.joint_names, HIDDEN, strict=True)))
    loaded = with_load(arm, LOAD.mass, LOAD.com or (), LOAD.inertia or ())
    free, second = (
        with_friction(each, simulate_recording(each, motion, duration, 2 * seed + index, RATE), motion, friction, seed)
        for index, each in enumerate((arm, loaded))
    )
    return free, second


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
        edges = np.flatnonzero(np.diff(np.concatenate([[False], rests, [False]]).astype(np.int8))).reshape(-1, 2)
        for start, stop in edges:
            more[joint, start:stop] = coulomb[joint] * generator.uniform(-1.0, 1.0)
    gains = np.array([arm.robot.drive(name).gain for name in names])
    channel = stream.channels["current"]
    channels = stream.channels | {"current": replace(channel, values=channel.values + (more / gains[:, None]).T)}
    return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})


def print_errors(label: str, results: list[Any]) -> None:
    """Per joint: RMS error in per cent, and how many of the 95 % intervals hold; `-` where no seed has a value."""
    robot = load_robot("ur10e").robot
    true = np.array([robot.drive(name).gain for name in robot.joint_names]) * np.array(HIDDEN)
    identified = [each for each in results if each is not None]
    texts = []
    for joint in range(len(true)):
        errors = np.array([100.0 * (each.values[joint] / true[joint] - 1.0) for each in identified])
        std = np.array([100.0 * each.std[joint] / abs(true[joint]) for each in identified])
        good = np.isfinite(errors)
        if not good.any():
            texts.append(f"{'-':>18}")
            continue
        rms, mean = np.sqrt(np.mean(errors[good] ** 2)), errors[good].mean()
        held = np.mean(np.abs(errors[good]) < INTERVAL * std[good])
        texts.append(
            f"{rms:6.2f} {mean:+5.1f} {held:4.0%}".rjust(18) if good.all() else f"{rms:6.2f} ({good.sum()})".rjust(18)
        )
    print(f"  {label:36}" + "".join(texts) + f"   {len(identified)}/{len(results)}")


def attempt(identify: Callable[..., Any], *arguments: Any) -> Any:
    """The identified gains; None where they were refused."""
    try:
        return identify(*arguments)
    except DynidError as error:
        print(f"    refused: {error.message}", file=sys.stderr)
        return None


def main(seeds: int = 20) -> None:
    """Print a table for each friction."""
    mass, with_com = KnownLoad(LOAD.mass), KnownLoad(LOAD.mass, LOAD.com)
    print(f"RMS error [%], mean error [%], 95 % intervals that hold; {seeds} seeds; last: recordings not refused")
    for label, friction in FRICTIONS.items():
        columns: dict[str, list[Any]] = {}
        for seed in range(seeds):
            passes = one_after_the_other(seed)
            pair = runs(passes, passes.duration, friction, seed)
            slow = runs(slow_motion(seed), SLOW_DURATION, friction, seed)
            for name, identify, recordings, known in (
                ("half sums, com known", identify_slow_gains, pair, with_com),
                ("half sums, com unknown", identify_slow_gains, pair, mass),
                ("least squares, same runs", identify_gains, pair, mass),
                ("least squares, same runs, com known", identify_gains, pair, with_com),
                ("least squares, all joints move", identify_gains, slow, mass),
            ):
                columns.setdefault(name, []).append(attempt(identify, *recordings, known))
        print(f"\nfriction {label}")
        for name, results in columns.items():
            print_errors(name, results)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
