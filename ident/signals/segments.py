"""Speed of the arm, and the segments with motion, without the ends that do not count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.core.arrays import FloatArray, true_runs
from drivers.core.errors import DataError
from ident.signals.cutoffs import Cutoffs
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Segment, SmoothMotion, Step

END_PERIODS = 2.0
"""Periods of the positions' cut-off that are left out at both ends of a segment. A low-pass cannot see how the motion
continues beyond them, and two derivatives amplify a wrong guess: a segment that ends in full motion can be off by its
whole acceleration there, and a few such samples outweigh thousands of good ones."""

FILTERED_END_PERIODS = 1.0
"""Periods of the parallel filter's cut-off at both ends that are not used. τ and W are filtered alike, but an odd
extension pins the filter to the end's raw sample: its noise passes unfiltered, many times that of the others."""

HOLES, OF_CUTOFF, ABOUT_HOLE, MOST_ABOUT_HOLES = (1.9, 2.5), 0.1, 0.1, 0.2
"""Time between rows, over the usual one, from which on accelerations there are not known (the second where too many
rows are missing for the first), if it is longer than that share of the positions' cut-off's period; time [s] before and
after that is not counted; share of the samples that it may be."""

SHORTEST_SEGMENT = 16
"""Samples; a shorter segment between two gaps is not worth differentiating."""

BAND_POWER = 0.999
"""Share of a joint's velocity power that lies within the motion's band."""

BAND_LIMIT_HZ = 20.0
"""Upper limit of the motion's band: drives do not follow, and the noise of differentiated positions grows with f²."""

MOVING_JOINT = 0.01
"""A joint counts for the band when its velocity's RMS is at least this share of the fastest joint's."""

REST_SHARE = 0.005
REST_FLOOR = 1e-3
"""Default rest velocity: `REST_SHARE` of the largest speed of any joint, but at least `REST_FLOOR` [rad/s or m/s]."""

SHORTEST_REST = 0.3
"""A standstill shorter than this [s] is a velocity reversal, not a rest."""


def motion_band(position: FloatArray, rate: float) -> float:
    """The frequency [Hz] below which `BAND_POWER` of the velocity's power of every moving joint lies.

    Args:
        position: (n, N) [rad or m] on a uniform grid.
        rate: [Hz].

    Positions are differenced and weighted with a Hann window; the spectrum is summed up to `BAND_LIMIT_HZ` or a fifth
    of the rate. The share of white position noise, which grows with f² once differenced, is estimated from the upper
    half of that range and subtracted. At least two periods of the record; 0 where nothing moves.
    """
    samples = position.shape[1] - 1
    if samples < 8:
        return 0.0
    velocity = np.diff(position, axis=1) * rate
    power = np.abs(np.fft.rfft(velocity * np.hanning(samples), axis=1)) ** 2
    frequency = np.fft.rfftfreq(samples, 1 / rate)
    within = frequency <= min(BAND_LIMIT_HZ, rate / 5)
    power, frequency = power[:, within], frequency[within]
    differencing = (2 * rate * np.sin(np.pi * frequency / rate)) ** 2
    upper = frequency > frequency[-1] / 2
    # The median of exponentially distributed values is ln 2 of their mean.
    noise = np.median(power[:, upper] / differencing[upper], axis=1) / np.log(2)
    power = power - noise[:, None] * differencing
    total = power.sum(axis=1)
    moving = total > MOVING_JOINT**2 * total.max()
    if not moving.any():
        return 0.0
    share = np.cumsum(power[moving], axis=1) / total[moving, None]
    last = int(np.argmax(share >= BAND_POWER, axis=1).max())
    return float(max(frequency[last], 2 * rate / samples))


def default_rest_velocity(velocity: FloatArray) -> float:
    """The speed [rad/s or m/s] below which a joint counts as at rest, from `velocity` (n, N)."""
    return max(REST_FLOOR, REST_SHARE * float(np.abs(velocity).max(initial=0.0)))


def moving_mask(velocity: FloatArray, rate: float, rest_velocity: float) -> npt.NDArray[np.bool_]:
    """(N,) False where every joint stays below `rest_velocity` for `SHORTEST_REST` or longer.

    There sign(q̇) is noise, and dry friction anything between its two values. `velocity` is (n, N) [rad/s or m/s] at
    `rate` [Hz].
    """
    moving = np.any(np.abs(velocity) >= rest_velocity, axis=0)
    for start, stop in true_runs(~moving):
        if stop - start < SHORTEST_REST * rate:
            moving[start:stop] = True
    return np.asarray(moving)


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


def end_seconds(cutoffs: Cutoffs) -> tuple[float, float]:
    """Time [s] at both ends of a segment that is cut off, and time beside it that is not counted."""
    return END_PERIODS / cutoffs.position, FILTERED_END_PERIODS / cutoffs.torque


def without_ends(segments: Sequence[Segment], cutoffs: Cutoffs) -> tuple[tuple[Segment, ...], Step]:
    """Step 'ends': both ends cut off where the low-pass is not valid, and not counted where the parallel filter is not.

    Raises:
        DataError: nothing with motion is left.
    """
    cut, uncounted = end_seconds(cutoffs)
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


def without_holes(
    segments: Sequence[Segment], stamps: FloatArray, cutoffs: Cutoffs
) -> tuple[tuple[Segment, ...], Step | None]:
    """Step 'holes': what lies about missing rows is not counted, where that is little.

    Positions between them are interpolated, and their second derivatives are wrong for a moment.
    """
    usual = float(np.median(np.diff(stamps)))
    before = sum(int(segment.used.sum()) for segment in segments)
    for least in HOLES:
        longest = max(least * usual, OF_CUTOFF / cutoffs.position)
        left = [replace(each, used=each.used & ~about_holes(each.time, stamps, longest)) for each in segments]
        lost = before - sum(int(segment.used.sum()) for segment in left)
        if 0 < lost <= MOST_ABOUT_HOLES * before:
            holes = int(np.count_nonzero(np.diff(stamps) > longest))
            text = f"{ABOUT_HOLE:g} s before and after {holes} holes of {least:g} periods and more not counted"
            step = Step("holes", {"holes": holes, "not_counted_s": lost / segments[0].rate}, text)
            return tuple(segment for segment in left if segment.used.any()), step
    return tuple(segments), None


def about_holes(time: FloatArray, stamps: FloatArray, longest: float) -> npt.NDArray[np.bool_]:
    """(M,) which of some times [s] lie within `ABOUT_HOLE` of rows (N,) that are more than `longest` [s] apart."""
    holes = np.flatnonzero(np.diff(stamps) > longest)
    begun = np.searchsorted(stamps[holes] - ABOUT_HOLE, time, side="right")
    ended = np.searchsorted(stamps[holes + 1] + ABOUT_HOLE, time, side="left")
    return np.asarray(begun > ended)


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
