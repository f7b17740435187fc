"""Where in a recording the motion was played: `dynid record` writes events when it begins and when it ends."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.streams import FloatArray
from ident.regression.observability import ranges

MOTION_BEGINS, MOTION_ENDS = "motion begins", "motion ends"
"""Events of the player."""


def played_window(recording: Recording, position: FloatArray) -> tuple[float | None, float | None]:
    """Start and stop [s from the first stamp] of the played motion where a joint stood still only there.

    On its way to the start pose and back every joint may move, also one that is locked for the experiment. Where that
    makes no difference, or no event tells the motion from its approach, the whole recording counts.

    Args:
        recording: its events and its stamps.
        position: (N, n) of its joints, as recorded [rad or m].

    Returns:
        None for an end that is the recording's.
    """
    whole = (None, None)
    time = recording.streams[JOINTS_STREAM].time
    times = {event.message: event.time - float(time[0]) for event in recording.events if event.source == "player"}
    if MOTION_BEGINS not in times or not len(time):
        return whole
    start, stop = times[MOTION_BEGINS], times.get(MOTION_ENDS)
    seconds = time - time[0]
    inside = (seconds >= start) & (seconds <= (np.inf if stop is None else stop))
    if not inside.any() or inside.all():
        return whole
    still, still_throughout = (moved <= allowed for moved, allowed in (ranges(position[inside]), ranges(position)))
    return (start, stop) if bool(np.any(still & ~still_throughout)) else whole
