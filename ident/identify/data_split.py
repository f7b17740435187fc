"""What an identification learns from and what it is judged by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.recording import Recording
from daq.robot import Robot
from drivers.errors import UsageError
from drivers.streams import FloatArray
from ident.assessment.validation import HELD_OUT_SHARE
from ident.identify.played_motion import played_window
from ident.signals.joint_signals import JointSignals, read_joint_signals
from ident.signals.options import PreprocessChoices

Window = dict[str, float | None]
"""`start` and `stop` of a part, from its recording's first stamp [s]."""

Part = tuple[JointSignals, Window]
"""A recording's signals, and which part of them counts."""


def split_data(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    robot: Robot,
    chosen: PreprocessChoices,
    split: float | None,
) -> tuple[list[Part], list[Part], str]:
    """What to identify from and what to hold out: other recordings, or the last part of each.

    Args:
        recordings: to identify from.
        validation: held-out recordings; without any, the last part of each of the others is held out.
        robot: whose joints they hold.
        chosen: start and stop of the data.
        split: end of the identification part [s]; None takes the first 70 %.

    Returns:
        Parts to identify from, parts that are held out, and these in words.

    Raises:
        UsageError: a window or a border without data.
        DataError: as `read_joint_signals`.
    """
    motions = [read_joint_signals(recording, robot) for recording in recordings]
    windows = [_window(recording, motion, chosen) for recording, motion in zip(recordings, motions, strict=True)]
    if validation:
        if split is not None:
            raise UsageError(
                "--split and --validate exclude each other", hint="name the held-out recording, or split one"
            )
        held = [read_joint_signals(recording, robot) for recording in validation]
        names = ", ".join(motion.label for motion in held)
        held_windows = [
            _window(recording, motion, PreprocessChoices()) for recording, motion in zip(validation, held, strict=True)
        ]
        return list(zip(motions, windows, strict=True)), list(zip(held, held_windows, strict=True)), names
    parts: list[Part] = []
    held_out: list[Part] = []
    for motion, window in zip(motions, windows, strict=True):
        start, end = window["start"] or 0.0, window["stop"]
        length = float(motion.time[-1] - motion.time[0]) if len(motion.time) else 0.0
        stop = length if end is None else min(end, length)
        if not start < stop:
            raise UsageError(
                f"the window from {start:g} to {stop:g} s holds no samples; the recording lasts {length:g} s",
                where=motion.label,
            )
        border = start + (1.0 - HELD_OUT_SHARE) * (stop - start) if split is None else split
        if not start < border < stop:
            raise UsageError(
                f"--split {border:g} s is outside the data, which last from {start:g} to {stop:g} s",
                hint="leave it out to hold out the last 30 %",
            )
        parts.append((motion, {"start": start, "stop": border}))
        held_out.append((motion, {"start": border, "stop": end}))
    share = "last 30 %" if split is None else f"part after {split:g} s"
    source = f"the {share} of the recording{'s' if len(motions) > 1 else ''}, held out of the identification"
    return parts, held_out, source


def _window(recording: Recording, motion: JointSignals, chosen: PreprocessChoices) -> Window:
    """As the user says, else the played motion where joints that are locked move on their way to it."""
    start, stop = chosen.start, chosen.stop
    if start is None and stop is None:
        start, stop = played_window(recording, motion.position)
    return {"start": start, "stop": stop}


def part_positions(part: Part) -> tuple[str, FloatArray]:
    """Label and positions (N, n) of a part of a recording, as recorded."""
    motion, window = part
    time = motion.time - motion.time[0] if len(motion.time) else motion.time
    start, stop = window.get("start"), window.get("stop")
    inside = (time >= (-np.inf if start is None else start)) & (time <= (np.inf if stop is None else stop))
    return motion.label, motion.position[inside] if inside.any() else motion.position
