"""The user's choices about an import; none of them is guessed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean

DROP_NAN = "drop-nan"
DROP_DUPLICATES = "drop-duplicates"
DROP_REPEATS = "drop-repeats"
OPPOSITE_TORQUE = "opposite-torque"
SORT = "sort"
REPAIRS: Mapping[str, str] = {
    DROP_NAN: "leave out samples with NaN or infinite values, and quantities that have no finite value at all",
    DROP_DUPLICATES: "of samples with the same time stamp keep the first",
    DROP_REPEATS: "leave out samples that repeat the one before while the arm moves",
    OPPOSITE_TORQUE: "change the sign of all torques, currents and voltages",
    SORT: "sort samples that arrived out of order by their time stamp",
}
"""Repairs by name, with what each one does; none is made without a request."""

TimeUnit = Literal["s", "ms", "us", "ns"]
TIME_UNITS: tuple[TimeUnit, ...] = ("s", "ms", "us", "ns")


@dataclass(frozen=True)
class ImportChoices:
    """The user's choices for one file.

    Attributes:
        columns: our name (`t`, `q1`, `qd1`, `torque3`, `current2`, `temperature4`, or `q` for a whole array) → the
            file's name. For a whole quantity also a pattern, `q{}` with the joints' numbers or names in place of {},
            or numbers of CSV columns, `2-7`. A quantity that is named here is taken from these names only.
        degrees: positions and velocities of revolute joints are in degrees.
        effort: quantity of an array called `effort`; unused without one.
        topic: which topic of a bag, where several carry sensor_msgs/JointState.
        rate: [Hz] of uniform stamps, for a file without a time column.
        repair: names of the requested `REPAIRS`.
        by_order: joints whose names don't match the robot's are taken in the file's order.
        time_unit: unit of the time column, where neither the file nor seconds are right.

    Raises:
        UsageError: an unknown repair, effort or time unit, or a rate that is not positive.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    degrees: bool = False
    effort: Literal["torque", "current"] | None = None
    topic: str | None = None
    rate: float | None = None
    repair: frozenset[str] = frozenset()
    by_order: bool = False
    time_unit: TimeUnit | None = None

    def __post_init__(self) -> None:
        for name in sorted(self.repair):
            if name not in REPAIRS:
                raise UsageError(
                    f"unknown repair '{name}'; known: {', '.join(REPAIRS)}", hint=did_you_mean(name, REPAIRS)
                )
        if self.effort not in (None, "torque", "current"):
            raise UsageError(f"effort is either torque or current, not '{self.effort}'")
        if self.time_unit is not None and self.time_unit not in TIME_UNITS:
            raise UsageError(f"a time unit is one of {', '.join(TIME_UNITS)}, not '{self.time_unit}'")
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise UsageError(f"a rate is a positive number of samples per second, not {self.rate}")
