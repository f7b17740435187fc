"""Physical parameters of links and the torque's cost in them: no regrouping, as the UP6 paper wants it.

A link has a mass m, a centre of mass c and an inertia I about it. The standard parameters of the model follow from
them: m·c are its first moments, I and m·c² its inertia about the joint's origin. So the torque is quadratic in c, but
linear in m and I where c is known: then least squares finds them, too, as far as the torque shows them.

The cost of a linear model, ‖W·x − τ‖₂ (UP6 eq. 10; ROCR6 eq. 9), is computed from the triangular factor of [W τ]: a
population of P points costs one product of (P, d) with (d, d), however long the recording was. Least squares minimises
it exactly, which every other method is measured by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.estimators.feasible.pseudo_inertia import body_of, pseudo_inertia
from ident.linear_algebra.independent_columns import DETERMINED, row_space
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import INERTIAL
from ident.regression.observation_matrix import Reduction


@dataclass(frozen=True, eq=False)
class QuadraticCost:
    """‖W·x − τ‖₂ = √(‖R·x − z‖² + ρ²)."""

    root: FloatArray  # R (r, d)
    target: FloatArray  # z (r,)
    rest: float = 0.0  # ρ², the sum of squares that no x lowers

    @classmethod
    def of_reduction(
        cls, reduction: Reduction, active: Sequence[int], weights: FloatArray | None = None
    ) -> QuadraticCost:
        """Build the cost of a reduced system's active base columns, rows times joints' weights (n,), 1 where None."""
        factor = reduction.stacked(weights, active)
        count = len(active)
        return cls(factor[:count, :count], factor[:count, count], float(factor[count, count] ** 2))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of points (P, d)."""
        residual = points @ self.root.T
        residual -= self.target
        return np.asarray(np.sqrt(np.einsum("pr,pr->p", residual, residual) + self.rest))

    def least(self) -> FloatArray:
        """The exact optimum x (d,)."""
        lengths = np.linalg.norm(self.root, axis=0)
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        return np.asarray(np.linalg.lstsq(self.root / lengths, self.target, rcond=None)[0] / lengths)

    def cost(self, point: FloatArray) -> float:
        """The cost at one point (d,)."""
        return float(self(point[None, :])[0])


INVOLVED = 0.01
"""A parameter takes part in an invisible combination with more than this share of it, in units of its effect."""


@dataclass(frozen=True)
class ParameterIdentifiability:
    """One estimated parameter."""

    name: str  # of the parameter
    determined: float  # share of it that the torque shows, 0 to 1
    std: float  # standard deviation [the parameter's unit], residuals assumed white; inf where it is not identifiable
    confounded_with: tuple[str, ...]  # names of the parameters that an invisible change compensates it with

    @property
    def identifiable(self) -> bool:
        """Return whether the torque determines it."""
        return self.determined >= DETERMINED


def identifiability(derivative: FloatArray, noise: float, names: Sequence[str]) -> tuple[ParameterIdentifiability, ...]:
    """Identifiability of d parameters, to first order about the estimate; it does not depend on their units.

    Args:
        derivative: (r, d) of the equations by the parameters.
        noise: standard deviation of one equation.
        names: (d,).
    """
    space = row_space(derivative)
    hidden = space.shares < DETERMINED
    invisible = np.abs(np.eye(len(names)) - space.rows.T @ space.rows)
    spread = noise * np.linalg.norm(space.rows.T / space.singular, axis=1)
    result = []
    for index, (name, share) in enumerate(zip(names, space.shares.tolist(), strict=True)):
        if not hidden[index]:
            result.append(ParameterIdentifiability(name, share, float(spread[index] / space.lengths[index]), ()))
            continue
        involved = hidden & (invisible[index] > INVOLVED)
        partners = tuple(names[other] for other in np.flatnonzero(involved).tolist() if other != index)
        result.append(ParameterIdentifiability(name, share, np.inf, partners))
    return tuple(result)


BODY = ("m", "cx", "cy", "cz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""Symbols of a link's ten physical parameters [kg, m, kg·m²], the inertia about the centre of mass."""

BODY_SIZE = len(BODY)


def physical_names(model: DynamicModel) -> tuple[str, ...]:
    """Names (p,): ten for each link, numbered from 1, then the joints' own parameters by their standard names."""
    links = len(model.joints)
    bodies = [f"{symbol}{link + 1}" for link in range(links) for symbol in BODY]
    return (*bodies, *(parameter.name for parameter in model.parameters[BODY_SIZE * links :]))


def physical_values(model: DynamicModel, standard: FloatArray) -> FloatArray:
    """Physical parameters (p,) of standard ones (p,); every mass must be positive."""
    values = standard.copy()
    for link in range(len(model.joints)):
        block = slice(BODY_SIZE * link, BODY_SIZE * (link + 1))
        body = body_of(standard[block])
        values[block] = [body.mass, *body.com, *body.inertia.values()]
    return values


@dataclass(frozen=True, eq=False)
class PhysicalParameters:
    """The choice of physical parameters that are estimated; the others keep their reference values."""

    links: int  # number of links
    reference: FloatArray  # (p,) all physical parameters
    names: tuple[str, ...]  # (d,) of the chosen ones
    chosen: tuple[int, ...]  # (d,) their places

    @classmethod
    def of(cls, model: DynamicModel, reference: FloatArray, names: Sequence[str]) -> PhysicalParameters:
        """The parameters of a model with some names, `m1`, `cx1`, `Izz1`, `Fv1`; reference values (p,).

        Raises:
            UsageError: the model has no such parameter, or a name stands twice.
        """
        places = {name: place for place, name in enumerate(physical_names(model))}
        for name in names:
            if name not in places:
                raise UsageError(
                    f"'{name}' is not a physical parameter of {model.name}", hint=f"one of {', '.join(places)}"
                )
        if len(set(names)) < len(names):
            raise UsageError("a physical parameter is named twice")
        return cls(len(model.joints), reference, tuple(names), tuple(places[name] for name in names))

    def standard(self, points: FloatArray) -> FloatArray:
        """Standard parameters (P, p) of a population (P, d)."""
        values = np.tile(self.reference, (len(points), 1))
        values[:, self.chosen] = points
        bodies = values[:, : BODY_SIZE * self.links].reshape(len(points), self.links, BODY_SIZE)
        mass, com = bodies[..., 0], bodies[..., 1:4]
        standard = np.empty_like(bodies)
        standard[..., :6] = bodies[..., 4:] + mass[..., None] * _com_squares(com)
        standard[..., 6:9] = mass[..., None] * com
        standard[..., 9] = mass
        values[:, : BODY_SIZE * self.links] = standard.reshape(len(points), -1)
        return values

    def derivative(self, point: FloatArray) -> FloatArray:
        """Derivatives (p, d) of the standard parameters by the chosen ones, at a point (d,)."""
        values = self.reference.copy()
        values[list(self.chosen)] = point
        whole = np.eye(len(values))
        for link in range(self.links):
            block = slice(BODY_SIZE * link, BODY_SIZE * (link + 1))
            whole[block, block] = _body_derivative(values[block])
        return whole[:, list(self.chosen)]


def _com_squares(com: FloatArray) -> FloatArray:
    """(…, 6) c·cᵀ-terms of the parallel-axis theorem per kg, in the order XX XY XZ YY YZ ZZ."""
    x, y, z = com[..., 0], com[..., 1], com[..., 2]
    return np.stack([y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y], axis=-1)


def _body_derivative(body: FloatArray) -> FloatArray:
    """(10, 10) of a link's standard parameters (rows, in the order of `INERTIAL`) by its physical ones."""
    mass, com = body[0], body[1:4]
    x, y, z = com
    derivative = np.zeros((len(INERTIAL), BODY_SIZE))
    derivative[:6, 0] = _com_squares(com)
    derivative[:6, 1:4] = mass * np.array(
        [[0, 2 * y, 2 * z], [-y, -x, 0], [-z, 0, -x], [2 * x, 0, 2 * z], [0, -z, -y], [2 * x, 2 * y, 0]]
    )
    derivative[:6, 4:] = np.eye(6)
    derivative[6:9, 0] = com
    derivative[6:9, 1:4] = mass * np.eye(3)
    derivative[9, 0] = 1.0
    return derivative


@dataclass(frozen=True, eq=False)
class PhysicalCost:
    """‖W·x − τ‖₂ in physical parameters, through the map physical → standard → base."""

    parameters: PhysicalParameters  # that are estimated
    quadratic: QuadraticCost  # the cost in the base parameters
    projection: FloatArray  # (b, p) base = projection · standard

    def base(self, points: FloatArray) -> FloatArray:
        """Base parameters (P, b) of a population (P, d)."""
        return np.asarray(self.parameters.standard(points) @ self.projection.T)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Costs (P,) of points (P, d)."""
        return self.quadratic(self.base(points))

    def derivative(self, point: FloatArray) -> FloatArray:
        """Derivatives (r, d) of the weighted equations R·x by the physical parameters, at a point (d,)."""
        return np.asarray(self.quadratic.root @ (self.projection @ self.parameters.derivative(point)))


@dataclass(frozen=True, eq=False)
class FeasibilityPenalty:
    """Sum over links of the negative eigenvalues of their pseudo-inertia, relative to a reference body's."""

    inverse_roots: FloatArray  # (k, 4, 4) L⁻¹ of each link's reference pseudo-inertia L·Lᵀ

    @classmethod
    def of(cls, references: FloatArray) -> FeasibilityPenalty:
        """Relative to links (k, 10) of standard parameters that can exist."""
        return cls(np.linalg.inv(np.linalg.cholesky(pseudo_inertia(references))))

    def __call__(self, links: FloatArray) -> FloatArray:
        """Penalties (P,) of links (P, k, 10)."""
        relative = self.inverse_roots @ pseudo_inertia(links) @ np.swapaxes(self.inverse_roots, -1, -2)
        return np.asarray(-np.minimum(np.linalg.eigvalsh(relative), 0.0).sum(axis=(-1, -2)))
