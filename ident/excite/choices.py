"""Options of an excitation design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, get_args

from drivers.core.errors import UsageError
from drivers.core.options import Options, option, read_names
from drivers.core.ranges import PERIOD, PIECE, Range
from ident.ranges import SEARCH_TIME, SEED

Kind = Literal["fourier", "fourier-quintic", "sines", "points"]
CriterionName = Literal[
    "condition", "plain-condition", "moments", "d-optimal", "e-optimal", "deviations", "motion-size"
]
Solver = Literal["slsqp", "sfla"]

DEFAULT_SECONDS = 20.0
"""Default duration of the search [s]."""

DEFAULT_MARGIN = 0.1
"""Share of every limit kept free: late commands make the played path faster than the designed one."""


@dataclass(frozen=True, kw_only=True)
class DesignChoices(Options):
    """Options of the motion and of what it is designed for."""

    PANEL: ClassVar[str] = "Motion"

    kind: Kind = option("fourier", "fourier, fourier-quintic, sines or points.", one_of=get_args(Kind))
    criterion: CriterionName = option(
        "d-optimal",
        "d-optimal, e-optimal, deviations, condition, plain-condition, moments or motion-size.",
        one_of=get_args(CriterionName),
    )
    harmonics: int = option(5, "Harmonics of the series, or number of sines.", allowed=Range(1, 50))
    points: int = option(12, "Points of a point-to-point motion.", allowed=Range(2, 200))
    period: float = option(
        10.0,
        "Duration of one repetition, or of a whole sum of sines or point-to-point motion [s].",
        allowed=PERIOD,
        panel="",
    )
    periods: int = option(3, "Repetitions.", allowed=Range(1, 10_000), panel="")
    ramp: float = option(
        2.0,
        "Time from rest to full speed, and back [s]; at least 0.1.",
        allowed=Range(0.1, 3600.0, "s"),
        hint="at least 0.1 s from rest to full speed",
    )
    loaded: bool = option(False, "Design for identifying a payload: the parameters of the last link.")
    joints: tuple[str, ...] | None = option(
        None, "Joints that move; the others rest in the middle of their range.", metavar="A,B,…", read=read_names
    )
    margin: float = option(DEFAULT_MARGIN, "Share of every limit kept free.")
    self_collision: bool = option(True, "Check for self-collision.", flag="--self-collision/--no-self-collision")

    def __post_init__(self) -> None:
        """Check every option, and the duration of all; a UsageError names the option."""
        super().__post_init__()
        duration = self.periods * self.period + 2.0 * self.ramp
        if not PIECE.holds(duration):
            raise UsageError(
                f"--periods {self.periods} of {self.period:g} s last {duration:g} s; at most one day can be played"
            )
        if not 0.0 <= self.margin < 1.0:
            raise UsageError(f"--margin {self.margin:g} is not between 0 and 1")


@dataclass(frozen=True, kw_only=True)
class SearchOptions(Options):
    """How long and how to search."""

    PANEL: ClassVar[str] = "Search"

    seed: int = option(0, "Seed of the random starts.", allowed=SEED)
    time: float | None = option(
        None, f"Duration of the search [s]; default {DEFAULT_SECONDS:g} unless starts are given.", allowed=SEARCH_TIME
    )
    starts: int | None = option(
        None, "Number of starts; the result does not depend on the machine's speed.", allowed=Range(1, 100000)
    )
    solver: Solver = option(
        "slsqp", "slsqp, with derivatives, or sfla, shuffled frog leaping without any.", one_of=get_args(Solver)
    )
    workers: int | None = option(None, meaning="processes; one per core where None, this one alone where 1.")
    scheduler: str = option("", "Dask scheduler whose workers search, too (tcp://host:8786).")


SMALLEST_STROKE = 0.1
"""Shorter strokes [rad or m] pass too few positions to tell gravity from friction."""

POSES = 20
"""Default number of poses: three to four minutes of most arms."""

FEWEST_POSES = 4

SERVO_LENGTH = 60.0
"""[s] Default length of a motion for a servo model."""

WANTED = 10.0
"""[%] Default half-width of the intervals that are enough."""


@dataclass(frozen=True, kw_only=True)
class MarginAndSeed(Options):
    """What motions of random poses share."""

    margin: float = option(
        DEFAULT_MARGIN,
        "Share of every limit kept free; of position ranges at both ends together.",
        allowed=Range(0.0, 0.9),
    )
    seed: int = option(0, "Seed of poses and phases.", allowed=SEED)


@dataclass(frozen=True, kw_only=True)
class SweepChoices(Options):
    """Options of a motion for friction: slow strokes of one joint after the other."""

    joints: Sequence[str] = option(
        (), "Joints that move, one after the other; default: all.", metavar="A,B,…", read=read_names
    )
    pose: str | None = option(
        None, "Pose in which the other joints rest; default: the robot file's first, or mid-range."
    )
    stroke: float = option(
        1.2,
        "Stroke of each joint, halved until it is free [rad or m].",
        allowed=Range(SMALLEST_STROKE, 12.0, "rad or m"),
    )
    slowest: float = option(0.2, "Peak of the slowest stroke [rad/s, m/s].", allowed=Range(1e-3, 20.0, "rad/s or m/s"))
    speeds: int = option(6, "Number of peak speeds up to the limits.", allowed=Range(2, 30))


@dataclass(frozen=True, kw_only=True)
class PoseCount(Options):
    """How many poses a motion for gravity has."""

    poses: int = option(
        POSES,
        "With --for gravity: number of poses.",
        meaning="number of poses; the first one is visited again at the end.",
        allowed=Range(FEWEST_POSES, 100),
        panel="",
    )


@dataclass(frozen=True, kw_only=True)
class GravityChoices(PoseCount, MarginAndSeed):
    """Options of a motion for gravity."""

    joints: Sequence[str] | None = option(
        None, "Joints that move; the others rest in the middle of their range.", metavar="A,B,…", read=read_names
    )


@dataclass(frozen=True, kw_only=True)
class ServoMotionLength(Options):
    """How long a motion for a servo model is, and for what."""

    length: float = option(
        SERVO_LENGTH,
        "With --for servo: longest motion [s].",
        meaning="longest motion [s].",
        allowed=Range(15.0, 600.0),
        panel="",
    )
    after: str | Path | None = option(
        None,
        "With --for servo: model folder to continue; designs for the parameters that are still wide.",
        meaning="folder or result.json of a servo model; the motion narrows its parameters that are still wide.",
        command_type=Path,
        panel="",
    )
    wanted: float = option(
        WANTED,
        "With --after: half-width of 95 % intervals that is enough [%].",
        meaning="half-width of 95 % intervals that is enough [%].",
        allowed=Range(0.5, 100.0),
        panel="",
    )


@dataclass(frozen=True, kw_only=True)
class ServoMotionChoices(ServoMotionLength, MarginAndSeed):
    """Options of a motion for a servo model."""
