"""Do positions and velocities agree with their stated units? For files and arrays."""

from __future__ import annotations

import math

import numpy as np

from daq.robot.schema import JointLimits
from drivers.core.arrays import FloatArray

DEGREES = 180 / math.pi
CORRELATED = 0.9
"""Below this correlation of ∫velocity dt with the change of position nothing is concluded from their ratio."""

BLOCKS = 100
"""Displacements are compared over this many segments of the recording, long enough to drown quantisation."""

BEYOND_TRAVEL = 50.0
"""Position of a sliding joint over its limits from which on it is in millimetres: a twentieth of its travel. An angle
in its column is up to 30 times a short travel."""

BEYOND_SPEED = 25.0
"""Speed over its limit from which on positions are in degrees or millimetres: a wrong rate hardly makes so much."""

COUNTS = 3.0
"""Speed, read as degrees or millimetres, over its limit, from which on positions are encoder counts."""

SPEED_QUANTILE = 0.95
"""Quantile of the speeds that counts: encoders that wrap jump."""

_LAG = 5  # samples between which a speed is taken: noise of neighbours is none


def beyond_reach(position: FloatArray, limits: tuple[float, float]) -> bool:
    """Whether positions (N,) [rad] lie more than a turn beyond a revolute joint's limits: then they are in degrees."""
    return bool(np.abs(position).max() > max(abs(limits[0]), abs(limits[1])) + 2 * math.pi)


def other_unit(time: FloatArray, position: FloatArray, limits: JointLimits) -> str | None:
    """The unit of a joint's positions (N,) by its limits: degrees, mm or counts; None where rad or m can be right."""
    if limits.sliding:
        far = float(np.abs(position).max(initial=0.0)) > BEYOND_TRAVEL * max(abs(limit) for limit in limits.position)
    else:
        far = bool(len(position)) and beyond_reach(position, limits.position)
    way, passed = (np.abs(position[_LAG:] - position[:-_LAG]), time[_LAG:] - time[:-_LAG])
    speeds = way[passed > 0] / passed[passed > 0]
    speed = float(np.quantile(speeds, SPEED_QUANTILE)) / limits.velocity if len(speeds) else 0.0
    if not far and speed <= BEYOND_SPEED:
        return None
    unit, factor = ("mm", 1e3) if limits.sliding else ("degrees", DEGREES)
    return unit if speed <= COUNTS * factor else "encoder counts"


def near(ratio: float, expected: float) -> bool:
    """Return whether a ratio of units is the expected one."""
    return 0.8 < ratio / expected < 1.25


def displacement_ratios(time: FloatArray, position: FloatArray, velocity: FloatArray) -> list[float | None]:
    """Per joint the median of Δposition over ∫velocity dt (trapezoids); None where they don't go together.

    Positions [rad or m] and velocities [rad/s or m/s] are (N, n).
    """
    edges = np.unique(np.linspace(0, len(time) - 1, min(BLOCKS, len(time) - 1) + 1).astype(np.intp))
    if len(edges) < 5:
        return [None] * position.shape[1]
    trapezoids = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None]
    integral = np.concatenate([np.zeros((1, velocity.shape[1])), np.cumsum(trapezoids, axis=0)])
    moved, expected = np.diff(position[edges], axis=0), np.diff(integral[edges], axis=0)
    ratios: list[float | None] = []
    for actual, predicted in zip(moved.T, expected.T, strict=True):
        energy, power = float(predicted @ predicted), float(actual @ actual)
        cross = float(actual @ predicted)
        norm = math.sqrt(energy) * math.sqrt(power)
        usable = 0 < norm < math.inf and math.isfinite(cross) and abs(cross) > CORRELATED * norm
        far = np.abs(predicted) > 0.1 * np.abs(predicted).max(initial=0.0)  # the median ignores jumps
        ratios.append(float(np.median(actual[far] / predicted[far])) if usable else None)
    return ratios
