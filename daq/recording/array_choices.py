"""What a user says about columns and arrays of other programs; none of it is guessed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from daq.recording.repairs import REPAIRS
from drivers.core.errors import UsageError
from drivers.core.options import Options, option
from drivers.core.ranges import Range
from drivers.core.text import did_you_mean

TimeUnit = Literal["s", "ms", "us", "ns"]
Effort = Literal["torque", "current"]


def _read_columns(pairs: list[str], flag: str) -> dict[str, str]:
    """Our names of the file's columns, from NAME=COLUMN each."""
    mapping: dict[str, str] = {}
    for pair in pairs:
        name, equals, column = (text.strip() for text in pair.partition("="))
        if not (name and equals and column):
            raise UsageError(f"{flag} {pair} is not NAME=COLUMN", hint=f"for example {flag} q1=JointPos1")
        if name in mapping:
            raise UsageError(f"{flag} gives '{name}' twice")
        mapping[name] = column
    return mapping


@dataclass(frozen=True, kw_only=True)
class ArrayChoices(Options):
    """The user's choices about columns of a file or arrays in memory."""

    columns: Mapping[str, str] = option(
        {},
        "NAME=COLUMN: q1=JointPos1; position='q{}' for all joints; position=2-7 by number (CSV).",
        meaning="dynid's name (`t`, `q1`, `qd1`, `torque3`, `current2`, `temperature4`, or `q` for a whole array) → "
        "the "
        "file's name. For a whole quantity also a pattern, `q{}` with the joints' numbers or names in place of {}, or "
        "numbers of CSV columns, `2-7`. A quantity named here is taken from these names only.",
        flag="--column",
        command_type=list[str],
        read=_read_columns,
    )
    degrees: bool = option(False, "Positions and velocities of revolute joints are in degrees.")
    effort: Effort | None = option(
        None, "Whether `effort` is a torque [N·m] or a current [A].", one_of=get_args(Effort)
    )
    rate: float | None = option(None, "Rate [Hz] of data without times.", allowed=Range(1e-06, 1000000000.0, "Hz"))
    time_unit: TimeUnit | None = option(None, "Unit of the time column: s, ms, us or ns.", one_of=get_args(TimeUnit))
    repair: Collection[str] = option(
        (), "Repair to make: drop-nan, drop-duplicates, drop-repeats, opposite-torque, sort.", command_type=list[str]
    )
    by_order: bool = option(False, "Match joints by their order, whatever their names.")

    def __post_init__(self) -> None:
        """Check every option, and that the repairs exist."""
        super().__post_init__()
        for name in sorted(self.repair):
            if name not in REPAIRS:
                raise UsageError(
                    f"unknown repair '{name}'; known: {', '.join(REPAIRS)}", hint=did_you_mean(name, REPAIRS)
                )
