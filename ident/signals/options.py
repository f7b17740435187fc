"""The user's choices of the preprocessing, and the cut-offs that follow from the data by default."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

from drivers.core.errors import UsageError
from drivers.core.ranges import DELAY, VELOCITY_LIMIT, check_option
from ident.ranges import CUTOFF, DECIMATION, NOISE_LEVEL, WINDOW_TIME
from ident.signals.filters import ZeroPhaseFilter, butterworth, chebyshev_decimation

FilterKind = Literal["butterworth", "chebyshev"]

Differentiation = Literal["butterworth", "kalman", "five-point", "savitzky-golay"]
"""How positions become q, q̇ and q̈; the parallel filter is another choice (`FilterKind`)."""

TORQUE_CUTOFF_PER_BAND = 10.0
TORQUE_CUTOFF_LEAST_HZ = 2.0
TORQUE_CUTOFF_MOST_HZ = 20.0
POSITION_CUTOFF_PER_TORQUE = 2.0
POSITION_CUTOFF_OF_RATE = 0.4
OUTPUT_RATE_PER_CUTOFF = 4.5
CHEBYSHEV_PASSBAND = 0.4
"""Cut-off of a Chebyshev decimation as a fraction of the reduced rate (0.8 of its Nyquist frequency)."""


@dataclass(frozen=True)
class PreprocessChoices:
    """The user's choices; None is chosen from the data (see `choose_cutoffs`, `default_rest_velocity`).

    Attributes:
        position_cutoff: of the positions [Hz]: where the gain of their low-pass or smoother is one half.
        torque_cutoff: of the parallel filter over τ and W [Hz].
        decimate: factor of the parallel filter.
        position_decimate: factor of a Chebyshev decimation of all signals before anything else is filtered (SR400);
            the Butterworth is then left out unless `position_cutoff` is given.
        filter_kind: of the parallel filter.
        delay: τ(t + delay) is compared with q(t) [s]; positive where the torque lags.
        joint_delays: (n,) the same for each joint, in place of `delay`, where joints differ.
        differentiation: how q, q̇ and q̈ follow from the positions (see `ident.signals.derivatives`).
        joint_cutoffs: (n,) of each joint's Kalman smoother [Hz]; from its noise levels where None.
        kalman_noise: Q and R of every joint's Kalman smoother: density of the white fourth derivative of the position
            [rad²/s⁷] and variance of a sample [rad²] (metres of sliding joints); from the data where None.
        measured_velocity: use the recorded velocity for q̇ instead of the positions' derivative.
        start: of the window, from the recording's first stamp [s].
        stop: of the window, from the recording's first stamp [s].
        rest_velocity: all joints slower than this are at rest [rad/s or m/s].
        keep_rest: keep the samples at rest.
    """

    position_cutoff: float | None = None
    torque_cutoff: float | None = None
    decimate: int | None = None
    position_decimate: int = 1
    filter_kind: FilterKind = "butterworth"
    delay: float = 0.0
    joint_delays: tuple[float, ...] | None = None
    differentiation: Differentiation = "butterworth"
    joint_cutoffs: tuple[float, ...] | None = None
    kalman_noise: tuple[float, float] | None = None
    measured_velocity: bool = False
    start: float | None = None
    stop: float | None = None
    rest_velocity: float | None = None
    keep_rest: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise UsageError(f"{value} is not a finite number", where=field.name)
        if not all(math.isfinite(delay) for delay in self.joint_delays or ()):
            raise UsageError("a joint's delay is not a finite number", where="joint_delays")
        given = (("position_cutoff", self.position_cutoff), ("torque_cutoff", self.torque_cutoff))
        for name, value in (*given, *(("joint_cutoffs", cutoff) for cutoff in self.joint_cutoffs or ())):
            if value is not None and value <= 0:
                raise UsageError(
                    f"a cut-off of {value:g} Hz removes the whole signal", where=name, hint="give more than 0 Hz"
                )
            if value is not None:
                check_option(name, value, CUTOFF)
        for name in ("decimate", "position_decimate"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise UsageError(f"decimation by {value} is not possible", where=name, hint="1 keeps every sample")
            if value is not None:
                check_option(name, value, DECIMATION)
        for delay in (self.delay, *(self.joint_delays or ())):
            check_option("a delay of", delay, DELAY, hint="it is in seconds")
        for name, allowed in (("start", WINDOW_TIME), ("stop", WINDOW_TIME), ("rest_velocity", VELOCITY_LIMIT)):
            value = getattr(self, name)
            if value is not None and value > 0:
                check_option(name, value, allowed)
        if self.filter_kind not in ("butterworth", "chebyshev"):
            raise UsageError(f"there is no filter '{self.filter_kind}'", hint="butterworth or chebyshev")
        if self.differentiation not in get_args(Differentiation):
            *others, last = get_args(Differentiation)
            raise UsageError(
                f"no differentiation is called '{self.differentiation}'", hint=f"{', '.join(others)} or {last}"
            )
        self._check_kalman_noise()
        if self.filter_kind == "chebyshev" and self.torque_cutoff is not None and self.decimate is not None:
            raise UsageError(
                "the decimation factor of a Chebyshev filter fixes its cut-off, give one of the two",
                where="decimate, torque_cutoff",
            )
        if self.rest_velocity is not None and self.rest_velocity < 0:
            raise UsageError(f"a rest velocity of {self.rest_velocity:g} is below zero", where="rest_velocity")
        if self.start is not None and self.start < 0:
            raise UsageError(f"the window starts {-self.start:g} s before the recording", where="start")
        if self.stop is not None and self.stop <= (self.start or 0.0):
            raise UsageError(f"the window from {self.start or 0:g} s to {self.stop:g} s is empty", where="start, stop")

    def _check_kalman_noise(self) -> None:
        if self.kalman_noise is None:
            return
        if len(self.kalman_noise) != 2:
            raise UsageError(f"{len(self.kalman_noise)} numbers in place of Q and R", where="kalman_noise")
        for name, value in zip(("Q", "R"), self.kalman_noise, strict=True):
            check_option(f"kalman_noise: {name}", value, NOISE_LEVEL)
        if self.differentiation != "kalman":
            raise UsageError(
                "Q and R have no meaning without the Kalman smoother",
                where="kalman_noise",
                hint="differentiation kalman",
            )
        if self.position_cutoff is not None:
            raise UsageError(
                "Q and R fix the cut-off", where="kalman_noise, position_cutoff", hint="give one of the two"
            )

    @property
    def without_low_pass(self) -> bool:
        """Whether the Chebyshev decimation is all that filters the positions."""
        return self.differentiation == "butterworth" and self.position_decimate > 1 and self.position_cutoff is None


@dataclass(frozen=True)
class Cutoffs:
    """The cut-offs of a recording.

    Attributes:
        band: of the motion [Hz].
        position: cut-off of the positions [Hz]; the lowest where joints have their own.
        torque: cut-off of the parallel filter [Hz].
        decimate: factor of the parallel filter.
    """

    band: float
    position: float
    torque: float
    decimate: int


def choose_cutoffs(band: float, rate: float, choices: PreprocessChoices) -> Cutoffs:
    """Cut-offs from the motion's band and the data's rate, where the user gives none.

    The parallel filter's is ten times the band: τ also holds the harmonics of q̇², of sin(q) over wide swings and of dry
    friction's reversals. It is kept between 2 Hz and 20 Hz (but at least three times the band), above which gears and
    links bend and the rigid model ends. The positions' is twice that: a zero-phase Butterworth 4 then differs from 1
    by (1/2)⁸ = 0.4 % at the parallel filter's edge and by nothing within the band, so q̇ and q̈ are undistorted wherever
    τ is compared; at most 0.4 of the rate. The parallel filter keeps 4.5 samples a period of its cut-off.

    Args:
        band: of the motion [Hz], 0 where nothing moves.
        rate: of the data [Hz].
        choices: the user's.

    Raises:
        UsageError: a cut-off above the Nyquist frequency, before or after decimation.
    """
    for name, value in (("position_cutoff", choices.position_cutoff), ("torque_cutoff", choices.torque_cutoff)):
        if value is not None and value >= rate / 2:
            raise UsageError(
                f"a cut-off of {value:g} Hz is not below half the sampling rate, {rate / 2:g} Hz",
                where=name,
                hint="leave it out to have it chosen from the motion",
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
    if choices.filter_kind == "chebyshev":
        decimate = max(1, int(CHEBYSHEV_PASSBAND * rate / torque + 1e-9)) if decimate is None else decimate
        torque = CHEBYSHEV_PASSBAND * rate / decimate
    elif decimate is None:
        decimate = max(1, int(rate / (OUTPUT_RATE_PER_CUTOFF * torque)))
    if decimate > 1 and torque >= rate / decimate / 2:
        most_decimate = max(1, int(rate / (OUTPUT_RATE_PER_CUTOFF * torque)))
        raise UsageError(
            f"every {decimate}th sample of {rate:g} Hz cannot hold frequencies up to the cut-off of {torque:g} Hz",
            where="decimate, torque_cutoff",
            hint=f"decimate by {most_decimate} or less, or leave one of them out",
        )
    return Cutoffs(band, position, torque, decimate)


def resolve(
    choices: PreprocessChoices, cutoffs: Cutoffs, joint_cutoffs: tuple[float, ...] | None, rest_velocity: float
) -> PreprocessChoices:
    """The choices with the cut-offs chosen from the data, so that other data get the same filters.

    The factor of a Butterworth's decimation stays open: it follows from the cut-off and the rate of the other data.
    """
    chebyshev = choices.filter_kind == "chebyshev"
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
