"""The whitened system with the derivatives by the friction's free shapes beside its columns (AUBO's third loop)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimation
from ident.estimators.robust.reweighting import Reweighting, RobustFit, weighted_pass
from ident.estimators.robust.weight_functions import WeightFunction
from ident.friction.table import SHAPED
from ident.model.joint_columns import own_column
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import excited_columns, ordinary_least_squares
from ident.regression.observation_matrix import Reduction


@dataclass(frozen=True, eq=False)
class ShapeColumns:
    """A kernel with sensitivities."""

    kernel: RegressorKernel  # base columns first, as they were (b), then the sensitivities (s)
    kinds: tuple[str, ...]  # of the sensitivities (s,)
    motors: tuple[int, ...]  # that they belong to (s,)

    @property
    def columns(self) -> tuple[int, ...]:
        """Places of the sensitivities in the kernel's selection."""
        count = len(self.kernel.columns)
        return tuple(range(count - len(self.kinds), count))


def shape_columns(kernel: RegressorKernel, torques: Sequence[int]) -> ShapeColumns:
    """The kernel with the derivatives of these motors' torques by their free shapes."""
    model = kernel.model
    if not model.terms.shaped:
        return ShapeColumns(kernel, (), ())
    linear = replace(model, terms=replace(model.terms, sensitivities=True))
    place = {parameter.name: column for column, parameter in enumerate(linear.parameters)}
    columns = [place[model.parameters[column].name] for column in kernel.columns]
    added = [
        (column, str(parameter.kind), model.active.index(parameter.joint))
        for column, parameter in enumerate(linear.parameters)
        if parameter.kind in SHAPED and model.active.index(parameter.joint) in torques
    ]
    return ShapeColumns(
        RegressorKernel(linear, [*columns, *(column for column, _, _ in added)]),
        tuple(kind for _, kind, _ in added),
        tuple(motor for _, _, motor in added),
    )


@dataclass(frozen=True, eq=False)
class ShapeSystem:
    """The whitened and weighted system of `ShapeColumns`."""

    shapes: ShapeColumns  # its columns
    reduction: Reduction  # of them

    @classmethod
    def at(cls, loops: Reweighting, fit: RobustFit, function: WeightFunction | None = None) -> ShapeSystem:
        """Return where the inner loops ended, with their Ω and weights; one pass where there are free shapes.

        Args:
            loops: the inner ones.
            fit: where they ended.
            function: of other weights than theirs.
        """
        shapes = shape_columns(fit.kernel, loops.torques)
        if not shapes.kinds:
            return cls(shapes, fit.done.reduction)
        parameters = np.concatenate([fit.solution.parameters, np.zeros(len(shapes.kinds))])
        loops.passes += 1
        done = weighted_pass(
            shapes.kernel, loops.runs, loops.torques, parameters, fit.covariance, function or loops.function
        )
        return cls(shapes, done.reduction)

    def together(self, active: Sequence[int]) -> FloatArray:
        """Parameters (b + s,) of least squares on the active columns and the sensitivities."""
        return ordinary_least_squares(self.reduction, [*active, *self._excited]).parameters

    def value(self, parameters: FloatArray, kind: str, motor: int) -> float | None:
        """Value of a motor's own parameter of a kind, among parameters (b + s,); None where it was not estimated."""
        place = own_column(self.shapes.kernel.model, self.shapes.kernel.columns, kind, motor)
        if place is None or (place in self.shapes.columns and place not in self._excited):
            return None
        return float(parameters[place])

    @property
    def _excited(self) -> list[int]:
        return [column for column in excited_columns(self.reduction) if column in self.shapes.columns]


def with_shapes(estimation: Estimation, torques: Sequence[int]) -> tuple[Estimation, ShapeColumns]:
    """A whitened estimate that takes its friction's shapes for unknown, for error bars that hold their uncertainty."""
    shapes = shape_columns(estimation.kernel, torques)
    solution = estimation.solution
    active = (*solution.active, *shapes.columns)
    parameters = np.concatenate([solution.parameters, np.zeros(len(shapes.columns))])
    extended = replace(solution, active=active, parameters=parameters)
    return replace(estimation, kernel=shapes.kernel, solution=extended), shapes
