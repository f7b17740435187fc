"""Gravity's torques beside those of a URDF's bodies: a factor common to all, and a body that is turned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text, rounded
from ident.assessment.torque_level import NOTHING, few_positions, gravity_torques
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.urdf import UrdfBody, urdf_inertias
from ident.model.parameters import link_parameters
from ident.model.regressor import RegressorKernel, dense_regressor
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

SCALED, IMPOSSIBLE_SCALE = 1.1, 2.0
"""Factor between gravity's torque and that of the URDF's bodies from which on it is reported, and called impossible."""

ALIKE = 0.3
"""What is left of gravity's torque by the URDF's bodies times a factor, and the joints' factors beside the common one,
in units of the factor's logarithm: more is another arm. The TX40 has 0.9 (factor 0.87), the UR10 a factor of 1.02."""

LEAST_TURN, MOST_TURN, UNCERTAIN_TURN, TURNED_ALIKE = np.deg2rad(3.0), np.deg2rad(60.0), 4.0, 0.1
"""Angle [rad] by which a body is turned from which on, and up to which, it is reported, and that over its σ; what is
left of its gravity's torque then."""

SHOWN = 0.1
"""Gravity's torque of a joint over the largest one from which on it is compared."""


def _urdf_gravity(model: DynamicModel, bodies: Sequence[UrdfBody], position: FloatArray) -> FloatArray:
    """Gravity's torque (n, N) of bodies (mass, centre, inertia about the joints' frames) at positions (n, N)."""
    stated = np.concatenate(
        [link_parameters(mass, list(centre), list(inertia[np.triu_indices(3)])) for mass, centre, inertia in bodies]
    )
    columns = [column for column, one in enumerate(model.parameters) if one.kind == "inertial"]
    still = np.zeros_like(position)
    rows = dense_regressor(RegressorKernel(model, columns), position, still, still)
    return np.asarray(np.einsum("nbN,b->nN", rows, stated))


def urdf_zero_checks(
    robot_file: RobotFile,
    model: DynamicModel,
    base: BaseParameters,
    parameters: FloatArray,
    covariance: FloatArray,
    active: Sequence[int],
    position: FloatArray,
) -> list[Check]:
    """Check whether gravity's torque of a joint that carries no other one is that of the URDF's body, but turned.

    The parameters absorb the zero of such a joint exactly; only a body whose place is known shows it.

    Args:
        robot_file: its URDF states the bodies, which gravity's torques of the arm confirm (`of_urdf`).
        model: of the arm.
        base: its base parameters.
        parameters: (b,) their values, without physical conditions.
        covariance: (a, a) of those that were estimated.
        active: (a,) indices of these.
        position: (n, N) that the arm was in [rad or m].
    """
    bodies = [body for body in urdf_inertias(robot_file, model.link_names) if body is not None]
    carrying = {joint.parent for joint in model.joints}
    few, checks = few_positions(position), []
    for row, joint in enumerate(model.active):
        if model.sliding[row] or joint in carrying or not model.transmission.direct:
            continue
        turned = few + 0.5 * np.pi * (np.arange(len(few)) == row)[:, None]
        pair = np.stack([_urdf_gravity(model, bodies, at)[row] for at in (few, turned)])
        rows, found = gravity_torques(model, base, parameters, few)
        if float(np.linalg.svd(pair, compute_uv=False)[-1]) < NOTHING:  # its centre lies on the axis, or it is vertical
            continue
        solve = np.linalg.pinv(pair.T)
        cosine, sine = solve @ found[row]
        inertial = [column for column, kind in enumerate(base.kinds) if kind == "inertial"]
        slopes = np.zeros((2, len(base.kinds)))
        slopes[:, inertial] = solve @ rows[row].T
        size, angle = max(NOTHING, float(np.hypot(cosine, sine))), float(np.arctan2(sine, cosine))
        along = np.array([-sine, cosine]) / size**2 @ slopes[:, list(active)]
        std = float(np.sqrt(max(0.0, float(along @ covariance @ along))))
        rest = np.linalg.norm(found[row] - np.array([cosine, sine]) @ pair) / np.linalg.norm(found[row])
        alike = abs(np.log(size)) < np.log(SCALED) and rest < TURNED_ALIKE
        if alike and LEAST_TURN < abs(angle) < MOST_TURN and abs(angle) > UNCERTAIN_TURN * std:
            name = model.joint_names[row]
            text = (
                f"gravity's torque of {name} is that of the URDF's body turned by {np.rad2deg(angle):+.1f}° ± "
                f"{np.rad2deg(WITHIN_95_PERCENT * std):.1f}°: compare the encoder's zero, and how the body is mounted, "
                "with the robot file's"
            )
            checks.append(raised("joint-zero", text, [name]))
    return checks


def urdf_scale(
    robot_file: RobotFile,
    model: DynamicModel,
    base: BaseParameters,
    parameters: FloatArray,
    position: FloatArray,
    torques: Sequence[int],
) -> tuple[float, float] | None:
    """Return gravity's torques over those of the URDF's bodies, and what the worst joint differs by from that factor.

    None where the URDF states no bodies, fewer than two joints carry weight, or the factor is negative.

    Args:
        robot_file: its URDF, where it has one.
        model: of the arm.
        base: its base parameters.
        parameters: (b,) their values, without physical conditions.
        position: (n, N) that the arm was in [rad or m].
        torques: joints whose torques were used.
    """
    bodies = [body for body in urdf_inertias(robot_file, model.link_names) if body is not None]
    if len(bodies) < len(model.link_names) or len({mass for mass, _, _ in bodies}) < 2:  # equal masses: placeholders
        return None
    few = few_positions(position)
    urdf = _urdf_gravity(model, bodies, few)
    found = gravity_torques(model, base, parameters, few)[1]
    urdf, found = (torque - torque.mean(axis=1, keepdims=True) for torque in (urdf, found))
    size = np.where(model.sliding, 0.0, np.linalg.norm(urdf, axis=1))
    shown = [joint for joint in torques if size[joint] > SHOWN * size.max() > 0.0]
    if len(shown) < 2:
        return None
    factors = np.array([found[joint] @ urdf[joint] for joint in shown]) / size[shown] ** 2
    factor = float(np.median(factors))
    if factor <= 0.0:
        return None
    return factor, float(np.max(np.linalg.norm(found[shown] - factor * urdf[shown], axis=1) / (factor * size[shown])))


def of_urdf(scale: tuple[float, float] | None) -> bool:
    """Whether gravity's torques are those of the URDF's bodies, by what `urdf_scale` returns."""
    return scale is not None and abs(np.log(scale[0])) < np.log(SCALED) and scale[1] < ALIKE


def urdf_scale_checks(scale: tuple[float, float] | None) -> list[Check]:
    """Check whether gravity's torques are the URDF's bodies' times one factor, by what `urdf_scale` returns."""
    if scale is None:
        return []
    factor, left = scale
    if abs(np.log(factor)) < np.log(SCALED) or left > ALIKE * min(1.0, abs(float(np.log(factor)))):
        return []
    text = (
        f"gravity's torques are {rounded(factor)} times those of the URDF's bodies, at all joints alike (within "
        f"{percent_text(left, 2)}): check the unit of torque or current and all drive gains, or the "
        "URDF's masses"
    )
    return [raised("implausible-mass" if abs(np.log(factor)) > np.log(IMPOSSIBLE_SCALE) else "torques-scaled", text)]
