"""What the results of whole models, of gravity and of servos share: arm, recordings, and a verdict in one grade."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Literal, Self

from pydantic import Field

from daq.robot.loader import RobotFile
from drivers.core.software import software_versions
from ident.stored import Number, Stored


class ModelResult(Stored):
    """The outcome of an identification of a model."""

    dynid_schema: Literal[1] = 1
    kind: str
    created: str
    robot: str
    robot_file: str
    urdf: str
    joints: list[str]
    method: str
    versions: dict[str, str]

    @classmethod
    def of(cls, robot_file: RobotFile, **figures: Any) -> Self:
        """The result of an arm, made now, by this software."""
        return cls(
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            robot=robot_file.robot.name,
            robot_file=robot_file.text,
            urdf=robot_file.urdf_text or "",
            joints=list(robot_file.robot.joint_names),
            versions=software_versions(),
            **figures,
        )


class ParameterResult(Stored):
    """An identified parameter of an arm's torque."""

    name: str
    expression: str
    kind: str
    joint: str
    unit: str
    value: Number = Field(description="null where the recordings do not determine it")
    std: Number


class UsedRecording(Stored):
    """A recording used in the identification or the validation."""

    file: str
    sha256: str
    role: Literal["identification", "validation"]
    started: str = Field(default="", description="ISO 8601, UTC: its first stamp where that is absolute, else created")
    robot_sha256: str = Field(default="", description="of the robot file and the URDF in the recording")
    serial: str = Field(default="", description="of the controller; empty where it does not say")
    temperature: list[Number] = Field(default=[], description="mean of each joint [°C]; empty without a reading")


def robots_of(recordings: Sequence[UsedRecording]) -> set[str]:
    """SHA-256 of the robot files in the recordings of an identification, which its own may correct."""
    return {recording.robot_sha256 for recording in recordings if recording.role == "identification"} - {""}


class Grade(Stored):
    """How far a model can be trusted for its one purpose; as text, the headline and a line per check."""

    grade: Literal["good", "usable", "poor"]
    headline: str
    checks: list[str] = Field(default=[])

    def __str__(self) -> str:
        return "\n".join([self.headline, *(f"  {check}" for check in self.checks)])
