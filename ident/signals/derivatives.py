"""q, q̇ and q̈ from sampled positions: a low-pass and central differences, or a smoother that gives all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import percent_text
from ident.signals.cutoffs import Cutoffs
from ident.signals.filters import butterworth as butterworth_filter
from ident.signals.filters import no_filter
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import SmoothMotion, Step
from ident.signals.segments import BAND_POWER, UniformSegment, central_difference
from ident.signals.smoothing.five_point import five_point_cubic, half_gain_frequency, passes_for
from ident.signals.smoothing.kalman import WHITE_SNAP, cutoff_of_noise, kalman_smoother, likeliest_cutoff, sample_noise
from ident.signals.smoothing.savitzky_golay import half_width_for, savitzky_golay

LOWEST_CUTOFF_PER_BAND = 2.0
"""A cut-off below it distorts the derivatives; at it, the gain within the motion's band is 1 − (1/2)⁸ or more."""

ROUNDING = 64 * float(np.finfo(np.float64).eps)
"""Change of a position in a period, as a share of the joint's largest one, that is a smoother's rounding at most."""

LEAST_BAND_HZ = 0.1
"""Taken for the band where next to nothing moves."""


@dataclass(frozen=True)
class Smoother:
    """How rows become smooth."""

    # rows (n, N) and a number k of derivatives → the smooth rows and their first k derivatives, each (n, N)
    apply: Callable[[FloatArray, int], tuple[FloatArray, ...]]
    derivatives: str  # in words, how they come about
    joint_cutoffs: tuple[float, ...] | None = None  # (n,) of the joints [Hz] where each has its own; None otherwise


def choose_smoother(
    segments: Sequence[UniformSegment], joint_names: Sequence[str], cutoffs: Cutoffs, choices: PreprocessChoices
) -> tuple[Smoother, Cutoffs, Step | None]:
    """Step 'low-pass' or 'smoothing': the smoother of the positions, and the cut-offs with its own.

    Raises:
        UsageError: cut-offs that do not fit the joints or the rate.
    """
    rate = segments[0].rate
    if choices.differentiation == "kalman":
        return _kalman(segments, joint_names, cutoffs, choices)
    if choices.differentiation == "savitzky-golay":
        return _savitzky_golay(cutoffs, rate, min(len(segment.time) for segment in segments))
    if choices.differentiation == "five-point":
        return _five_point(cutoffs, rate)
    return _butterworth(cutoffs, rate, choices)


def smooth_motion(
    segments: Sequence[UniformSegment], smoother: Smoother, joint_names: Sequence[str], *, measured: bool
) -> tuple[list[SmoothMotion], Step]:
    """Step 'derivatives': the motion of each segment, all at one rate, recorded velocities compared with derived ones.

    With `measured` the recorded velocities are taken, and accelerations from them.
    """
    derived = [SmoothMotion(*smoother.apply(segment.position, 2)) for segment in segments]
    if any(segment.velocity is None for segment in segments):
        return derived, Step(
            "derivatives", {"velocity": "derived"}, f"q̇ and q̈ {smoother.derivatives} of the filtered positions"
        )
    velocities = [
        smoother.apply(segment.velocity, int(measured)) for segment in segments if segment.velocity is not None
    ]
    squares = [(recorded[0] - motion.velocity) ** 2 for recorded, motion in zip(velocities, derived, strict=True)]
    difference = np.sqrt(np.concatenate(squares, axis=1).mean(axis=1))
    worst = int(np.argmax(difference))
    how = f"q̈ {smoother.derivatives}"
    text = (
        f"q̇ as recorded, filtered like the positions; {how} of it"
        if measured
        else f"q̇ and {how} of the filtered positions"
    )
    text += f"; recorded and derived velocity differ by up to {difference[worst]:.3g} (RMS, {joint_names[worst]})"
    settings: dict[str, float | int | str] = {"velocity": "measured" if measured else "derived"}
    settings |= {
        f"velocity_difference_rms_{name}": float(value) for name, value in zip(joint_names, difference, strict=True)
    }
    if measured:
        derived = [
            replace(motion, velocity=recorded[0], acceleration=recorded[1])
            for motion, recorded in zip(derived, velocities, strict=True)
        ]
    return derived, Step("derivatives", settings, text)


def without_rounding(motion: SmoothMotion, rate: float) -> SmoothMotion:
    """The motion at a rate [Hz], with no velocity where a joint rests: the sign of rounding is no direction."""
    least = ROUNDING * rate * np.abs(motion.position).max(axis=1, keepdims=True)
    velocity = np.where(np.abs(motion.velocity) > least, motion.velocity, 0.0)
    return replace(motion, velocity=velocity)


def _band_text(cutoffs: Cutoffs) -> str:
    """The motion's band, and whether the positions' cut-off is too low for it."""
    text = f"{percent_text(BAND_POWER)} of the motion's power lies below {cutoffs.band:.3g} Hz"
    distorts = cutoffs.position < (1.0 - 1e-9) * LOWEST_CUTOFF_PER_BAND * cutoffs.band
    return text + "; so low a cut-off distorts the derivatives" if distorts else text


def _differenced(smooth: FloatArray, rate: float, derivatives: int) -> tuple[FloatArray, ...]:
    """Smooth rows with their derivatives by central differences."""
    rows = [smooth]
    for _ in range(derivatives):
        rows.append(central_difference(rows[-1], rate))
    return tuple(rows)


def _butterworth(cutoffs: Cutoffs, rate: float, choices: PreprocessChoices) -> tuple[Smoother, Cutoffs, Step | None]:
    zero_phase = no_filter() if choices.without_low_pass else butterworth_filter(cutoffs.position, rate)

    def apply(rows: FloatArray, derivatives: int) -> tuple[FloatArray, ...]:
        return _differenced(zero_phase.apply(rows), rate, derivatives)

    smoother = Smoother(apply, "by central differences")
    if choices.without_low_pass:
        return smoother, cutoffs, None
    text = f"positions: {zero_phase.description}; {_band_text(cutoffs)}"
    settings = {"position_cutoff_hz": cutoffs.position, "motion_band_hz": cutoffs.band, "order": 4}
    return smoother, cutoffs, Step("low-pass", settings, text)


def _kalman(
    segments: Sequence[UniformSegment], joint_names: Sequence[str], cutoffs: Cutoffs, choices: PreprocessChoices
) -> tuple[Smoother, Cutoffs, Step]:
    rate = segments[0].rate
    longest = max(segments, key=lambda segment: len(segment.time)).position
    joint_cutoffs = choices.joint_cutoffs
    if joint_cutoffs is None and choices.kalman_noise is not None:
        joint_cutoffs = (cutoff_of_noise(*choices.kalman_noise, rate, WHITE_SNAP),) * len(joint_names)
    if joint_cutoffs is None and choices.position_cutoff is not None:
        joint_cutoffs = (choices.position_cutoff,) * len(joint_names)
    if joint_cutoffs is None:
        least = LOWEST_CUTOFF_PER_BAND * max(cutoffs.band, LEAST_BAND_HZ)
        joint_cutoffs = tuple(likeliest_cutoff(row, rate, WHITE_SNAP, least) for row in longest)
    if len(joint_cutoffs) != len(joint_names):
        raise UsageError(f"{len(joint_cutoffs)} cut-offs for {len(joint_names)} joints", where="joint_cutoffs")
    if max(joint_cutoffs) >= rate / 2:
        raise UsageError(
            f"a cut-off of {max(joint_cutoffs):.4g} Hz is not below half the sampling rate, {rate / 2:.4g} Hz",
            where="joint_cutoffs",
        )
    each, lowest = joint_cutoffs, replace(cutoffs, position=min(joint_cutoffs))

    def apply(rows: FloatArray, derivatives: int) -> tuple[FloatArray, ...]:
        smooth = np.stack(
            [kalman_smoother(row, rate, cutoff)[: derivatives + 1] for row, cutoff in zip(rows, each, strict=True)],
            axis=1,
        )
        return tuple(smooth)

    noise = [sample_noise(row, rate, WHITE_SNAP, cutoff) for row, cutoff in zip(longest, each, strict=True)]
    of_joints = ", ".join(
        f"{name} {cutoff:.3g} ({std:.2g})" for name, cutoff, std in zip(joint_names, each, noise, strict=True)
    )
    text = (
        "positions: Kalman filter, RTS smoother, white snap; cut-off [Hz] (and σ of a sample's noise) of each joint: "
        f"{of_joints}; {_band_text(lowest)}"
    )
    settings: dict[str, float | int | str] = {"motion_band_hz": cutoffs.band, "order": WHITE_SNAP}
    for name, cutoff, std in zip(joint_names, each, noise, strict=True):
        settings |= {f"cutoff_hz_{name}": cutoff, f"noise_std_{name}": std}
    smoother = Smoother(apply, "by the Kalman smoother", each)
    return smoother, lowest, Step("smoothing", settings, text)


def _savitzky_golay(cutoffs: Cutoffs, rate: float, samples: int) -> tuple[Smoother, Cutoffs, Step]:
    half_width = half_width_for(cutoffs.position, rate, samples)

    def apply(rows: FloatArray, derivatives: int) -> tuple[FloatArray, ...]:
        return savitzky_golay(rows, rate, half_width)[: derivatives + 1]

    window = 2 * half_width + 1
    text = (
        f"positions: Savitzky-Golay, degree 4 over {window} samples; the gain is one half at "
        f"{cutoffs.position:.4g} Hz; {_band_text(cutoffs)}"
    )
    settings = {"position_cutoff_hz": cutoffs.position, "motion_band_hz": cutoffs.band, "window": window}
    return Smoother(apply, "by the polynomials"), cutoffs, Step("smoothing", settings, text)


def _five_point(cutoffs: Cutoffs, rate: float) -> tuple[Smoother, Cutoffs, Step]:
    passes = passes_for(cutoffs.position, rate)
    reached = half_gain_frequency(passes, rate)

    def apply(rows: FloatArray, derivatives: int) -> tuple[FloatArray, ...]:
        return _differenced(five_point_cubic(rows, passes), rate, derivatives)

    text = (
        f"positions: five-point cubic, {passes} passes; the gain is one half at {reached:.4g} Hz; {_band_text(cutoffs)}"
    )
    settings = {"position_cutoff_hz": reached, "motion_band_hz": cutoffs.band, "passes": passes}
    return (Smoother(apply, "by central differences"), cutoffs, Step("smoothing", settings, text))
