"""How many false alarms does an hour of motion bring? A simulated UR5e that warms up and wears, in simulated time.

    python -m studies.monitor.hour [MINUTES]

The model and the thresholds (one false alarm per hour) come from two minutes of random Fourier series on the cold arm.
Then MINUTES (60) of other motions follow: shorter and slower Fourier series, and moves from point to point with rests.
Half of the viscous friction falls by 2 % per kelvin; dry friction rises by 2 % every 20 minutes. The controller,
ripple, noise and heat are those of the simulated arm. Prints false alarms by kind of motion and by observer, with the
95 % interval of the number per hour (Poisson). About 8 min of processor time for an hour.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import chi2

from daq.motion.approach import TimeScaled
from daq.motion.trajectories import Motion, PointToPoint, RestToRest, slow_move
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS
from ident.model.dynamic_model import build_model
from ident.monitor.choices import Kind
from ident.monitor.interval_torque import JointSamples
from ident.monitor.monitor import Monitor, earned_thresholds, joint_samples
from ident.result.models.model import Model
from ident.tasks.identification import identify
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.synthetic.controlled_run import record_plant

RATE = 500.0
LEARNT = 30.0
"""Length of each of the four recordings that model and thresholds come from [s]."""
WARMED, PER_KELVIN = 0.5, 0.02
"""Share of the viscous friction that depends on temperature, and by how much it falls [1/K]."""
WEAR, SHIFT = 0.02, 1200.0
"""By how much dry friction rises, and after how long [s]."""
CANDIDATES = 2
"""Random series of which the best is played; the search costs more than the simulation."""
SEED = 1
"""Seed of the plant: the arm keeps its ripple from one recording to the next."""
KINDS: tuple[Kind, ...] = ("direct", "momentum", "kalman")


def worn(robot_file: RobotFile, wear: float) -> RobotFile:
    """The arm with friction that depends on temperature, and dry friction times 1 + wear."""
    robot = robot_file.robot
    kelvin = robot.truth.thermal.ambient + ZERO_CELSIUS
    joints = {}
    for name, one in robot.truth.joints.items():
        root = WARMED * one.viscous
        joints[name] = one.model_copy(
            update={
                "coulomb": one.coulomb * (1.0 + wear),
                "viscous": one.viscous - root,
                "temperature": (root * (1.0 + PER_KELVIN * kelvin), -PER_KELVIN * root, 0.0),
            }
        )
    truth = robot.truth.model_copy(update={"joints": joints})
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"truth": truth})})


def motions(robot_file: RobotFile, start: FloatArray) -> Iterator[tuple[str, Motion]]:
    """Motions without end, each from where the last one left the arm: (kind, motion)."""
    arm = build_model(robot_file)
    generator = np.random.default_rng(9)
    low, high = np.array([limit.position for limit in arm.limits]).T
    fastest = np.array([limit.velocity for limit in arm.limits])
    hardest = np.array([limit.acceleration for limit in arm.limits])
    number = 0
    while True:
        number += 1
        series = RestToRest(random_fourier_motion(arm, (8.0, 15.0, 25.0)[number % 3], 500 + number, CANDIDATES), 1, 1.0)
        speed = (1.0, 0.6, 0.3)[generator.integers(3)]
        motion: Motion = series if speed == 1.0 else TimeScaled(series, speed)
        first = motion.evaluate(np.zeros(1))[0][:, 0]
        yield "approach", slow_move(start, first, arm.limits, share=0.4)
        yield f"Fourier series, {100 * speed:.0f} % speed", motion
        start = motion.evaluate(np.array([motion.duration]))[0][:, 0]
        points = np.vstack([start, start + generator.uniform(-0.8, 0.8, (8, arm.dof))])
        points = np.clip(points, 0.9 * low, 0.9 * high)
        way = np.abs(np.diff(points, axis=0))
        share = generator.uniform(0.1, 0.9, (len(way), 1))
        least = np.maximum(1.875 * way / (share * fastest), np.sqrt(5.774 * way / (share * hardest))).max(axis=1)
        yield "point to point", PointToPoint(points, least, dwell=float(generator.uniform(0.0, 2.0)))
        start = points[-1]


def samples_of(model: Model, robot_file: RobotFile, plant: Plant, motion: Motion) -> JointSamples:
    """What the drives deliver while the plant plays a motion, which begins where it stands."""
    return joint_samples(model, record_plant(robot_file, plant, motion, RATE))


def cold_runs() -> tuple[Model, list[tuple[str, JointSamples]]]:
    """The model, and the recordings that it and the thresholds come from."""
    robot_file = worn(load_robot("ur5e"), 0.0)
    recordings = []
    for seed in (1, 2, 3, 4):
        motion = RestToRest(random_fourier_motion(build_model(robot_file), LEARNT - 2.0, seed), 1, 1.0)
        plant = Plant(robot_file, seed=SEED, position=motion.evaluate(np.zeros(1))[0][:, 0])
        recordings.append(record_plant(robot_file, plant, motion, RATE))
    model = identify(recordings[0]).model
    return model, [(f"run {k}", joint_samples(model, run)) for k, run in enumerate(recordings, start=1)]


def hour(model: Model, seconds: float) -> Iterator[tuple[int, str, JointSamples]]:
    """Motion after motion of an arm that warms up and wears: (shift, kind of motion, samples)."""
    arm = load_robot("ur5e")
    start, celsius = np.zeros(arm.robot.dof), np.full(arm.robot.dof, arm.robot.truth.thermal.ambient)
    course = motions(arm, start)
    elapsed, shift = 0.0, 0
    while elapsed < seconds:
        robot_file = worn(arm, WEAR * shift)
        plant = Plant(robot_file, seed=SEED, position=start)
        for joint, kelvin in enumerate((celsius - plant.thermal.housing).tolist()):
            plant.heat(joint, kelvin)
        while elapsed < min(seconds, SHIFT * (shift + 1)):
            kind, motion = next(course)
            samples = samples_of(model, robot_file, plant, motion)
            elapsed += motion.duration
            yield shift, kind, samples
            start = motion.evaluate(np.array([motion.duration]))[0][:, 0]
        celsius, shift = plant.thermal.housing, shift + 1


def main() -> None:
    """Print the tables."""
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    model, quiet = cold_runs()
    thresholds = {kind: earned_thresholds(model, quiet, kind=kind) for kind in KINDS}
    alarms: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    spent: Counter[str] = Counter()
    watching: dict[str, Monitor] = {}
    before, warmest = -1, -np.inf
    for shift, motion, samples in hour(model, 60.0 * minutes):
        if shift != before:  # another plant, whose clock begins anew
            watching, before = {kind: Monitor(model, thresholds[kind], load=False) for kind in KINDS}, shift
        spent[motion] += len(samples.time)
        if samples.celsius is not None:
            warmest = max(warmest, float(samples.celsius.max()))
        for kind, monitor in watching.items():
            known = len(monitor.contacts)
            monitor.add(samples)
            alarms[kind][motion] += len(monitor.contacts) - known
    print("| motion | minutes | " + " | ".join(f"false alarms, {kind}" for kind in KINDS) + " |")
    print("|---|---|" + "---|" * len(KINDS))
    for motion in sorted(spent):
        counts = " | ".join(str(alarms[kind][motion]) for kind in KINDS)
        print(f"| {motion} | {spent[motion] / RATE / 60.0:.1f} | {counts} |")
    hours = spent.total() / RATE / 3600.0
    print(f"| all | {60.0 * hours:.1f} | " + " | ".join(str(alarms[kind].total()) for kind in KINDS) + " |")
    intervals = [poisson_interval(alarms[kind].total(), hours) for kind in KINDS]
    print("| per hour, 95 % interval | | " + " | ".join(f"{low:.2f} to {high:.2f}" for low, high in intervals) + " |")
    print(f"\nWarmest joint {warmest:.0f} °C; thresholds were learnt below {warmest_learnt(quiet):.0f} °C.")


def poisson_interval(count: int, hours: float) -> tuple[float, float]:
    """The exact 95 % interval of a rate [1/h] of which so many were counted."""
    low = 0.5 * float(chi2.ppf(0.025, 2 * count)) if count else 0.0
    return low / hours, 0.5 * float(chi2.ppf(0.975, 2 * count + 2)) / hours


def warmest_learnt(quiet: list[tuple[str, JointSamples]]) -> float:
    """[°C]"""
    return max(float(samples.celsius.max()) for _, samples in quiet if samples.celsius is not None)


if __name__ == "__main__":
    main()
