"""The result of a gravity identification: result.json, kind "gravity"."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from ident.result.graded import Grade, ModelResult, ParameterResult, UsedRecording
from ident.result.result_file import GRAVITY, checked, read_content
from ident.result.tables import Cell, Table, table_of_rows
from ident.stored import Number, Stored, Value

GRAVITY_SCHEMA = 1


class GravityParameter(ParameterResult):
    """One gravity parameter, or the offset of a motor."""

    kind: Literal["inertial", "offset"]
    low: Number = Field(description="of the 95 % interval")
    high: Number
    note: str = ""


class GravityJoint(Stored):
    """What the recording says of one joint."""

    joint: str
    unit: str
    poses: int = Field(description="in which it moves")
    gravity: Value = Field(description="root mean square of its gravity torque over the poses")
    friction: Number = Field(description="at the speed of the passes: half the difference of the two directions")
    friction_interval: Number = Field(description="half of its 95 % interval")
    friction_spread: Number = Field(description="its standard deviation over the poses")
    held_out_rms: Number = Field(description="of the torque predicted from the other poses, minus the measured one")
    held_out_max: Number
    model_file_rms: Number = Field(
        default=None, description="the same figure of the masses in the robot file, offsets fitted; null without masses"
    )


class GravityPose(Stored):
    """One visit of a pose."""

    position: list[Value]
    time: Value = Field(description="[s] from the recording's first sample")
    recording: str
    measured: list[Number] = Field(description="mean torque of both directions; null of a joint that rests there")
    predicted: list[Number] = Field(description="from the other poses")


class GravityValidation(Stored):
    """Errors on other recordings."""

    rms: list[Number]
    max: list[Number]
    poses: int
    held_out: bool


class GravityRecording(UsedRecording):
    """A recording of poses."""

    poses: int


class GravityResult(ModelResult):
    """The outcome of an identification of gravity."""

    kind: Literal["gravity"] = "gravity"
    sliding: list[bool]
    method: Literal["gravity"] = "gravity"
    torque_origin: str
    gravity_parameters: list[GravityParameter]
    covariance: list[list[Value]]
    of_joints: list[GravityJoint]
    poses: list[GravityPose]
    silent: list[str] = Field(description="joints that gravity does not act on")
    validation: GravityValidation | None = None
    recordings: list[GravityRecording]
    verdict: Grade = Field(description="for gravity compensation")

    @model_validator(mode="after")
    def _sizes(self) -> Self:
        count = len(self.gravity_parameters)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"'covariance' is not {count} × {count}")
        if len(self.of_joints) != len(self.joints) or len(self.sliding) != len(self.joints):
            raise ValueError(f"'of_joints' and 'sliding' do not have {len(self.joints)} entries")
        return self

    @property
    def parameters(self) -> Table:
        """Every parameter with its 95 % interval."""
        rows: list[list[Cell]] = [
            [
                parameter.name,
                parameter.joint,
                parameter.value,
                parameter.low,
                parameter.high,
                parameter.unit,
                parameter.note or parameter.expression,
            ]
            for parameter in self.gravity_parameters
        ]
        headings = [(name, "") for name in ("name", "joint", "value", "low", "high", "unit", "meaning")]
        return table_of_rows(f"Gravity parameters of {self.robot}, 95 % intervals", headings, rows)

    @property
    def errors(self) -> Table:
        """Errors in held-out poses beside the size of gravity and friction."""
        headings = [
            (name, "")
            for name in ("joint", "gravity", "held_out_error", "worst", "friction", "friction_±", "offset", "unit")
        ]
        has_file = [joint.model_file_rms is not None for joint in self.of_joints]
        if any(has_file):
            headings.insert(4, ("robot_file", ""))
        offsets = {
            parameter.joint: parameter.value for parameter in self.gravity_parameters if parameter.kind == "offset"
        }
        rows: list[list[Cell]] = []
        for joint in self.of_joints:
            row: list[Cell] = [joint.joint, joint.gravity, joint.held_out_rms, joint.held_out_max]
            if any(has_file):
                row.append(joint.model_file_rms)
            row += [joint.friction, joint.friction_interval, offsets.get(joint.joint), joint.unit]
            rows.append(row)
        return table_of_rows(f"Torques of {self.robot} in held-out poses (root mean square)", headings, rows)

    @property
    def validation_errors(self) -> Table:
        """Errors on other recordings beside the size of gravity and friction; empty without any."""
        headings = [(name, "") for name in ("joint", "gravity", "error", "worst", "friction", "unit")]
        shown = (
            []
            if self.validation is None
            else zip(self.of_joints, self.validation.rms, self.validation.max, strict=True)
        )
        rows: list[list[Cell]] = [
            [entry.joint, entry.gravity, rms, largest, entry.friction, entry.unit] for entry, rms, largest in shown
        ]
        return table_of_rows(f"Torques of {self.robot} on other recordings (root mean square)", headings, rows)


def read_gravity_result(path: Path) -> GravityResult:
    """Read the result.json of a gravity identification.

    Raises:
        ResultFileError: no such file, another kind of file, a newer schema, a missing key.
    """
    return checked(GravityResult, read_content(path), path, GRAVITY, "dynid identify --gravity", GRAVITY_SCHEMA)
