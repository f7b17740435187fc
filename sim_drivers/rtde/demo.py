"""The demonstration: a simulated UR arm is excited and recorded over real RTDE, identified, validated, reported."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from daq.commands.console import print_json, print_table
from daq.motion.trajectory_file import dump_trajectory, load_trajectory
from daq.output_files import REPORT_FILE, RESULT_FILE, check_output_folder, left_to_others, replace_files, write_folder
from daq.recording.reader import read_recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError, WorkError
from ident.commands.printing.result import print_result
from ident.excite.choices import DesignChoices
from ident.excite.design import design
from ident.excite.path import trajectory_of
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.identify.summary import Identified
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report import ReportData, TruthTable, recorded_runs, render_report
from ident.result.result_file import result_json
from ident.tasks.excitation import search_state
from sim_drivers.served import DemoOptions
from sim_drivers.simulated_arm import Record, Recorded, over_rtde

PERIOD = 15.0
"""Period of the identification motion [s]."""

VALIDATION_PERIOD = 10.0
"""Period of the other motion [s], designed in the same way: `dynid excite --seed 2` for a user."""

ATTEMPTS = 3
"""Attempts at each recording: a stall of this computer ends a motion."""

RAMP = 2.0
"""From rest into the periodic motion and back [s]."""

LIMIT_MARGIN = 0.2
"""Margin to every limit: the simulated robot shares this computer with all the rest, and commands come late."""

STARTS = 1
"""Starts of the excitation's design: the first start already comes within a tenth of the best of many."""

RECORDINGS = ("identification.h5", "validation.h5")
"""What the `dynid record` that the demonstration starts writes into its folder."""

FILES = ("identification.yaml", "validation.yaml", RESULT_FILE, REPORT_FILE)
"""What the demonstration itself writes there."""


@dataclass(frozen=True)
class Demo:
    """Outcome of the demonstration."""

    identification: Identified  # of the two recordings
    truth: FloatArray  # (b,) true base parameters
    folder: Path  # where everything was written
    lost: int  # samples that the two recordings lost
    samples: int  # that they hold

    @property
    def inside(self) -> int:
        """Number of true base parameters within their 95 % interval."""
        error = np.abs(self.identification.solution.parameters - self.truth)
        return int(np.count_nonzero(error <= WITHIN_95_PERCENT * self.identification.std))


def run_demo(
    options: DemoOptions,
    *,
    overwrite: bool = False,
    progress: Callable[[str], None] = lambda step: None,
    arm: Callable[[str, int, FloatArray], AbstractContextManager[Record]] = over_rtde,
) -> Demo:
    """Serve a simulated arm, move and record it over RTDE, identify, validate and report it.

    Args:
        options: the duration is rounded to whole periods; trajectories are written to its folder, too.
        overwrite: files of an earlier demonstration.
        progress: called before each step.
        arm: serves a robot with noise of a seed, at first at a position (n,), and returns its recorder.

    Raises:
        RobotFileError: the robot file has no truth.
        UsageError: no RTDE connection, or a folder that is a file.
        WorkError: a recording stopped before its end.
    """
    folder, robot, seed = options.out, options.robot, options.seed
    robot_file = load_robot(robot)
    check_output_folder(folder, FILES, robot_file.files, overwrite=overwrite)
    with left_to_others():
        check_output_folder(folder, RECORDINGS, robot_file.files, overwrite=overwrite)
    if not any(connection.driver == "rtde" for connection in robot_file.robot.connections.values()):
        raise UsageError(f"{robot} has no RTDE connection", hint="the demonstration works with ur5e, ur10 and ur10e")
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    folder.mkdir(parents=True, exist_ok=True)
    periods = max(1, round(options.duration / PERIOD))
    period = options.duration / periods
    progress("designing an excitation trajectory, and another one to validate with")
    choices = DesignChoices(period=period, periods=periods, ramp=RAMP, margin=LIMIT_MARGIN)
    other = replace(choices, period=min(period, VALIDATION_PERIOD), periods=1)
    trajectories = {
        "identification": _excitation(robot_file, choices, seed, progress),
        "validation": _excitation(robot_file, other, seed + 1, progress),
    }
    paths = []
    lost = samples = 0
    for name, trajectory_text in trajectories.items():
        trajectory = folder / f"{name}.yaml"
        replace_files({trajectory: trajectory_text})
        paths.append(folder / f"{name}.h5")
        motion = load_trajectory(trajectory, robot_file.robot).motion
        progress(f"recording {motion.duration:.0f} s for {name} over RTDE")
        # The arm stands where the motion starts: a slow approach takes 20 s and shows nothing.
        start = motion.evaluate(np.zeros(1))[0][:, 0]
        recorded = _recorded(partial(arm, robot, seed, start), trajectory, paths[-1], progress)
        lost += recorded.lost
        samples += recorded.samples
    # From here on it is what a user does: two recordings on disk, nothing known but their content.
    recordings = [[read_recording(path)] for path in paths]
    identification = identify(recordings[0], recordings[1], IdentifyChoices(), progress=progress)
    data = ReportData(
        identification.result,
        identification.fit_series,
        identification.validation_series,
        TruthTable(names=base.names, values=truth),
        recorded_runs(identification),
    )
    write_folder(folder, {RESULT_FILE: result_json(data.result) + "\n", REPORT_FILE: render_report(data)})
    return Demo(identification, truth, folder, lost, samples)


def _recorded(
    served: Callable[[], AbstractContextManager[Record]], trajectory: Path, out: Path, progress: Callable[[str], None]
) -> Recorded:
    """A recording of a freshly served arm; again where this computer, which does all the work, was too busy for it."""
    for _ in range(ATTEMPTS - 1):
        try:
            with served() as record:
                return record(trajectory, out)
        except WorkError as error:
            progress(f"{error.message}; recording again")
    with served() as record:
        return record(trajectory, out)


def _excitation(robot_file: RobotFile, choices: DesignChoices, seed: int, progress: Callable[[str], None]) -> str:
    """The trajectory file of a design as `dynid excite` makes it: the file's public inertias bound the torque."""
    search = SearchChoices(seed=seed, starts=STARTS, workers=1)
    designed = design(
        robot_file, find_prior(robot_file), choices, search, progress=lambda result: progress(search_state(result))
    )
    comment = f"designed by dynid demo, condition number {designed.condition:.3g}"
    return dump_trajectory(trajectory_of(designed.motion, robot_file.robot.name, comment))


def print_demo(demo: Demo, as_json: bool, *, verbose: bool = False) -> None:
    """The verdict and how many true values were met; with `verbose` truth and estimate of every base parameter."""
    estimates, deviations = demo.identification.solution.parameters, demo.identification.std
    names = demo.identification.base.names
    if as_json:
        print_json(
            {
                "robot": demo.identification.result.robot,
                "report": demo.folder / REPORT_FILE,
                "result": demo.folder / RESULT_FILE,
                "validation_relative_error": demo.identification.validation.relative_error,
                "inside_95_percent": demo.inside,
                "samples": demo.samples,
                "lost": demo.lost,
                "base_parameters": [
                    {"name": name, "truth": true, "value": value, "std": std}
                    for name, true, value, std in zip(names, demo.truth, estimates, deviations, strict=True)
                ],
            }
        )
        return
    print(f"{demo.identification.result.robot}, simulated: {demo.samples} samples over RTDE, {demo.lost} lost")
    print(f"{demo.inside} of {len(names)} true values lie within their 95 % interval")
    report = demo.folder / REPORT_FILE
    print_result(demo.identification.result, report, verbose=verbose)
    if verbose:
        print_table(
            f"\n{demo.identification.result.robot}, simulated and recorded over RTDE: truth and estimate",
            ("base parameter", "truth", "estimate", "error", "σ", "error/σ", "unit"),
            [
                (
                    name,
                    float(true),
                    float(value),
                    float(value - true),
                    float(std),
                    float((value - true) / std),
                    stored.unit,
                )
                for name, true, value, std, stored in zip(
                    names, demo.truth, estimates, deviations, demo.identification.result.base_parameters, strict=True
                )
            ],
        )
    print(f"\nOpen {report} in a browser.")
