"""What an identification learns from and what it is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.recording.recording import Recording
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, UsageError
from drivers.core.text import percent_text
from ident.assessment.validation import HELD_OUT_SHARE
from ident.identify.held_friction import HeldFriction
from ident.regression.least_squares import LEAST_TORQUE
from ident.signals.copied_runs import copied_run
from ident.signals.joint_signals import JointSignals, read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared
from ident.signals.sample_hashes import HashArray, check_counted_once, kept_hashes, overlap, sample_hashes
from ident.signals.segments import played_window

MOVES, JUMBLED, LAGS, ALIKE = 0.1, 0.3, 20, 0.5
"""Range of positions [rad or m] from which on a joint moves. Rows are in disorder where its median change per row over
the positions' standard deviation is beyond `JUMBLED` (independent rows: 0.9) and the least of its mean squared changes
over 1 to `LAGS` rows beyond `ALIKE` of the largest: 0.36 at most of rows in order, 0.58 at least of 200 shuffled."""

FASTEST = 500.0
"""Median speed [rad/s or m/s] that no arm has; in degrees per second it is 9 rad/s."""

NOT_HELD_OUT = "NOT held out"
"""Stands in the name of a recording whose samples were used in the identification."""


@dataclass(frozen=True)
class RunWindow:
    """One recording's signals, and the window of them that counts."""

    signals: JointSignals  # as recorded
    # start, stop: of the window, from the recording's first stamp [s]; None where the recording begins or ends
    start: float | None
    stop: float | None
    played: bool = False  # whether the window follows from the player's events
    overlap: float = 0.0  # share of a held-out window's samples that are the identification's

    @property
    def duration(self) -> float:
        """Duration of the whole recording [s]."""
        time = self.signals.time
        return float(time[-1] - time[0]) if len(time) else 0.0

    @property
    def position(self) -> FloatArray:
        """Positions (N, n) within the window, as recorded; all of them where it holds none [rad or m]."""
        return self._within(self.signals.position)

    @property
    def torque(self) -> FloatArray:
        """Torques (N, n) within the window, as recorded; all of them where it holds none [N·m or N]."""
        return self._within(self.signals.torque)

    @property
    def time(self) -> FloatArray:
        """Stamps (N,) within the window; all of them where it holds none [s]."""
        return self._within(self.signals.time)

    @property
    def temperature(self) -> FloatArray | None:
        """Temperatures (N, n) within the window [K], nan for joints without a sensor; None where none was recorded."""
        return None if self.signals.temperature is None else self._within(self.signals.temperature)

    @cached_property
    def hashes(self) -> HashArray:
        """Hashes of the samples within the window (`ident.signals.sample_hashes`)."""
        return sample_hashes(self.position, self._within(self.signals.torque))

    def _within(self, values: FloatArray) -> FloatArray:
        time = self.signals.time - self.signals.time[:1]
        inside = (time >= (-np.inf if self.start is None else self.start)) & (
            time <= (np.inf if self.stop is None else self.stop)
        )
        return values[inside] if inside.any() else values


@dataclass(frozen=True)
class PreparedRun:
    """A recording, or a part of one, ready for the estimator."""

    signals: JointSignals  # as recorded
    choices: PreprocessChoices  # its preprocessing and its window
    prepared: Prepared  # what came of it
    torques: tuple[int, ...]  # motors whose torques the model of this experiment predicts
    # the same with samples at rest, of held-out runs; None where `prepared` holds them
    with_rest: Prepared | None = None
    overlap: float = 0.0  # share of a held-out run's samples that are the identification's

    @property
    def everything(self) -> Prepared:
        """What came of it, samples at rest included."""
        return self.with_rest or self.prepared


@dataclass(frozen=True)
class DataSplit:
    """Recordings to identify from, recordings that are held out, and these in words."""

    identification: tuple[RunWindow, ...]
    held_out: tuple[RunWindow, ...]
    validation_source: str
    held: HeldFriction | None = None  # friction that is known beforehand, in all of them; None where none is


def split_data(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    robot: Robot,
    chosen: PreprocessChoices,
    split: float | None,
) -> DataSplit:
    """Return what to identify from and what to hold out: other recordings, or the last part of each.

    Args:
        recordings: to identify from.
        validation: held-out recordings; without any, the last part of each of the others is held out.
        robot: whose joints they hold.
        chosen: start and stop of the data.
        split: end of the identification part [s]; None takes the first 70 %.

    Raises:
        UsageError: a window or a border without data, recordings that share samples, or a held-out recording that holds
            the identification's.
        DataError: as `read_joint_signals`.
    """
    runs = tuple(run_window(recording, robot, chosen) for recording in recordings)
    used = []
    if validation or len(runs) > 1:
        used = check_counted_once([run.signals.label for run in runs], [run.hashes for run in runs])
    if validation:
        if split is not None:
            raise UsageError(
                "--split and --validate exclude each other", hint="name the held-out recording, or split one"
            )
        held_out = tuple(run_window(recording, robot, PreprocessChoices()) for recording in validation)
        held_out = tuple(replace(run, overlap=overlap(run.hashes, used)) for run in held_out)
        for run in held_out:
            if run.overlap >= 1.0:
                raise UsageError(
                    f"{run.signals.label} contains the data of the identification: nothing is held out",
                    where="--validate",
                    hint="validate with another recording; without any, the last 30 % are held out",
                )
        held_out = tuple(
            replace(run, overlap=1.0) if run.overlap == 0.0 and copied(run, runs) else run for run in held_out
        )
        return DataSplit(runs, held_out, ", ".join(labelled(run.signals.label, run.overlap) for run in held_out))
    halves = [_split(run, split) for run in runs]
    share = f"last {percent_text(HELD_OUT_SHARE)}" if split is None else f"part after {split:g} s"
    each = "each recording" if len(runs) > 1 else "the recording"
    why = "since no other recording was given for validation" if split is None else "as --split says"
    return DataSplit(
        identification=tuple(first for first, _ in halves),
        held_out=tuple(last for _, last in halves),
        validation_source=f"the {share} of {each}, held out of the identification {why}",
    )


def copied(run: RunWindow, others: Sequence[RunWindow]) -> bool:
    """Whether a held-out run is one of the others resampled, scaled or with noise added, by noise that both hold."""
    own = run.time, run.position, run.torque
    return any(copied_run(own, (other.time, other.position, other.torque)) for other in others)


def distinct(labels: Sequence[str]) -> list[str]:
    """The labels of recordings, numbered where some are alike, as those of recordings in memory are."""
    if len(set(labels)) == len(labels):
        return list(labels)
    return [f"{label} ({number})" for number, label in enumerate(labels, start=1)]


def labelled(label: str, overlap: float) -> str:
    """A held-out recording's name; says so where it is not held out."""
    if overlap == 0.0:
        return label
    return f"{label} ({NOT_HELD_OUT}: {percent_text(overlap, 2)} of its samples were used in the identification)"


def run_window(recording: Recording, robot: Robot, chosen: PreprocessChoices) -> RunWindow:
    """The signals of a recording, and the window that the user chose, else the played motion.

    Raises:
        DataError: as `read_joint_signals`.
    """
    signals = read_joint_signals(recording, robot)
    if chosen.start is not None or chosen.stop is not None:
        return RunWindow(signals, chosen.start, chosen.stop)
    start, stop = played_window(recording)
    return RunWindow(signals, start, stop, played=start is not None)


def check_torques(runs: Sequence[RunWindow], torques: Sequence[int], names: Sequence[str]) -> None:
    """Refuse a torque that is used and never changes: it was not measured.

    Args:
        runs: to identify from.
        torques: indices of the motors whose torques are used.
        names: of all joints.

    Raises:
        DataError: such torques, by name.
    """
    changes = np.max([np.ptp(run.torque, axis=0) for run in runs], axis=0) > LEAST_TORQUE
    constant = [names[motor] for motor in torques if not changes[motor]]
    if constant:
        measured = [names[motor] for motor in torques if changes[motor]]
        if not measured:
            raise DataError(
                "no torque changes: the arm was at rest, or its torques were not measured",
                where=", ".join(run.signals.label for run in runs),
                hint="record a motion that `dynid excite` designed, or check the columns of torque or current",
            )
        raise DataError(
            f"the torque of {', '.join(constant)} does not change while the arm moves: it was not measured",
            where=", ".join(run.signals.label for run in runs),
            hint=f"check the column of the torque or current, or omit it: --torques-of {','.join(measured)}",
        )


def check_motion(runs: Sequence[RunWindow], names: Sequence[str]) -> None:
    """Refuse positions that are no motion: rows in another order than that of time, and encoder counts.

    Raises:
        DataError: such joints, by name.
    """
    for run in (run for run in runs if len(run.time) > 1):
        period = np.ptp(run.time) / (len(run.time) - 1)
        change = np.median(np.abs(np.diff(run.position, axis=0)), axis=0)
        doubtful = (np.ptp(run.position, axis=0) > MOVES) & (change > JUMBLED * run.position.std(axis=0))
        jumbled = [names[n] for n in np.flatnonzero(doubtful).tolist() if _independent(run.position[:, n])]
        if jumbled:
            raise DataError(
                f"the positions of {', '.join(jumbled)} change from row to row as much as over the whole recording",
                where=run.signals.label,
                hint="the rows are not in the order of time: sort them by their stamps, not by another column",
            )
        fast = [names[n] for n in np.flatnonzero(change > FASTEST * period).tolist()]
        if fast:
            raise DataError(
                f"by positions and stamps the speed of {', '.join(fast)} is beyond that of any arm",
                where=run.signals.label,
                hint="positions are in rad (or m), not in encoder counts; stamps are in s",
            )


def _independent(position: FloatArray) -> bool:
    """Whether positions (N,) change as much over one row as over many, in enough rows to tell."""
    lags = range(1, LAGS + 1)
    squares = [float(np.mean((position[lag:] - position[:-lag]) ** 2)) for lag in lags if len(position) > 3 * LAGS]
    return bool(squares) and min(squares) > ALIKE * max(squares)


def _split(run: RunWindow, split: float | None) -> tuple[RunWindow, RunWindow]:
    """The window before the border, and the one behind it."""
    start = run.start or 0.0
    stop = run.duration if run.stop is None else min(run.stop, run.duration)
    if not start < stop:
        raise UsageError(
            f"the window from {start:g} to {stop:g} s holds no samples; the recording lasts {run.duration:g} s",
            where=run.signals.label,
        )
    border = start + (1.0 - HELD_OUT_SHARE) * (stop - start) if split is None else split
    if not start < border < stop:
        raise UsageError(
            f"--split {border:g} s is outside the data, which last from {start:g} to {stop:g} s",
            hint="omit it to hold out the last 30 %",
        )
    first, last = replace(run, start=start, stop=border), replace(run, start=border)
    # less than all may be coarse values of a periodic motion
    shared = overlap(last.hashes, [kept_hashes(first.hashes)])
    return first, replace(last, overlap=1.0) if shared >= 1.0 else last
