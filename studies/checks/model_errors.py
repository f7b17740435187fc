"""Which wrong gains and lengths `dynid identify` names, and which not (docs/measurements/checks.md).

    python -m studies.checks.model_errors 3 ../shared/data

Simulated arms, 30 s each of a random motion with a period of 10 s, with one gain or one length (d or r of the modified
DH table) of the robot file wrong, one after the other; then the public recordings as they are, whole and in parts, on
which nothing should be named. Takes some ten minutes with 3 seeds.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Kind
from ident.assessment.instants import instants
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks.mistaken_recordings import arms
from studies.synthetic.data_mistakes import with_values

ROBOTS = ("ur5e", "rocr6", "panda")
GAINS = (0.05, 0.1, 0.2)
SHIFTS = (0.01, 0.02, 0.05)
PERIOD, DURATION = 10.0, 30.0
MODEL_ERRORS = ("inconsistent-gain", "inconsistent-length", "joint-zero", "gravity-direction")
KINDS: tuple[Kind, ...] = ("gain", "length", "zero", "gravity")


def with_gain(recording: Recording, joint: int, factor: float) -> Recording:
    """The recording with one motor's signal scaled."""
    stream = recording.streams[JOINTS_STREAM]
    scale = np.ones(len(stream.channels["position"].columns))
    scale[joint] = factor
    signals = stream.channels.keys() - {"position"}
    return with_values(recording, **{name: stream.channels[name].values * scale for name in signals})


def lengths(robot_file: RobotFile) -> Iterator[tuple[int, str]]:
    """Rows of the modified DH table, and which of their two lengths is not 0."""
    for number, row in enumerate(robot_file.robot.model.mdh or ()):
        for key in ("d", "r"):
            if getattr(row, key):
                yield number, key


def with_length(robot_file: RobotFile, number: int, key: str, shift: float) -> RobotFile:
    """The robot file with another length."""
    model = robot_file.robot.model
    rows = list(model.mdh or ())
    rows[number] = rows[number].model_copy(update={key: getattr(rows[number], key) + shift})
    changed = robot_file.robot.model_copy(update={"model": model.model_copy(update={"mdh": tuple(rows)})})
    return robot_file.model_copy(update={"robot": changed})


def named(found: Identification) -> list[str]:
    """Names and joints of the checks that are about model errors."""
    return [f"{one.name} {' '.join(one.joints)}" for one in found.checks if one.name in MODEL_ERRORS]


def power(robot: str, seeds: int) -> None:
    """Print how often each wrong number is named, and how often at the right joint."""
    robot_file = load_robot(robot)
    model, choices = build_model(robot_file), IdentifyChoices()
    runs = []
    for seed in range(seeds):
        motion = random_fourier_motion(model, PERIOD, seed=seed, candidates=5)
        runs.append(simulate_recording(robot_file, motion, DURATION, seed=seed))
    false = sum(bool(named(identify([run], [], choices))) for run in runs)
    print(f"| {robot} | nothing | {false} of {len(runs)} | |", flush=True)
    for deviation in GAINS:
        found = [
            (named(identify([with_gain(run, joint, 1.0 + deviation)], [], choices)), model.joint_names[joint])
            for run in runs
            for joint in range(model.dof)
        ]
        report(robot, f"gain {100 * deviation:.0f} %", found)
    for shift in SHIFTS:
        found = [
            (named(identify([run], [], choices, with_length(robot_file, *length, shift))), model.joint_names[length[0]])
            for run in runs
            for length in lengths(robot_file)
        ]
        report(robot, f"length {100 * shift:.0f} cm", found)


def report(robot: str, error: str, found: list[tuple[list[str], str]]) -> None:
    """Print a line: runs in which something is named, those in which it is this joint, and the joints never named."""
    some = sum(bool(names) for names, _ in found)
    right = [joint for names, joint in found if any(joint in name for name in names)]
    never = [joint for joint in dict.fromkeys(joint for _, joint in found) if joint not in right]
    print(
        f"| {robot} | {error} | {some} of {len(found)}, the right one {len(right)} | {', '.join(never) or '–'} |",
        flush=True,
    )


def public(folder: Path) -> None:
    """Print what is named on the public recordings, and the largest likelihood ratios."""
    print(
        "\n| recording | part | checks | largest ratio of a gain | of a length | of a zero | of gravity's direction |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, text, path, choices in arms(folder):
        recording = import_file(path, parse_robot(text, where=name, folder=folder), ImportChoices())
        time = recording.streams[JOINTS_STREAM].time
        end = choices.preprocess.stop or float(time[-1] - time[0])
        for part, (start, stop) in {"all": (0.0, 1.0), "first half": (0.0, 0.5), "second half": (0.5, 1.0)}.items():
            window = replace(choices.preprocess, start=start * end, stop=stop * end)
            found = identify([recording], [], replace(choices, preprocess=window))
            print(f"| {name} | {part} | {', '.join(named(found)) or '–'} | {' | '.join(ratios(found))} |", flush=True)


def ratios(found: Identification) -> list[str]:
    """The largest doubled log-likelihood ratio of each kind of deviation, and its value."""
    prepared = [run.prepared for run in found.runs]
    few = instants(RegressorKernel(found.model, found.base.columns), prepared)
    refit = Refit(found.model, found.experiment, found.base.columns, few, found.solution)
    share = (found.corrected.effective_rows - len(found.solution.active)) / refit.rows.sum()
    texts = []
    for kind in KINDS:
        of_kind = [one for one in refit.deviations if one.unknown.kind == kind]
        worst = max(of_kind, key=lambda one: one.likelihood, default=None)
        texts.append("–" if worst is None else f"{worst.likelihood * share:.1f} ({worst.value:.2g})")
    return texts


def main(seeds: int, folder: Path | None) -> None:
    """Print the tables."""
    print("| arm | wrong | named | joints never named |\n|---|---|---|---|")
    for robot in ROBOTS:
        power(robot, seeds)
    if folder is not None:
        public(folder)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3, Path(sys.argv[2]) if len(sys.argv) > 2 else None)
