"""Prepare recorded joint signals as segments that the model can be fitted to (SR400 .4.3 points 2 to 4).

`prepare` runs the steps below in this order; each is a function that returns the changed signals and
one `Step`, a printable sentence with its numbers. The last step, parallel filtering, is only chosen here: the caller
applies `Prepared.parallel_filter` to τ and to every column of W, and keeps every `factor`-th entry of `Segment.used`.

    outliers → window → resample → delay → decimation → low-pass → derivatives → motion windows → ends → parallel filter
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, DynidError, UsageError
from drivers.core.text import counted
from drivers.core.units import common_unit
from ident.signals.cutoffs import CHEBYSHEV_PASSBAND, choose_cutoffs, parallel_filter, resolve
from ident.signals.derivatives import Smoother, choose_smoother, smooth_motion, without_rounding
from ident.signals.filters import ZeroPhaseFilter, chebyshev_decimation, unit_gain
from ident.signals.joint_signals import JointSignals
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared, Segment, SmoothMotion, Step
from ident.signals.resampling import (
    Irregularity,
    check_stamps,
    gap_free_segments,
    measure_irregularity,
    resample,
    shift_torque,
    shiftable,
    spread_stamps,
    uniform_grid,
)
from ident.signals.segments import (
    SHORTEST_SEGMENT,
    UniformSegment,
    end_seconds,
    motion_band,
    moving_segments,
    without_ends,
    without_holes,
)

__all__ = ["Prepared", "PreprocessChoices", "Segment", "prepare"]


def prepare(signals: JointSignals, choices: PreprocessChoices) -> Prepared:
    """Run the whole pipeline over one recording.

    Raises:
        DataError: stamps that go backwards, too few samples, no motion.
        UsageError: choices that this recording cannot fulfil.
    """
    try:
        return _prepare(signals, choices)
    except DynidError as error:
        where = ": ".join(text for text in (signals.label, error.where) if text)
        raise type(error)(error.message, where=where, hint=error.hint) from error


def prepare_with_rest(signals: JointSignals, choices: PreprocessChoices, *, played: bool) -> Prepared:
    """All samples of a window, those at rest, too; a played motion after its approach, which is not `used`.

    The approach decides with which friction the joints rest at the start. The motion's own ends are left out as ever.

    Raises:
        DataError: as `prepare`.
    """
    everything = prepare(signals, replace(choices, keep_rest=True, start=None if played else choices.start))
    if not played or choices.start is None:
        return everything
    begin = signals.time[0] + choices.start + sum(end_seconds(everything.cutoffs))
    counted = (replace(segment, used=segment.used & (segment.time >= begin)) for segment in everything.segments)
    return replace(everything, segments=tuple(segment for segment in counted if segment.used.any()))


def _prepare(signals: JointSignals, choices: PreprocessChoices) -> Prepared:
    if choices.measured_velocity and signals.velocity is None:
        raise UsageError("the recording holds no velocity", hint="omit the measured velocity; it is then derived")
    check_stamps(signals.time)
    windowed, window_step = _windowed(signals, choices)
    windowed, spread_step = _spread(windowed)
    irregularity = measure_irregularity(windowed.time)
    uniform, resample_step = _uniform(windowed, irregularity)
    aligned, delay_step = _aligned(uniform, signals.joint_names, choices)
    band = _motion_band(aligned)
    decimated, decimation_step = _decimated(aligned, band, choices.position_decimate)
    rate = decimated[0].rate
    cutoffs = choose_cutoffs(band, rate, choices)
    smoother, cutoffs, low_pass_step = choose_smoother(decimated, signals.joint_names, cutoffs, choices)
    motions, derivatives_step = smooth_motion(
        decimated, smoother, signals.joint_names, measured=choices.measured_velocity
    )
    motions = [without_rounding(motion, rate) for motion in motions]
    moving, rest_velocity, motion_step = moving_segments(
        decimated, motions, choices, common_unit("rad/s", signals.sliding)
    )
    segments, ends_step = without_ends(moving, cutoffs)
    segments, holes_step = without_holes(segments, windowed.time, cutoffs)
    segments = _with_temperature(segments, signals)
    segments = _with_target(segments, aligned, signals, smoother, choices.position_decimate)
    parallel = parallel_filter(cutoffs, choices.filter, rate)
    parallel_step = Step(
        "parallel filter",
        {"kind": choices.filter, "factor": parallel.factor, "torque_cutoff_hz": cutoffs.torque},
        f"τ and every column of W: {parallel.description}; {rate / parallel.factor:.4g} Hz remain",
    )
    steps = (
        *(
            _stale_step(signals),
            _outlier_step(signals),
            window_step,
            spread_step,
            resample_step,
            delay_step,
            decimation_step,
            low_pass_step,
        ),
        *(derivatives_step, motion_step, ends_step, holes_step, parallel_step),
    )
    return Prepared(
        segments=segments,
        steps=tuple(step for step in steps if step is not None),
        parallel_filter=parallel,
        cutoffs=cutoffs,
        irregularity=irregularity,
        choices=resolve(choices, cutoffs, smoother.joint_cutoffs, rest_velocity),
    )


def _with_temperature(segments: tuple[Segment, ...], signals: JointSignals) -> tuple[Segment, ...]:
    """The segments with the joints' temperatures, where they were recorded."""
    if signals.temperature is None:
        return segments
    columns = signals.temperature.T
    return tuple(
        replace(segment, temperature=np.array([np.interp(segment.time, signals.time, column) for column in columns]))
        for segment in segments
    )


def _with_target(
    segments: tuple[Segment, ...],
    aligned: Sequence[UniformSegment],
    signals: JointSignals,
    smoother: Smoother,
    decimation: int,
) -> tuple[Segment, ...]:
    """The segments with the targets' motion, filtered like the positions, where it was recorded without a gap."""
    if signals.target is None:
        return segments
    chebyshev = unit_gain(chebyshev_decimation(decimation)) if decimation > 1 else None
    motions = []
    for segment in aligned:
        rows = np.array([np.interp(segment.time, signals.time, column) for column in signals.target.T])
        rows = rows if chebyshev is None else chebyshev.apply(rows)
        time = segment.time[::decimation]
        if np.all(np.isfinite(rows)) and len(time) >= SHORTEST_SEGMENT:
            motions.append((time, smoother.apply(rows, 2)))

    def with_target(segment: Segment) -> Segment:
        for time, motion in motions:
            start = int(np.searchsorted(time, segment.time[0] - 0.5 / segment.rate))
            if time[0] <= segment.time[0] and segment.time[-1] <= time[-1]:
                chunk = slice(start, start + len(segment.time))
                target = SmoothMotion(*(np.ascontiguousarray(signal[:, chunk]) for signal in motion))
                return replace(segment, target=target)
        return segment

    return tuple(with_target(segment) for segment in segments)


def window_of(time: FloatArray, start: float | None, stop: float | None) -> slice:
    """The samples of the window from `start` to `stop` [s] after the first stamp, `stop` itself left out.

    Raises:
        DataError: the recording has fewer than `SHORTEST_SEGMENT` samples.
        UsageError: the window has.
    """
    if len(time) == 0:
        raise DataError("the recording holds no samples")
    relative = time - time[0]
    first = 0 if start is None else int(np.searchsorted(relative, start))
    last = len(time) if stop is None else int(np.searchsorted(relative, stop))
    if last - first < SHORTEST_SEGMENT:
        where = "" if start is None and stop is None else " of the window"
        raise (DataError if not where else UsageError)(
            f"the {last - first} samples{where} are too few, the recording lasts {relative[-1]:.4g} s",
            hint=f"at least {SHORTEST_SEGMENT} are needed, a few thousand are usual",
        )
    return slice(first, last)


def _windowed(signals: JointSignals, choices: PreprocessChoices) -> tuple[UniformSegment, Step | None]:
    """Step 'window': the chosen samples, stamps as recorded; the rate is not known yet."""
    time = signals.time
    window = window_of(time, choices.start, choices.stop)

    def rows(values: FloatArray) -> FloatArray:
        return np.ascontiguousarray(values[window].T, dtype=np.float64)

    windowed = UniformSegment(
        time[window],
        rows(signals.position),
        rows(signals.torque),
        None if signals.velocity is None else rows(signals.velocity),
        rate=float("nan"),
    )
    if window == slice(0, len(time)):
        return windowed, None
    start, stop = float(time[window.start] - time[0]), float(time[window.stop - 1] - time[0])
    samples = window.stop - window.start
    text = f"{start:.4g} s to {stop:.4g} s, {samples} of {len(time)} samples"
    return windowed, Step("window", {"start_s": start, "stop_s": stop, "samples": samples}, text)


def _spread(recorded: UniformSegment) -> tuple[UniformSegment, Step | None]:
    """Step 'repeated stamps': those of new positions, which a late or coarse clock made up for, are spread evenly."""
    repeated = np.diff(recorded.time) == 0.0
    if not repeated.any() or np.any(repeated & np.all(np.diff(recorded.position, axis=1) == 0.0, axis=0)):
        return recorded, None
    time = spread_stamps(recorded.time)
    count = int(np.count_nonzero(repeated) - np.count_nonzero(np.diff(time) == 0.0))
    text = f"{count} repeated stamps spread evenly between their neighbours"
    return replace(recorded, time=time), Step("repeated stamps", {"spread": count}, text)


def _stale_step(signals: JointSignals) -> Step | None:
    """Step 'stale samples': what was left out when the signals were read, in the whole recording."""
    if signals.stale is None:
        return None
    counts = {"repeated": signals.stale.repeated, "held": signals.stale.held, "stuck": signals.stale.stuck}
    settings = {name: int(np.count_nonzero(rows)) for name, rows in counts.items()}
    text = (
        f"repeated rows left out: {settings['repeated']} repeat the previous one, {settings['held']} its positions, "
        f"{settings['stuck']} while an encoder was stuck"
    )
    if signals.stale.off is not None and signals.stale.off.any():
        settings["off"] = int(np.count_nonzero(signals.stale.off))
        text += f", {settings['off']} while a motor was off"
    if signals.stale.jumps:
        settings["jumps"] = len(signals.stale.jumps)
        text += f", and those beside {settings['jumps']} jumps of the positions"
    return Step("stale samples", settings, text)


def _outlier_step(signals: JointSignals) -> Step | None:
    """Step 'outliers': what was replaced when the signals were read, in the whole recording."""
    if not signals.replaced:
        return None
    counts = ", ".join(f"{replaced.quantity} of {replaced.joint} {replaced.count}" for replaced in signals.replaced)
    text = f"single outliers replaced by interpolation: {counts}"
    return Step(
        "outliers", {f"{replaced.quantity}_{replaced.joint}": replaced.count for replaced in signals.replaced}, text
    )


def _uniform(recorded: UniformSegment, irregularity: Irregularity) -> tuple[tuple[UniformSegment, ...], Step]:
    """Step 'resample': every gap-free segment on a uniform grid."""
    if irregularity.duplicates:
        recorded = _kept(recorded, np.flatnonzero(np.concatenate([[True], np.diff(recorded.time) > 0])))
    time = recorded.time
    if irregularity.regular:
        rate = float(f"{(len(time) - 1) / (time[-1] - time[0]):.9g}")
        text = f"stamps are regular, {rate:.6g} Hz; used as they are"
        segments = [replace(recorded, rate=rate)] if len(time) >= SHORTEST_SEGMENT else []
    else:
        rate = irregularity.rate
        between_gaps = gap_free_segments(time, irregularity.median_period)
        long = [span for span in between_gaps if span.stop - span.start >= SHORTEST_SEGMENT]
        segments = [_resampled(recorded, span, rate) for span in long]
        dropped = len(time) - sum(span.stop - span.start for span in long)
        text = (
            f"stamps {1e3 * irregularity.shortest:.4g} to {1e3 * irregularity.longest:.4g} ms apart "
            f"(median {1e3 * irregularity.median_period:.4g} ms, "
            f"RMS deviation {1e3 * irregularity.rms_deviation:.3g} ms); cubic spline at {rate:.6g} Hz"
        )
        if irregularity.gaps:
            text += f", split at {counted(irregularity.gaps, 'gap')}, not interpolated"
        if dropped:
            text += f", {dropped} samples in segments below {SHORTEST_SEGMENT} samples left out"
    if irregularity.duplicates:
        text += f"; {irregularity.duplicates} repeated stamps left out"
    if not segments:
        raise DataError(
            f"no gap-free segment of {SHORTEST_SEGMENT} samples ({irregularity.gaps} gaps, "
            f"{irregularity.duplicates} repeated stamps)",
            hint="record again; dynid info lists the gaps",
        )
    settings: dict[str, float | int | str] = {
        "median_period_s": irregularity.median_period,
        "shortest_period_s": irregularity.shortest,
        "longest_period_s": irregularity.longest,
        "rms_deviation_s": irregularity.rms_deviation,
        "gaps": irregularity.gaps,
        "duplicates": irregularity.duplicates,
        "rate_hz": rate,
        "segments": len(segments),
    }
    return tuple(segments), Step("resample", settings, text)


def _resampled(recorded: UniformSegment, span: slice, rate: float) -> UniformSegment:
    time = recorded.time[span]
    grid = uniform_grid(time[0], time[-1], rate)

    def rows(values: FloatArray) -> FloatArray:
        return resample(time, values[:, span], grid)

    velocity = None if recorded.velocity is None else rows(recorded.velocity)
    return UniformSegment(grid, rows(recorded.position), rows(recorded.torque), velocity, rate)


def _kept(segment: UniformSegment, columns: slice | np.ndarray[tuple[int], np.dtype[np.intp]]) -> UniformSegment:
    """Some samples of a segment."""
    return replace(
        segment,
        time=segment.time[columns],
        position=np.ascontiguousarray(segment.position[:, columns]),
        torque=np.ascontiguousarray(segment.torque[:, columns]),
        velocity=None if segment.velocity is None else np.ascontiguousarray(segment.velocity[:, columns]),
    )


def _aligned(
    segments: tuple[UniformSegment, ...], joint_names: Sequence[str], choices: PreprocessChoices
) -> tuple[tuple[UniformSegment, ...], Step | None]:
    """Step 'delay': the torques moved against the positions, ends without a torque cut off."""
    delays = (choices.delay,) * len(joint_names) if choices.joint_delays is None else choices.joint_delays
    if len(delays) != len(joint_names):
        raise UsageError(f"{len(delays)} delays for {len(joint_names)} joints", where="joint_delays")
    if not any(delays):
        return segments, None
    measured = [_shiftable(segment, delays) for segment in segments]
    aligned = tuple(
        _kept(replace(segment, torque=_shifted(segment, delays)), columns)
        for segment, columns in zip(segments, measured, strict=True)
        if columns.stop - columns.start >= SHORTEST_SEGMENT
    )
    if not aligned:
        longest = max(delays, key=abs)
        raise UsageError(f"a delay of {longest:g} s is longer than the recording", where="delay", hint="give seconds")
    if choices.joint_delays is None:
        sign = "later" if choices.delay > 0 else "earlier"
        text = f"position compared with the torque {1e3 * abs(choices.delay):.4g} ms {sign}, ends dropped"
        return aligned, Step("delay", {"delay_s": choices.delay}, text)
    of_joints = ", ".join(f"{name} {1e3 * delay:.4g} ms" for name, delay in zip(joint_names, delays, strict=True))
    settings = {f"delay_s_{name}": delay for name, delay in zip(joint_names, delays, strict=True)}
    return aligned, Step("delay", settings, f"position compared with the torque later by {of_joints}; ends dropped")


def _shifted(segment: UniformSegment, delays: Sequence[float]) -> FloatArray:
    rows = [shift_torque(row[None], segment.rate, delay) for row, delay in zip(segment.torque, delays, strict=True)]
    return np.concatenate(rows)


def _shiftable(segment: UniformSegment, delays: Sequence[float]) -> slice:
    """The columns in which every joint's torque comes from measured samples; may be empty."""
    ranges = [shiftable(len(segment.time), segment.rate, delay) for delay in set(delays)]
    start = max(each.start for each in ranges)
    return slice(start, max(start, min(each.stop for each in ranges)))


def _motion_band(segments: Sequence[UniformSegment]) -> float:
    """Band of the motion [Hz], from the segments that are long enough to show it."""
    longest = max(len(segment.time) for segment in segments)
    return max(motion_band(s.position, s.rate) for s in segments if 2 * len(s.time) >= longest)


def _decimated(
    segments: tuple[UniformSegment, ...], band: float, factor: int
) -> tuple[tuple[UniformSegment, ...], Step | None]:
    """Step 'decimation' of all signals: τ gets the positions' filter, else its noise above the new Nyquist aliases."""
    if factor == 1:
        return segments, None
    rate = segments[0].rate
    if CHEBYSHEV_PASSBAND * rate / factor < 2 * band:
        raise UsageError(
            f"decimating the positions by {factor} leaves {CHEBYSHEV_PASSBAND * rate / factor:.3g} Hz, the motion "
            f"needs {2 * band:.3g} Hz",
            where="position_decimate",
            hint=f"give {max(1, int(CHEBYSHEV_PASSBAND * rate / (2 * band)))} or less",
        )
    chebyshev = unit_gain(chebyshev_decimation(factor))
    filtered = [_filtered(segment, chebyshev) for segment in segments]
    decimated = tuple(segment for segment in filtered if len(segment.time) >= SHORTEST_SEGMENT)
    if not decimated:
        raise UsageError(
            f"decimation by {factor} leaves fewer than {SHORTEST_SEGMENT} samples", where="position_decimate"
        )
    rate /= factor
    text = f"all signals: {chebyshev.description}; {rate:.6g} Hz remain"
    return decimated, Step("decimation", {"factor": factor, "rate_hz": rate}, text)


def _filtered(segment: UniformSegment, zero_phase: ZeroPhaseFilter) -> UniformSegment:
    return UniformSegment(
        segment.time[:: zero_phase.factor],
        zero_phase.apply(segment.position),
        zero_phase.apply(segment.torque),
        None if segment.velocity is None else zero_phase.apply(segment.velocity),
        segment.rate / zero_phase.factor,
    )
