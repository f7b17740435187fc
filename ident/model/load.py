"""Effect of a load on the last link on the base parameters (SR400 .4.4: the relations above Table 4).

A rigid load adds its ten standard parameters to those of the link that carries it. Base parameters are linear in the
standard ones, so they change by `effect @ load`; the columns of a loaded run's load are W·effect, and nothing but the
base columns W needs to be computed.

The tool frame: origin at the robot file's `workspace.tool` (the origin of the last joint's frame where it says
nothing), axes of the last joint's frame; the last joint is the one that carries the tool (`DynamicModel.tool_link`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.ranges import INERTIA, LENGTH, check_option
from drivers.core.ranges import MASS as MASS_RANGE
from ident.linear_algebra.independent_columns import independent_columns
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import INERTIAL, MASS, inertia_tensor, link_parameters

FIRST_MOMENTS = tuple(INERTIAL.index(symbol) for symbol in ("MX", "MY", "MZ"))

_KEEP_ORDER = ("M", "MX", "MY", "MZ", "ZZ", "XX", "XY", "XZ", "YZ", "YY")
"""Which load parameters are kept first where only combinations of them are identifiable: the mass before all."""

ROUNDED = 0.1
"""Principal moments may break the triangle inequality by this share: tables are rounded (SR400 Table 3 breaks it)."""

INDEPENDENT = 1e-7
"""A load column is dependent when its component independent of those before it is below this share of its length."""


@dataclass(frozen=True)
class KnownLoad:
    """Known parameters of the load, in the tool frame."""

    mass: float  # [kg]
    com: tuple[float, ...] | None = None  # (3,) centre of mass [m]; None where it is unknown
    # (6,) xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]; None where it is unknown
    inertia: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mass) and self.mass > 0):
            raise UsageError(f"a load of {self.mass:g} kg is not possible", where="--mass", hint="weigh it; give kg")
        for option, values, count in (("--com", self.com, 3), ("--inertia", self.inertia, 6)):
            if values is not None and (len(values) != count or not np.all(np.isfinite(values))):
                raise UsageError(f"{count} finite numbers are needed, separated by commas", where=option)
        check_option("--mass", self.mass, MASS_RANGE, "give kg")
        for option, values, allowed in (("--com", self.com, LENGTH), ("--inertia", self.inertia, INERTIA)):
            for value in values or ():
                check_option(option, value, allowed)
        if self.inertia is not None and self.com is None:
            raise UsageError("--inertia without --com has no reference point", hint="give the centre of mass, too")
        if self.inertia is not None:
            moments = np.linalg.eigvalsh(inertia_tensor(self.inertia))
            if moments[0] < -ROUNDED * moments[2] or (1 + ROUNDED) * (moments[0] + moments[1]) < moments[2]:
                raise UsageError(
                    f"no body has the principal moments {', '.join(f'{moment:.3g}' for moment in moments)} kg·m²: none "
                    "may be negative, nor larger than the sum of the other two",
                    where="--inertia",
                )

    @property
    def known(self) -> tuple[int, ...]:
        """Return which of the ten parameters are known."""
        if self.com is None:
            return (MASS,)
        return (*FIRST_MOMENTS, MASS) if self.inertia is None else tuple(range(len(INERTIAL)))

    @property
    def values(self) -> FloatArray:
        """(10,) the known parameters about the tool frame's origin; 0 for the others."""
        values = link_parameters(self.mass, self.com or (0.0, 0.0, 0.0), self.inertia or (0.0,) * 6)
        return np.where(np.isin(np.arange(len(INERTIAL)), self.known), values, 0.0)


@dataclass(frozen=True)
class LoadColumns:
    """Identifiable combinations of load parameters, and their effect on the base parameters."""

    names: tuple[str, ...]  # `M_L`, or `XXR_L` where others are regrouped on it
    expressions: tuple[str, ...]  # in full, `XX_L - YY_L`
    units: tuple[str, ...]  # of each
    kept: tuple[int, ...]  # which of the ten parameters each is named after
    projection: FloatArray  # (k, 10) combinations = projection @ standard load parameters in the tool frame
    effect: FloatArray  # (b, k) change of the base parameters = effect @ combinations
    no_effect: tuple[str, ...]  # names of the parameters that never act on the torque

    @property
    def not_identifiable(self) -> list[str]:
        """Names of the parameters without a column of their own: without effect, or regrouped with others."""
        alone = {kept for kept, row in zip(self.kept, self.projection, strict=True) if np.count_nonzero(row) == 1}
        return [f"{symbol}_L" for index, symbol in enumerate(INERTIAL) if index not in alone]


def load_effect(model: DynamicModel, base: BaseParameters, robot: Robot) -> FloatArray:
    """(b, 10) change of the base parameters per standard load parameter in the tool frame."""
    columns = [
        column
        for column, parameter in enumerate(model.parameters)
        if parameter.kind == "inertial" and parameter.joint == model.tool_link
    ]
    return np.asarray(base.projection[:, columns] @ moved_origin(np.array(robot.workspace.tool)))


def moved_origin(offset: FloatArray) -> FloatArray:
    """(10, 10) standard parameters about an origin from those about another one, `offset` (3,) [m] away from it.

    I' = I + M(p²E − ppᵀ) + 2(p·h)E − phᵀ − hpᵀ, h' = h + M·p, M' = M; axes stay parallel.
    """
    p = np.asarray(offset, dtype=np.float64)
    matrix = np.eye(10)
    inertia = (("XX", 0, 0), ("XY", 0, 1), ("XZ", 0, 2), ("YY", 1, 1), ("YZ", 1, 2), ("ZZ", 2, 2))
    for row, (_, i, j) in enumerate(inertia):
        matrix[row, MASS] = (p @ p) * (i == j) - p[i] * p[j]
        for axis, column in enumerate(FIRST_MOMENTS):
            matrix[row, column] = 2.0 * p[axis] * (i == j) - p[i] * (j == axis) - p[j] * (i == axis)
    matrix[list(FIRST_MOMENTS), MASS] = p
    return matrix


def load_columns(effect: FloatArray, without: Sequence[int] = ()) -> LoadColumns:
    """The identifiable combinations of a load's parameters; `without` are known ones that need no column."""
    lengths = np.linalg.norm(effect, axis=0)
    present = [i for i in range(10) if i not in without]
    acting = [i for i in present if lengths[i] > INDEPENDENT * max(float(lengths.max()), np.finfo(float).tiny)]
    order = sorted(acting, key=lambda i: _KEEP_ORDER.index(INERTIAL[i]))
    scaled = effect / np.where(lengths > 0.0, lengths, 1.0)
    kept = sorted(independent_columns(scaled, order, INDEPENDENT))
    projection = np.zeros((len(kept), 10))
    if kept:
        coefficients, *_ = np.linalg.lstsq(effect[:, kept], effect[:, acting], rcond=None)
        coefficients[np.abs(coefficients) < 1e-9] = 0.0
        projection[:, acting] = coefficients
        projection[:, kept] = np.eye(len(kept))
    texts = [_expression(row, i) for row, i in zip(projection, kept, strict=True)]
    return LoadColumns(
        names=tuple(name for name, _ in texts),
        expressions=tuple(expression for _, expression in texts),
        units=tuple(unit_of(i) for i in kept),
        kept=tuple(kept),
        projection=projection,
        effect=np.asarray(effect[:, kept]),
        no_effect=tuple(f"{INERTIAL[i]}_L" for i in present if i not in acting),
    )


def unit_of(parameter: int) -> str:
    """Unit of one of the ten parameters."""
    return "kg" if parameter == MASS else "kg·m" if parameter in FIRST_MOMENTS else "kg·m²"


def _expression(row: FloatArray, kept: int) -> tuple[str, str]:
    others = [i for i in np.flatnonzero(row) if i != kept]
    text = f"{INERTIAL[kept]}_L"
    for i in others:
        size = f"{abs(row[i]):.4g}"
        text += f" {'-' if row[i] < 0 else '+'} {'' if size == '1' else size + '·'}{INERTIAL[i]}_L"
    return (f"{INERTIAL[kept]}R_L" if others else f"{INERTIAL[kept]}_L"), text
