"""The serial number of a recording's arm, as its controller reported it: two arms are combined by mistake only."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from daq.recording.recording import Recording
from drivers.core.errors import DynidWarning

SERIAL_EVENT = "serial number of the controller: "
"""Begins the event of a recording that tells it."""


def serial_number(recording: Recording) -> str:
    """The controller's serial number; empty where it is unknown."""
    numbers = [event.message for event in recording.events if event.message.startswith(SERIAL_EVENT)]
    return numbers[-1].removeprefix(SERIAL_EVENT) if numbers else ""


def warn_of_other_arms(recordings: Sequence[Recording]) -> None:
    """Warn (`DynidWarning`) where recordings that are used together are of controllers with different numbers."""
    of_number: dict[str, str] = {}
    for recording in recordings:
        if number := serial_number(recording):
            of_number.setdefault(number, recording.label)
    if len(of_number) > 1:
        listed = ", ".join(f"{label} of {number}" for number, label in of_number.items())
        warnings.warn(
            f"these recordings are of different arms, by the serial numbers of their controllers: {listed}",
            DynidWarning,
            stacklevel=3,
        )
