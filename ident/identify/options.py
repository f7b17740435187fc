"""The user's choices about the model of an identification."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import ClassVar

from drivers.core.errors import UsageError
from drivers.core.options import Options, option
from ident.ranges import SMOOTHING


@dataclass(frozen=True, kw_only=True)
class ColumnOptions(Options):
    """Departures from the robot file's columns; None follows the file."""

    PANEL: ClassVar[str] = "Model"

    friction: str | None = option(
        None,
        "auto (default), coulomb-viscous, coulomb-viscous+stribeck+load, …; see docs.",
        meaning='"none", "viscous", "coulomb" or "coulomb-viscous", and further terms with plus signs, as in '
        '"coulomb-viscous+stribeck+load" (power, stribeck, load, load-linear, temperature, temperature-linear); or '
        '"auto", which chooses the terms of each joint by held-out error; the robot file\'s where None, "auto" where '
        "that states none.",
        panel="",
    )
    friction_from: str | PathLike[str] | None = option(
        None,
        "Folder or friction.json of dynid friction: terms, shapes, temperature terms.",
        meaning="folder or friction.json of a friction experiment: its terms and shapes hold, and so do its "
        "temperature terms where the recordings span too little temperature; the rest is estimated.",
        command_type=Path,
    )
    offset: bool | None = option(None, "Add a constant torque per joint.", flag="--offset/--no-offset")
    motor_inertia: bool | None = option(
        None, "Add columns for motor inertia.", flag="--motor-inertia/--no-motor-inertia"
    )
    smoothing: float | None = option(None, "ε [rad/s] of tanh(q̇/ε) in place of sign(q̇).", allowed=SMOOTHING)

    def __post_init__(self) -> None:
        """Check every option, and that friction is stated once; a UsageError names the option."""
        super().__post_init__()
        if self.friction is not None and self.friction_from is not None:
            raise UsageError("--friction and --friction-from exclude each other", hint="the experiment has the terms")
