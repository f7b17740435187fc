"""Periods of recordings in which one joint moves and all others rest, and what its torque is made of beside friction.

What the joint carries is then one body: its torque is, exactly and whatever is on the tool,

    τ = J·q̈ + MX·g_x(q) + MY·g_y(q) + friction(q̇, T, τ_L)

with the body's inertia J (motor included) and first moments MX, MY, which are other ones in each pose of the others and
with each load. g_x and g_y are the joint's columns of the regressor at rest, two combinations of cos q and sin q; a
prismatic joint has one constant in their place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray, true_runs
from drivers.core.errors import DataError
from drivers.core.reading_process import Progress
from ident.friction.terms import NO_TERMS
from ident.identify.data_split import DataSplit, run_window
from ident.identify.identification import IdentifyChoices
from ident.identify.preparation import PreparedData, prepare_data
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.parameters import INERTIAL
from ident.model.regressor import RegressorKernel, regressor
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Prepared, Segment
from ident.signals.repetition import motion_phases

LEAST_STROKE = 0.05
"""Shorter movements [rad or m] tell nothing of gravity."""

FEWEST_SAMPLES = 50
"""Filtered samples of a period below which it is left out."""

GRAVITY = 1e-3
"""Torque [N·m] of a first moment of 1 kg·m below which gravity does not act on a joint."""

FILTER_PERIODS = 1.0
"""Periods of the parallel filter's cut-off that a period is longer than what counts of it, at both ends."""


@dataclass(frozen=True, eq=False)
class JointPeriod:
    """One joint moving, the others at rest: N samples, M of them after the parallel filter."""

    recording: int  # index of its recording
    # position, velocity, acceleration, torque: (N,) of the joint [rad, rad/s, rad/s², N·m or m, m/s, m/s², N]
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    gravity: FloatArray  # (g, N) columns of the gravity torque; g is 0 where gravity does not act
    temperature: FloatArray | None  # (N,) of the joint [K]; None where it was not recorded
    parallel_filter: ZeroPhaseFilter  # for torque and columns
    counted: npt.NDArray[np.bool_]  # (M,) whether the equation counts: away from reversals and rest
    phase: npt.NDArray[np.int64]  # (M,) samples at the same place of a repeated motion have the same

    def filtered(self, signals: FloatArray) -> FloatArray:
        """(k, C) of signals (k, N): filtered, those samples that count."""
        return np.asarray(self.parallel_filter.apply(signals)[:, self.counted])

    def sampled(self, signal: FloatArray) -> FloatArray:
        """(C,) of a signal (N,), not filtered."""
        return np.asarray(signal[:: self.parallel_filter.factor][self.counted])


@dataclass(frozen=True)
class JointPeriods:
    """All periods of all joints."""

    model: DynamicModel  # of the arm, friction terms left out
    periods: tuple[tuple[JointPeriod, ...], ...]  # of each joint; none where it never moves alone
    data: PreparedData  # all recordings as prepared


def joint_periods(
    recordings: Sequence[Recording], robot_file: RobotFile, choices: IdentifyChoices, progress: Progress
) -> JointPeriods:
    """Read and preprocess recordings, and cut out the periods in which one joint moves alone.

    Raises:
        DataError: the arm has loops or coupled motors; no joint moves alone.
    """
    model = build_model(robot_file)
    everywhere = (True,) * model.dof
    if not model.transmission.direct:
        raise DataError(
            "one joint cannot move alone in an arm with loops or coupled motors",
            where=robot_file.robot.name,
            hint="dynid identify --friction auto finds the friction terms of such an arm",
        )
    model = replace(model, terms=NO_TERMS, coulomb=everywhere, viscous=everywhere, offset=everywhere)
    robot = robot_file.robot
    progress("preprocessing")
    windows = [run_window(recording, robot, choices.preprocess) for recording in recordings]
    kernel = RegressorKernel(model, base_parameters(model).columns)
    data = prepare_data(kernel, DataSplit(tuple(windows), (), ""), range(model.dof), (), choices, progress)
    periods = tuple(tuple(_of_joint(model, joint, data)) for joint in range(model.dof))
    if not any(periods):
        raise DataError(
            "no joint moves back and forth while all others rest",
            where=", ".join(recording.label for recording in recordings),
            hint="record the motion that dynid sweep designs",
        )
    return JointPeriods(model, _with_phases(periods), data)


def _of_joint(model: DynamicModel, joint: int, data: PreparedData) -> Iterator[JointPeriod]:
    for index, run in enumerate(data.runs):
        for segment in run.prepared.segments:
            yield from _of_segment(model, joint, index, run.prepared, segment)


def _of_segment(
    model: DynamicModel, joint: int, recording: int, prepared: Prepared, segment: Segment
) -> Iterator[JointPeriod]:
    nowhere = np.zeros(segment.velocity.shape, dtype=np.bool_)
    resting = nowhere if segment.resting is None else segment.resting
    reversing = nowhere if segment.reversing is None else segment.reversing
    others = np.delete(~resting, joint, axis=0).any(axis=0)
    alone = ~resting[joint] & ~others & segment.used
    factor = prepared.parallel_filter.factor
    margin = round(FILTER_PERIODS / prepared.cutoffs.torque * segment.rate)
    for start, stop in true_runs(np.asarray(~others)):
        inside = np.flatnonzero(alone[start:stop]) + start
        if not len(inside):
            continue
        whole = slice(max(0, int(inside[0]) - margin), min(len(alone), int(inside[-1]) + 1 + margin))
        counted = (alone & ~reversing[joint])[whole]
        velocity, position = segment.velocity[joint, whole], segment.position[:, whole]
        moved = velocity[counted]
        stroke = float(np.ptp(position[joint][counted])) if len(moved) else 0.0
        kept = counted[::factor]
        if stroke < LEAST_STROKE or kept.sum() < FEWEST_SAMPLES or np.all(moved > 0) or np.all(moved < 0):
            continue
        heat = None if segment.temperature is None else segment.temperature[joint, whole]
        yield JointPeriod(
            recording,
            position[joint],
            velocity,
            segment.acceleration[joint, whole],
            segment.torque[joint, whole],
            _gravity(model, joint, position),
            None if heat is None or not np.all(np.isfinite(heat)) else heat,
            prepared.parallel_filter,
            kept,
            np.zeros(len(kept), dtype=np.int64),
        )


def _gravity(model: DynamicModel, joint: int, position: FloatArray) -> FloatArray:
    """(g, N) columns of the gravity torque on a joint, all others in their mean position."""
    pose = np.repeat(position.mean(axis=1, keepdims=True), position.shape[1], axis=1)
    pose[joint] = position[joint]
    names = ("M",) if model.joints[joint].prismatic else ("MX", "MY")
    columns = [len(INERTIAL) * joint + INERTIAL.index(name) for name in names]
    still = np.zeros_like(pose)
    acting: FloatArray = regressor(model, pose, still, still, columns)[joint]
    if model.joints[joint].prismatic:
        return np.ones_like(acting)
    return acting if float(np.max(np.abs(acting))) > GRAVITY else acting[:0]


def _with_phases(periods: tuple[tuple[JointPeriod, ...], ...]) -> tuple[tuple[JointPeriod, ...], ...]:
    alone = []
    for of_joint in periods:
        phases = motion_phases([sweep.velocity[None, :: sweep.parallel_filter.factor] for sweep in of_joint])
        alone.append(tuple(replace(sweep, phase=phase) for sweep, phase in zip(of_joint, phases, strict=True)))
    return tuple(alone)
