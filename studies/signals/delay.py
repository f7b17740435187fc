"""The estimated delay, and its benefit.

In simulation: a UR5e under its own controller, with dry friction as in its robot file and three times that, slow and
fast, its torque recorded 0, 2 and 7 ms late, and one sample (2 ms) early. The controller holds a torque for 2 ms, and
the sensors read at the end of it: 0.5 ms more. Printed are the delay found and the one used, and the error of predicted
against true torque on another motion, without compensation and with what was used.

On public recordings (their folder in DYNID_DATA): held-out errors with and without the delay.

`python -m studies.signals.delay` takes a few minutes; `python -m studies.signals.delay 2` takes two seeds.
"""

from __future__ import annotations

import os
import re
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.assessment.delay.delay import DelaySearch, JointDelay
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion

ROBOT = "ur5e"
RATE = 500.0
PLAIN = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), presliding=False)
"""Choices with plain friction: further terms and presliding would take part of a delay."""
PERIOD = 20.0
EARLY = -0.002
DELAYS = (EARLY, 0.0, 0.002, 0.007)
CASES = (("fast", 1.0, 1.0), ("slow", 3.0, 1.0), ("fast, friction × 3", 1.0, 3.0), ("slow, friction × 3", 3.0, 3.0))
OTHER = 100

PUBLIC = (
    ("TX40", "tx40_t1.npz", "tx40.urdf", [f"joint_{k}" for k in range(1, 7)], 7.45),
    (
        "UR10",
        "ur10_unisa1.npz",
        "ur10.urdf",
        [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")],
        None,
    ),
    ("Panda", "panda_gaz1.npz", "panda.urdf", [f"joint_{k}" for k in range(1, 8)], None),
)


def arm(delay: float, friction: float) -> RobotFile:
    """The arm with a late torque [s] and so much of its dry friction."""
    text = load_robot(ROBOT).text.replace("  noise:\n", f"  noise:\n    torque_delay: {max(delay, 0.0)}\n")
    text = re.sub(r"coulomb: ([\d.]+), offset", lambda match: f"coulomb: {friction * float(match[1])}, offset", text)
    return parse_robot(text, where=ROBOT, folder=None)


def controlled(robot_file: RobotFile, period: float, seed: int, early: bool) -> Recording:
    """Sensor values over one period of a motion; `early` pairs a position with the next sample's torque."""
    motion = random_fourier_motion(build_model(robot_file), period, seed)
    position, velocity, acceleration = motion.evaluate(np.arange(round(period * RATE)) / RATE)
    plant = Plant(robot_file, seed=seed, position=position[:, 0])
    samples = []
    for q, v, a in zip(position.T, velocity.T, acceleration.T, strict=True):
        plant.set_target(q, v, a)
        plant.advance(1.0 / RATE)
        samples.append(plant.measure())
    stamps = np.array([sample.time for sample in samples])
    positions, currents = (np.array([getattr(sample, name) for sample in samples]) for name in ("position", "current"))
    if early:
        stamps, positions, currents = stamps[:-1], positions[:-1], currents[1:]
    names = robot_file.robot.joint_names
    channels = {
        "position": Channel("position", positions, "rad", names),
        "current": Channel("current", currents, "A", names),
    }
    return Recording(robot_file.text, {JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)})


def true_error(search: Identification, seed: int) -> float:
    """Error of predicted against true torque on another motion [%]."""
    model = build_model(search.robot_file)
    motion = random_fourier_motion(model, PERIOD, OTHER + seed).evaluate(np.linspace(0.0, PERIOD, 2000))
    true = model_torque(model, None, truth_vector(search.robot_file), *motion)
    predicted = model_torque(model, search.base.columns, search.solution.parameters, *motion)
    return float(100.0 * np.linalg.norm(predicted - true) / np.linalg.norm(true))


def milliseconds(delay: DelaySearch | JointDelay) -> str:
    """The best delay and half of its 95 % interval [ms]."""
    if delay.best is None or delay.interval is None:
        return "–"
    return f"{1e3 * delay.best:.2f} ± {1e3 * delay.interval:.2f}"


def simulated(seeds: int) -> None:
    """Print a line for each case, delay and seed."""
    print(f"{'simulated':20} {'true [ms]':>9} {'found [ms]':>15} {'used [ms]':>9} {'error without, with [%]':>24}")
    for name, slower, friction in CASES:
        for delay in DELAYS:
            robot_file = arm(delay, friction)
            for seed in range(seeds):
                recording = controlled(robot_file, slower * PERIOD, seed, delay == EARLY)
                search = identify([recording], [], PLAIN)
                without = identify([recording], [], replace(PLAIN, search_delay=False))
                assert search.delay is not None
                best = milliseconds(search.delay)
                used = ", ".join(f"{1e3 * value:.2f}" for value in sorted({j.used for j in search.delay.joints}))
                errors = f"{true_error(without, seed):.2f}, {true_error(search, seed):.2f}"
                print(f"{name:20} {1e3 * delay:9.1f} {best:>15} {used:>9} {errors:>24}", flush=True)


def public(folder: Path) -> None:
    """Print the estimate for each public recording, and the held-out error without and with it."""
    for name, file, urdf, joints, stop in PUBLIC:
        if name == "TX40":
            text = (Path(__file__).parents[2] / "examples" / "tx40.yaml").read_text(encoding="utf-8")
        else:
            limits = "\n".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}" for joint in joints)
            text = f"name: {name}\nmodel: {{urdf: {urdf}}}\njoints:\n{limits}\n"
        robot_file = parse_robot(text, where=name, folder=folder)
        recording = import_file(folder / file, robot_file, ImportChoices())
        inertia = False if name == "Panda" else None
        choices = replace(PLAIN, model=ModelChoices(friction="coulomb-viscous", motor_inertia=inertia))
        choices = replace(choices, preprocess=replace(choices.preprocess, stop=stop))
        search = identify([recording], [], choices)
        without = identify([recording], [], replace(choices, search_delay=False))
        assert search.delay is not None
        assert search.delay.best is not None
        always = replace(choices, search_delay=False, preprocess=replace(choices.preprocess, delay=search.delay.best))
        errors = [100.0 * one.validation.relative_error for one in (without, identify([recording], [], always), search)]
        print(
            f"{name}: {search.delay.note}\n    held-out error {errors[0]:.3f} % without, {errors[1]:.3f} % with the "
            f"best delay for all joints, {errors[2]:.3f} % as used\n    of each joint alone (used): "
            + ", ".join(f"{milliseconds(j)} ({1e3 * j.used:.2f})" for j in search.delay.joints)
        )


def main(seeds: int = 3) -> None:
    """Print both tables."""
    simulated(seeds)
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    if folder.is_dir():
        public(folder)
    else:
        print(f"no public recordings in {folder}: set DYNID_DATA")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
