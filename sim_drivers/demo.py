"""The demonstration: a simulated arm through the whole pipeline, truth beside estimate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.console import print_json, print_table
from daq.recording import read_recording, write_recording
from daq.robot import load_robot
from drivers.errors import UsageError
from ident.base_parameters import base_parameters
from ident.identify import Identification, IdentifyChoices, identify
from ident.kinematics import FloatArray
from ident.model import build_model, truth_vector
from ident.report import TruthTable, write_report
from ident.result import Result, write_result
from ident.summary import summarise
from sim_drivers.measurement import simulate_recording
from sim_drivers.motion import random_fourier_motion

PERIOD = 15.0
"""Period of the demonstration's motions [s]."""

INTERVAL = 1.96
"""Half width of a 95 % interval in standard deviations."""


@dataclass(frozen=True)
class Demo:
    """What the demonstration found: the identification, its result, the true base parameters (b,), its folder."""

    found: Identification
    result: Result
    truth: FloatArray
    folder: Path

    @property
    def inside(self) -> int:
        """Number of true base parameters within their 95 % interval."""
        error = np.abs(self.found.solution.parameters - self.truth)
        return int(np.count_nonzero(error <= INTERVAL * self.found.std))


def run_demo(folder: Path, robot: str, duration: float, seed: int) -> Demo:
    """Record, identify, validate and report a simulated arm.

    Raises:
        RobotFileError: the robot file has no truth.
        UsageError: a duration that is too short, or a folder that is a file.
    """
    if not 2.0 <= duration <= 3600.0:
        raise UsageError(f"--duration {duration:g} s is not between 2 s and an hour")
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file; a folder is needed")
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, name in enumerate(("identification", "validation")):
        motion = random_fourier_motion(model, PERIOD, seed=seed + number)
        recording = simulate_recording(robot_file, motion, duration / (1 + number), seed=seed + number)
        paths.append(folder / f"{name}.h5")
        write_recording(paths[-1], recording, overwrite=True)
    # From here on it is what a user does: two recordings on disk, nothing known but their content.
    recordings = [[read_recording(path)] for path in paths]
    found = identify(recordings[0], recordings[1], IdentifyChoices())
    result = summarise(found, recordings[0], recordings[1])
    write_result(folder / "result.json", result)
    table = TruthTable(names=base.names, values=truth)
    write_report(folder / "report.html", result, found.fit_series, found.validation_series, table)
    return Demo(found, result, truth, folder)


def print_demo(demo: Demo, as_json: bool) -> None:
    """Truth, estimate and error of every base parameter, and where the report is."""
    estimates, deviations = demo.found.solution.parameters, demo.found.std
    names = demo.found.base.names
    if as_json:
        print_json(
            {
                "robot": demo.result.robot,
                "report": str(demo.folder / "report.html"),
                "result": str(demo.folder / "result.json"),
                "validation_relative_error": demo.result.validation.relative_error if demo.result.validation else None,
                "inside_95_percent": demo.inside,
                "base_parameters": [
                    {"name": name, "truth": float(true), "value": float(value), "std": float(std)}
                    for name, true, value, std in zip(names, demo.truth, estimates, deviations, strict=True)
                ],
            }
        )
        return
    print_table(
        f"{demo.result.robot}, simulated: truth and estimate",
        ("base parameter", "truth", "estimate", "error", "σ", "error/σ", "unit"),
        [
            (name, float(true), float(value), float(value - true), float(std), float((value - true) / std), stored.unit)
            for name, true, value, std, stored in zip(
                names, demo.truth, estimates, deviations, demo.result.base_parameters, strict=True
            )
        ],
    )
    print(f"\n{demo.inside} of {len(names)} true values lie within their 95 % interval.")
    print(demo.result.verdict)
    for warning in demo.result.warnings:
        print(f"warning: {warning}")
    print(f"\nOpen {demo.folder / 'report.html'} in a browser.")
