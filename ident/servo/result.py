"""The result of a servo identification: result.json, kind "servo" (DESIGN.md "The result")."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import ResultFileError
from ident.result.graded import Grade, UsedRecording
from ident.result.result_file import SERVO, checked, read_content
from ident.result.tables import Cell, Table, table_of_rows
from ident.servo.terms import INDEX, TERMS
from ident.stored import Stored, Value

SERVO_SCHEMA = 1


class ServoParameter(Stored):
    """One parameter of a servo joint."""

    value: Value
    unit: str
    interval: tuple[Value, Value] | None = Field(default=None, description="95 %; null where it was not searched")
    unidentifiable: bool = Field(default=False, description="the data do not tell it; the value only fits them")
    origin: Literal["data", "given", "assumed"] = "data"


class ServoJoint(Stored):
    """One joint as a servo; terms that the data did not ask for are left out."""

    joint: str
    parameters: dict[str, ServoParameter]
    kept: dict[str, float] = Field(
        default={}, description="optional terms, and the share of the cost of held-out pieces that each saved"
    )
    note: str = ""


class References(Stored):
    """Roll-out errors without the fit, per joint [rad or m]."""

    command: list[Value] = Field(description="the command itself")
    delay_and_lag: list[Value] = Field(description="the best delay and first-order lag for all joints together")
    model_file: list[Value] | None = Field(
        default=None, description="an MJCF of the arm as it came, rolled out in MuJoCo; null where none was given"
    )


class RolloutError(Stored):
    """Roll-out error of one recording."""

    recording: str
    rollout_error: list[Value]


class ServoContact(Stored):
    """A horizontal surface that the arm touches, with one point."""

    link: str = Field(description="to which the point belongs")
    point: list[Value] = Field(description="in the frame of the link's joint [m]")
    height: Value = Field(description="of the surface, against gravity from the base frame's origin [m]")
    stiffness: Value = Field(description="[N/m]")


class ContactStretch(Stored):
    """A stretch of a roll-out in which the arm touches the surface."""

    recording: str
    begin: Value = Field(description="in the recording's clock [s]")
    end: Value
    force: Value = Field(description="largest [N]")


class RolloutFit(Stored):
    """Roll-out on commands alone, its first second left out; mean absolute errors per joint [rad or m]."""

    rollout_error: list[Value]
    rollout_mean: Value = Field(description="over the joints")
    references: References
    recordings: list[RolloutError]
    contacts: list[ContactStretch] = Field(default=[])
    held_out: bool
    seconds: Value


class ServoRecording(UsedRecording):
    """A recording of commands and positions."""

    seconds: Value
    rate_hz: Value


class ServoResult(Stored):
    """The outcome of an identification by commands and encoders."""

    dynid_schema: Literal[1] = 1
    kind: Literal["servo"] = "servo"
    created: str
    robot: str
    robot_file: str
    urdf: str
    joints: list[str]
    sliding: list[bool]
    method: Literal["servo"] = "servo"
    links: str = Field(description="where the links' masses are from")
    resolution: list[Value] = Field(description="steps of the encoders [rad or m]")
    step: Value = Field(description="of the roll-out [s]")
    servo: list[ServoJoint]
    contact: ServoContact | None = Field(default=None, description="what the arm touches; null without a sign of it")
    covariance: list[list[list[Value]]] = Field(
        default=[],
        description="per joint, of its searched terms in the order of `searched`; logarithms of positive ones",
    )
    searched: list[list[str]] = Field(default=[])
    fit: RolloutFit
    validation: RolloutFit | None
    validation_source: str
    recordings: list[ServoRecording]
    versions: dict[str, str]
    verdict: Grade = Field(description="for simulation")

    @property
    def values(self) -> FloatArray:
        """(n, terms) parameters; terms that were left out stand at their value for none."""
        values = np.tile([term.absent for term in TERMS], (len(self.joints), 1))
        for row, joint in enumerate(self.servo):
            for name, parameter in joint.parameters.items():
                values[row, INDEX[name]] = parameter.value
        return values

    @property
    def parameters(self) -> Table:
        """Every parameter with its 95 % interval."""
        rows: list[list[Cell]] = []
        for joint in self.servo:
            for name, parameter in joint.parameters.items():
                low, high = parameter.interval or (None, None)
                determined = "unidentifiable" if parameter.unidentifiable else "identified"
                rows.append(
                    [
                        joint.joint,
                        name.replace("_", " "),
                        parameter.value,
                        None if parameter.unidentifiable else low,
                        None if parameter.unidentifiable else high,
                        parameter.unit,
                        determined if parameter.origin == "data" else parameter.origin,
                    ]
                )
        columns = [
            ("joint", ""),
            ("parameter", ""),
            ("value", ""),
            ("low", ""),
            ("high", ""),
            ("unit", ""),
            ("origin", ""),
        ]
        return table_of_rows(f"Servo parameters of {self.robot}, 95 % intervals", columns, rows)

    @property
    def errors(self) -> Table:
        """Roll-out errors of each joint beside the references, on held-out data where there are some."""
        shown = self.validation or self.fit
        return error_table(f"Roll-out errors of {self.robot}", self, shown)


def with_values(result: ServoResult, values: FloatArray) -> ServoResult:
    """The result with other values (n, terms) of the parameters that it has."""
    joints = [
        joint.model_copy(
            update={
                "parameters": {
                    name: parameter.model_copy(update={"value": float(values[row, INDEX[name]])})
                    for name, parameter in joint.parameters.items()
                }
            }
        )
        for row, joint in enumerate(result.servo)
    ]
    return result.model_copy(update={"servo": joints})


def error_table(title: str, result: ServoResult, shown: RolloutFit) -> Table:
    """Roll-out errors of each joint beside the references [mrad or mm]."""
    unit = "mm" if all(result.sliding) else "mrad, mm" if any(result.sliding) else "mrad"
    references = shown.references
    columns = [("joint", ""), ("rollout", unit), ("command", unit), ("delay_and_lag", unit)]
    parts = [shown.rollout_error, references.command, references.delay_and_lag]
    if references.model_file is not None:
        columns.append(("model_file", unit))
        parts.append(references.model_file)
    columns.append(("encoder_step", unit))
    parts.append(result.resolution)
    rows: list[list[Cell]] = [[name, *(1e3 * part[row] for part in parts)] for row, name in enumerate(result.joints)]
    return table_of_rows(title, columns, rows)


def read_servo_result(path: Path) -> ServoResult:
    """Read the result.json of a servo model.

    Raises:
        ResultFileError: no such file, another kind of file, a newer schema, a missing key.
    """
    result = checked(ServoResult, read_content(path), path, SERVO, "dynid identify --method servo", SERVO_SCHEMA)
    unknown = {name for joint in result.servo for name in joint.parameters} - set(INDEX)
    wrong = ""
    if unknown:
        wrong = f"names the unknown parameter '{min(unknown)}'"
    elif [joint.joint for joint in result.servo] != list(result.joints):
        wrong = "does not have one entry a joint, in their order"
    wrong = wrong or next((said for joint in result.servo if (said := _impossible(joint))), "")
    if wrong:
        raise ResultFileError(wrong, where=f"{path}: servo", hint="identify again")
    return result


def _impossible(joint: ServoJoint) -> str:
    """What is wrong with a joint's values, in words; empty where nothing is."""
    for name, parameter in joint.parameters.items():
        term, value = TERMS[INDEX[name]], parameter.value
        low, high = parameter.interval or (value, value)
        if not (value == term.absent or term.allowed.holds(value)) or low > high:
            return f"{name} {value:g} of {joint.joint} is not within {term.allowed}, or its interval is empty"
    return ""
