"""Least squares under positive definite matrices and linear inequalities, by a primal-dual interior-point method.

    minimise  ½·‖B·y − c‖² + Σ_k w_k·(⟨P_k, S_k(y)⟩ − log det S_k(y)) + Σ_i v_i·(p_i·s_i(y) − log s_i(y))

The slacks S_k (4 by 4) and s_i are affine in y. With P_k the inverse of a prior's pseudo-inertia the bracket is, up to
a constant, the log-det (entropic) divergence from that prior, weighted by w_k (Lee, Wensing and Park 2020, "Geometric
robot dynamic identification"): it regularises, and keeps every iterate strictly inside. With P_k = 0 and a small
weight it is a plain barrier.

The weights fall step by step to those of the problem. Each matrix has a dual Z_k, w_k·S_k⁻¹ at the minimum, and Newton
steps are taken in the scaling of Nesterov and Todd (1997, "Self-scaled barriers"), which goes along a curved boundary
where Newton on the barrier alone would crawl.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.linear_algebra.triangular import triangular

MATRIX_ROWS = 4
"""Rows of the matrices."""

MOST_STEPS = 200
"""Steps; most problems need 10 to 50."""

DECREMENT = 1e-10
"""Half the squared Newton decrement, over the greatest weight, at which an iterate counts as the minimum."""

TO_BOUNDARY = 0.95
"""Share of the way to the boundary that one step may take."""

LONG_STEP = 0.6
"""After a step of at least this share of Newton's, the weights fall faster."""

FAST, SLOW = 0.15, 0.5
"""Factors by which the weights fall."""

RECENTRED = 2.0
"""Factor on the weights where the duals are replaced by those of the iterate."""

DEEP = 1.0
"""Margin, in units of the conditions, with which a start is searched."""

ENOUGH = 0.1
"""Share of it with which the search ends."""

PUSH = 1e3
"""Weight of that margin over the barrier's."""

IntArray = np.ndarray[tuple[int, ...], np.dtype[np.intp]]
BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Conditions:
    """Positivity conditions: k matrices S_k(y) = Σ_j y[variables[k, j]]·basis[k, j] − least[k], and g slacks."""

    variables: IntArray  # (k, q) variables of each matrix
    basis: FloatArray  # (k, q, 4, 4)
    least: FloatArray  # (k, 4, 4)
    pull: FloatArray  # (k, 4, 4) P_k
    # rows, limits: (g, p), (g,): s = rows @ y − limits
    rows: FloatArray
    limits: FloatArray
    row_pull: FloatArray  # (g,) p_i
    weights: FloatArray  # (k + g,) w and v

    def matrices(self, y: FloatArray) -> FloatArray:
        """S_k(y) (k, 4, 4)."""
        return np.asarray(np.einsum("kj,kjab->kab", y[self.variables], self.basis) - self.least)

    def slacks(self, y: FloatArray) -> FloatArray:
        """s(y) (g,)."""
        return np.asarray(self.rows @ y - self.limits)

    def hold(self, y: FloatArray) -> bool:
        """Return whether y is strictly inside."""
        return bool(np.all(self.slacks(y) > 0) and np.all(np.linalg.eigvalsh(self.matrices(y)) > 0))


@dataclass(frozen=True)
class NewtonMinimum:
    """End of the Newton iteration."""

    y: FloatArray  # (p,)
    root: FloatArray  # (f, f) upper triangular; rootᵀ·root is the objective's Hessian over the free variables
    steps: int  # Newton steps made


def minimise(
    system: FloatArray,
    target: FloatArray,
    conditions: Conditions,
    start: FloatArray,
    free: BoolArray,
    enough: Callable[[FloatArray], bool] = lambda _: False,
) -> NewtonMinimum:
    """The minimum of the objective above.

    Args:
        system: (m, p) B.
        target: (m,) c.
        conditions: that must be positive, and the weights.
        start: (p,) strictly inside.
        free: (p,) variables that may change; the others keep their value of `start`.
        enough: whether an iterate (p,) will do, so that the search ends there.

    Raises:
        IdentificationError: no minimum was reached (a system that is not finite, above all).
    """
    from scipy.linalg import solve_triangular

    variables = np.flatnonzero(free)
    least = conditions.weights
    y = start.copy()
    residual = system @ y - target
    ratio = float(residual @ residual) / max(float(np.sum(least)), np.finfo(float).tiny)
    duals = _Duals.central(conditions, y, max(1.0, ratio) * least)
    for step in range(MOST_STEPS):
        now = max(1.0, ratio) * least
        try:
            scaled = duals.scaled(conditions, y)
            rows, right = scaled.newton(conditions, now)
            # A step is a least-squares problem; by QR it keeps the digits that the squared Hessian would lose.
            stacked = np.vstack([system[:, variables], rows[:, variables]])
            factor = triangular(np.column_stack([stacked, np.concatenate([residual, right])]))
            root, image = factor[:-1, :-1], factor[:-1, -1]
            decrement = 0.5 * float(image @ image)
            if not np.isfinite(decrement):
                break
            if ratio <= 1.0 and decrement <= DECREMENT * float(np.max(least, initial=1.0)):
                return NewtonMinimum(y, root, step)
            direction = np.zeros_like(y)
            direction[variables] = -solve_triangular(root, image)
            length, duals = scaled.stepped(conditions, now, direction)
        except np.linalg.LinAlgError:  # a dual that lost its last digits: those of the iterate take its place
            if not conditions.hold(y):
                break
            ratio *= RECENTRED
            duals = _Duals.central(conditions, y, max(1.0, ratio) * least)
            continue
        y = y + length * direction
        if enough(y):
            return NewtonMinimum(y, root, step + 1)
        residual = system @ y - target
        ratio = duals.ratio(conditions, y) * (FAST if length >= LONG_STEP else SLOW)
    raise IdentificationError(
        f"no physically consistent parameters were found in {MOST_STEPS} steps",
        hint="check the units of the recording and of the links in the robot file",
    )


def strictly_inside(conditions: Conditions, start: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """A point strictly inside, and how far each condition is from holding where there is none.

    All conditions are relaxed by the same τ, in units of each matrix's `least` or of 1, and τ is driven down.

    Args:
        conditions: that must be positive.
        start: (p,) any point.
        free: (p,) variables that may change.

    Returns:
        (p,) the point, and (k + g,) the force with which each condition resists: all 0 where the point is inside.
    """
    count, forces = len(start), np.zeros(len(conditions.weights))
    if conditions.hold(start):
        return start, forces
    units = conditions.least + np.eye(MATRIX_ROWS) * 1e-12
    relaxed = replace(
        conditions,
        variables=np.column_stack([conditions.variables, np.full(len(units), count, dtype=np.intp)]),
        basis=np.concatenate([conditions.basis, units[:, None]], axis=1),
        pull=np.zeros_like(conditions.pull),
        rows=np.column_stack([conditions.rows, np.ones(len(conditions.rows))]),
        row_pull=np.zeros_like(conditions.row_pull),
        weights=np.ones_like(conditions.weights),
    )
    matrices, slacks = conditions.matrices(start), conditions.slacks(start)
    worst = [float(np.max(-np.linalg.eigvals(np.linalg.solve(units, matrices)).real, initial=0.0)) if len(units) else 0]
    tau = 2.0 * max(*worst, float(np.max(-slacks, initial=0.0))) + DEEP
    system = np.zeros((count + 1, count + 1))
    system[:count, :count] = 1e-3 * np.eye(count)
    system[count, count] = PUSH
    target = np.append(1e-3 * start, -PUSH * DEEP)
    minimum = minimise(
        system, target, relaxed, np.append(start, tau), np.append(free, True), lambda y: y[-1] < -ENOUGH * DEEP
    )
    point = minimum.y[:count]
    if conditions.hold(point):
        return point, forces
    pushed = relaxed.matrices(minimum.y)
    forces[: len(units)] = np.trace(np.linalg.solve(pushed, units), axis1=1, axis2=2)
    forces[len(units) :] = 1.0 / relaxed.slacks(minimum.y)
    return point, forces


_UPPER = np.triu_indices(MATRIX_ROWS)
_TWICE = np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))
"""Symmetric matrices as vectors of equal norm."""


@dataclass(frozen=True)
class _Duals:
    """Duals Z (k, 4, 4) of the matrices and z (g,) of the slacks, all positive."""

    matrices: FloatArray
    slacks: FloatArray

    @classmethod
    def central(cls, conditions: Conditions, y: FloatArray, weights: FloatArray) -> _Duals:
        """Those that belong to y if it is the minimum for these weights (k + g,)."""
        count = len(conditions.least)
        matrices = weights[:count, None, None] * np.linalg.inv(conditions.matrices(y))
        return cls(_symmetric(matrices), weights[count:] / conditions.slacks(y))

    def scaled(self, conditions: Conditions, y: FloatArray) -> _Scaled:
        """The conditions at y in the scaling of these duals; LinAlgError where rounding left S or Z negative."""
        matrices = conditions.matrices(y)
        roots = np.linalg.cholesky(matrices)
        values, vectors = np.linalg.eigh(_symmetric(roots.transpose(0, 2, 1) @ self.matrices @ roots))
        if not np.all(values > 0.0):
            raise np.linalg.LinAlgError("not positive")
        inverse_roots = np.linalg.inv(roots)
        scaling = values[:, :, None] ** 0.25 * vectors.transpose(0, 2, 1) @ inverse_roots
        return _Scaled(self, matrices, conditions.slacks(y), inverse_roots, np.asarray(scaling))

    def ratio(self, conditions: Conditions, y: FloatArray) -> float:
        """Mean of ⟨S, Z⟩ and s·z over their values at the minimum: the remaining weight of the barrier."""
        products = np.einsum("kab,kab->k", conditions.matrices(y), self.matrices) / MATRIX_ROWS
        return float(np.mean(np.append(products, conditions.slacks(y) * self.slacks) / conditions.weights))


@dataclass(frozen=True)
class _Scaled:
    """Conditions at a point, and the scaling of Nesterov and Todd there: W = G·Gᵀ with W·Z·W = S."""

    duals: _Duals
    matrices: FloatArray  # (k, 4, 4) S
    slacks: FloatArray  # (g,) s
    inverse_roots: FloatArray  # (k, 4, 4) L⁻¹ with S = L·Lᵀ
    scaling: FloatArray  # (k, 4, 4) G⁻¹

    def _inverses(self) -> FloatArray:
        return np.asarray(self.inverse_roots.transpose(0, 2, 1) @ self.inverse_roots)

    def newton(self, conditions: Conditions, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows A (r, p) and s (r,): Aᵀ·A in place of the conditions' Hessian, and Aᵀ·s their gradient."""
        count, width = len(self.matrices), conditions.rows.shape[1]
        scaling = self.scaling
        moved = (scaling[:, None] @ conditions.basis @ scaling.transpose(0, 2, 1)[:, None])[:, :, *_UPPER] * _TWICE
        block = np.zeros((count, len(_TWICE), width))
        places = np.arange(count)[:, None, None], np.arange(len(_TWICE))[:, None], conditions.variables[:, None, :]
        block[places] = moved.transpose(0, 2, 1)
        back = np.linalg.inv(scaling)
        force = conditions.weights[:count, None, None] * conditions.pull
        force = force - weights[:count, None, None] * self._inverses()
        right = (back.transpose(0, 2, 1) @ force @ back)[:, *_UPPER] * _TWICE
        scale = np.sqrt(self.duals.slacks / self.slacks)
        pulled = conditions.weights[count:] * conditions.row_pull - weights[count:] / self.slacks
        return (
            np.vstack([block.reshape(-1, width), scale[:, None] * conditions.rows]),
            np.concatenate([right.ravel(), pulled / scale]),
        )

    def stepped(self, conditions: Conditions, weights: FloatArray, direction: FloatArray) -> tuple[float, _Duals]:
        """Share of the step that leaves everything positive, and the duals after it."""
        count, duals = len(self.matrices), self.duals
        change = np.einsum("kj,kjab->kab", direction[conditions.variables], conditions.basis)
        slack_change = conditions.rows @ direction
        inverse = self.scaling.transpose(0, 2, 1) @ self.scaling
        wanted = weights[:count, None, None] * self._inverses() - duals.matrices
        dual_change = _symmetric(wanted - inverse @ change @ inverse)
        dual_slack_change = weights[count:] / self.slacks - duals.slacks - duals.slacks / self.slacks * slack_change
        worst = min(
            _steepest(self.inverse_roots, change),
            _steepest(np.linalg.inv(np.linalg.cholesky(duals.matrices)), dual_change),
            float(np.min(slack_change / self.slacks, initial=0.0)),
            float(np.min(dual_slack_change / duals.slacks, initial=0.0)),
        )
        length = min(1.0, -TO_BOUNDARY / worst) if worst < 0 else 1.0
        return length, _Duals(duals.matrices + length * dual_change, duals.slacks + length * dual_slack_change)


def _symmetric(matrices: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrices + matrices.transpose(0, 2, 1)))


def _steepest(inverse_roots: FloatArray, change: FloatArray) -> float:
    """The smallest eigenvalue (0 at most) of the change (k, 4, 4) relative to S (k, 4, 4), of whose root this is."""
    return float(np.min(np.linalg.eigvalsh(inverse_roots @ change @ inverse_roots.transpose(0, 2, 1)), initial=0.0))
