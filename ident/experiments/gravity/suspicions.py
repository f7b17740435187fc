"""What makes a fit of gravity doubtful: signs, units, the direction of gravity, drift, bad encoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.assessment.arm_mass import LENGTHS_PER_REACH, arm_length, mass_of_size
from ident.experiments.gravity.fit import GravityFit
from ident.experiments.gravity.passes import Visit, Visits, pose_text
from ident.model.base_parameters import BaseParameters, gravity_base, gravity_rows
from ident.model.dynamic_model import DynamicModel
from ident.model.true_parameters import truth_vector

POOR_FIT = 0.1
"""Residuals over gravity's torque from which on signs and gravity's direction are questioned."""

EXPLAINED = 0.25
"""A suspicion is raised where it lowers the residuals to this share."""

ALIKE = 1.5
"""Ratio of residuals up to which two suspicions are as good."""

DRIFT = 4.0
"""Standard deviations by which the torques of one place differ where the arm changed."""

BEYOND_SIZE = 3.0
"""Gravity torque over the most that an arm of the size can have, from which on units are wrong."""

SHOWN = 5.0
"""Standard deviations of the noise by which a joint's torques vary where they are compared."""

_TINY = 1e-9


def residual_share(visits: Sequence[Visit], fit: GravityFit) -> float:
    """Root mean square of the residuals over that of the torques that vary with the pose."""
    torque = np.where(fit.used, np.array([visit.mean[0] for visit in visits]), np.nan)
    moving = fit.used.any(axis=0)
    vary = torque[:, moving] - np.nanmean(torque[:, moving], axis=0)
    return float(np.sqrt(np.nanmean(fit.residual**2) / max(np.nanmean(vary**2), _TINY)))


def refuse_wrong_size(visits: Sequence[Visit], model: DynamicModel, where: str) -> None:
    """Refuse torques that no arm of this size has at rest.

    Raises:
        DataError: names the joint, its torque and what an arm of the size can have.
    """
    mass = mass_of_size(model)
    if mass is None:
        return
    torque = np.array([visit.mean[0] for visit in visits])
    span = 0.5 * np.ptp(torque, axis=0)
    reach = arm_length(model) / LENGTHS_PER_REACH
    for joint, slides in enumerate(model.sliding):
        most = BEYOND_SIZE * mass.most * 9.81 * (1.0 if slides else reach)
        limit = model.limits[joint].torque
        most = max(most, 0.0 if limit is None else limit)
        if span[joint] > most:
            unit = "N" if slides else "N·m"
            raise DataError(
                f"the torque of {model.joint_names[joint]} at rest varies by ±{span[joint]:.3g} {unit} from pose to "
                f"pose; an arm of this size weighs at most {mass.most:.3g} kg",
                where=where,
                hint="check the unit of the current (A, not mA) and the drive's gain",
            )


def doubts(
    robot_file: RobotFile,
    model: DynamicModel,
    base: BaseParameters,
    visits: Visits,
    fit: GravityFit,
    still_though_commanded: Sequence[str],
) -> list[tuple[bool, str]]:
    """Return what is wrong, or not known: whether it makes the model poor, and a sentence."""
    suspicions: list[tuple[bool, str]] = []
    seen = visits.visits
    for name in still_though_commanded:
        suspicions.append((True, f"{name} was commanded to move, and its position never changes: its encoder is stuck"))
    share = residual_share(seen, fit)
    if share > POOR_FIT:
        suspicions += _wrong_sign(model, seen, fit) or _wrong_gravity(robot_file, model, seen, fit)
    suspicions += _opposite_masses(robot_file, model, base, fit, seen)
    suspicions += _drift(model, seen, fit)
    if visits.unbalanced:
        pose, direction, time = visits.unbalanced[0]
        more = "" if len(visits.unbalanced) == 1 else f", and {len(visits.unbalanced) - 1} more"
        suspicions.append(
            (
                False,
                f"left out, passed in one direction only: {pose_text(model, pose, direction)} at {time:.1f} s{more}",
            )
        )
    resting = [name for name, count in zip(model.joint_names, fit.used.sum(axis=0), strict=True) if not count]
    if resting:
        suspicions.append((False, f"{', '.join(resting)} never moves in both directions: its torque is not used"))
    lost = [base.names[index] for index in np.flatnonzero(~fit.determined)]
    if lost:
        suspicions.append((bool(resting) is False, f"not determined by these poses: {', '.join(lost)}"))
    return suspicions


def _wrong_sign(model: DynamicModel, visits: Sequence[Visit], fit: GravityFit) -> list[tuple[bool, str]]:
    torque, rows = (np.array([visit.mean[direction] for visit in visits]) for direction in (0, 1))
    size = _sizes(visits, fit)
    costs = []
    for joint in (-1, *range(model.dof)):
        signs = np.ones(model.dof)
        if joint >= 0:
            signs[joint] = -1.0
        costs.append(_cost(rows, torque * signs, fit, size))
    least = min(costs[1:])
    if least > EXPLAINED**2 * costs[0]:
        return []
    # Of two joints that gravity acts on, each fits the other with its sign reversed.
    names = [name for name, cost in zip(model.joint_names, costs[1:], strict=True) if cost <= ALIKE * least]
    text = (
        f"the torque of {' or '.join(names)} fits the others with the opposite sign only: reverse the sign of "
        "its gain (drives), or of its encoder"
    )
    return [(True, text)]


def _wrong_gravity(
    robot_file: RobotFile, model: DynamicModel, visits: Sequence[Visit], fit: GravityFit
) -> list[tuple[bool, str]]:
    torque, rows = (np.array([visit.mean[direction] for visit in visits]) for direction in (0, 1))
    poses = np.array([visit.pose for visit in visits])
    size = _sizes(visits, fit)
    strength = float(np.linalg.norm(model.gravity)) or 9.81
    costs = []
    for axis in range(3):
        turned = replace(model, gravity=strength * np.eye(3)[axis])
        costs.append(_cost(gravity_rows(turned, gravity_base(turned), poses), torque, fit, size))
    best = int(np.argmin(costs))
    if costs[best] > EXPLAINED**2 * _cost(rows, torque, fit, size):
        return []
    text = (
        f"the torques fit gravity along the base's {'xyz'[best]} axis, and not {model.gravity.tolist()}: correct "
        f"`gravity` and `mounting` of {robot_file.robot.name}'s robot file"
    )
    return [(True, text)]


def _opposite_masses(
    robot_file: RobotFile, model: DynamicModel, base: BaseParameters, fit: GravityFit, visits: Sequence[Visit]
) -> list[tuple[bool, str]]:
    """All signs at once, where the robot file knows masses; without them the sign of all torques is gravity's."""
    of_file = file_parameters(robot_file, model, base)
    if of_file is None:
        return []
    rows = np.array([visit.mean[1] for visit in visits])
    inertial = np.array([kind == "inertial" for kind in base.kinds])
    ours, theirs = ((rows @ np.where(inertial, values, 0.0))[fit.used] for values in (fit.values, of_file))
    norm = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
    if norm <= _TINY or float(ours @ theirs) > -0.5 * norm:
        return []
    text = (
        "gravity acts opposite to what the robot file's masses need: the sign of all torques (gains) or the direction "
        "of `gravity` is wrong; the model still compensates in these units"
    )
    return [(False, text)]


def file_parameters(robot_file: RobotFile, model: DynamicModel, base: BaseParameters) -> FloatArray | None:
    """Gravity parameters (b,) by the masses that the robot file states; None where it does not state all."""
    if not all(name in robot_file.robot.truth.links for name in model.link_names):
        return None
    return np.asarray(base.projection @ truth_vector(robot_file, model))


def _drift(model: DynamicModel, visits: Sequence[Visit], fit: GravityFit) -> list[tuple[bool, str]]:
    """Torques that differ between visits of one place."""
    suspicions = []
    for place in sorted(set(fit.group.tolist())):
        members = np.flatnonzero(fit.group == place)
        if len(members) < 2:
            continue
        first, last = members[0], members[-1]
        both = fit.used[first] & fit.used[last]
        change = np.where(both, fit.residual[last] - fit.residual[first], 0.0)
        # Compared with the noise of these two alone: a change enlarges the residuals of all.
        noise = np.hypot(visits[first].noise, visits[last].noise)
        wrong = np.abs(change) > np.maximum(DRIFT * noise, 2.0 * POOR_FIT * _sizes_of_gravity(visits, fit))
        if np.any(wrong):
            joint = int(np.argmax(np.where(wrong, np.abs(change) / np.maximum(noise, _TINY), 0.0)))
            seconds = visits[last].time - visits[first].time
            text = (
                f"{model.joint_names[joint]} needs {change[joint]:+.3g} {model.limits[joint].unit('N·m')} more in the "
                f"same pose {seconds:.0f} s later: a load was picked up or put down, or the torque drifts; record again"
            )
            suspicions.append((True, text))
    return suspicions


def _sizes_of_gravity(visits: Sequence[Visit], fit: GravityFit) -> FloatArray:
    torque = np.array([visit.mean[0] for visit in visits])
    columns = zip(torque.T, fit.used.T, strict=True)
    return np.array([float(np.std(column[used])) if np.any(used) else 0.0 for column, used in columns])


def _sizes(visits: Sequence[Visit], fit: GravityFit) -> FloatArray:
    """Return what each joint's torques vary by (n,); infinite of those that hardly vary beside their noise."""
    spread = _sizes_of_gravity(visits, fit)
    noise = np.sqrt(np.mean(np.square([visit.noise for visit in visits]), axis=0))
    return np.where(spread > SHOWN * noise, np.maximum(spread, _TINY), np.inf)


def _cost(rows: FloatArray, torque: FloatArray, fit: GravityFit, size: FloatArray) -> float:
    """Sum of squares that a fit leaves, every joint's torques over their size."""
    weight = fit.used / size
    wide = (rows * weight[..., None]).reshape(-1, rows.shape[2])
    aim = (torque * weight).ravel()
    solved, *_ = np.linalg.lstsq(wide, aim, rcond=1e-9)
    return float(np.sum((aim - wide @ solved) ** 2))
