"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import typer

from drivers.core.errors import UsageError
from drivers.core.options import Options, argument, default_of, flag_of, option
from ident.tasks.options import MODEL_HELP

if TYPE_CHECKING:
    from ident.result.delivered import Parameters


def _list_methods(text: str) -> str:
    """Print the methods and end, where asked for them."""
    if text == "help":
        from ident.estimators.method_choice import describe_methods

        print(describe_methods())
        raise typer.Exit
    return text


METHOD = {"callback": _list_methods, "is_eager": True}
"""What `--method` does beside: 'help' lists the methods."""

ACCEPT = typer.Option(
    None, "--accept", help="YAML file of limits; exit status 1 if one is exceeded.", rich_help_panel="Acceptance"
)
MAX_ERROR = typer.Option(
    None,
    "--max-error",
    help="Limit of the held-out relative error, a ratio such as 0.08.",
    rich_help_panel="Acceptance",
)
MAX_JOINT_ERROR = typer.Option(None, "--max-joint-error", help="The same for each joint.", rich_help_panel="Acceptance")
MAX_RMSE = typer.Option(
    None, "--max-rmse", help="Limit of each joint's held-out RMSE [N·m or N].", rich_help_panel="Acceptance"
)
MODEL_FILE = typer.Option(
    None, "--model-file", help="Servo model: original MJCF of the arm, rolled out for comparison."
)


def limits_option(
    accept: Path | None, max_error: float | None, max_joint_error: float | None, max_rmse: float | None
) -> dict[str, Any] | None:
    """Limits of a file and of options, which go before the file's; None where there are none.

    Raises:
        UsageError: the file cannot be read, or a limit is wrong.
    """
    from ident.verdict.acceptance import declared, read_limits

    limits = {} if accept is None else read_limits(accept).model_dump(exclude_none=True)
    given = (
        ("--max-error", "relative_error", max_error),
        ("--max-joint-error", "joint_relative_error", max_joint_error),
        ("--max-rmse", "rmse", max_rmse),
    )
    for flag, key, limit in given:
        if limit is not None:
            limits |= declared({key: limit}, flag).model_dump(exclude_none=True)
    return limits or None


def refuse_options_but(taken: Collection[str], options: Options, mode: str, *, limited: bool = False) -> None:
    """Refuse options of a command that do nothing in one of its modes, such as `--method servo`.

    Raises:
        UsageError: names them all; acceptance limits, too, where they are given (`limited`).
    """
    strange = [
        flag_of(of).partition("/")[0]
        for of in fields(cast("Any", options))
        if of.name not in taken and getattr(options, of.name) != default_of(of)
    ]
    if limited:
        strange.append("--accept, --max-…")
    if strange:
        raise UsageError(f"{', '.join(strange)} does nothing with {mode}", hint="leave it out")


@dataclass(frozen=True, kw_only=True)
class ExportOptions(Options):
    """Options of `export`: a model, and the files to write of it."""

    model: Path = field(metadata=argument("model", MODEL_HELP))
    urdf: Path | None = option(None, "URDF to write: the robot's own, or a complete one from MDH.")
    into: Path | None = option(None, "URDF of the same arm to put the model into, with --urdf.")
    mjcf: Path | None = option(None, "MJCF to write, for MuJoCo.")
    ros2_inertial: Path | None = option(None, "YAML to write, as in Universal_Robots_ROS2_Description.")
    c: Path | None = option(None, "C99 code to write: `arm` for arm.h and arm.c.")
    c_float: bool = option(False, "C code in float, not double.")
    isaaclab: Path | None = option(None, "Servo model: Python configuration for Isaac Lab, with events.")
    usd: Path | None = option(None, "Servo model: USD stage with joint drives (.usda).")
    ranges: Path | None = option(
        None, "Servo model: JSON of ranges for domain randomisation, intervals and covariance."
    )
    unit_spread: float = option(0.0, "Ranges and events: spread between units of a type, as σ of logarithms.")
    replay: Sequence[Path] = option(
        (), "Servo model: recording to roll the files out on; repeatable.", command_type=list[Path]
    )
    parameters: Parameters | None = option(
        None, "C code: consistent, full or essential; default: consistent if available. Other formats need these."
    )

    def __post_init__(self) -> None:
        """Check every option, and that there is a file to write; a UsageError names the options."""
        super().__post_init__()
        if not self.targets:
            hint = "--urdf, --mjcf, --ros2-inertial, --c, --isaaclab, --usd or --ranges"
            raise UsageError("no file to write is named", hint=hint)
        if self.c_float and self.c is None:
            raise UsageError("--c-float needs --c, the files to write")
        if self.into is not None and self.urdf is None:
            raise UsageError("--into needs --urdf, the file to write")

    @property
    def targets(self) -> list[Path]:
        """Files to write; of C code the path that its files are named after."""
        files = (self.urdf, self.mjcf, self.ros2_inertial, self.isaaclab, self.usd, self.ranges, self.c)
        return [path for path in files if path is not None]

    def given(self, *names: str) -> list[str]:
        """Flags of those options, among the named ones, that are given: they are None, 0 or empty else."""
        return [flag_of(of) for of in fields(self) if of.name in names and getattr(self, of.name)]
