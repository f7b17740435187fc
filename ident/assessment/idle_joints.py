"""Joints that rest most of the time, or move one way only: their friction is confounded with other constants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray, true_runs
from drivers.core.text import percent_text
from drivers.core.units import joint_unit
from ident.regression.comparison import TorqueSeries
from ident.signals.segments import SHORTEST_REST
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

MOSTLY = 0.5
"""Share of a joint's equations at rest beyond which they, and not those in motion, decide on its parameters."""

ONE_WAY = 0.02
"""Share of a joint's moving samples in one direction below which its Coulomb friction and a constant torque are one."""


def idle_share(series: Sequence[TorqueSeries], rest_velocity: float) -> FloatArray:
    """Share (n,) of the samples whose equation is used although the joint rests, for `SHORTEST_REST` or longer."""
    resting = np.sum(
        [np.sum(idle_mask(torques, rest_velocity) & torques.counted, axis=1) for torques in series], axis=0
    )
    return np.asarray(resting / max(1, sum(int(torques.used.sum()) for torques in series)))


def idle_mask(torques: TorqueSeries, rest_velocity: float) -> npt.NDArray[np.bool_]:
    """(n, M) samples within a rest of `SHORTEST_REST` or longer; shorter ones are velocity reversals."""
    slow = np.abs(torques.velocity) < rest_velocity
    if len(torques.time) < 2:
        return slow
    shortest = SHORTEST_REST / float(np.median(np.diff(torques.time)))
    for row in slow:
        for start, stop in true_runs(row):
            if stop - start < shortest:
                row[start:stop] = False
    return slow


def idle_joint_checks(
    names: Sequence[str],
    sliding: Sequence[bool],
    series: Sequence[TorqueSeries],
    rest_velocity: float,
    coulomb: FloatArray,
    coulomb_std: FloatArray,
    joints: Sequence[int],
) -> list[Check]:
    """Joints that mostly rest, and whose static friction is larger than the residual that they leave in motion.

    A joint without dry friction may rest as long as it likes.

    Args:
        names: of the joints.
        sliding: whether each of them slides.
        series: measured and predicted torques.
        rest_velocity: below which a joint rests [rad/s or m/s].
        coulomb: (n,) Coulomb friction [N·m]; 0 where the model has none.
        coulomb_std: (n,) its standard deviation [N·m].
        joints: that move in some run, and whose torques are used.
    """
    share = idle_share(series, rest_velocity)
    idle = []
    for joint in joints:
        moving = np.concatenate(
            [torques.residual[joint][torques.used & ~idle_mask(torques, rest_velocity)[joint]] for torques in series]
        )
        noise = float(np.sqrt(np.mean(moving**2))) if len(moving) else 0.0
        dry = abs(float(coulomb[joint]))
        if share[joint] > MOSTLY and dry > max(noise, 3.0 * float(coulomb_std[joint])):
            idle.append(joint)
    if not idle:
        return []
    figures = ", ".join(
        f"{names[j]} {percent_text(float(share[j]), 2)} "
        f"(friction {abs(coulomb[j]):.2g} {joint_unit('N·m', sliding=sliding[j])})"
        for j in idle
    )
    text = (
        f"joints rest for most of the data: {figures}; static friction carries an unknown share of their load, which "
        "the error bars do not cover: move all joints at once, or identify each run with --torques-of its moving "
        "joints and merge the models"
    )
    return [raised("idle-joints", text, [names[j] for j in idle])]


def one_way_checks(
    names: Sequence[str], series: Sequence[TorqueSeries], rest_velocity: float, joints: Sequence[int]
) -> list[Check]:
    """Joints with Coulomb friction and an offset that move in one direction only, where both are constant.

    Args:
        names: of the joints.
        series: measured and predicted torques.
        rest_velocity: below which a joint rests [rad/s or m/s].
        joints: with both, that move in some run, and whose torques are used.
    """
    velocity = np.concatenate([torques.velocity[:, torques.used] for torques in series], axis=1)
    ways = np.array([np.sum(sign * velocity > rest_velocity, axis=1) for sign in (1.0, -1.0)], dtype=np.float64)
    share = ways.min(axis=0) / np.maximum(1.0, ways.sum(axis=0))
    found = [names[joint] for joint in joints if share[joint] < ONE_WAY]
    if not found:
        return []
    text = (
        f"{', '.join(found)} moved in one direction only, in which Coulomb friction is as constant as an offset or a "
        "weight: each may have the other's value, and the torque at rest and on the way back is not known; record both "
        "directions"
    )
    return [raised("one-direction", text, found)]
