"""Recorded torques against the arm's capability: a current in the wrong unit, a missing gear ratio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.assessment.arm_mass import LENGTHS_PER_REACH, arm_length, joint_distances, mass_of_length, part_of_arm
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import weights_in_offsets
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.regressor import RegressorKernel, dense_regressor
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

PEAK = 0.999
"""Quantile of |τ| that counts as the peak: single outliers do not."""

BEYOND = 5.0
"""Peak over limit. Gears withstand two to three times their rated torque briefly; mistaken units make a factor of 1000,
forgotten gear ratios one of 50 and more."""

FAR_BELOW = 0.01
"""The same of the joint that is used most. An excited arm carries itself: the public recordings reach 0.43 to 0.66 of
a limit, so that a gear ratio of 50 left out gives about 0.01."""

CARRIED = 0.05
"""Peak torque over gravity's of the URDF's masses at full length, above which the masses are carried. Of
example-robot-data: a finger 0.6, a hand 0.8, arms of talos and kinova 1.2 and 1.0, two vertical axes 0.07; a gear ratio
of 50 left out gives 0.02."""

STANDARD_GRAVITY = 9.81
DENSEST_ARM = 500.0
"""[kg/m³] mass that the peak torque holds at full length, over the length cubed. It is 10 to 220 for the public
recordings (TX40 219, UR10 9, Panda 7); milliampere read as ampere make it a thousand times that."""

UNKNOWN_LENGTH = 0.5
"""[m] that a part of an arm may be longer than its frames."""

CENTRE = 0.25
"""Gravity's largest torque over the weight of the whole arm, in reaches: most of an arm is near its base."""

HOLDS = 1.5
"""Gravity's part of a torque over its limit beyond which the arm could not hold itself: 0.1 to 0.5 of UR5e, UR10e, AUBO
i5, Panda, TX40 and SR400."""

LITTLE, LIGHT, LITTLE_OF_BOTH = 0.1, 1.0 / 3.0, 0.02
"""The same of the joint that bears most, apparent mass over what arms of this size weigh, and the product of both:
below them together the torques are too small; each alone is no more than unusual. The public recordings have 0.39 and
0.40 (Panda), 0.33 and 0.28 (UR10), 0.20 and 2.5 (TX40)."""

HARDLY, SMOOTH = (0.01, 0.06), 0.01
"""Where the torques show no mass: the same share of gravity, and that of the Coulomb friction of every joint, of its
torque limit. Gears take 3.9 to 7.1 % on the UR10's and TX40's joints; arms that carry no weight show nothing."""

TOO_HEAVY = 5.0
"""Weight that gravity's torque shows over the most that an arm of its size has (`ident.assessment.arm_mass`)."""

NOTHING = 1e-9
"""Gravity's column of a joint [m/s² of a mass, m²/s² of a first moment] that is rounding residue."""

GRAVITY_INSTANTS = 500


def torque_level_checks(robot_file: RobotFile, model: DynamicModel, torque: FloatArray) -> list[Check]:
    """Compare recorded joint torques with the robot file's limits, with its URDF's masses and with the arm's size.

    Args:
        robot_file: its joints' limits and its URDF, where it has any.
        model: of the arm.
        torque: (N, n) at the joints, as recorded [N·m or N].
    """
    if not len(torque):
        return []
    robot = robot_file.robot
    peak = np.quantile(np.abs(torque), PEAK, axis=0)
    limits = np.array([np.nan if joint.torque is None else joint.torque for joint in robot.joints])
    share = peak / limits
    names = robot.joint_names
    beyond = [joint for joint in range(len(names)) if share[joint] > BEYOND]
    if beyond:
        figures = ", ".join(
            f"{names[j]} {_figure(peak[j])} of {limits[j]:.4g} {robot.joints[j].unit('N·m')}" for j in beyond
        )
        text = (
            f"torques are far above the limits: {figures}; check the unit of the current (A, not mA), the drive gains "
            "and the limits"
        )
        return [raised("torque-beyond-limits", text, [names[j] for j in beyond])]
    known = share[np.isfinite(share)]
    if len(known) and np.max(known) < FAR_BELOW and not _carries_stated_masses(robot_file, model, peak):
        text = (
            f"torques reach at most {percent_text(float(np.max(known)), 2)} of the limits, too little for an arm: "
            "check the unit of the current, that the drive gains are on the joint side, gear ratio included, and that "
            "no model's torque was taken off"
        )
        return [raised("torque-far-below-limits", text)]
    return _load_checks(names, model, peak)


def _carries_stated_masses(robot_file: RobotFile, model: DynamicModel, peak: FloatArray) -> bool:
    """Whether peak torques are those of the URDF's masses: then its torque limits are placeholders (1000 N·m)."""
    bodies = urdf_inertias(robot_file, model.link_names)
    distances = joint_distances(model)
    first = min(distances)
    moments = [
        body[0] * (distance - first + float(np.linalg.norm(body[1])))
        for body, distance in zip(bodies, distances, strict=True)
        if body is not None
    ]
    return float(np.max(peak)) > CARRIED * STANDARD_GRAVITY * sum(moments) > 0.0


def _load_checks(names: Sequence[str], model: DynamicModel, peak: FloatArray) -> list[Check]:
    """Check whether the peak torque would hold a mass that no arm of this size has; needs no limits."""
    reach = full_length(model)
    turning = [row for row, joint in enumerate(model.active) if not model.joints[joint].prismatic]
    if not turning:
        return []
    strongest = max(turning, key=lambda row: float(peak[row]))
    mass = float(peak[strongest]) / (STANDARD_GRAVITY * reach)
    if mass < DENSEST_ARM * reach**3:
        return []
    text = (
        f"the torque of {names[strongest]} reaches {_figure(peak[strongest])} N·m, which would hold {_figure(mass)} kg "
        f"at the arm's length of {reach:.2g} m: check the unit of the current (A, not mA) and the drive gains"
    )
    return [raised("implausible-load", text, [names[strongest]])]


def weight_checks(
    robot: Robot,
    model: DynamicModel,
    base: BaseParameters,
    parameters: FloatArray,
    position: FloatArray,
    apparent: float | None = None,
    torque: FloatArray | None = None,
) -> list[Check]:
    """Whether gravity's part of the torque is that of a mass that no arm of this size, or with these limits, has.

    Args:
        robot: its joints' limits, where it has any.
        model: of the arm.
        base: its base parameters.
        parameters: (b,) their values, of bodies that can exist where there are such.
        position: (n, N) that the arm was in [rad or m].
        apparent: mass that the torques show [kg], where they show one.
        torque: (N, n) at the joints, as recorded [N·m or N].
    """
    rows, weight = gravity_torques(model, base, parameters, few_positions(position))
    turning = [row for row, joint in enumerate(model.active) if not model.joints[joint].prismatic]
    if not turning or not weight.size:
        return []
    peak = np.max(np.abs(weight), axis=1)
    strongest = max(turning, key=lambda row: float(peak[row]))
    mass = mass_of_length(full_length(model), part_of_arm(model))
    shown = float(peak[strongest]) / (CENTRE * STANDARD_GRAVITY * full_length(model) / LENGTHS_PER_REACH)
    name = model.joint_names[strongest]
    gravity = f"gravity's part of the torque of {name} reaches {_figure(float(peak[strongest]))} N·m"
    if shown >= TOO_HEAVY * mass.most:
        text = (
            f"{gravity}, as for an arm of {_figure(shown)} kg, while arms of this size weigh about "
            f"{_figure(mass.expected)} kg: check the unit of the current (A, not mA) or torque (N·m, not N·mm), and "
            "the drive gains"
        )
        return [raised("implausible-load", text, [name])]
    limits = {robot.joint_names.index(joint.name): joint.torque for joint in robot.joints if joint.torque is not None}
    # Gravity shows at no joint of a vertical axis: a SCARA carries its weight with its slide alone, and the slide's
    # offset holds it.
    carrying = np.max(np.abs(rows), axis=(1, 2), initial=0.0) > NOTHING
    for name, column in weights_in_offsets(model, base).items():
        lift = model.joint_names.index(name)
        carrying[lift], peak[lift] = True, peak[lift] + abs(float(parameters[column]))
    shares = {row: float(peak[row]) / limit for row, limit in limits.items() if carrying[row]}
    if len({limits[row] for row in turning if row in limits}) < 2:  # equal limits are placeholders
        return []
    if not shares:
        return _weightless_checks(robot, model, base, parameters, torque)
    most = max(shares, key=lambda row: shares[row])
    name, share = model.joint_names[most], percent_text(shares[most], 2)
    if most in turning and shares[most] > HOLDS and model.transmission.direct:  # else motors share a load
        text = (
            f"gravity alone takes {share} of the torque limit of {name}, so that the arm could not hold itself: check "
            "the unit of the current (A, not mA) or torque, the drive gains, and the limits"
        )
        return [raised("implausible-load", text, [name])]
    small = _small_beside(shares[most], mass.expected, apparent, _largest_friction(robot, model, base, parameters))
    if small:
        text = (
            f"gravity takes {share} of the torque limits at most, and {small}: check the unit of torque or current, "
            "and the drive gains (left at 1 they give amperes)"
        )
        return [raised("torque-far-below-limits", text)]
    return []


def few_positions(position: FloatArray) -> FloatArray:
    """Thin out positions (n, N) to at most twice `GRAVITY_INSTANTS`."""
    return position[:, :: max(1, position.shape[1] // GRAVITY_INSTANTS)]


def gravity_torques(
    model: DynamicModel, base: BaseParameters, parameters: FloatArray, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows (n, i, N) of the inertial base parameters at rest, and gravity's torque (n, N)."""
    still = np.zeros_like(position)
    inertial = [column for column, kind in enumerate(base.kinds) if kind == "inertial"]
    rows = dense_regressor(
        RegressorKernel(model, [base.columns[column] for column in inertial]), position, still, still
    )
    return rows, np.asarray(np.einsum("nbN,b->nN", rows, parameters[inertial]))


def _small_beside(gravity: float, expected: float, apparent: float | None, friction: float | None) -> str:
    """Return what is too small beside gravity's largest share of a torque limit; empty where nothing is."""
    if apparent is not None:
        ratio = apparent / expected
        if gravity < LITTLE and ratio < LIGHT and gravity * ratio < LITTLE_OF_BOTH:
            return (
                f"the torques imply an arm of {_figure(apparent)} kg, while arms of this size weigh about "
                f"{_figure(expected)} kg"
            )
    elif friction is not None and HARDLY[0] < gravity < HARDLY[1] and friction < SMOOTH:
        return f"Coulomb friction {percent_text(friction, 2)}, where gears lose 4 % and more"
    return ""


def _weightless_checks(
    robot: Robot, model: DynamicModel, base: BaseParameters, parameters: FloatArray, torque: FloatArray | None
) -> list[Check]:
    """Whether an arm whose joints show no weight uses next to nothing of its torque limits, with friction as small."""
    limits = np.array([np.nan if joint.torque is None else joint.torque for joint in robot.joints])
    friction = _largest_friction(robot, model, base, parameters)
    if torque is None or friction is None or friction >= SMOOTH:
        return []
    used = float(np.max(np.quantile(np.abs(torque), PEAK, axis=0) / limits))
    if used >= LITTLE:
        return []
    text = (
        f"torques reach {percent_text(used, 2)} of the limits at most, and Coulomb friction "
        f"{percent_text(friction, 2)}, where gears lose 4 % and more: check the unit of torque or current, and the "
        "drive gains (left at 1 they give amperes)"
    )
    return [raised("torque-far-below-limits", text)]


def _largest_friction(robot: Robot, model: DynamicModel, base: BaseParameters, parameters: FloatArray) -> float | None:
    """Largest Coulomb friction over its joint's torque limit; None unless every joint has both."""
    limits = {one.name: one.torque for one in robot.joints}
    shares = {}
    for kind, joint, value in zip(base.kinds, base.joints, parameters, strict=True):
        limit = limits.get(model.link_names[joint])
        if kind == "coulomb" and limit:
            shares[joint] = abs(float(value)) / limit
    return max(shares.values()) if len(shares) == model.dof else None


def full_length(model: DynamicModel) -> float:
    """Length [m] of the arm, with what the frames of a part may not show."""
    return arm_length(model) + (UNKNOWN_LENGTH if part_of_arm(model) else 0.0)


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"
