"""Checks that a small residual does not replace: gravity's sign, definite inertia, dissipative friction, offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import DISSIPATIVE_KINDS, REFERENCE_TEMPERATURE
from ident.model.base_parameters import BaseParameters, random_states
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import regressor
from ident.regression.least_squares import LeastSquares, excited_columns, ordinary_least_squares
from ident.regression.observation_matrix import Reduction
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

POSES = 200
CLEARLY_SMALLER = 0.99
"""The opposite gravity's sum of squared residuals must be below this, relative to the file's: not by rounding."""

LEVEL = 0.01
"""Significance level of the F-test on a smaller residual."""

SURE_DEVIATIONS = 3.0
"""A wrong sign is reported beyond this many σ from 0."""

BIASED, OF_COULOMB, SURE_BIAS = 0.15, 0.4, 5.0
LARGE_BIAS, ALONE = 0.3, 3.0
"""Offset over the peak of a joint's torque, over its Coulomb friction, and in σ, beyond which something was added: to a
joint alone, whose share is so many times the others', or larger. On the public recordings it is 0.13 and 0.36 (UR10,
wrist 2), 0.005 and 0.95 (Panda, joint 2)."""


def inertia_matrices(
    model: DynamicModel, base: BaseParameters, parameters: FloatArray, position: FloatArray
) -> FloatArray:
    """Joint-space inertia matrices (N, n, n), motor inertias included, at positions (n, N)."""
    count = position.shape[1]
    weightless = replace(model, gravity=np.zeros(3))
    heat = np.full_like(position, REFERENCE_TEMPERATURE)  # at rest it does not matter
    still = np.zeros_like(position)
    matrices = np.empty((count, model.dof, model.dof))
    inertial = np.array([kind in ("inertial", "motor_inertia") for kind in base.kinds])
    inertial |= np.array([name.startswith("Iac") for name in base.names])
    for joint in range(model.dof):
        acceleration = np.zeros_like(position)
        acceleration[joint] = 1.0
        rows = regressor(weightless, position, still, acceleration, base.columns, heat)
        # The offset column is 1 whatever moves, and no torque of inertia.
        matrices[:, :, joint] = np.einsum("nbN,b->Nn", rows, np.where(inertial, parameters, 0.0))
    return model.transmission.at_joints(matrices)


def indefinite_share(model: DynamicModel, base: BaseParameters, parameters: FloatArray) -> float:
    """Share of random poses at which the inertia matrix is not positive definite; 0 for every arm that exists."""
    position, _, _ = random_states(model, POSES)
    matrices = inertia_matrices(model, base, parameters, position)
    smallest = np.linalg.eigvalsh(0.5 * (matrices + matrices.transpose(0, 2, 1)))[:, 0]
    return float(np.mean(smallest <= 0.0))


def refitted(reduction: Reduction, active: Sequence[int]) -> LeastSquares:
    """Least squares over those `active` columns that are excited in this system as well."""
    return ordinary_least_squares(reduction, [column for column in excited_columns(reduction) if column in active])


def critical_variance_ratio(freedom: float) -> float:
    """Ratio of two residual variances, each of so many degrees of freedom, below which they differ significantly.

    With few independent equations for many parameters, as the energy model has, one sign of gravity leaves a little
    less than the other whatever the truth.
    """
    from scipy.special import fdtri

    return float(min(CLEARLY_SMALLER, fdtri(freedom, freedom, LEVEL))) if freedom >= 1 else 0.0


def sign_checks(base: BaseParameters, parameters: FloatArray, std: FloatArray) -> list[Check]:
    """Checks of friction and motor inertia that are clearly negative; regrouped with others they may well be."""
    alone = np.count_nonzero(base.projection, axis=1) == 1
    wrong = [
        column
        for column, kind in enumerate(base.kinds)
        if kind in (*DISSIPATIVE_KINDS, "motor_inertia")
        and alone[column]
        and parameters[column] < -SURE_DEVIATIONS * std[column]
    ]
    checks = []
    friction = [base.names[i] for i in wrong if base.kinds[i] != "motor_inertia"]
    if friction:
        text = (
            f"{', '.join(friction)} is negative (not dissipative): usually the sign of a drive gain is wrong, or a "
            "friction term is missing"
        )
        checks.append(raised("negative-friction", text))
    motors = [base.names[i] for i in wrong if base.kinds[i] == "motor_inertia"]
    if motors:
        text = (
            f"{', '.join(motors)} of the unconstrained parameters is negative: torque sensors behind the gearbox do "
            "not see the motor; set `inertia: false` for these drives or use --no-motor-inertia"
        )
        checks.append(raised("negative-motor-inertia", text))
    return checks


def opposite_gravity() -> Check:
    """The check of gravity's sign, where nothing more is known of its direction."""
    text = (
        "the data fit gravity with the opposite sign better: check `model.gravity`, the mounting, and the signs of "
        "the drive gains"
    )
    return raised("gravity-opposite", text)


def bias_checks(
    model: DynamicModel, base: BaseParameters, values: FloatArray, std: FloatArray, torque: FloatArray
) -> list[Check]:
    """Offsets beyond friction and beyond what drives and sensors have: what was added to a joint's torque.

    Args:
        model: of the arm.
        base: its base parameters.
        values: (b,) of these.
        std: (b,) their standard deviations.
        torque: (N, n) recorded.
    """
    peak = np.max(np.abs(torque), axis=0)
    joints = [model.active.index(joint) if joint in model.active else -1 for joint in base.joints]
    coulomb = {joint: abs(values[i]) for i, joint in enumerate(joints) if base.kinds[i] == "coulomb"}
    offsets = {
        joint: i
        for i, joint in enumerate(joints)
        if base.kinds[i] == "offset" and joint >= 0 and peak[joint] > 0.0 and not model.sliding[joint]
    }
    shares = {joint: abs(values[i]) / peak[joint] for joint, i in offsets.items()}
    found = {
        joint: float(values[i])
        for joint, i in offsets.items()
        if shares[joint] > max(BIASED, min(LARGE_BIAS, ALONE * _largest_other(shares, joint)))
        and abs(values[i]) > max(OF_COULOMB * coulomb.get(joint, 0.0), SURE_BIAS * std[i])
    }
    if not found:
        return []
    figures = ", ".join(f"{model.joint_names[joint]} {value:+.3g} N·m" for joint, value in found.items())
    text = (
        f"a large constant is added to the torque: {figures}; check the zero of the torque sensor or current (the "
        "model holds it as an offset), unless a spring does it"
    )
    return [raised("torque-biased", text, [model.joint_names[joint] for joint in found])]


def _largest_other(shares: dict[int, float], joint: int) -> float:
    return max((share for other, share in shares.items() if other != joint), default=0.0)
