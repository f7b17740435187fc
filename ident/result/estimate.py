"""The estimate of a result with its covariance, the experiments behind it, and what was merged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from drivers.core.arrays import FloatArray
from drivers.core.errors import ResultFileError
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.regression.estimate import Estimate
from ident.regression.observability import Experiment
from ident.stored import Number, Stored, Value

AGAIN = "identify again"


class ExperimentResult(Stored):
    """An `Experiment` by names, which outlive indices: joints that were locked, motors whose torques were used."""

    locked: dict[str, list[Value]] = Field(description="positions of a joint at rest, one per pose [rad or m]")
    torques_of: list[str]

    @classmethod
    def of(cls, model: DynamicModel, experiment: Experiment) -> Self:
        """The experiment by the names of the joints."""
        names = model.joint_names
        return cls(
            locked={
                names[joint]: [pose[index] for pose in experiment.poses]
                for index, joint in enumerate(experiment.locked)
            },
            torques_of=[names[motor] for motor in experiment.torques],
        )

    def restored(self, model: DynamicModel, where: str) -> Experiment:
        """The experiment by the indices of a model's joints.

        Raises:
            ResultFileError: it is not one of this arm.
        """
        names = model.joint_names
        unknown = [name for name in (*self.locked, *self.torques_of) if name not in names]
        if unknown:
            raise ResultFileError(
                f"names joints that the robot does not have: {', '.join(unknown)}", where=where, hint=AGAIN
            )
        if len({len(positions) for positions in self.locked.values()}) > 1:
            raise ResultFileError("holds different numbers of positions", where=f"{where}.locked", hint=AGAIN)
        if not self.torques_of or not all(np.all(np.isfinite(positions)) for positions in self.locked.values()):
            raise ResultFileError("lacks torques or positions", where=where, hint=AGAIN)
        locked = sorted(self.locked, key=names.index)
        poses = tuple(zip(*(self.locked[name] for name in locked), strict=True)) if locked else ((),)
        torques = tuple(sorted(names.index(name) for name in self.torques_of))
        return Experiment(tuple(names.index(name) for name in locked), poses, torques)


class ShapeErrorResult(Stored):
    """How the error of an estimated shape of friction is correlated with those of the parameters."""

    kind: str = Field(description="of the shape: exponent or Stribeck velocity")
    joint: str
    covariance: list[Number] = Field(
        description="(a + s,) of its sensitivity's parameter (coefficient times change of the shape) with the a "
        "parameters, then with those of all s shapes"
    )


class EstimateResult(Stored):
    """An `Estimate` for merging, by names: the indices of its parameters belong to one version's base parameters."""

    parameters: list[str] = Field(description="names of the estimated base parameters, a of them")
    root: list[list[Value]] = Field(description="(a, a) upper triangular; its square is the inverse covariance")
    covariance: list[list[Number]] = Field(description="(a, a) corrected for autocorrelated residuals")
    within: list[list[Number]] | None = Field(
        default=None,
        description="(a, a) the same without what changes between runs, for the friction's shapes as estimated; null "
        "where that is all of it",
    )
    shapes: list[ShapeErrorResult] = Field(default_factory=list, description="estimated shapes of friction, s of them")
    absorbed: dict[str, list[Value]] = Field(description="how an unexcited parameter is absorbed by each estimated one")
    blocks: int = Field(description="of the jackknife behind the covariance")

    @field_validator("root", "covariance", "within")
    @classmethod
    def _sound(cls, rows: list[list[float | None]] | None, info: ValidationInfo) -> list[list[float | None]] | None:
        """Refuse what is no triangular factor, or no covariance, of the parameters."""
        size = len(info.data.get("parameters", rows or ()))
        if rows is None:
            return None
        if len(rows) != size or any(len(row) != size for row in rows):
            raise ValueError(f"is not {size} by {size}")
        if not size:
            return rows
        matrix = _matrix(rows)
        if info.field_name == "root":
            if not np.all(np.isfinite(matrix)) or not np.all(np.diag(matrix)) or np.any(np.tril(matrix, -1)):
                raise ValueError("is no triangular factor")
            return rows
        finite = np.isfinite(np.diag(matrix))
        inner = matrix[np.ix_(finite, finite)]
        if not np.all(np.isfinite(inner)) or np.any(np.diag(inner) < 0) or not np.allclose(inner, inner.T, rtol=1e-6):
            raise ValueError("is no covariance")
        return rows

    @classmethod
    def of(cls, estimate: Estimate, names: Sequence[str], joints: Sequence[str]) -> Self:
        """The estimate by the names of the base parameters (b,), and of the joints with motors (n,)."""
        others = [column for column in range(len(names)) if column not in estimate.active]
        return cls(
            parameters=[names[column] for column in estimate.active],
            root=estimate.root.tolist(),
            covariance=estimate.covariance.tolist(),
            within=None if estimate.within is None else estimate.within.tolist(),
            shapes=[
                ShapeErrorResult(kind=kind, joint=joints[motor], covariance=row.tolist())
                for (kind, motor), row in zip(estimate.shapes, estimate.shape_covariance, strict=True)
            ],
            absorbed={
                names[column]: shares.tolist()
                for column, shares in zip(others, estimate.absorbed.T, strict=True)
                if np.any(shares)
            },
            blocks=estimate.blocks,
        )

    def restored(self, values: Mapping[str, float | None], base: BaseParameters, model: DynamicModel) -> Estimate:
        """The estimate by the indices of base parameters.

        Raises:
            ResultFileError: its parts do not belong together.
        """
        count = len(self.parameters)
        if len(set(self.parameters)) != count or any(values.get(name) is None for name in self.parameters):
            raise ResultFileError("names parameters that have no value", where="estimate.parameters", hint=AGAIN)
        active = tuple(base.names.index(name) for name in self.parameters)
        others = [base.names[column] for column in range(base.count) if column not in active]
        absorbed = np.zeros((count, len(others)))
        for name, shares in self.absorbed.items():
            if name not in others or len(shares) != count or not np.all(np.isfinite(shares)):
                raise ResultFileError("does not fit the parameters", where=f"estimate.absorbed.{name}", hint=AGAIN)
            absorbed[:, others.index(name)] = shares
        return Estimate(
            active=active,
            values=np.array([values[name] for name in self.parameters], dtype=np.float64),
            root=_matrix(self.root),
            covariance=_matrix(self.covariance),
            absorbed=absorbed,
            blocks=self.blocks,
            within=None if self.within is None else _matrix(self.within),
            shape_covariance=self._shape_covariance(model),
            shapes=tuple((shape.kind, model.joint_names.index(shape.joint)) for shape in self.shapes),
        )

    def _shape_covariance(self, model: DynamicModel) -> FloatArray:
        """(s, a + s); empty where no shape was estimated."""
        names, width = model.joint_names, len(self.parameters) + len(self.shapes)
        for free_shape in self.shapes:
            free = free_shape.joint in names and model.terms.is_free(free_shape.kind, names.index(free_shape.joint))
            if not free or len(free_shape.covariance) != width:
                raise ResultFileError("does not fit the model's friction", where="estimate.shapes", hint=AGAIN)
        rows = [[np.inf if value is None else value for value in shape.covariance] for shape in self.shapes]
        return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def _matrix(rows: Sequence[Sequence[float | None]]) -> FloatArray:
    """A square of numbers; a variance that is not known is null in JSON."""
    values = [[np.inf if value is None else value for value in row] for row in rows]
    return np.array(values, dtype=np.float64).reshape(len(rows), len(rows))


class MergedModel(Stored):
    """One of the models that were merged."""

    file: str
    method: str
    experiments: list[ExperimentResult]
    parameters: int = Field(description="number of estimated base parameters")
    variance_ratio: float = Field(
        description="mean variance corrected for autocorrelated residuals, over that for white ones"
    )


class Contradiction(Stored):
    """A value that differs significantly from the merged one."""

    file: str
    parameter: str
    value: float = Field(description="of that model")
    merged: float = Field(description="the same combination of standard parameters, of the merged model")
    deviations: float = Field(description="difference in its own standard deviations")


class Consistency(Stored):
    """Tells whether the merged models agree on what they share, as a chi-square test."""

    statistic: float
    freedom: int = Field(description="number of combinations that more than one model identifies")
    p_value: float = Field(description="probability of a larger statistic if the models agree")
    agree: bool
    text: str
    contradictions: list[Contradiction]


class Merge(Stored):
    """Origin of a merged model."""

    models: list[MergedModel]
    consistency: Consistency | None = Field(description="null where the models share nothing, or too little is known")
