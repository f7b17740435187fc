"""Write an export: composed, read again, compared and simulated as a text, and only then put in its place."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from daq.output_files import check_outputs, replace_files
from daq.robot.urdf_check import urdf_file_text
from drivers.core.errors import ModelError
from drivers.core.files import path_of
from ident.export import mujoco_reading, pinocchio_reading
from ident.export.arm import ExportedArm
from ident.export.left_out import left_out_of_mjcf, left_out_of_ros2_inertial, left_out_of_urdf
from ident.export.mjcf import mjcf
from ident.export.reading import ReadBack, check_same_torque, simulation_checks
from ident.export.ros2_inertial import check_ros2_inertial, ros2_inertial
from ident.export.urdf import new_urdf
from ident.export.urdf_edit import edited_urdf
from ident.verdict.catalogue import raised
from ident.verdict.check import Check


@dataclass(frozen=True)
class Export:
    """A file that was written."""

    path: Path  # of the file
    format: str  # "URDF", "MJCF" or "ROS 2 inertial parameters"
    left_out: tuple[str, ...]  # what the format cannot hold of this arm, in sentences
    readings: tuple[ReadBack, ...]  # what reading it again showed, by reader
    checks: tuple[Check, ...]  # that concern the purpose simulation; empty where all went well

    @property
    def lines(self) -> list[str]:
        """Lines for the terminal."""
        return [
            f"{self.path}: {self.format}",
            *(f"  {line}" for reading in self.readings for line in reading.lines),
            *(f"  not in it: {sentence}" for sentence in self.left_out),
            *(f"  {check.severity}: {check.text} [{check.name}]" for check in self.checks),
        ]

    def __repr__(self) -> str:
        return f"<dynid.Export {self.path}>"

    def __str__(self) -> str:
        return "\n".join(self.lines)


def export_urdf(
    arm: ExportedArm, path: str | PathLike[str], *, into: str | PathLike[str] | None = None, overwrite: bool = False
) -> Export:
    """Write a URDF: the robot's own, or `into`, with new inertials, friction and limits; a complete one from MDH.

    Raises:
        UsageError: the path cannot be written.
        RobotFileError: `into` is no URDF, or not of this arm.
        ModelError: the file reads back as another model.
    """
    target = path_of(path)
    check_outputs([target], [Path(into)] if into is not None else [], overwrite=overwrite)
    own = arm.robot_file.urdf_text
    if into is not None:
        text = edited_urdf(arm, urdf_file_text(Path(into)), str(into))
    elif own is not None:
        text = edited_urdf(arm, own, f"{arm.model.name}: {arm.robot_file.robot.model.urdf}")
    else:
        text = new_urdf(arm)
    readings = [pinocchio_reading.read_urdf(arm, text)]
    checks = []
    if mujoco_reading.mujoco_installed():
        try:
            readings.append(mujoco_reading.read_urdf(arm, text))
        except ModelError as error:  # what MuJoCo refuses may be of the robot's own, such as the inertia of its base
            checks.append(raised("export-not-read", f"{error.message}."))
    return _written(target, "URDF", text, left_out_of_urdf(arm), readings, checks)


def export_mjcf(arm: ExportedArm, path: str | PathLike[str], *, overwrite: bool = False) -> Export:
    """Write an MJCF of the whole model; read again where MuJoCo is installed.

    Raises:
        UsageError: the path cannot be written.
        ModelError: the file reads back as another model.
    """
    target = path_of(path)
    check_outputs([target], overwrite=overwrite)
    text = mjcf(arm)
    readings, checks = [], []
    if mujoco_reading.mujoco_installed():
        readings.append(mujoco_reading.read_mjcf(arm, text))
    else:
        checks.append(
            raised("export-not-read", "MuJoCo is not installed: the MJCF was neither read again nor simulated.")
        )
    return _written(target, "MJCF", text, left_out_of_mjcf(arm), readings, checks)


def export_ros2_inertial(arm: ExportedArm, path: str | PathLike[str], *, overwrite: bool = False) -> Export:
    """Write the bodies as ROS 2 inertial parameters.

    Raises:
        UsageError: the path cannot be written.
        ModelError: the file reads back other numbers.
    """
    target = path_of(path)
    check_outputs([target], overwrite=overwrite)
    text = ros2_inertial(arm)
    check_ros2_inertial(arm, text)
    return _written(target, "ROS 2 inertial parameters", text, left_out_of_ros2_inertial(arm), [], [])


def _written(
    target: Path, kind: str, text: str, left_out: tuple[str, ...], readings: list[ReadBack], checks: list[Check]
) -> Export:
    for reading in readings:
        check_same_torque(reading, str(target))
        checks = [*checks, *simulation_checks(reading)]
    replace_files({target: text})
    return Export(target, kind, left_out, tuple(readings), tuple(checks))
