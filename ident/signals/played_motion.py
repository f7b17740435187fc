"""Where in a recording the motion was played: `dynid record` writes events when it begins and when it ends."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording

MOTION_BEGINS, MOTION_ENDS = "motion begins", "motion ends"
"""Events of the player."""


def played_window(recording: Recording) -> tuple[float | None, float | None]:
    """Start and stop [s from the first stamp] of the played motion, by the player's events.

    The approach to the start pose and the hold at the end belong to no excitation: the arm creeps or rests, where
    friction differs from the model, and every joint may move, even one that is locked for the experiment.

    Args:
        recording: its events and its stamps.

    Returns:
        None for an end that is the recording's: imported data have no such events, nor older recordings.
    """
    stream = recording.streams.get(JOINTS_STREAM)
    if stream is None or not len(stream.time):
        return None, None
    begin = float(stream.time[0])
    times = {event.message: event.time - begin for event in recording.events if event.source == "player"}
    if MOTION_BEGINS not in times:
        return None, None
    start, stop = times[MOTION_BEGINS], times.get(MOTION_ENDS)
    seconds = stream.time - begin
    if not np.any((seconds >= start) & (seconds <= (np.inf if stop is None else stop))):
        return None, None
    return max(start, 0.0), stop
