"""The last steps from uniform signals to segments: motion windows, and ends that do not count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.signals.cutoffs import Cutoffs
from ident.signals.motion_masks import SHORTEST_REST, default_rest_velocity, moving_mask
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Segment, SmoothMotion, Step

END_PERIODS = 2.0
"""Periods of the positions' cut-off that are left out at both ends of a segment. A low-pass cannot see how the motion
continues beyond them, and two derivatives amplify a wrong guess: a segment that ends in full motion can be off by its
whole acceleration there, and a few such samples outweigh thousands of good ones."""

FILTERED_END_PERIODS = 1.0
"""Periods of the parallel filter's cut-off at both ends that are not used. τ and W are filtered alike, but an odd
extension pins the filter to the end's raw sample: its noise passes unfiltered, many times that of the others."""

SHORTEST_SEGMENT = 16
"""Samples; a shorter segment between two gaps is not worth differentiating."""


@dataclass(frozen=True, eq=False)
class UniformSegment:
    """Gap-free signals on a uniform grid, not yet differentiated; shapes as in `Segment`."""

    time: FloatArray
    position: FloatArray
    torque: FloatArray
    velocity: FloatArray | None
    rate: float


def central_difference(rows: FloatArray, rate: float) -> FloatArray:
    """Derivative by central differences of `rows` (n, N) at `rate` [Hz] → (n, N) (SR400 .4.3 points 2 and 3).

    Second order at both ends too; a sinusoid of frequency f is scaled by sin(2πf/rate)/(2πf/rate).
    """
    return np.asarray(np.gradient(rows, 1 / rate, axis=1, edge_order=2))


def moving_segments(
    segments: Sequence[UniformSegment], motions: Sequence[SmoothMotion], choices: PreprocessChoices, unit: str
) -> tuple[tuple[Segment, ...], float, Step]:
    """Step 'motion windows': segments with their smooth motion, those without any motion left out.

    Returns:
        The segments, the rest velocity [rad/s or m/s], and the step.

    Raises:
        DataError: nothing moves.
    """
    threshold = choices.rest_velocity
    if threshold is None:
        threshold = max(default_rest_velocity(motion.velocity) for motion in motions)
    masks = [
        moving_mask(motion.velocity, segment.rate, threshold) for segment, motion in zip(segments, motions, strict=True)
    ]
    complete = [
        Segment(
            time=segment.time,
            position=motion.position,
            velocity=motion.velocity,
            acceleration=motion.acceleration,
            torque=segment.torque,
            rate=segment.rate,
            used=np.ones_like(moving) if choices.keep_rest else moving,
        )
        for segment, motion, moving in zip(segments, motions, masks, strict=True)
    ]
    seconds = sum(len(segment.time) for segment in complete) / segments[0].rate
    at_rest = sum(int((~segment.used).sum()) for segment in complete) / segments[0].rate
    moved = tuple(segment for segment in complete if segment.used.any())
    if not moved:
        raise DataError(
            f"no joint reaches the rest velocity of {threshold:.3g} {unit} for {SHORTEST_REST:g} s: nothing moves",
            hint="choose another window or a lower rest velocity, or keep the samples at rest",
        )
    if choices.keep_rest:
        text = "samples at rest are kept"
    else:
        text = (
            f"{at_rest:.4g} of {seconds:.4g} s left out, in which every joint stays below {threshold:.3g} {unit} "
            f"for {SHORTEST_REST:g} s or longer"
        )
    settings = {"rest_velocity": threshold, "left_out_s": at_rest, "total_s": seconds}
    return moved, threshold, Step("motion windows", settings, text)


def without_ends(segments: Sequence[Segment], cutoffs: Cutoffs) -> tuple[tuple[Segment, ...], Step]:
    """Step 'ends': both ends cut off where the low-pass is not valid, and not counted where the parallel filter is not.

    Raises:
        DataError: nothing with motion is left.
    """
    cut, uncounted = END_PERIODS / cutoffs.position, FILTERED_END_PERIODS / cutoffs.torque
    shortened = tuple(
        shorter for segment in segments if (shorter := _without_ends(segment, cut, uncounted)) is not None
    )
    ends = cut + uncounted
    if not shortened:
        raise DataError(
            f"no motion remains after leaving out {ends:.3g} s at both ends, where the filters are not valid",
            hint="record longer, or give higher cut-offs",
        )
    text = f"the first and the last {ends:.3g} s of every segment left out, where the filters are not valid"
    return shortened, Step("ends", {"cut_off_s": cut, "not_counted_s": uncounted}, text)


def _without_ends(segment: Segment, cut: float, uncounted: float) -> Segment | None:
    """Cut `cut` [s] off both ends and mark the next `uncounted` [s] as not used; None where nothing is left."""
    edge = math.ceil(cut * segment.rate)
    inner = slice(edge, len(segment.time) - edge)
    if inner.stop - inner.start < SHORTEST_SEGMENT:
        return None
    used = segment.used[inner].copy()
    margin = math.ceil(uncounted * segment.rate)
    used[:margin] = False
    used[max(0, len(used) - margin) :] = False
    if not used.any():
        return None
    return Segment(
        time=segment.time[inner],
        position=np.ascontiguousarray(segment.position[:, inner]),
        velocity=np.ascontiguousarray(segment.velocity[:, inner]),
        acceleration=np.ascontiguousarray(segment.acceleration[:, inner]),
        torque=np.ascontiguousarray(segment.torque[:, inner]),
        rate=segment.rate,
        used=used,
    )


MOTION_BEGINS, MOTION_ENDS = "motion begins", "motion ends"
"""Events of the player."""


def played_window(recording: Recording) -> tuple[float | None, float | None]:
    """Start and stop [s from the first stamp] of the played motion, by the player's events.

    The approach to the start pose and the hold at the end belong to no excitation: the arm creeps or rests, where
    friction differs from the model, and every joint may move, even one that is locked for the experiment.

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
