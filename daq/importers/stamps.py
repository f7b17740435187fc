"""Stamps of a file's samples and of its commands, in seconds from one moment."""

from __future__ import annotations

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.naming import allowed_units, to_si
from daq.importers.table import ForeignTable, Note, printable
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.units import normalised

EPOCH = 1e8
"""[s]; stamps beyond it count from 1970, not from the start of a measurement (it is March 1973)."""


def sample_times(
    table: ForeignTable, count: int, choices: ImportChoices, where: str, notes: list[Note]
) -> tuple[FloatArray, FloatArray | None]:
    """Stamps of the samples (N,) and, where they have their own, of the commands (M,) [s].

    Assumptions are appended to `notes`; `count` is N.

    Raises:
        ImportFileError: no stamps and no rate, both, or an unknown unit.
    """
    if table.time is None:
        if choices.rate is None:
            raise ImportFileError(
                "has no time", where=where, hint="give the sampling rate: --rate HZ, or map a column: --column t=NAME"
            )
        notes.append(Note("info", f"the file has no time; uniform stamps at {choices.rate:g} Hz were assumed"))
        time, factor, origin = np.arange(count) / choices.rate, 1.0, 0.0
    else:
        if choices.rate is not None:
            raise ImportFileError(
                f"has time stamps; --rate {choices.rate:g} would discard them", where=where, hint="leave --rate out"
            )
        factor = _factor(table.time_unit, choices, where, notes)
        finite = table.time[np.isfinite(table.time)]
        origin = float(finite.min()) if len(finite) else 0.0
        if origin * factor > EPOCH:
            text = f"time is counted from the first sample, stamped {origin * factor:.6f} s after 1970"
            notes.append(Note("info", text))
        else:
            origin = 0.0
        # Subtracted before the conversion, where integer stamps are still exact.
        time = (table.time - origin) * factor
    if table.target_time is None:
        return time, None
    own = _factor(table.target_time_unit or table.time_unit, choices, where, notes)
    origin = origin if own == factor else origin * factor / own
    return time, (table.target_time - origin) * own


def _factor(stated: str, choices: ImportChoices, where: str, notes: list[Note]) -> float:
    """Seconds of the unit that the file states or the user gives."""
    if choices.time_unit is not None and stated and normalised(stated) != choices.time_unit:
        raise ImportFileError(
            f"states the time in {printable(stated)}, but --time-unit {choices.time_unit} was given",
            where=where,
            hint="leave --time-unit out",
        )
    unit = choices.time_unit or stated or "s"
    conversion = to_si("time", unit, prismatic=False)
    if conversion is None:
        allowed = allowed_units("time", prismatic=False)
        raise ImportFileError(f"unit '{printable(unit)}' is none of time: {allowed}", where=where)
    note = Note("info", f"time converted from {printable(unit)}")
    if conversion[0] != 1.0 and note not in notes:
        notes.append(note)
    return conversion[0]
