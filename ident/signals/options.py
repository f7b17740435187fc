"""The user's choices of the preprocessing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from drivers.core.errors import UsageError
from drivers.core.options import Options, option, read_delay, read_numbers
from drivers.core.ranges import DELAY, VELOCITY_LIMIT, Range

FilterKind = Literal["butterworth", "chebyshev"]

Differentiation = Literal["butterworth", "kalman", "five-point", "savitzky-golay"]
"""How positions become q, q̇ and q̈; the parallel filter is another choice (`FilterKind`)."""

CUTOFF = Range(0.01, 10_000.0, "Hz")
"""Cut-off of a filter, whose response lasts as long as a period of its cut-off."""
DECIMATION = Range(1, 10_000)
WINDOW_TIME = Range(0.0, 1e7, "s")
"""From a recording's first stamp; four months."""
NOISE_LEVEL = Range(1e-30, 1e30)
"""A variance, or the density of white noise."""

_CUTOFF_HINT = "a cut-off of 0 Hz removes the whole signal"
_DECIMATION_HINT = "1 keeps every sample"


def delay_option() -> float | None:
    """The option `delay` of a dataclass."""
    return option(
        None,
        "Delay of torque behind position: auto, or SECONDS.",
        meaning="of the torque behind the position [s]; searched where None.",
        allowed=DELAY,
        hint="it is in seconds",
        read=read_delay,
        shown="auto",
    )


@dataclass(frozen=True, kw_only=True)
class FilterOptions(Options):
    """How positions and torques are filtered; None is chosen from the data (see `choose_cutoffs`)."""

    PANEL: ClassVar[str] = "Signals"

    delay: float | None = delay_option()
    position_cutoff: float | None = option(
        None,
        "Cut-off of the positions' low-pass or smoother, where its gain is one half [Hz].",
        allowed=CUTOFF,
        hint=_CUTOFF_HINT,
    )
    torque_cutoff: float | None = option(None, "Parallel filter of τ and W [Hz].", allowed=CUTOFF, hint=_CUTOFF_HINT)
    decimate: int | None = option(None, "Keep every N-th filtered sample.", allowed=DECIMATION, hint=_DECIMATION_HINT)
    position_decimate: int = option(
        1,
        "Factor of a Chebyshev decimation of all signals, in place of the Butterworth unless that has a cut-off.",
        allowed=DECIMATION,
        hint=_DECIMATION_HINT,
    )
    filter: FilterKind = option(
        "butterworth", "Parallel filter: butterworth or chebyshev.", one_of=get_args(FilterKind)
    )
    differentiation: Differentiation = option(
        "butterworth",
        "How q̇ and q̈ follow from positions: butterworth, kalman, five-point or savitzky-golay.",
        one_of=get_args(Differentiation),
    )
    kalman_noise: tuple[float, float] | None = option(
        None,
        "Q,R of kalman: density of the 4th derivative [rad²/s⁷], variance of a sample [rad²]; default: from the data.",
        allowed=NOISE_LEVEL,
        read=read_numbers,
    )
    measured_velocity: bool = option(False, "Use the recorded velocity.")

    def __post_init__(self) -> None:
        """Check every option, and that they agree; a UsageError names the option."""
        super().__post_init__()
        if self.filter == "chebyshev" and self.torque_cutoff is not None and self.decimate is not None:
            raise UsageError(
                "the decimation factor of a Chebyshev filter fixes its cut-off, give one of the two",
                where="--decimate, --torque-cutoff",
            )
        if self.kalman_noise is None:
            return
        if self.differentiation != "kalman":
            raise UsageError(
                "Q and R need the Kalman smoother", where="--kalman-noise", hint="--differentiation kalman"
            )
        if self.position_cutoff is not None:
            raise UsageError(
                "Q and R fix the cut-off", where="--kalman-noise, --position-cutoff", hint="give one of the two"
            )

    @property
    def without_low_pass(self) -> bool:
        """Return whether the Chebyshev decimation is all that filters the positions."""
        return self.differentiation == "butterworth" and self.position_decimate > 1 and self.position_cutoff is None


@dataclass(frozen=True, kw_only=True)
class WindowOptions(Options):
    """Choice of the samples that are used."""

    PANEL: ClassVar[str] = "Samples"

    start: float | None = option(
        None, "Leave out samples before this time [s from the first stamp].", allowed=WINDOW_TIME
    )
    stop: float | None = option(
        None, "Leave out samples after this time [s from the first stamp].", allowed=WINDOW_TIME
    )
    keep_rest: bool = option(False, "Keep samples at rest: segments in which no joint moves, and motors at rest.")

    def __post_init__(self) -> None:
        """Check every option, and that the window is not empty; a UsageError names the option."""
        super().__post_init__()
        if self.stop is not None and self.stop <= (self.start or 0.0):
            raise UsageError(
                f"the window from {self.start or 0:g} s to {self.stop:g} s is empty", where="--start, --stop"
            )


@dataclass(frozen=True, kw_only=True)
class PreprocessChoices(WindowOptions, FilterOptions):
    """The user's choices with what the preprocessing finds."""

    # τ(t + delay) is compared with q(t) [s]; positive where the torque lags
    delay: float = option(0.0, flag="delay", allowed=DELAY, hint="it is in seconds")
    # (n,) the same for each joint, in place of `delay`, where joints differ
    joint_delays: tuple[float, ...] | None = option(None, flag="joint_delays", allowed=DELAY, hint="it is in seconds")
    # (n,) of each joint's Kalman smoother [Hz]; from its noise levels where None
    joint_cutoffs: tuple[float, ...] | None = option(None, flag="joint_cutoffs", allowed=CUTOFF, hint=_CUTOFF_HINT)
    # all joints slower than this are at rest [rad/s or m/s]; from the data where None
    rest_velocity: float | None = option(None, flag="rest_velocity", allowed=VELOCITY_LIMIT)
