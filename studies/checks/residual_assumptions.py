"""False alarms and power of the checks of the residuals (docs/measurements/checks.md).

    python -m studies.checks.residual_assumptions 20 ../shared/data

Simulated arms with white torque noise and a correct model, then with one deviation each; how often each check is raised
among the recordings, and how often joints fail. Then the public recordings, joint by joint. About two minutes.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.assessment.residual_tests import ResidualTests
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks.mistaken_recordings import arms
from studies.synthetic.data_mistakes import with_values

ASSUMPTIONS = ("linearity", "independence", "constant_variance", "normality")
ROBOTS = ("ur5e", "rocr6")
DURATION = 30.0
Change = Callable[[FloatArray, FloatArray, FloatArray, np.random.Generator], FloatArray]
"""Torque (N, n), its noise's σ (n,), velocity (N, n), a generator → another torque."""


def _ripple(torque: FloatArray, std: FloatArray, velocity: FloatArray, generator: np.random.Generator) -> FloatArray:
    position = np.cumsum(velocity, axis=0) / 500.0
    return torque + 0.5 * std * np.sin(20.0 * position)


def _stribeck(torque: FloatArray, std: FloatArray, velocity: FloatArray, generator: np.random.Generator) -> FloatArray:
    return torque + 2.0 * std * np.sign(velocity) * np.exp(-((velocity / 0.3) ** 2))


def _uneven(torque: FloatArray, std: FloatArray, velocity: FloatArray, generator: np.random.Generator) -> FloatArray:
    return torque + 3.0 * np.abs(velocity) * std * generator.standard_normal(torque.shape)


def _bursts(torque: FloatArray, std: FloatArray, velocity: FloatArray, generator: np.random.Generator) -> FloatArray:
    starts = generator.random((len(torque) // 25 + 1, torque.shape[1])) < 0.01
    size = np.where(starts, 5.0 * generator.standard_normal(starts.shape), 0.0)
    return np.asarray(torque + std * np.repeat(size, 25, axis=0)[: len(torque)])


CHANGES: dict[str, Change | None] = {
    "nothing": None,
    "ripple of 0.5 σ, 20 a turn of 2π rad": _ripple,
    "Stribeck term of 2 σ below 0.3 rad/s": _stribeck,
    "noise that grows with velocity": _uneven,
    "bursts of 5 σ, 1 % of 50 ms intervals": _bursts,
}


def white(robot: str) -> RobotFile:
    """The robot without ripple."""
    described = yaml.safe_load(load_robot(robot).text)
    described["truth"]["noise"].pop("ripple_amplitude")
    text = yaml.safe_dump(described, sort_keys=False)
    return parse_robot(text, where=robot, folder=None)


def changed(recording: Recording, robot_file: RobotFile, change: Change, seed: int) -> Recording:
    """The recording with another torque."""
    robot = robot_file.robot
    stream = recording.streams[JOINTS_STREAM]
    name = "current" if "current" in stream.channels else "torque"
    gains = np.array([robot.drive(joint).gain or 1.0 for joint in robot.joint_names]) if name == "current" else 1.0
    std = np.array([robot.truth.noise.torque_std.get(joint, 0.0) for joint in robot.joint_names])
    velocity = np.gradient(stream.channels["position"].values, stream.time, axis=0)
    torque = change(stream.channels[name].values * gains, std, velocity, np.random.default_rng(1000 + seed))
    return with_values(recording, **{name: torque / gains})


def simulated(count: int) -> None:
    """Shares of recordings and of joints."""
    names = " | ".join(assumption.replace("_", " ") for assumption in ASSUMPTIONS)
    of_joints = " | ".join(f"of them {assumption.replace('_', ' ')}" for assumption in ASSUMPTIONS)
    print(f"| arm | deviation | recordings | {names} | joints | {of_joints} |\n|{'---|' * 12}")
    for robot in ROBOTS:
        robot_file = white(robot)
        model = build_model(robot_file)
        for deviation, change in CHANGES.items():
            recordings, joints = Counter[str](), Counter[str]()
            tested = 0
            for seed in range(1, (count if change is None else max(1, count // 4)) + 1):
                motion = random_fourier_motion(model, 10.0, seed, candidates=5)
                recording = simulate_recording(robot_file, motion, DURATION, seed, rate=500.0)
                if change is not None:
                    recording = changed(recording, robot_file, change, seed)
                tests = identify([recording], [], IdentifyChoices(search_delay=False)).residual_tests
                tested += len(tests)
                for assumption in ASSUMPTIONS:
                    made = [one for test in tests if (one := getattr(test, assumption)) is not None]
                    violated = sum(one.violated for one in made)
                    recordings[assumption] += violated > 0
                    joints[assumption] += violated
            figures = " | ".join(str(recordings[assumption]) for assumption in ASSUMPTIONS)
            of_joints = " | ".join(f"{joints[assumption]}" for assumption in ASSUMPTIONS)
            print(f"| {robot} | {deviation} | {seed} | {figures} | {tested} | {of_joints} |", flush=True)


def shown(arm: str, tests: list[ResidualTests]) -> None:
    """A row per joint."""
    for test in tests:
        cells = []
        for assumption in ASSUMPTIONS:
            one = getattr(test, assumption)
            if one is None:
                cells.append("–")
                continue
            cells.append(f"{one.effect:.2f} (p {one.p_value:.1g}){' ×' if one.violated else ''}")
        print(f"| {arm} | {test.joint} | {test.residuals} | {test.independent} | {' | '.join(cells)} |")


def public_recordings(folder: Path) -> None:
    """Effects and p-values of each joint."""
    names = " | ".join(assumption.replace("_", " ") for assumption in ASSUMPTIONS)
    print(f"\n| arm | joint | residuals | independent | {names} |\n|{'---|' * 8}")
    for name, text, path, choices in arms(folder):
        robot_file = parse_robot(text, where=name, folder=folder)
        recording = import_file(path, robot_file, ImportChoices())
        identification = identify([recording], [], choices)
        shown(name, identification.residual_tests)


if __name__ == "__main__":
    simulated(int(sys.argv[1]))
    if len(sys.argv) > 2:
        public_recordings(Path(sys.argv[2]))
