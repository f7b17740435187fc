"""What the commands `demo` and `sim` are told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.core.options import Options, option
from drivers.core.ranges import Range

DEMO_TIME = Range(2.0, 3600.0, "s")
"""Duration of the demonstration's motion."""


@dataclass(frozen=True, kw_only=True)
class DemoOptions(Options):
    """What the demonstration is told."""

    out: Path = option(Path("demo"), "Folder for the recordings, result.json, report.html.", short="-o")
    robot: str = option("ur5e", "UR arm: built-in, or a robot file with a truth section.")
    duration: float = option(
        30.0,
        "Length of the identification motion [s].",
        allowed=DEMO_TIME,
    )
    seed: int = option(1, "Seed of the motion and the noise.")
