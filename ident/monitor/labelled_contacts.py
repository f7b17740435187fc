"""A detector against labelled contacts: the share that is found over the false alarms, for every threshold (ROC)."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.files import InputKind, check_input

COLUMNS = ("start", "end")
"""Columns of a file of contacts: seconds from the recording's first sample; further columns are ignored."""
LABELS_FILE = InputKind("contacts", 10 * 2**20)
AFTER = 0.3
"""Time [s] after a contact in which an alarm still belongs to it."""
ONCE = 0.3
"""Alarms [s] apart count as one."""
LEVELS = 60
"""Thresholds of a curve."""


@dataclass(frozen=True)
class LabelledContact:
    """A contact that a person marked: start and end [s, the recording's clock]."""

    start: float
    end: float


@dataclass(frozen=True)
class OperatingPoint:
    """What a detector does at one threshold."""

    threshold: float  # in the detector's unit
    found: float  # share of the contacts in which it was passed
    false_per_hour: float  # alarms outside of contacts [1/h]
    delay: float  # median time from a contact's start to its alarm [s]; nan where none was found


def read_contacts(path: Path, first: float) -> tuple[LabelledContact, ...]:
    """Read contacts from a CSV file with columns start and end [s], both after the recording's `first` stamp.

    Raises:
        UsageError: it cannot be read, lacks a column, or a line is no contact.
    """
    check_input(path, LABELS_FILE, UsageError)
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        if any(name not in (reader.fieldnames or ()) for name in COLUMNS):
            raise UsageError(
                f"its first line should name the columns {' and '.join(COLUMNS)}",
                where=str(path),
                hint="seconds from the recording's first sample, one contact per line",
            )
        contacts = []
        for row in reader:
            try:
                start, end = (float(row[name]) for name in COLUMNS)
            except (TypeError, ValueError):
                start = end = math.nan
            if not (math.isfinite(start) and math.isfinite(end) and end > start):
                raise UsageError(
                    "is no contact: its end must be after its start", where=f"{path}: line {reader.line_num}"
                )
            contacts.append(LabelledContact(first + start, first + end))
    if not contacts:
        raise UsageError("holds no contact", where=str(path))
    return tuple(contacts)


def operating_point(
    time: FloatArray, ratio: FloatArray, contacts: Sequence[LabelledContact], threshold: float, hours: float
) -> OperatingPoint:
    """Return what a detector does whose ratio (N,) passes one threshold, with so many hours watched without contact."""
    passed = time[ratio > threshold]
    free = np.ones(len(passed), dtype=bool)
    delays = []
    for contact in contacts:
        inside = (passed >= contact.start) & (passed <= contact.end + AFTER)
        free &= ~inside
        during = passed[inside & (passed <= contact.end)]
        if len(during):
            delays.append(float(during[0] - contact.start))
    outside = passed[free]
    alarms = int(np.count_nonzero(np.diff(outside, prepend=-np.inf) > ONCE))
    detected = len(delays) / len(contacts) if contacts else math.nan
    return OperatingPoint(threshold, detected, alarms / hours, float(np.median(delays)) if delays else math.nan)


def roc(
    time: FloatArray, ratio: FloatArray, contacts: Sequence[LabelledContact], hours: float
) -> tuple[OperatingPoint, ...]:
    """The operating points of a detector from the lowest threshold to the highest; arguments as `operating_point`."""
    largest = float(ratio.max(initial=1e-9))
    lowest = max(float(np.quantile(ratio, 0.2)) if len(ratio) else 0.0, 1e-3 * largest)
    levels = np.geomspace(lowest, 1.001 * largest, LEVELS).tolist()
    return tuple(operating_point(time, ratio, contacts, level, hours) for level in levels)


def found_at(points: Sequence[OperatingPoint], per_hour: float) -> OperatingPoint:
    """The point that finds most with at most so many false alarms per hour."""
    allowed = [point for point in points if point.false_per_hour <= per_hour]
    return max(allowed or points[-1:], key=lambda point: point.found)
