"""Recorded torques against the arm's capability: a current in the wrong unit, a missing gear ratio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.schema import Robot
from drivers.percentage import percent_text
from drivers.streams import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.kinematics.joints import BASE_INDEX
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

STANDARD_GRAVITY = 9.81
DENSEST_ARM = 2000.0
"""[kg/m³] mass that the peak torque holds at full reach, over the reach cubed. It is 10 to 220 for the public
recordings (TX40 219, UR10 9, Panda 7); milliampere read as ampere make it a thousand times that."""


def torque_level_checks(robot: Robot, model: DynamicModel, torque: FloatArray) -> list[Check]:
    """Compare recorded joint torques with the robot file's limits and with the size of the arm.

    Args:
        robot: its joints' limits, where it has any.
        model: of the arm.
        torque: (N, n) at the joints, as recorded [N·m or N].
    """
    if not len(torque):
        return []
    peak = np.quantile(np.abs(torque), PEAK, axis=0)
    limits = np.array([np.nan if joint.torque is None else joint.torque for joint in robot.joints])
    share = peak / limits
    names = robot.joint_names
    beyond = [joint for joint in range(len(names)) if share[joint] > BEYOND]
    if beyond:
        figures = ", ".join(f"{names[j]} {_figure(peak[j])} of {limits[j]:.4g} N·m" for j in beyond)
        text = (
            f"torques are far beyond the limits: {figures}; check the unit of the current (A, not mA), the drive gains "
            "and the limits"
        )
        return [raised("torque-beyond-limits", text, [names[j] for j in beyond])]
    known = share[np.isfinite(share)]
    if len(known) and np.max(known) < FAR_BELOW:
        text = (
            f"torques reach at most {percent_text(float(np.max(known)), 2)} of the limits, too little to carry an "
            "arm: check the unit of the current, and whether the drive gains are on the joint side, gear ratio included"
        )
        return [raised("torque-far-below-limits", text)]
    return _load_checks(names, model, peak)


def _load_checks(names: Sequence[str], model: DynamicModel, peak: FloatArray) -> list[Check]:
    """Whether the peak torque would hold a mass that no arm of this size has; needs no limits."""
    reach = arm_length(model)
    turning = [row for row, joint in enumerate(model.active) if not model.joints[joint].prismatic]
    if not turning or reach == 0.0:
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


def arm_length(model: DynamicModel) -> float:
    """Longest distance [m] from the base to a joint along the links, at position zero."""
    lengths: list[float] = []
    for joint in model.joints:
        before = 0.0 if joint.parent == BASE_INDEX else lengths[joint.parent]
        lengths.append(before + float(np.linalg.norm(joint.translation)))
    return max(lengths, default=0.0)


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"
