"""The user's choices about an import; none of them is guessed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from daq.recording.array_choices import ArrayChoices
from drivers.core.options import option
from drivers.core.ranges import Range


@dataclass(frozen=True, kw_only=True)
class ImportChoices(ArrayChoices):
    """The user's choices for one file."""

    topic: str | None = option(None, "Topic of a bag with several JointState topics.")
    episode: int | None = option(None, "Episode of a LeRobot dataset, from 0; all without it.", allowed=Range(0, 1e9))
    calibration: Path | None = option(
        None, "LeRobot's calibration JSON, where positions are -100 to 100 of the calibrated range."
    )
