"""Cut-offs of the filters that follow from the data by default."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drivers.core.errors import UsageError
from ident.signals.filters import ZeroPhaseFilter, butterworth, chebyshev_decimation
from ident.signals.options import FilterKind, PreprocessChoices

TORQUE_CUTOFF_PER_BAND = 10.0
TORQUE_CUTOFF_LEAST_HZ = 2.0
TORQUE_CUTOFF_MOST_HZ = 20.0
POSITION_CUTOFF_PER_TORQUE = 2.0
POSITION_CUTOFF_OF_RATE = 0.4
OUTPUT_RATE_PER_CUTOFF = 4.5
CHEBYSHEV_PASSBAND = 0.4
"""Cut-off of a Chebyshev decimation as a fraction of the reduced rate (0.8 of its Nyquist frequency)."""


@dataclass(frozen=True)
class Cutoffs:
    """The cut-offs of a recording."""

    band: float  # of the motion [Hz]
    position: float  # cut-off of the positions [Hz]; the lowest where joints have their own
    torque: float  # cut-off of the parallel filter [Hz]
    decimate: int  # factor of the parallel filter


def choose_cutoffs(band: float, rate: float, choices: PreprocessChoices) -> Cutoffs:
    """Cut-offs from the motion's band and the data's rate [Hz], where the user gives none.

    The parallel filter's is ten times the band: τ also holds the harmonics of q̇², of sin(q) over wide swings and of dry
    friction's reversals. It is kept between 2 Hz and 20 Hz (but at least three times the band), above which gears and
    links bend and the rigid model ends. The positions' is twice that: a zero-phase Butterworth 4 then differs from 1
    by (1/2)⁸ = 0.4 % at the parallel filter's edge and by nothing within the band, so q̇ and q̈ are undistorted wherever
    τ is compared; at most 0.4 of the rate. The parallel filter keeps 4.5 samples a period of its cut-off.

    Raises:
        UsageError: a cut-off above the Nyquist frequency, before or after decimation.
    """
    for name, value in (("position_cutoff", choices.position_cutoff), ("torque_cutoff", choices.torque_cutoff)):
        if value is not None and value >= rate / 2:
            raise UsageError(
                f"a cut-off of {value:g} Hz is not below half the sampling rate, {rate / 2:g} Hz",
                where=name,
                hint="omit it to choose it from the motion",
            )
    torque = choices.torque_cutoff
    if torque is None:
        most = max(TORQUE_CUTOFF_MOST_HZ, 3 * band)
        torque = min(max(TORQUE_CUTOFF_PER_BAND * band, TORQUE_CUTOFF_LEAST_HZ), most)
        if choices.position_cutoff is not None:
            torque = min(torque, choices.position_cutoff)
        torque = min(torque, POSITION_CUTOFF_OF_RATE / POSITION_CUTOFF_PER_TORQUE * rate)
        if choices.decimate is not None:
            torque = min(torque, CHEBYSHEV_PASSBAND * rate / choices.decimate)
    position = choices.position_cutoff
    if position is None:
        position = min(POSITION_CUTOFF_PER_TORQUE * torque, max(POSITION_CUTOFF_OF_RATE * rate, torque))
    decimate = choices.decimate
    if choices.filter == "chebyshev":
        decimate = max(1, int(CHEBYSHEV_PASSBAND * rate / torque + 1e-9)) if decimate is None else decimate
        torque = CHEBYSHEV_PASSBAND * rate / decimate
    elif decimate is None:
        decimate = max(1, int(rate / (OUTPUT_RATE_PER_CUTOFF * torque)))
    if decimate > 1 and torque >= rate / decimate / 2:
        most_decimate = max(1, int(rate / (OUTPUT_RATE_PER_CUTOFF * torque)))
        raise UsageError(
            f"every {decimate}th sample of {rate:g} Hz cannot represent frequencies up to the cut-off of {torque:g} Hz",
            where="decimate, torque_cutoff",
            hint=f"decimate by {most_decimate} or less, or omit one of them",
        )
    return Cutoffs(band, position, torque, decimate)


def resolve(
    choices: PreprocessChoices, cutoffs: Cutoffs, joint_cutoffs: tuple[float, ...] | None, rest_velocity: float
) -> PreprocessChoices:
    """The choices with the cut-offs chosen from the data, so that other data get the same filters.

    The factor of a Butterworth's decimation stays open: it follows from the cut-off and the rate of the other data.
    """
    chebyshev = choices.filter == "chebyshev"
    return replace(
        choices,
        position_cutoff=None if choices.without_low_pass else cutoffs.position,
        joint_cutoffs=joint_cutoffs,
        kalman_noise=None,  # they are in the joints' cut-offs
        torque_cutoff=None if chebyshev else cutoffs.torque,
        decimate=cutoffs.decimate if chebyshev else choices.decimate,
        rest_velocity=rest_velocity,
    )


def filtered_rate(resolved: PreprocessChoices, rate: float) -> float | None:
    """Rate [Hz] of the filtered torques of data at `rate` [Hz]; None where the cut-off was left to the data.

    Needs no data: with the cut-off or the factor given, the band of the motion decides nothing more.
    """
    if resolved.torque_cutoff is None and resolved.decimate is None:
        return None
    return rate / choose_cutoffs(0.0, rate, resolved).decimate


def parallel_filter(cutoffs: Cutoffs, kind: FilterKind, rate: float) -> ZeroPhaseFilter:
    """The filter for τ and every column of W (SR400 .4.3 point 4) at `rate` [Hz]."""
    if kind == "chebyshev":
        return chebyshev_decimation(cutoffs.decimate)
    return butterworth(cutoffs.torque, rate, factor=cutoffs.decimate)
