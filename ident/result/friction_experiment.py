"""The result of friction experiments: friction.json, schema version 1."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from daq.output_files import warn_of_strange_files
from drivers.core.arrays import FloatArray
from drivers.core.files import path_of
from ident.friction.table import SHAPED, SHAPES, TEMPERATURE_KINDS
from ident.result.friction import FrictionStep, JointFrictionResult, ParameterKind
from ident.result.result_file import check_kind, read_content, stored
from ident.stored import Number, Stored, Value

FRICTION_FILE = "friction.json"
"""Its name in the folder that `dynid friction` writes."""

TemperatureTerm = Literal["none", "linear", "full"]


class ValueRange(BaseModel):
    """Least and greatest value of what the recordings cover."""

    model_config = ConfigDict(defer_build=True, frozen=True, extra="forbid")

    least: Value
    greatest: Value

    @property
    def width(self) -> float:
        """Their difference."""
        return self.greatest - self.least


class JointFrictionExperiment(JointFrictionResult):
    """Friction of one joint by the experiment: values with σ, what they hold for, and their covariance."""

    temperature_term: TemperatureTerm = Field(description="'linear' has two of the coefficients, 'full' all three")
    kinds: list[ParameterKind] = Field(
        description="what the covariance is of: kinds of friction columns, then of the shapes that were estimated; the "
        "three of the temperature are those about 298.15 K that β1, β2, β3 follow from"
    )
    values: list[Value] = Field(description="of these")
    covariance: list[list[Number]]
    speed_range: ValueRange = Field(description="that the recordings cover [rad/s or m/s]")
    temperature_range: ValueRange | None = Field(description="[°C]; null where it was not recorded")
    load_range: ValueRange = Field(description="of the load torque's absolute value [N·m or N]")
    least_temperature_span: Value = Field(description="that a temperature term needs [K]")
    least_load_span: Value = Field(description="that a load term needs [N·m or N]")
    rmse: Value = Field(description="of the filtered torque's residual [N·m or N]")
    samples: int = Field(description="equations")
    periods: int = Field(description="in which this joint moves and all others rest")
    settled: bool = Field(description="whether shapes and load torque converged")
    notes: list[str] = Field(description="what the recordings do not determine")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Refuse shapes out of range, and a covariance that does not belong to the values."""
        count = len(self.kinds)
        if len(set(self.kinds)) != count or len(self.values) != count:
            raise ValueError(f"{len(self.values)} values for {len(set(self.kinds))} different kinds")
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance is not {count} by {count}")
        for name, shape in SHAPES.items():
            value = self.shape_value(name)
            if value is not None and name in SHAPED and not shape.allowed.holds(value):
                raise ValueError(f"{name} {value:g} is not within {shape.allowed}")
        if self.load_power not in (None, 1.0, 2.0):
            raise ValueError(f"load_power {self.load_power:g} is neither 1 nor 2")
        heat = {"none": 0, "linear": 2, "full": 3}[self.temperature_term]
        if tuple(kind for kind in TEMPERATURE_KINDS if kind in self.kinds) != TEMPERATURE_KINDS[:heat]:
            raise ValueError("kinds and temperature_term do not agree")
        return self

    def part(self, kinds: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Values (m,) and covariance (m, m) of some kinds, inf where it is not known."""
        places = [self.kinds.index(kind) for kind in kinds]
        rows = [[self.covariance[i][j] for j in places] for i in places]
        covariance = np.array([[np.inf if value is None else value for value in row] for row in rows], dtype=np.float64)
        return np.array([self.values[i] for i in places], dtype=np.float64), covariance.reshape(len(places), -1)


class FrictionExperimentResult(Stored):
    """Output of `dynid friction`."""

    dynid_schema: Literal[1] = 1
    kind: Literal["friction"] = "friction"
    robot: str
    recordings: list[str]
    torque_origin: str = Field(description="where the torque comes from")
    asked: str = Field(description="friction terms as asked for, or auto")
    delay: Value = Field(description="of the torque behind the position [s]")
    delay_note: str
    joints: list[JointFrictionExperiment] = Field(description="those that moved alone")
    friction_steps: list[FrictionStep]
    not_moved: list[str] = Field(description="joints that never move alone")
    versions: dict[str, str]

    @property
    def warnings(self) -> list[str]:
        """Return what to know before the values are used."""
        sentences = [f"{joint.joint}: {note}" for joint in self.joints for note in joint.notes]
        sentences += [f"{joint.joint}: shapes did not settle" for joint in self.joints if not joint.settled]
        if self.not_moved:
            sentences.append(f"never move alone: {', '.join(self.not_moved)}")
        return sentences


def friction_path(path: str | PathLike[str]) -> Path:
    """The friction.json that a path means: itself, or the one in a folder that `dynid friction` wrote."""
    given = path_of(path)
    return given / FRICTION_FILE if given.is_dir() else given


def read_friction_experiment(path: str | PathLike[str]) -> FrictionExperimentResult:
    """Read a friction.json, or that of a folder.

    Raises:
        ResultFileError: no such file, or it is none.
    """
    file = friction_path(path)
    content = read_content(file)
    check_kind(content, file, "friction", "dynid friction")
    warn_of_strange_files(file, content)
    return stored(FrictionExperimentResult, content, file, "analyse again")
