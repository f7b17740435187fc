"""A servo identification's result (result.json, kind "servo"; DESIGN.md "The result"), and two of them compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import ResultFileError, UsageError
from ident.regression.hypothesis_tests import SignificanceTest
from ident.result.graded import Grade, ModelResult, UsedRecording
from ident.result.result_file import SERVO, checked, read_content
from ident.result.tables import Cell, Table, table_of_rows
from ident.servo.contact import ServoContact
from ident.servo.terms import INDEX, TERMS, to_search
from ident.stored import Stored, Value

SERVO_SCHEMA = 1


class ServoParameter(Stored):
    """One parameter of a servo joint."""

    value: Value
    unit: str
    interval: tuple[Value, Value] | None = Field(default=None, description="95 %; null where it was not searched")
    unidentifiable: bool = Field(default=False, description="the data do not determine it; the value merely fits them")
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
        default=None, description="the original MJCF of the arm, rolled out in MuJoCo; null if none was given"
    )


class RolloutError(Stored):
    """Roll-out error of one recording."""

    recording: str
    rollout_error: list[Value]


class ContactSegment(Stored):
    """A segment of a roll-out in which the arm touches the surface."""

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
    contacts: list[ContactSegment] = Field(default=[])
    held_out: bool
    seconds: Value


class ServoRecording(UsedRecording):
    """A recording of commands and positions."""

    seconds: Value
    rate_hz: Value
    sample_hashes: list[int] = Field(default=[], description="the smallest hashes of its samples")


class ServoResult(ModelResult):
    """The outcome of an identification by commands and encoders."""

    kind: Literal["servo"] = "servo"
    sliding: list[bool]
    method: Literal["servo"] = "servo"
    links: str = Field(description="source of the links' masses")
    resolution: list[Value] = Field(description="steps of the encoders [rad or m]")
    step: Value = Field(description="of the roll-out [s]")
    servo: list[ServoJoint]
    contact: ServoContact | None = Field(
        default=None, description="the surface that the arm touches; null if there is none"
    )
    covariance: list[list[list[Value]]] = Field(
        default=[],
        description="per joint, of its searched terms in the order of `searched`; logarithms of positive ones",
    )
    searched: list[list[str]] = Field(default=[])
    fit: RolloutFit
    validation: RolloutFit | None
    validation_source: str
    recordings: list[ServoRecording]
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
    """Return what is wrong with a joint's values, in words; empty where nothing is."""
    for name, parameter in joint.parameters.items():
        term, value = TERMS[INDEX[name]], parameter.value
        low, high = parameter.interval or (value, value)
        if not (value == term.absent or term.allowed.holds(value)) or low > high:
            return f"{name} {value:g} of {joint.joint} is not within {term.allowed}, or its interval is empty"
    return ""


def refuse_other_arm(first: ServoResult, other: ServoResult) -> None:
    """Refuse models that are not of one arm.

    Raises:
        UsageError: other robots or joints.
    """
    if first.robot != other.robot:
        raise UsageError(f"the models are of different robots: {first.robot} and {other.robot}")
    if first.joints != other.joints:
        raise UsageError(f"the models have different joints: {', '.join(first.joints)}; {', '.join(other.joints)}")


def parameter_differences(one: ServoResult, other: ServoResult) -> Table:
    """Every parameter of both; σ and z of those that the data of both determine, by their logarithms where positive."""
    points, rows = [to_search(result.values) for result in (one, other)], []
    spreads = [_spread(result) for result in (one, other)]
    for row, name in enumerate(one.joints):
        own = [result.servo[row].parameters for result in (one, other)]
        for term in [term.name for term in TERMS if any(term.name in parameters for parameters in own)]:
            first, second = (parameters[term].value if term in parameters else None for parameters in own)
            sigmas = [spread.get((row, term)) for spread in spreads]
            z: float | None = None
            if sigmas[0] is not None and sigmas[1] is not None:
                apart = points[1][row, INDEX[term]] - points[0][row, INDEX[term]]
                z = float(apart / np.hypot(sigmas[0], sigmas[1]))
            difference = None if first is None or second is None else second - first
            unit = next(parameters[term].unit for parameters in own if term in parameters)
            rows.append([f"{name} {term.replace('_', ' ')}", first, second, difference, z, unit])
    columns = [(heading, "") for heading in ("name", "first", "second", "difference", "z", "unit")]
    return table_of_rows(f"Servo parameters of {one.robot}", columns, rows)


def parameters_agree(first: ServoResult, other: ServoResult) -> SignificanceTest | None:
    """χ² of all parameters that both determine, joint by joint; None where there is none."""
    from scipy.special import chdtrc

    statistic, freedom = 0.0, 0
    points = [to_search(result.values) for result in (first, other)]
    known = [set(_spread(result)) for result in (first, other)]
    for row in range(len(first.joints)):
        common = [term.name for term in TERMS if (row, term.name) in known[0] & known[1]]
        if not common:
            continue
        total = np.sum([_covariance(result, row, common) for result in (first, other)], axis=0)
        apart = (points[1] - points[0])[row, [INDEX[term] for term in common]]
        statistic += float(apart @ np.linalg.lstsq(total, apart, rcond=None)[0])
        freedom += len(common)
    return SignificanceTest(statistic, freedom, float(chdtrc(freedom, statistic))) if freedom else None


def error_differences(first: ServoResult, other: ServoResult) -> Table:
    """Roll-out errors of each joint, of each model's own validation, and what the encoder resolves."""
    shown = [result.validation or result.fit for result in (first, other)]
    unit = "mm" if all(first.sliding) else "mrad, mm" if any(first.sliding) else "mrad"
    parts: list[Sequence[float]] = [fit.rollout_error for fit in shown]
    rows: list[list[Cell]] = [
        [name, *(1e3 * part[row] for part in parts), 1e3 * first.resolution[row]]
        for row, name in enumerate(first.joints)
    ]
    rows.append(["mean", *(1e3 * fit.rollout_mean for fit in shown), None])
    columns = [("joint", ""), ("first", unit), ("second", unit), ("encoder_step", unit)]
    return table_of_rows(f"Roll-out errors: {first.validation_source}; {other.validation_source}", columns, rows)


def _spread(result: ServoResult) -> dict[tuple[int, str], float]:
    """Standard deviations in the search's coordinates of what the data determine, by joint and term."""
    found = {}
    for row, (searched, covariance) in enumerate(zip(result.searched, result.covariance, strict=True)):
        parameters = result.servo[row].parameters
        for place, term in enumerate(searched):
            variance = covariance[place][place]
            if term in parameters and not parameters[term].unidentifiable and variance > 0:
                found[row, term] = float(variance**0.5)
    return found


def _covariance(result: ServoResult, row: int, terms: Sequence[str]) -> FloatArray:
    places = [result.searched[row].index(term) for term in terms]
    return np.array(result.covariance[row], dtype=np.float64)[np.ix_(places, places)]
