"""What makes samples unusable, and the repairs that a user can request; nothing is repaired without a request."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import numpy.typing as npt

from daq.importers.assembly import ImportedSamples, rows
from daq.importers.choices import ImportChoices
from daq.importers.naming import REVOLUTE
from daq.importers.table import Note, printable
from daq.recording.array_choices import TimeUnit
from daq.recording.counter_stamps import counter_range, unwrapped
from daq.recording.quality.stale_samples import stale_samples
from daq.recording.recording import MOTOR_SIGNALS
from daq.recording.repairs import DROP_DUPLICATES, DROP_NAN, DROP_REPEATS, OPPOSITE_TORQUE, SORT, UNWRAP
from daq.recording.unit_plausibility import near
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.ranges import SAMPLING_RATE
from drivers.core.text import counted

COARSE = 0.4
"""Share of the samples that repeat a stamp from which on the clock is coarser than the samples."""

RESTART_RUN = 50
"""So many samples that rise in order, all before a stamp already passed, are a second run and not a late message."""


def check_samples(samples: ImportedSamples, choices: ImportChoices, where: str) -> ImportedSamples:
    """Check for missing values, the order of the stamps and the sampling rate; make the requested repairs.

    Returns:
        The samples with strictly rising stamps and finite values, repairs as notes.

    Raises:
        ImportFileError: something is wrong and its repair was not requested, or cannot help.
    """
    samples = _finite(samples, choices, where)
    samples = _rising(samples, choices, where)
    _plausible_rate(samples, choices, where)
    samples = _opposite(_fresh(samples, choices), choices)
    if samples.commands is None:
        return samples
    commands = _checked_commands(samples.commands, samples.time, choices, where)
    notes = (replace(note, message=f"commands: {note.message}") for note in commands.notes)
    return replace(samples, commands=commands, notes=(*samples.notes, *notes))


def _checked_commands(
    commands: ImportedSamples, time: FloatArray, choices: ImportChoices, where: str
) -> ImportedSamples:
    """Commands with rising stamps and finite values, at any rate; some of them during the motion."""
    where = f"{where}: commands"
    commands = _rising(_finite(commands, choices, where), choices, where)
    if commands.time[-1] < time[0] or commands.time[0] > time[-1]:
        raise ImportFileError(
            f"the stamps, {commands.time[0]:.6g} to {commands.time[-1]:.6g} s, are all outside those of the samples, "
            f"{time[0]:.6g} to {time[-1]:.6g} s",
            where=where,
            hint="commands and samples need stamps of one clock; check their units, too",
        )
    longer = (commands.time[-1] - commands.time[0]) / (time[-1] - time[0])
    for unit in get_args(TimeUnit)[1:]:
        if near(longer * REVOLUTE["time"][unit], 1.0):
            raise ImportFileError(
                f"the stamps last {longer:.4g} times as long as those of the samples: they look like {unit}",
                where=where,
                hint=f"state their unit, in a header like target_time [{unit}], or give all stamps in seconds",
            )
    return commands


def sample_place(samples: ImportedSamples, index: int, where: str) -> str:
    """Name a sample, with its line where the file has lines."""
    line = f" (line {samples.lines[index]})" if samples.lines is not None else ""
    return f"{where}: sample {index}{line}"


def _finite(samples: ImportedSamples, choices: ImportChoices, where: str) -> ImportedSamples:
    notes: list[Note] = []
    if DROP_NAN in choices.repair:
        empty = [name for name, entry in samples.quantities.items() if not np.isfinite(entry.values).any()]
        if empty and "position" not in empty:
            kept = {name: entry for name, entry in samples.quantities.items() if name not in empty}
            samples = replace(samples, quantities=kept)
            notes.append(Note("warning", f"{DROP_NAN}: dropped, without any finite value: {', '.join(empty)}"))
    good: npt.NDArray[np.bool_] = np.isfinite(samples.time)
    for entry in samples.quantities.values():
        good &= np.isfinite(entry.values).all(axis=1)
    bad = np.flatnonzero(~good)
    if len(bad) == 0:
        return replace(samples, notes=(*samples.notes, *notes))
    first = int(bad[0])
    if DROP_NAN not in choices.repair:
        raise ImportFileError(
            f"{len(bad)} of {len(good)} samples have NaN or infinite values, the first in {_culprit(samples, first)}",
            where=sample_place(samples, first, where),
            hint=f"drop them: --repair {DROP_NAN}, in Python repair=['{DROP_NAN}']",
        )
    if good.sum() < 2:
        raise ImportFileError(f"--repair {DROP_NAN} would leave {good.sum()} of {len(good)} samples", where=where)
    place = sample_place(samples, first, "first")
    notes.append(Note("warning", f"{DROP_NAN}: {len(bad)} of {len(good)} samples dropped, {place}"))
    return replace(rows(samples, np.flatnonzero(good)), notes=(*samples.notes, *notes))


def _culprit(samples: ImportedSamples, index: int) -> str:
    if not np.isfinite(samples.time[index]):
        return "the time"
    for quantity, entry in samples.quantities.items():
        for label, joint, value in zip(entry.labels, entry.joints, entry.values[index], strict=True):
            if not np.isfinite(value):
                return f"the {quantity} of {joint} ('{printable(label)}')"
    raise ValueError("no value of this sample is missing")


def _rising(samples: ImportedSamples, choices: ImportChoices, where: str) -> ImportedSamples:
    steps = np.diff(samples.time)
    backward = np.flatnonzero(steps < 0) + 1
    if len(backward) and (range_of_counter := counter_range(samples.time, int(backward[0]))) is not None:
        first = int(backward[0])
        if UNWRAP not in choices.repair:
            raise ImportFileError(
                f"time goes backward by {range_of_counter:.6g} s, at the end of a counter's range",
                where=sample_place(samples, first, where),
                hint=f"continue the stamps: --repair {UNWRAP}, in Python repair=['{UNWRAP}']",
            )
        text = (
            f"{UNWRAP}: the counter of the stamps restarted {counted(len(backward), 'time')}, first at sample {first}"
        )
        samples = replace(samples, time=unwrapped(samples.time), notes=(*samples.notes, Note("warning", text)))
        backward = np.flatnonzero(np.diff(samples.time) < 0) + 1
    if len(backward):
        first = int(backward[0])
        back = float(samples.time[first - 1] - samples.time[first])
        restart = _restart(samples.time)
        if restart is not None:
            raise ImportFileError(
                f"time jumps back by {samples.time[restart - 1] - samples.time[restart]:.6g} s and continues from "
                "there: two runs in one file",
                where=sample_place(samples, restart, where),
                hint="split the file there and import the runs separately",
            )
        if SORT not in choices.repair:
            raise ImportFileError(
                f"time goes backward {counted(len(backward), 'time')}, first by {back:.6g} s",
                where=sample_place(samples, first, where),
                hint=f"sort the samples: --repair {SORT}, in Python repair=['{SORT}']",
            )
        text = f"{SORT}: time went backward {counted(len(backward), 'time')}, first at sample {first} by {back:.6g} s"
        samples = rows(samples, np.argsort(samples.time, kind="stable"))
        samples = replace(samples, notes=(*samples.notes, Note("warning", text)))
    repeated = np.flatnonzero(np.diff(samples.time) == 0) + 1
    if len(repeated):
        first = int(repeated[0])
        count = len(samples.time)
        if DROP_DUPLICATES not in choices.repair:
            hint = f"keep the first of each: --repair {DROP_DUPLICATES}, in Python repair=['{DROP_DUPLICATES}']"
            if len(repeated) >= COARSE * count and (span := float(np.ptp(samples.time))) > 0:
                hint = (
                    "the clock is coarser than the samples: omit its column and give the rate, about --rate "
                    f"{(count - 1) / span:.4g}; or {hint}"
                )
            raise ImportFileError(
                f"{len(repeated)} of {count} samples repeat the stamp before them, first {samples.time[first]:.9g} s",
                where=sample_place(samples, first, where),
                hint=hint,
            )
        keep = np.setdiff1d(np.arange(count), repeated)
        if len(keep) < 2:
            raise ImportFileError(f"all {count} samples have the same time stamp", where=where)
        place = sample_place(samples, first, "first")
        note = Note("warning", f"{DROP_DUPLICATES}: {len(repeated)} of {count} samples dropped, {place}")
        samples = rows(samples, keep)
        samples = replace(samples, notes=(*samples.notes, note))
    return samples


def _restart(time: FloatArray) -> int | None:
    """The sample at which a second run begins, None where stamps are merely out of order."""
    passed = np.maximum.accumulate(time)
    late = np.concatenate([[False], (time[1:] <= passed[:-1])])
    for start in np.flatnonzero(np.concatenate([[False], np.diff(time) < 0])):
        run = slice(start, start + RESTART_RUN)
        if late[run].sum() == RESTART_RUN and np.all(np.diff(time[run]) > 0):
            return int(start)
        if start + RESTART_RUN > len(time):
            break
    return None


def _fresh(samples: ImportedSamples, choices: ImportChoices) -> ImportedSamples:
    """Drop rows and positions that repeat those before them, where that repair was requested."""
    if DROP_REPEATS not in choices.repair:
        return samples
    joints = samples.quantities["position"].joints
    measured = {name: entry.values for name, entry in samples.quantities.items() if entry.joints == joints}
    stale = stale_samples(samples.time, joints, measured)
    repeats = stale.repeated | stale.held
    if not repeats.any():
        return samples
    place = sample_place(samples, int(np.argmax(repeats)), "first")
    note = Note("info", f"{DROP_REPEATS}: {int(repeats.sum())} of {len(repeats)} samples dropped, {place}")
    return replace(rows(samples, np.flatnonzero(~repeats)), notes=(*samples.notes, note))


def _opposite(samples: ImportedSamples, choices: ImportChoices) -> ImportedSamples:
    """Reverse the sign of all motor signals, where that repair was requested."""
    if OPPOSITE_TORQUE not in choices.repair:
        return samples
    turned = {
        name: replace(entry, values=-entry.values)
        for name, entry in samples.quantities.items()
        if name in MOTOR_SIGNALS
    }
    note = Note("warning", f"{OPPOSITE_TORQUE}: the sign of {', '.join(turned) or 'nothing'} was changed")
    return replace(samples, quantities={**samples.quantities, **turned}, notes=(*samples.notes, note))


def _plausible_rate(samples: ImportedSamples, choices: ImportChoices, where: str) -> None:
    period = float(np.median(np.diff(samples.time)))
    if not np.isfinite(period) or period <= 0:
        raise ImportFileError("time stamps are too large to distinguish samples", where=where)
    rate = 1.0 / period
    if SAMPLING_RATE.holds(rate):
        return
    outside = f"{rate:.4g} samples per second is not a plausible rate for a robot arm ({SAMPLING_RATE})"
    if choices.rate is not None:
        raise ImportFileError(f"--rate: {outside}", where=where)
    fitting = [unit for unit in get_args(TimeUnit)[1:] if SAMPLING_RATE.holds(rate / REVOLUTE["time"][unit])]
    if fitting and choices.time_unit is None:
        guesses = " or ".join(f"{unit} ({rate / REVOLUTE['time'][unit]:.4g} Hz)" for unit in fitting)
        raise ImportFileError(
            f"{outside}; the stamps look like {guesses}",
            where=where,
            hint=f"--time-unit {fitting[0]}, or a header like t [{fitting[0]}]",
        )
    raise ImportFileError(f"{outside}; is the time column a counter?", where=where, hint="map another: --column t=NAME")
