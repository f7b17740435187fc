"""Forecast for a designed motion: condition number, predicted error bars, limit utilisation.

The error bars are those of weighted least squares, (Σ_j Φ_jᵀΦ_j/σ_j²)⁻¹ (SR400 eq. 14 with the joints' weights of
ROCR6 eq. 10-12), Φ_j the rows of the base regressor that joint j records and σ_j the prior's torque noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.motion.limits import Extremes, motion_extremes
from daq.motion.trajectories import Motion
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.excite.path import repeated_for
from ident.excite.prior import PriorKnowledge, recording_rate
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel, model_torque
from ident.regression.least_squares import excited_columns
from ident.regression.observation_matrix import Reduction, reduce_segments
from ident.regression.pruning import relative_std
from ident.result.units import parameter_unit
from ident.signals.filters import no_filter
from ident.signals.prepared import Segment

MOST_SAMPLES = 100_000
"""A longer motion is evaluated with fewer repetitions, or on a coarser grid than that of its recording."""

TORQUE_GRID_RATE = 1000.0
"""Rate [Hz] of the grid for the largest torques, the same as for the limits of the motion."""


@dataclass(frozen=True)
class ParameterForecast:
    """Expected precision of one base parameter."""

    name: str  # as in the result
    expression: str  # the combination of standard parameters
    kind: str  # inertial, friction, …
    unit: str  # of value and std
    value: float | None  # prior; None where nothing is known
    std: float  # predicted standard deviation; inf where the motion does not excite it
    rsd_percent: float | None  # the same, of the value [%]; inf where the value is 0, None where it is not known


@dataclass(frozen=True)
class Forecast:
    """Expected precision of an identification with a motion."""

    condition: float  # condition number of the base regressor
    scaled_condition: float  # the same, column-normalised
    # natural logarithm of the determinant of the information matrix Σ_j Φ_jᵀΦ_j/σ_j² (all excited columns)
    log_det: float
    unexcited: tuple[str, ...]  # names of the base parameters that the motion does not excite
    parameters: tuple[ParameterForecast, ...]  # one entry per base parameter


@dataclass(frozen=True)
class JointUse:
    """Limit utilisation of one joint; 1 is the limit."""

    joint: str  # its name
    # lowest, highest: position [rad or m]
    lowest: float
    highest: float
    position_use: float  # largest distance from the middle of the range, of half the range
    velocity: float  # largest magnitude [rad/s or m/s]
    velocity_use: float  # of its limit
    acceleration: float  # largest magnitude [rad/s² or m/s²]
    acceleration_use: float  # of its limit
    torque: float | None  # largest magnitude that the prior parameters need [N·m or N]; None where there are none
    torque_use: float | None  # of its limit; None where either is unknown


@dataclass(frozen=True)
class ExcitationFigures:
    """Duration, forecast and limit utilisation of a designed motion."""

    duration: float  # of what is played [s]
    rate: float  # at which it is recorded [Hz]
    forecast: Forecast  # expected precision with its recording
    joints: tuple[JointUse, ...]  # limit utilisation of each joint
    worst_use: float  # largest limit utilisation of any joint
    worst_limit: str  # the name of that limit
    worst_time: float  # when [s]
    prior: str  # origin of parameters and noise


def excitation_figures(robot_file: RobotFile, motion: Motion, prior: PriorKnowledge) -> ExcitationFigures:
    """Figures of a motion as it is played, from rest to rest.

    Raises:
        RobotFileError: the geometry cannot be used.
    """
    model = build_model(robot_file)
    base = base_parameters(model)
    rate = recording_rate(robot_file.robot)
    joints, worst = _limit_use(model, base, motion, prior)
    return ExcitationFigures(
        duration=motion.duration,
        rate=rate,
        forecast=forecast(base, model, _motion_reduction(model, base, motion, rate), prior),
        joints=joints,
        worst_use=worst[0],
        worst_limit=worst[1],
        worst_time=worst[2],
        prior=prior.source,
    )


def forecast(
    base: BaseParameters,
    model: DynamicModel,
    reduction: tuple[Reduction, float],
    prior: PriorKnowledge,
    active: Sequence[int] | None = None,
) -> Forecast:
    """Expected precision with rows of a regressor at their rate per joint [Hz], whatever their torque.

    Of the base columns in `active`; of those that the rows make identifiable where None.
    """
    reduced, row_rate = reduction
    active = list(excited_columns(reduced) if active is None else active)
    plain = reduced.stacked()[:, active]
    # A row carries prior.rate/row_rate independent values of the noise.
    weighted = math.sqrt(prior.rate / row_rate) * reduced.stacked(1.0 / prior.noise)[:, active]
    lengths = np.linalg.norm(weighted, axis=0)
    std = np.full(base.count, np.inf)
    log_det, condition = -math.inf, math.inf
    if active:
        inverse = np.linalg.pinv(weighted / lengths)
        std[active] = np.linalg.norm(inverse, axis=1) / lengths
        singular = np.linalg.svd(weighted / lengths, compute_uv=False)
        log_det = 2.0 * float(np.sum(np.log(singular)) + np.sum(np.log(lengths)))
        singular = np.linalg.svd(plain, compute_uv=False)
        condition = float(singular[0] / singular[-1])
    rsd = None if prior.parameters is None else relative_std(prior.parameters, std)
    return Forecast(
        condition=condition,
        scaled_condition=scaled_condition(plain),
        log_det=log_det,
        unexcited=tuple(base.names[i] for i in range(base.count) if i not in active),
        parameters=tuple(
            ParameterForecast(
                name=base.names[i],
                expression=base.expressions[i],
                kind=base.kinds[i],
                unit=parameter_unit(model, column),
                value=None if prior.parameters is None else float(prior.parameters[i]),
                std=float(std[i]),
                rsd_percent=None if rsd is None else float(rsd[i]),
            )
            for i, column in enumerate(base.columns)
        ),
    )


def _motion_reduction(
    model: DynamicModel, base: BaseParameters, motion: Motion, rate: float
) -> tuple[Reduction, float]:
    """The base regressor along a motion, and its rows a second [Hz]."""
    shorter = repeated_for(motion, MOST_SAMPLES / rate)
    count = max(2, min(round(shorter.duration * rate), MOST_SAMPLES))
    time = np.linspace(0.0, shorter.duration, count, endpoint=False)
    position, velocity, acceleration = shorter.evaluate(time)
    segment = Segment(
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=np.zeros_like(position),
        rate=count / shorter.duration,
        used=np.ones(count, dtype=np.bool_),
    )
    return reduce_segments(RegressorKernel(model, base.columns), [segment], no_filter()), count / motion.duration


def _limit_use(
    model: DynamicModel, base: BaseParameters, motion: Motion, prior: PriorKnowledge
) -> tuple[tuple[JointUse, ...], tuple[float, str, float]]:
    """Limit utilisation of every joint, and the largest one: value, name, time [s]."""
    extremes = motion_extremes(motion)
    torque, torque_times = _largest_torques(model, base, motion, prior)
    joints = []
    uses: list[tuple[float, str, float]] = []
    for index, limits in enumerate(model.limits):
        low, high = limits.position
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        below, above = (middle - extremes.lowest[index]) / half, (extremes.highest[index] - middle) / half
        torque_limit = None if torque is None else float(torque[index])
        entry = JointUse(
            joint=limits.name,
            lowest=float(extremes.lowest[index]),
            highest=float(extremes.highest[index]),
            position_use=float(max(below, above)),
            velocity=float(extremes.velocity[index]),
            velocity_use=float(extremes.velocity[index]) / limits.velocity,
            acceleration=float(extremes.acceleration[index]),
            acceleration_use=float(extremes.acceleration[index]) / limits.acceleration,
            torque=torque_limit,
            torque_use=None if torque_limit is None or limits.torque is None else torque_limit / limits.torque,
        )
        joints.append(entry)
        uses += _named_uses(entry, extremes, index, int(above >= below))
        if entry.torque_use is not None:
            uses.append((entry.torque_use, f"torque of {entry.joint}", float(torque_times[index])))
    return tuple(joints), max(uses)


def _named_uses(entry: JointUse, extremes: Extremes, index: int, side: int) -> list[tuple[float, str, float]]:
    """Limit utilisations of one joint with names and times; `side` is 0 where the lower position limit is nearer."""
    return [
        (entry.position_use, f"position of {entry.joint}", float(extremes.times[side, index])),
        (entry.velocity_use, f"velocity of {entry.joint}", float(extremes.times[2, index])),
        (entry.acceleration_use, f"acceleration of {entry.joint}", float(extremes.times[3, index])),
    ]


def _largest_torques(
    model: DynamicModel, base: BaseParameters, motion: Motion, prior: PriorKnowledge
) -> tuple[FloatArray | None, FloatArray]:
    """Largest magnitudes (n,) of the torques of the prior parameters, None without them, and their times (n,) [s]."""
    if prior.parameters is None:
        return None, np.zeros(model.dof)
    motion = repeated_for(motion, 0.0)
    count = int(min(max(motion.duration * TORQUE_GRID_RATE, 2000.0), MOST_SAMPLES)) + 1
    time = np.linspace(0.0, motion.duration, count)
    torque = np.abs(model_torque(model, base.columns, prior.parameters, *motion.evaluate(time)))
    at = torque.argmax(axis=1)
    return torque[np.arange(model.dof), at], time[at]
