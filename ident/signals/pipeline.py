"""From a recording to signals that the model can be fitted to (SR400 .4.3 points 2 to 4).

`prepare` runs the steps below in this order; each is a plain function of its own and leaves one `Step`, a printable
sentence with its numbers. The last step, parallel filtering, is only chosen here: the caller applies
`Prepared.parallel_filter` to τ and to every column of W, and takes every `factor`-th entry of `Segment.used`.

    check → window → resample → delay → low-pass → derivatives → motion windows → ends → parallel filter
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.errors import DataError, UsageError
from drivers.streams import FloatArray
from ident.signals.filters import ZeroPhaseFilter, butterworth, chebyshev_decimation, unit_gain
from ident.signals.finite import check_finite
from ident.signals.motion_masks import BAND_POWER, motion_band
from ident.signals.options import (
    CHEBYSHEV_PASSBAND,
    Cutoffs,
    PreprocessChoices,
    choose_cutoffs,
    parallel_filter,
    resolve,
)
from ident.signals.prepared import Prepared, Segment, Step, describe
from ident.signals.resampling import (
    Irregularity,
    check_stamps,
    measure_irregularity,
    resample,
    shift_torque,
    shiftable,
    stretches_between_gaps,
    uniform_grid,
)
from ident.signals.segments import SHORTEST_SEGMENT, Stretch, central_difference, with_motion_windows, without_ends

__all__ = [
    "Cutoffs",
    "Irregularity",
    "Prepared",
    "PreprocessChoices",
    "Segment",
    "Step",
    "central_difference",
    "choose_cutoffs",
    "describe",
    "parallel_filter",
    "prepare",
    "shift_torque",
]


def prepare(
    time: FloatArray,
    position: FloatArray,
    torque: FloatArray,
    choices: PreprocessChoices,
    velocity: FloatArray | None = None,
) -> Prepared:
    """Run the whole pipeline over one recording.

    Args:
        time: (N,) stamps [s].
        position: (N, n) as recorded [rad or m].
        torque: (N, n) joint side [N·m or N].
        choices: what the user chose.
        velocity: (N, n) as recorded [rad/s or m/s].

    Raises:
        DataError: values that are no numbers, stamps that go backwards, too few samples, no motion.
        UsageError: choices that this recording cannot fulfil.
    """
    signals = {"position": position, "torque": torque} | ({} if velocity is None else {"velocity": velocity})
    for name, values in signals.items():
        if values.shape != position.shape or len(values) != len(time):
            raise ValueError(f"{name} of shape {values.shape}, position {position.shape}, time {time.shape}")
    if choices.measured_velocity and velocity is None:
        raise UsageError("the recording holds no velocity", hint="leave the measured velocity out; it is derived then")
    check_stamps(time)
    joints = [f"joint {number + 1}" for number in range(position.shape[1])]
    for name, values in signals.items():
        check_finite(name, values, joints)
    steps: list[Step] = []
    window = window_of(time, choices.start, choices.stop)
    if window != slice(0, len(time)):
        steps.append(_window_step(time - time[0], window))
    time = time[window]
    rows = {name: np.ascontiguousarray(values[window].T, dtype=np.float64) for name, values in signals.items()}
    irregularity = measure_irregularity(time)
    stretches = _uniform(time, rows, irregularity, steps)
    stretches = _delayed(stretches, choices.delay, steps)
    stretches, cutoffs = _low_passed(stretches, choices, steps)
    rate = stretches[0].rate
    velocities, difference = _velocities(stretches, choices.measured_velocity, steps)
    segments, rest_velocity = with_motion_windows(stretches, velocities, choices, steps)
    segments = without_ends(segments, cutoffs, steps)
    parallel = parallel_filter(cutoffs, choices.filter_kind, rate)
    steps.append(
        Step(
            "parallel filter",
            {"kind": choices.filter_kind, "factor": parallel.factor, "torque_cutoff_hz": cutoffs.torque},
            f"τ and every column of W: {parallel.description}; {rate / parallel.factor:.4g} Hz remain",
        )
    )
    resolved = resolve(choices, cutoffs, rest_velocity)
    return Prepared(segments, tuple(steps), parallel, irregularity, resolved, difference)


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


def _window_step(relative: FloatArray, window: slice) -> Step:
    start, stop = float(relative[window.start]), float(relative[window.stop - 1])
    samples = window.stop - window.start
    text = f"{start:.4g} s to {stop:.4g} s, {samples} of {len(relative)} samples"
    return Step("window", {"start_s": start, "stop_s": stop, "samples": samples}, text)


def _uniform(
    time: FloatArray, rows: Mapping[str, FloatArray], irregularity: Irregularity, steps: list[Step]
) -> tuple[Stretch, ...]:
    """Step 'resample': every stretch between gaps on a uniform grid."""
    settings: dict[str, float | int | str] = {
        "median_period_s": irregularity.median_period,
        "shortest_period_s": irregularity.shortest,
        "longest_period_s": irregularity.longest,
        "rms_deviation_s": irregularity.rms_deviation,
        "gaps": irregularity.gaps,
        "duplicates": irregularity.duplicates,
    }
    if irregularity.duplicates:
        kept = np.concatenate([[True], np.diff(time) > 0])
        time, rows = time[kept], {name: np.ascontiguousarray(values[:, kept]) for name, values in rows.items()}
    if irregularity.regular:
        rate = float(f"{(len(time) - 1) / (time[-1] - time[0]):.9g}")
        text = f"stamps are regular, {rate:.6g} Hz; taken as they are"
        whole = Stretch(time, rows["position"], rows["torque"], rows.get("velocity"), rate)
        stretches = [whole] if len(time) >= SHORTEST_SEGMENT else []
    else:
        rate = irregularity.rate
        stretches = []
        dropped = 0
        for part in stretches_between_gaps(time, irregularity.median_period):
            if part.stop - part.start < SHORTEST_SEGMENT:
                dropped += part.stop - part.start
                continue
            grid = uniform_grid(time[part.start], time[part.stop - 1], rate)
            new = {name: resample(time[part], values[:, part], grid) for name, values in rows.items()}
            stretches.append(Stretch(grid, new["position"], new["torque"], new.get("velocity"), rate))
        text = (
            f"stamps {1e3 * irregularity.shortest:.4g} to {1e3 * irregularity.longest:.4g} ms apart "
            f"(median {1e3 * irregularity.median_period:.4g} ms, "
            f"RMS deviation {1e3 * irregularity.rms_deviation:.3g} ms); cubic spline at {rate:.6g} Hz"
        )
        if irregularity.gaps:
            text += f", split at {irregularity.gaps} gap{'s' * (irregularity.gaps > 1)} that are not interpolated"
        if dropped:
            text += f", {dropped} samples in stretches below {SHORTEST_SEGMENT} samples left out"
    if irregularity.duplicates:
        text += f"; {irregularity.duplicates} repeated stamps left out"
    if not stretches:
        raise DataError(
            f"no stretch of {SHORTEST_SEGMENT} samples without a gap ({irregularity.gaps} gaps, "
            f"{irregularity.duplicates} repeated stamps)",
            hint="record again; dynid info lists the gaps",
        )
    steps.append(Step("resample", settings | {"rate_hz": rate, "segments": len(stretches)}, text))
    return tuple(stretches)


def _delayed(stretches: tuple[Stretch, ...], delay: float, steps: list[Step]) -> tuple[Stretch, ...]:
    """Step 'delay': the torque moved against the position, ends without a torque cut off."""
    if delay == 0.0:
        return stretches
    moved = []
    for stretch in stretches:
        kept = shiftable(len(stretch.time), stretch.rate, delay)
        if kept.stop - kept.start < SHORTEST_SEGMENT:
            continue
        moved.append(
            Stretch(
                stretch.time[kept],
                np.ascontiguousarray(stretch.position[:, kept]),
                np.ascontiguousarray(shift_torque(stretch.torque, stretch.rate, delay)[:, kept]),
                None if stretch.velocity is None else np.ascontiguousarray(stretch.velocity[:, kept]),
                stretch.rate,
            )
        )
    if not moved:
        raise UsageError(f"a delay of {delay:g} s is longer than the recording", where="delay", hint="give seconds")
    sign = "later" if delay > 0 else "earlier"
    steps.append(
        Step(
            "delay",
            {"delay_s": delay},
            f"position compared with the torque {1e3 * abs(delay):.4g} ms {sign}, ends cut off",
        )
    )
    return tuple(moved)


def _low_passed(
    stretches: tuple[Stretch, ...], choices: PreprocessChoices, steps: list[Step]
) -> tuple[tuple[Stretch, ...], Cutoffs]:
    """Steps 'decimation' and 'low-pass' of the positions (a recorded velocity takes the same), and all cut-offs."""
    rate = stretches[0].rate
    longest = max(len(stretch.time) for stretch in stretches)
    band = max(motion_band(s.position, rate) for s in stretches if 2 * len(s.time) >= longest)
    factor = choices.position_decimate
    if factor > 1:
        if CHEBYSHEV_PASSBAND * rate / factor < 2 * band:
            raise UsageError(
                f"decimating the positions by {factor} leaves {CHEBYSHEV_PASSBAND * rate / factor:.3g} Hz, the motion "
                f"needs {2 * band:.3g} Hz",
                where="position_decimate",
                hint=f"give {max(1, int(CHEBYSHEV_PASSBAND * rate / (2 * band)))} or less",
            )
        # τ takes the same filter, else its noise above the new Nyquist frequency folds down.
        chebyshev = unit_gain(chebyshev_decimation(factor))
        stretches = tuple(_filtered(stretch, chebyshev, with_torque=True) for stretch in stretches)
        stretches = tuple(stretch for stretch in stretches if len(stretch.time) >= SHORTEST_SEGMENT)
        if not stretches:
            raise UsageError(
                f"decimation by {factor} leaves fewer than {SHORTEST_SEGMENT} samples", where="position_decimate"
            )
        rate /= factor
        steps.append(
            Step(
                "decimation",
                {"factor": factor, "rate_hz": rate},
                f"all signals: {chebyshev.description}; {rate:.6g} Hz remain",
            )
        )
    cutoffs = choose_cutoffs(band, rate, choices)
    if factor > 1 and choices.position_cutoff is None:
        return stretches, cutoffs
    zero_phase = butterworth(cutoffs.position, rate)
    text = f"positions: {zero_phase.description}; {100 * BAND_POWER:g} % of the motion's power lies below {band:.3g} Hz"
    if cutoffs.position < 2 * band:
        text += "; so low a cut-off distorts the derivatives"
    settings: dict[str, float | int | str] = {
        "position_cutoff_hz": cutoffs.position,
        "motion_band_hz": band,
        "order": 4,
    }
    steps.append(Step("low-pass", settings, text))
    return tuple(_filtered(stretch, zero_phase, with_torque=False) for stretch in stretches), cutoffs


def _filtered(stretch: Stretch, zero_phase: ZeroPhaseFilter, *, with_torque: bool) -> Stretch:
    return Stretch(
        stretch.time[:: zero_phase.factor],
        zero_phase.apply(stretch.position),
        zero_phase.apply(stretch.torque) if with_torque else stretch.torque,
        None if stretch.velocity is None else zero_phase.apply(stretch.velocity),
        stretch.rate / zero_phase.factor,
    )


def _velocities(
    stretches: tuple[Stretch, ...], measured: bool, steps: list[Step]
) -> tuple[list[FloatArray], FloatArray | None]:
    """Step 'derivatives': q̇ of each stretch, and (n,) how far the recorded velocity is from the derived one."""
    derived = [central_difference(stretch.position, stretch.rate) for stretch in stretches]
    recorded = [stretch.velocity for stretch in stretches if stretch.velocity is not None]
    text = "q̇ and q̈ by central differences of the filtered positions"
    if not recorded:
        steps.append(Step("derivatives", {"velocity": "derived"}, text))
        return derived, None
    squares = np.concatenate([(a - b) ** 2 for a, b in zip(recorded, derived, strict=True)], axis=1)
    difference = np.sqrt(squares.mean(axis=1))
    if measured:
        text = "q̇ as recorded, filtered like the positions; q̈ by central differences of it"
    worst = int(np.argmax(difference))
    text += f"; recorded and derived velocity differ by up to {difference[worst]:.3g} (RMS, joint {worst + 1})"
    settings: dict[str, float | int | str] = {"velocity": "measured" if measured else "derived"}
    settings |= {f"velocity_difference_rms_{joint + 1}": float(value) for joint, value in enumerate(difference)}
    steps.append(Step("derivatives", settings, text))
    return (recorded if measured else derived), difference
