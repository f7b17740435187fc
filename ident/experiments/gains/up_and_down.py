"""Drive gains from slow up-and-down runs, without and with a load of known mass: gravity against friction.

What the load adds to the half sum of the signals up and down (`slow_passes`) is its gravity torque over the gain,

    g_j·(s_loaded − s_free) = E_j(q)·load

E_j(q) follows from the kinematics only: neither the arm's own parameters nor a friction model are needed, and the
joints at rest do not matter. With a known centre of mass each joint is independent; without, the three first moments
are unknowns common to all joints, and gains and moments are the null vector of one small system, solved as that of the
exciting motions (`total_least_squares`). Standard deviations come from a delete-block jackknife over the bins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, IdentificationError
from drivers.core.text import percentage_text
from ident.experiments.gains.drive_gains import (
    LEAST_GAP,
    GainsFigures,
    JointGain,
    drives_text,
    estimated_values,
    gain_unit,
    left_out_gains,
)
from ident.experiments.gains.gain_system import signal_of, torques_by
from ident.experiments.gains.slow_passes import Sweep, passes_of, sweeps_of
from ident.linear_algebra.independent_columns import independent_columns
from ident.linear_algebra.triangular import triangular
from ident.model.another_arm import check_one_arm
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.load import FIRST_MOMENTS, KnownLoad, load_effect
from ident.model.parameters import INERTIAL
from ident.model.regressor import regressor
from ident.regression.comparison import lag_one
from ident.regression.jackknife import block_length, jackknife_covariance
from ident.regression.options import SIGNIFICANT_RSD
from ident.regression.total_least_squares import NullVector, null_vector, null_vector_moves, signal_noise
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.prepared import Prepared
from ident.stored import Real

LEAST_SIGNAL = 10.0
"""What the load adds to a joint's signal, as a vector over its bins, must be this many deviations of one bin long: a
gain is then known to about 10 %."""

ONLY_MOMENTS = "only the load's unknown moments act on it; give its centre of mass"
"""Reason for a joint whose gain would not be distinguishable from them."""

FEWEST_BINS = 8
"""Bins of a joint below which its jackknife is not reliable."""


class SlowGain(JointGain):
    """Gain of one joint's drive from slow passes."""

    sliding: bool = Field(default=False, description="whether the joint slides: N and m/s for N·m and rad/s")
    sweeps: int = Field(description="poses of the other joints in which it passed up and down")
    positions: int = Field(description="compared in all of them")
    speed: Real = Field(description="mean [rad/s or m/s]")
    friction_free: Real = Field(description="mean half difference, by the gain [N·m or N]")
    friction_loaded: Real = Field(description="the same with the load")
    reason: str | None = Field(description="why there is no value; null where there is one")


class SlowGainsResult(GainsFigures):
    """Gains of the drives from slow up-and-down runs."""

    kind: Literal["gains-up-and-down"] = "gains-up-and-down"
    gains: list[SlowGain]


@dataclass(frozen=True)
class _JointRows:
    """One joint's bins: gravity of unit load parameters (m, 10) [N·m], and what the load adds to the signal (m,)."""

    joint: int
    gravity: FloatArray
    signal: FloatArray


@dataclass(frozen=True)
class _Solved:
    """Gains of some joints and what of the load was estimated with them."""

    joints: tuple[int, ...]  # their indices
    gains: FloatArray  # (n,) [N·m/A or N·m/V]
    # unknown, moments: which load parameters (a,), and their values [kg·m]
    unknown: tuple[int, ...]
    moments: FloatArray
    deviations: FloatArray  # (n + a,) standard deviations of both
    gap: float  # second-smallest over smallest singular value


def identify_slow_gains(
    free: Recording,
    loaded: Recording,
    known: KnownLoad,
    robot_file: RobotFile | None = None,
    delay: float | None = None,
) -> SlowGainsResult:
    """Gains of the drives whose joints pass slowly up and down, one at a time, in both runs.

    Args:
        free: recording without the load, with motor signals.
        loaded: recording of the same arm with it.
        known: of the load; its mass at least.
        robot_file: in place of the free recording's.
        delay: of the signals [s]; 0 where None, since it cancels between up and down.

    Raises:
        DataError: different arms, no motor signal, no joint with slow passes in both directions and both runs.
        IdentificationError: the gains are confounded with the unknown centre of mass.
    """
    check_one_arm([free, loaded])
    robot_file = free.robot() if robot_file is None else robot_file
    robot = robot_file.robot
    model = build_model(robot_file)
    prepared = [_prepared(recording, robot, delay or 0.0) for recording in (free, loaded)]
    passes = [passes_of(run.segments, run.rest_velocity) for run in prepared]
    sweeps = sweeps_of(*passes)
    if not sweeps:
        raise DataError(
            "no joint passes the same positions slowly in both directions in both runs, with the others at "
            "rest in the same pose",
            where=f"{free.label}, {loaded.label}",
            hint="record a motion of kind 'points', one joint after the other back and forth; without --up-and-down "
            "any motion of all joints works",
        )
    rows = _joint_rows(model, robot, sweeps)
    reasons = _reasons(rows, known, model.dof)
    used = [joint_rows for joint_rows in rows if not reasons[joint_rows.joint]]
    if not used:
        raise DataError(
            "no joint's gain is identifiable: "
            + "; ".join(f"{robot.joint_names[joint_rows.joint]}: {reasons[joint_rows.joint]}" for joint_rows in rows),
            where=loaded.label,
            hint="move joints whose axes are not vertical, as fast up as down, with a heavier load",
        )
    if known.com is not None:  # nothing is shared: each joint for itself
        solved = [_solve([joint_rows], (), known) for joint_rows in used]
    else:
        solved = [_with_moments(used, known, loaded.label)]
    identified = {joint for solution in solved for joint in solution.joints}
    reasons = [reason or ("" if joint in identified else ONLY_MOMENTS) for joint, reason in enumerate(reasons)]
    return _slow_gains(robot, [free.label, loaded.label], known, sweeps, reasons, solved)


def _prepared(recording: Recording, robot: Robot, delay: float) -> Prepared:
    signals = torques_by(np.ones(len(robot.joint_names)))(recording, robot)
    return prepare(signals, PreprocessChoices(delay=delay))


def _joint_rows(model: DynamicModel, robot: Robot, sweeps: Sequence[Sweep]) -> list[_JointRows]:
    base = base_parameters(model)
    effect = load_effect(model, base, robot)
    rows = []
    for joint in sorted({sweep.joint for sweep in sweeps}):
        own = [sweep for sweep in sweeps if sweep.joint == joint]
        pose = np.concatenate([sweep.pose for sweep in own], axis=1)
        columns = regressor(model, pose, np.zeros_like(pose), np.zeros_like(pose), base.columns)
        added = np.concatenate([sweep.half_sum[1] - sweep.half_sum[0] for sweep in own])
        rows.append(_JointRows(joint, columns[joint].T @ effect, added))
    return rows


def _reasons(rows: Sequence[_JointRows], known: KnownLoad, dof: int) -> list[str]:
    """Return why a joint gets no gain, in words; empty where it gets one."""
    reasons = ["no slow passes up and down with the others at rest, in both runs"] * dof
    moments = FIRST_MOMENTS if known.com is None else ()
    for joint_rows in rows:
        factor, count = triangular(_wide(joint_rows, moments, known)), np.array([float(len(joint_rows.signal))])
        if len(joint_rows.signal) < FEWEST_BINS:
            reasons[joint_rows.joint] = (
                f"only {len(joint_rows.signal)} positions are passed both ways at the same speed"
            )
        elif _explained(factor) < LEAST_SIGNAL * signal_noise([factor], count)[0]:
            reasons[joint_rows.joint] = "the load's weight about its axis does not exceed the noise"
        else:
            reasons[joint_rows.joint] = ""
    return reasons


def _explained(factor: FloatArray) -> float:
    """Length of what the columns (·, a) of a triangular factor (·, a + 1) explain of its last one."""
    rest = np.linalg.norm(factor[factor.shape[1] - 1 :, -1])
    return float(np.sqrt(max(float(factor[:, -1] @ factor[:, -1] - rest**2), 0.0)))


def _with_moments(used: Sequence[_JointRows], known: KnownLoad, where: str) -> _Solved:
    """Gains and first moments together; without the joints on which moments alone act, where those prevent it.

    Raises:
        IdentificationError: gains and centre of mass are not distinguishable.
    """
    carrying = [joint_rows for joint_rows in used if _carries(joint_rows, known)]
    for joints in (used, carrying):
        unknown = _unknown_moments(joints, known)
        if unknown is None:
            continue
        solution = _solve(joints, unknown, known)
        if solution.gap >= LEAST_GAP:
            return solution
    raise IdentificationError(
        "in these passes the gains are confounded with the load's centre of mass, which is unknown",
        where=where,
        hint="give it with --com, or move more joints up and down, in several poses of the others",
    )


def _carries(joint_rows: _JointRows, known: KnownLoad) -> bool:
    """Return whether the known load has a moment about a joint's axis."""
    weight = np.max(np.abs(joint_rows.gravity @ known.values))
    return bool(weight > 1e-6 * np.max(np.abs(joint_rows.gravity)) * known.mass)


def _unknown_moments(joints: Sequence[_JointRows], known: KnownLoad) -> tuple[int, ...] | None:
    """Return which first moments show; None where the known mass does not show beside them."""
    if not joints:
        return None
    columns = np.vstack([_wide(joint_rows, FIRST_MOMENTS, known)[:, :-1] for joint_rows in joints])
    lengths = np.linalg.norm(columns, axis=0)
    kept = independent_columns(columns / np.where(lengths > 0.0, lengths, 1.0), range(columns.shape[1]), 1e-6)
    if columns.shape[1] - 1 not in kept:
        return None
    return tuple(FIRST_MOMENTS[index] for index in kept[:-1])


def _wide(joint_rows: _JointRows, unknown: Sequence[int], known: KnownLoad) -> FloatArray:
    """(m, a + 2) columns of the unknown moments, of the known load, and the signal."""
    return np.column_stack([joint_rows.gravity[:, list(unknown)], joint_rows.gravity @ known.values, joint_rows.signal])


def _solve(joints: Sequence[_JointRows], unknown: Sequence[int], known: KnownLoad) -> _Solved:
    wides = [_wide(joint_rows, unknown, known) for joint_rows in joints]
    counts = np.array([float(len(wide)) for wide in wides])
    factors = [triangular(wide) for wide in wides]
    solution = null_vector(factors, counts, signal_noise(factors, counts))
    covariance = _jackknife(wides, solution)
    return _Solved(
        joints=tuple(joint_rows.joint for joint_rows in joints),
        gains=solution.factors,
        unknown=tuple(unknown),
        moments=solution.unknowns[:-1],
        deviations=np.sqrt(np.diag(covariance)),
        gap=solution.gap,
    )


def _jackknife(wides: Sequence[FloatArray], solution: NullVector) -> FloatArray:
    """Covariance (n + a, n + a) of gains and unknown moments, blocks of bins as long as the residuals' memory."""
    width = wides[0].shape[1] - 1
    size = width + len(wides)
    blocks = []
    for index, (wide, gain) in enumerate(zip(wides, solution.factors, strict=True)):
        residual = gain * wide[:, -1] - wide[:, :-1] @ solution.unknowns
        length = block_length(lag_one([residual[None]]), len(wide))
        place = np.ix_([*range(width), width + index], [*range(width), width + index])
        for start in range(0, len(wide), length):
            rows = solution.weights[index] * wide[start : start + length]
            block = np.zeros((size, size))
            block[place] = rows.T @ rows
            blocks.append(block)
    return jackknife_covariance(null_vector_moves(np.array(blocks), solution))


def _slow_gains(
    robot: Robot,
    runs: list[str],
    known: KnownLoad,
    sweeps: Sequence[Sweep],
    reasons: Sequence[str],
    solved: Sequence[_Solved],
) -> SlowGainsResult:
    values, deviations = np.full(len(reasons), np.nan), np.full(len(reasons), np.inf)
    moments, spread = np.full(3, np.nan), np.full(3, np.nan)
    if known.com is not None:
        moments, spread = known.values[list(FIRST_MOMENTS)], np.zeros(3)
    for solution in solved:
        values[list(solution.joints)], deviations[list(solution.joints)] = (
            solution.gains,
            solution.deviations[: len(solution.joints)],
        )
        places = [FIRST_MOMENTS.index(column) for column in solution.unknown]
        moments[places], spread[places] = solution.moments, solution.deviations[len(solution.joints) :]
    gains = [
        _slow_gain(robot, joint, float(values[joint]), float(deviations[joint]), sweeps, reasons[joint])
        for joint in range(len(reasons))
    ]
    signal = signal_of(robot)
    names = [f"{INERTIAL[column]}_L" for column in FIRST_MOMENTS]
    return SlowGainsResult(
        robot=robot.name,
        runs=runs,
        signal=signal,
        unit=gain_unit(signal, robot),
        known=known,
        gains=gains,
        load=estimated_values(names, ["kg·m"] * len(names), moments, spread),
        gap=min(solution.gap for solution in solved),
        robot_file_text=drives_text(robot, signal, gains),
        warnings=_warnings(gains, moments),
    )


def _slow_gain(robot: Robot, joint: int, gain: float, std: float, sweeps: Sequence[Sweep], reason: str) -> SlowGain:
    name = robot.joint_names[joint]
    own = [sweep for sweep in sweeps if sweep.joint == joint]
    friction, speed = np.full(2, np.nan), float("nan")
    if own:
        friction = np.abs(gain * np.concatenate([sweep.half_difference for sweep in own], axis=1).mean(axis=1))
        speed = float(np.mean([sweep.speed for sweep in own]))
    return SlowGain(
        joint=name,
        sliding=robot.sliding[joint],
        gain=gain,
        std=std,
        file_gain=robot.drive(name).gain,
        sweeps=len(own),
        positions=sum(sweep.pose.shape[1] for sweep in own),
        speed=speed,
        friction_free=float(friction[0]),
        friction_loaded=float(friction[1]),
        reason=reason or None,
    )


def _warnings(gains: Sequence[SlowGain], moments: FloatArray) -> list[str]:
    warnings = []
    for gain in gains:
        if gain.reason:
            warnings.append(f"no value for the gain of {gain.joint}: {gain.reason}")
        elif gain.rsd_percent >= SIGNIFICANT_RSD:
            warnings.append(
                f"the gain of {gain.joint} has a relative standard deviation of {percentage_text(gain.rsd_percent, 2)} "
                "%; record more passes, a heavier load, or poses with the load farther from its axis"
            )
        if gain.file_gain is not None and gain.gain * gain.file_gain < 0:
            warnings.append(f"the gain of {gain.joint} has the opposite sign of the robot file's")
    warnings += left_out_gains(gains)
    hidden = [INERTIAL[column] for column, value in zip(FIRST_MOMENTS, moments, strict=True) if np.isnan(value)]
    if hidden:
        warnings.append(f"the passes do not show the load's {', '.join(hidden)}")
    return warnings
