"""Two recordings of one arm, without and with a load on its tool, reduced in the same way and cut into the same blocks.

All that payload and drive gains need of them are, for each run and joint, the triangular factor of [W_j y_j] (y the
joint torque, or the motor's signal) and the Gram matrices of its blocks, from which the delete-block jackknife of
`jackknife` follows for any estimator: samples of the same phase of a motion share a block over both runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray, IntArray
from ident.assessment.delay.delay import DelaySearch, search_delay
from ident.assessment.excitation import excited_base_columns
from ident.assessment.recording_checks import closing_checks
from ident.model.another_arm import check_one_arm
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.jackknife import motion_blocks, rows_by_block
from ident.regression.observation_matrix import Reduction, reduce_segments, stack_reductions
from ident.signals.joint_signals import JointSignals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.prepared import Prepared

FREE, LOADED = 0, 1
"""Indices of the two runs, in every list of two."""

Motion = Callable[[Recording, Robot], JointSignals]
"""Reader of a recording's positions, and torques or motor signals."""


@dataclass(frozen=True)
class Run:
    """One of the two recordings, ready for the estimator; `gains_used` as of `JointSignals`."""

    label: str
    prepared: Prepared
    reduction: Reduction
    gains_used: tuple[str, ...] = ()


@dataclass(frozen=True)
class RunPair:
    """The free and the loaded run."""

    robot_file: RobotFile  # the arm
    # model, base, kernel: its model, base parameters and their regressor
    model: DynamicModel
    base: BaseParameters
    kernel: RegressorKernel
    runs: tuple[Run, Run]  # free, then loaded
    active: tuple[int, ...]  # base columns that the two runs together excite
    delay: DelaySearch  # of the torque behind the position, the same for both runs


@dataclass(frozen=True)
class BlockGrams:
    """[W_j y_j]ᵀ[W_j y_j] of every block."""

    # for each run and joint (B, w + 1, w + 1), w its structurally non-zero base columns, y_j last
    grams: tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]
    length: int  # samples per block

    @property
    def count(self) -> int:
        """Number of blocks B."""
        return int(self.grams[0][0].shape[0])


def prepare_pair(
    free: Recording,
    loaded: Recording,
    motion_of: Motion,
    robot_file: RobotFile | None = None,
    delay: float | None = None,
) -> RunPair:
    """Preprocess and reduce both runs with the same filters; the torque's delay [s] is the free run's where None.

    Raises:
        DynidError: the recordings are of different arms, or one of them lacks something.
    """
    check_one_arm([free, loaded])
    robot_file = free.robot() if robot_file is None else robot_file
    motions = [motion_of(recording, robot_file.robot) for recording in (free, loaded)]
    model = build_model(robot_file)
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    first = prepare(motions[FREE], PreprocessChoices(delay=delay or 0.0))
    choices, search = first.choices, DelaySearch(used=first.choices.delay)
    if delay is None:
        search = search_delay(kernel, first.segments, first.parallel_filter)
        choices = replace(choices, delay=search.used, joint_delays=search.joint_delays)
    runs = []
    for motion in motions:
        prepared = prepare(motion, choices)
        reduction = reduce_segments(kernel, prepared.segments, prepared.parallel_filter)
        runs.append(Run(motion.label, prepared, reduction, motion.gains_used))
    pair = (runs[FREE], runs[LOADED])
    active = excited_base_columns(
        stack_reductions([run.reduction for run in pair]), base, [run.prepared for run in pair]
    )
    return RunPair(robot_file, model, base, kernel, pair, active, search)


def pair_warnings(pair: RunPair, recordings: Sequence[Recording]) -> list[str]:
    """Recordings that were not closed, and runs in which joints rest throughout: friction may carry their load."""
    warnings = [check.text for recording in recordings for check in closing_checks(recording)]
    for run in pair.runs:
        speed = np.max([np.max(np.abs(segment.velocity), axis=1) for segment in run.prepared.segments], axis=0)
        resting = [
            name
            for name, value in zip(pair.model.joint_names, speed, strict=True)
            if value < run.prepared.rest_velocity
        ]
        if resting:
            warnings.append(
                f"{', '.join(resting)} rest{'s' if len(resting) == 1 else ''} throughout {run.label}: static friction "
                "may carry part of the apparent load torque; move all joints in both runs"
            )
    return warnings


def block_grams(
    pair: RunPair, parameters: tuple[FloatArray, FloatArray], joints: Sequence[int] | None = None
) -> BlockGrams:
    """Gram matrices of both runs' blocks, whose length follows from the residuals of these joints."""
    series = [_series(pair, run, values) for run, values in zip(pair.runs, parameters, strict=True)]
    everything = [torques for of_run in series for torques in of_run]
    blocks = motion_blocks(everything, joints)
    of_segments = iter(blocks.of_segments)
    free, loaded = (_block_grams(pair.kernel, run.prepared, of_segments, blocks.count) for run in pair.runs)
    return BlockGrams((free, loaded), blocks.length)


def _block_grams(
    kernel: RegressorKernel, prepared: Prepared, of_segments: Iterator[IntArray], blocks: int
) -> tuple[FloatArray, ...]:
    """One run's Gram matrices (B, w + 1, w + 1), joint by joint."""
    widths = [joint.rows.stop - joint.rows.start + 1 for joint in kernel.joint_rows]
    grams = tuple(np.zeros((blocks, width, width)) for width in widths)
    for segment in prepared.segments:
        for block in rows_by_block(kernel, segment, prepared.parallel_filter, next(of_segments), segment.torque):
            for joint, gram in enumerate(grams):
                rows = np.vstack([block.regressor[kernel.joint_rows[joint].rows], block.torque[joint : joint + 1]])
                gram[block.index] += rows @ rows.T
    return grams


def _series(pair: RunPair, run: Run, parameters: FloatArray) -> tuple[TorqueSeries, ...]:
    return compare_torques(
        pair.model, pair.base.columns, parameters, run.prepared.segments, run.prepared.parallel_filter
    )


def weighted_blocks(
    pair: RunPair,
    grams: BlockGrams,
    run: int,
    weights: FloatArray,
    change: tuple[FloatArray, FloatArray],
    chosen: Sequence[int],
) -> FloatArray:
    """(B, c, c) Gram matrices of one run's blocks over all joints, weighted, in the chosen columns of `widened`."""
    summed = np.zeros((grams.count, len(chosen), len(chosen)))
    for joint, gram, weight in zip(pair.kernel.joint_rows, grams.grams[run], weights, strict=True):
        wide = widened(joint.columns, pair.base.count, *change)[:, chosen]
        summed += weight**2 * (wide.T @ gram @ wide)
    return summed


def widened(columns: tuple[int, ...], count: int, effect: FloatArray, shift: FloatArray) -> FloatArray:
    """(w + 1, b + k + 1) maps [W_j τ_j], non-zero columns only, to [W_j, W_j·effect, τ_j − W_j·shift]."""
    width, extra = len(columns), effect.shape[1]
    wide = np.zeros((width + 1, count + extra + 1))
    wide[np.arange(width), list(columns)] = 1.0
    wide[:width, count : count + extra] = effect[list(columns)]
    wide[:width, -1] = -shift[list(columns)]
    wide[width, -1] = 1.0
    return wide
