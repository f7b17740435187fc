"""Derivatives of the regressor by the motion, in reverse: one pass for any number of joints and columns.

For a link, the kernel's rows are functions of what its recursion gives in the link's frame: angular velocity ω and
acceleration α, the origin's acceleration a, and the axes s_k = (w_k, v_k) of the joints below. Seen from that frame, a
change of joint k moves everything before it by −s_k, so every motion vector u before joint k changes by u × s_k (the
cross product of motion vectors). With V, A the link's spatial velocity and acceleration, λ the joint before k,

    ∂V/∂q̇_k = s_k                ∂V/∂q_k = c_k = V_λ × s_k             ∂s_j/∂q_k = s_j × s_k  (j before k)
    ∂A/∂q̈_k = s_k                ∂A/∂q̇_k = c_k + s_k × (V − V_k)
    ∂A/∂q_k = A_λ × s_k + c_k × (V − V_λ)

so the derivatives by all joints below a link are sums along its chain, built from what the recursion holds already.
Where general loops make a motor's axis a combination of theirs with factors that vary, the derivatives by these factors
are the rows that the joints' axes would have alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.vectors import cross
from ident.model.joint_columns import column_slope
from ident.model.newton_euler import stacked
from ident.model.regressor import RegressorKernel


@dataclass(frozen=True)
class _Spatial:
    """Motion vectors or their duals; both components (..., 3, m)."""

    angular: FloatArray
    linear: FloatArray

    def __add__(self, other: _Spatial) -> _Spatial:
        return _Spatial(self.angular + other.angular, self.linear + other.linear)

    def __sub__(self, other: _Spatial) -> _Spatial:
        return _Spatial(self.angular - other.angular, self.linear - other.linear)

    def times(self, factor: FloatArray) -> _Spatial:
        """Scaled by factors (..., m)."""
        return _Spatial(self.angular * factor[..., None, :], self.linear * factor[..., None, :])

    def cross(self, other: _Spatial) -> _Spatial:
        """The cross product of motion vectors."""
        return _Spatial(
            cross(self.angular, other.angular), cross(self.angular, other.linear) + cross(self.linear, other.angular)
        )

    def cross_dual(self, dual: _Spatial) -> _Spatial:
        """The dual d with d·t = dual·(self × t) for every motion vector t."""
        return _Spatial(
            cross(dual.angular, self.angular) + cross(dual.linear, self.linear), cross(dual.linear, self.angular)
        )

    def dot(self, other: _Spatial) -> FloatArray:
        """Scalar product (..., m)."""
        return _dot(self.angular, other.angular) + _dot(self.linear, other.linear)

    def sums(self) -> _Spatial:
        """Sums along the chain (the first axis), each member included."""
        return _Spatial(np.cumsum(self.angular, axis=0), np.cumsum(self.linear, axis=0))

    def total(self) -> _Spatial:
        """Sum along the chain."""
        return _Spatial(self.angular.sum(axis=0), self.linear.sum(axis=0))


def pull_back_regressor(
    kernel: RegressorKernel, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, weights: FloatArray
) -> FloatArray:
    """Derivatives (3, n, m) by position, velocity and acceleration of Σ weights · packed regressor, per sample.

    Call it right after `kernel.evaluate` of the same motion: it reads the recursion's state. sign(q̇) counts as
    constant.

    Args:
        kernel: just evaluated.
        position: (n, m), m ≤ the kernel's chunk.
        velocity: (n, m).
        acceleration: (n, m).
        weights: (row_count, m), a factor for every packed entry.
    """
    count, model, tree = position.shape[1], kernel.model, kernel.tree
    gradient = np.zeros((3, *tree.velocity.shape))
    by_share = np.zeros(kernel.shares.shape)
    for link, rows in enumerate(kernel.link_rows):
        if rows.joints:
            chain = list(rows.joints)
            of_rows = np.zeros((len(chain), 10, count))
            varying: list[tuple[int, tuple[int, int], FloatArray]] = []
            for start, axes in rows.targets:
                of_motor = weights[start : start + len(rows.kinds)]
                for index, share in axes:
                    if isinstance(share, float):
                        of_rows[index, list(rows.kinds)] += of_motor if share == 1.0 else share * of_motor
                    else:
                        of_rows[index, list(rows.kinds)] += kernel.shares[share] * of_motor
                        varying.append((index, share, of_motor))
            gradient[:, chain] += _link_gradient(kernel, link, of_rows, tree.velocity[chain], tree.acceleration[chain])
            for index, share, of_motor in varying:
                by_share[share] += _row_value(kernel, link, index, rows.kinds, of_motor)
    gradient = model.transmission.pull_back(velocity, acceleration, tree, gradient, by_share)
    for entry in kernel.joint_parameter_rows:
        column = entry.column
        weight = weights[entry.row] if entry.factor == 1.0 else entry.factor * weights[entry.row]
        if column.quantity == "motor_inertia":
            derivative, by = 2, weight
        else:
            slope = column_slope(model, column, velocity)
            if isinstance(slope, float) and slope == 0.0:
                continue
            derivative, by = 1, weight if isinstance(slope, float) else weight * slope
        for joint, factor in column.motion:
            gradient[derivative, joint] += by if factor == 1.0 else factor * by
    return gradient


def _link_gradient(
    kernel: RegressorKernel, link: int, weights: FloatArray, rates: FloatArray, rate_changes: FloatArray
) -> FloatArray:
    """Derivatives (3, J, m) by the J joints of a link's chain; weights (J, 10, m), rates q̇ and q̈ (J, m)."""
    count = rates.shape[1]
    frame = kernel.frames[link]
    omega, alpha = frame.angular_velocity[:, :count], frame.angular_acceleration[:, :count]
    a = frame.linear[:, :count]
    axes = _Spatial(*stacked(frame.axes, count))
    of_axes, of_omega, of_alpha, of_a = _body_gradient(weights, axes, omega, alpha, a)

    # From the origin's acceleration to the spatial one: a = A_linear + ω × v.
    shares = axes.times(rates)
    before = shares.sums() - shares
    velocity = shares.total()
    of_velocity = _Spatial(of_omega + cross(velocity.linear, of_a), cross(of_a, omega))
    of_acceleration = _Spatial(of_alpha, of_a)
    spatial = _Spatial(alpha, a - cross(omega, velocity.linear))

    carried = before.cross(axes)
    own = axes.times(rate_changes) + carried.times(rates)
    from_joint_on = own.total() - own.sums() + own
    acceleration_before = spatial - from_joint_on
    after = velocity - before - shares
    turned = axes.cross_dual(of_axes)
    turned_before = turned.sums() - turned

    by_acceleration = axes.dot(of_acceleration)
    by_velocity = axes.dot(of_velocity) + (carried + axes.cross(after)).dot(of_acceleration)
    by_position = (
        carried.dot(of_velocity)
        + axes.dot(acceleration_before.cross_dual(of_acceleration) + turned_before)
        + carried.cross(after + shares).dot(of_acceleration)
    )
    return np.stack([by_position, by_velocity, by_acceleration])


def _row_value(kernel: RegressorKernel, link: int, index: int, kinds: Sequence[int], weights: FloatArray) -> FloatArray:
    """Weighted sum (m,) of the rows of one joint's axis, `index` in the link's chain, with weights (kinds, m)."""
    count = weights.shape[1]
    frame = kernel.frames[link]
    of_parameters = np.zeros((1, 10, count))
    of_parameters[0, list(kinds)] = weights
    omega, alpha = frame.angular_velocity[:, :count], frame.angular_acceleration[:, :count]
    inertia_omega = _symmetric(of_parameters[:, :6], omega)
    of_axis = _axis_gradient(of_parameters, inertia_omega, omega, alpha, frame.linear[:, :count])
    return np.asarray(_Spatial(*stacked(frame.axes[index : index + 1], count)).dot(of_axis)[0])


def _axis_gradient(
    weights: FloatArray, inertia_omega: FloatArray, omega: FloatArray, alpha: FloatArray, a: FloatArray
) -> _Spatial:
    """Derivatives by the axes (J, 3, m) of the weighted sum of a link's rows, see `_body_gradient`."""
    inertia, h, mass = weights[:, :6], weights[:, 6:9], weights[:, 9:10]
    of_w = _symmetric(inertia, alpha) + cross(omega, inertia_omega) + cross(h, a)
    of_v = mass * a + cross(alpha, h) + cross(omega, cross(omega, h))
    return _Spatial(of_w, of_v)


def _body_gradient(
    weights: FloatArray, axes: _Spatial, omega: FloatArray, alpha: FloatArray, a: FloatArray
) -> tuple[_Spatial, FloatArray, FloatArray, FloatArray]:
    """Derivatives by the axes (J, 3, m) and by ω, α, a (3, m) of the weighted sum of a link's rows.

    Row (j, parameter) is w_j·n + v_j·f with the force and moment of that unit parameter (module `regressor`); with the
    weights of row j in the parameters' places, its weighted sum is w_j·(I α + ω × I ω + h × a) + v_j·(M a + α × h +
    ω × (ω × h)).
    """
    inertia, h, mass = weights[:, :6], weights[:, 6:9], weights[:, 9:10]
    w, v = axes.angular, axes.linear
    inertia_omega = _symmetric(inertia, omega)
    of_alpha = _symmetric(inertia, w) + cross(h, v)
    of_a = mass * v + cross(w, h)
    of_omega = (
        cross(inertia_omega, w)
        + _symmetric(inertia, cross(w, omega))
        + v * _dot(omega, h)[..., None, :]
        + h * _dot(v, omega)[..., None, :]
        - 2.0 * omega * _dot(v, h)[..., None, :]
    )
    of_axes = _axis_gradient(weights, inertia_omega, omega, alpha, a)
    return of_axes, of_omega.sum(axis=0), of_alpha.sum(axis=0), of_a.sum(axis=0)


def _symmetric(inertia: FloatArray, vector: FloatArray) -> FloatArray:
    """Matrices of XX XY XZ YY YZ ZZ (J, 6, m) times vectors (…, 3, m)."""
    product = np.empty((len(inertia), 3, inertia.shape[-1]))
    term = np.empty((len(inertia), inertia.shape[-1]))
    for row, entries in enumerate(((0, 1, 2), (1, 3, 4), (2, 4, 5))):
        out = product[:, row]
        np.multiply(inertia[:, entries[0]], vector[..., 0, :], out=out)
        for component in (1, 2):
            out += np.multiply(inertia[:, entries[component]], vector[..., component, :], out=term)
    return product


def _dot(left: FloatArray, right: FloatArray) -> FloatArray:
    """Scalar product (…, m) of (…, 3, m) arrays."""
    return np.asarray((left * right).sum(axis=-2))
