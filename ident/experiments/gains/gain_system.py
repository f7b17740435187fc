"""The concatenated system of two runs: gains, base parameters and load are the unknowns (see `drive_gains`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, IdentificationError
from ident.experiments.run_pair import FREE, LOADED, BlockGrams, Motion, RunPair, block_grams, widened
from ident.linear_algebra.triangular import triangular
from ident.model.load import KnownLoad, LoadColumns, load_columns, load_effect
from ident.regression.least_squares import excited_columns
from ident.regression.observation_matrix import JointFactor, Reduction
from ident.regression.total_least_squares import NullVector, distinctness, null_vector, null_vector_moves, signal_noise
from ident.signals.joint_signals import JointSignals, read_joint_signals


def signal_of(robot: Robot) -> str:
    """Motor signal of an arm's drives: "current" or "voltage".

    Raises:
        DataError: they differ, or give torque.
    """
    signals = {robot.drive(name).signal for name in robot.joint_names}
    if len(signals) > 1:
        raise DataError(
            f"the drives have different signals: {', '.join(sorted(signals))}",
            where=f"{robot.name}: drives",
            hint="all must be currents, or all voltages",
        )
    signal = signals.pop()
    if signal in ("torque", "magnitude"):
        what = "torque" if signal == "torque" else "a magnitude without its sign"
        raise DataError(
            f"the drives' signal is {what}, which has no gain to identify",
            where=f"{robot.name}: drives",
            hint="record motor currents and say 'signal: current'",
        )
    return signal


def torques_by(gains: FloatArray) -> Motion:
    """Reads positions and motor signals times gains (n,) from a recording.

    The returned function raises DataError where the recording has no such signal.
    """

    def motion(recording: Recording, robot: Robot) -> JointSignals:
        signal = signal_of(robot)
        stream = recording.streams.get(JOINTS_STREAM)
        if stream is not None and signal not in stream.channels:
            quantities = ", ".join(sorted(stream.channels)) or "nothing"
            raise DataError(
                f"records no motor {signal}, without which there is no gain to identify; it has {quantities}",
                where=recording.label,
                hint=f"record the motors' {signal}; a recorded torque already contains a gain",
            )
        drives = tuple(
            robot.drive(name).model_copy(update={"gain": float(gain)})
            for name, gain in zip(robot.joint_names, gains, strict=True)
        )
        return read_joint_signals(recording, robot.model_copy(update={"drives": drives}))

    return motion


LEAST_DISTINCTNESS = 1.5
"""A motor signal of which the model's columns leave less than this times its noise does not determine its gain."""


@dataclass(frozen=True)
class GainSystem:
    """One pass: the concatenated system and its solution; gains relative to those that made the torques."""

    pair: RunPair  # the runs
    columns: LoadColumns  # unknown combinations of the load
    parts: FloatArray  # (b, k + 1) effect of these and, last, of the known load on the base parameters
    # the unknowns: base columns that are excited, b + i for load column i, b + k for the known load, last
    layout: tuple[int, ...]
    noise: FloatArray  # (n,) standard deviation of each joint's torque about its own columns [N·m]
    used: tuple[int, ...]  # joints whose gain is identifiable; the rows of the others are left out
    solution: NullVector  # null vector of these

    @property
    def relative_gains(self) -> FloatArray:
        """(n,) gains over those that made the torques; nan where they are not identifiable."""
        relative = np.full(self.pair.model.dof, np.nan)
        relative[list(self.used)] = self.solution.factors
        return relative


def solve_gains(pair: RunPair, known: KnownLoad) -> GainSystem:
    """Set up and solve one pass.

    Raises:
        DataError: the motions do not show the known load.
        IdentificationError: no gain is identifiable.
    """
    robot = pair.robot_file.robot
    effect = load_effect(pair.model, pair.base, robot)
    columns = load_columns(effect, known.known)
    effects = np.column_stack([columns.effect, effect @ known.values])
    factors, rows = _joint_factors(pair, effects)
    count, size = pair.base.count, pair.base.count + effects.shape[1]
    noise = _noise(factors, rows, (*pair.active, *range(count, size)))
    if not np.all(noise > 0):
        silent = [name for name, value in zip(robot.joint_names, noise, strict=True) if value <= 0]
        raise IdentificationError(
            f"the motor signal of {', '.join(silent)} is zero throughout", hint="record all motors"
        )
    everything, used = tuple(range(size)), list(range(len(factors)))
    while True:
        joints = tuple(JointFactor(everything, factors[joint], int(rows[joint])) for joint in used)
        excited = set(excited_columns(Reduction(joints, size, 1, int(rows[0]), "")))
        layout = tuple(i for i in everything if i in excited and (i >= count or i in pair.active))
        if layout[-1:] != (size - 1,):
            raise DataError(
                "the two motions do not show the known load",
                where=pair.runs[LOADED].label,
                hint="move more joints: dynid excite ROBOT --loaded",
            )
        chosen = [factors[joint][:, [*layout, size]] for joint in used]
        distinct = distinctness(chosen, rows[used], noise[used])
        worst = int(np.argmin(distinct))
        if distinct[worst] >= LEAST_DISTINCTNESS:
            break
        # Its gain goes with its own friction and inertia: it would drag the others along.
        if len(used) == 1:
            raise IdentificationError(
                "no motor signal is distinguishable from the friction and inertia of its own joint",
                where=pair.runs[LOADED].label,
                hint="record a richer motion or a heavier load, off the last joint's axis",
            )
        used.pop(worst)
    return GainSystem(pair, columns, effects, layout, noise, tuple(used), null_vector(chosen, rows[used], noise[used]))


def _noise(factors: Sequence[FloatArray], rows: FloatArray, columns: Sequence[int]) -> FloatArray:
    """(n,) what these columns, coefficients free in every joint, leave of each joint's torque (the last column)."""
    return signal_noise([factor[:, [*columns, factor.shape[1] - 1]] for factor in factors], rows)


def _joint_factors(pair: RunPair, effects: FloatArray) -> tuple[list[FloatArray], FloatArray]:
    """Triangular factors (·, b + k + 2) of [W_j, W_j·parts, τ_j] over both runs, and the rows (n,) of each joint."""
    none = np.zeros(pair.base.count)
    factors, rows = [], []
    for joint in range(pair.model.dof):
        stacked, count = [], 0
        for run_index, run in enumerate(pair.runs):
            of_run = run.reduction.joints[joint]
            wide = widened(
                of_run.columns, pair.base.count, effects if run_index == LOADED else np.zeros_like(effects), none
            )
            stacked.append(of_run.factor @ wide)
            count += of_run.rows
        factors.append(triangular(np.vstack(stacked)))
        rows.append(float(count))
    return factors, np.array(rows)


def system_blocks(system: GainSystem) -> BlockGrams:
    """Blocks as long as the residuals' memory."""
    pair, count = system.pair, system.pair.base.count
    unknowns = np.zeros(count + system.parts.shape[1])
    unknowns[list(system.layout)] = system.solution.unknowns
    free = unknowns[:count]
    return block_grams(pair, (free, free + system.parts @ unknowns[count:]), system.used)


def jackknife_moves(system: GainSystem, grams: BlockGrams) -> FloatArray:
    """(B, n + a − 1) how far leaving out each block moves the relative gains of `used` and the unknowns."""
    pair, solution = system.pair, system.solution
    width, size = len(system.layout), pair.base.count + system.parts.shape[1]
    none = np.zeros(pair.base.count)
    chosen = [*system.layout, size]
    blocks = np.zeros((grams.count, width + len(system.used), width + len(system.used)))
    for run_index in (FREE, LOADED):
        effects = system.parts if run_index == LOADED else np.zeros_like(system.parts)
        for position, joint in enumerate(system.used):
            wide = widened(pair.kernel.joint_rows[joint].columns, pair.base.count, effects, none)[:, chosen]
            place = [*range(width), width + position]
            gram = solution.weights[position] ** 2 * (wide.T @ grams.grams[run_index][joint] @ wide)
            blocks[np.ix_(range(grams.count), place, place)] += gram
    return null_vector_moves(blocks, solution)


def own_angles(system: GainSystem) -> FloatArray:
    """(n,) degrees between each motor signal, without its noise, and the columns that act on its joint alone."""
    pair = system.pair
    factors, rows = _joint_factors(pair, system.parts)
    acting_on = [set(joint.columns) for joint in pair.kernel.joint_rows]
    angles = []
    for joint, (factor, count) in enumerate(zip(factors, rows, strict=True)):
        own = [i for i in pair.active if i in acting_on[joint] and sum(i in other for other in acting_on) == 1]
        torque = factor[:, -1]
        noise = count * system.noise[joint] ** 2
        lengths = np.linalg.norm(factor[:, own], axis=0)
        rest = torque - factor[:, own] / lengths @ np.linalg.lstsq(factor[:, own] / lengths, torque, rcond=1e-10)[0]
        total = max(float(torque @ torque) - noise, 0.0)
        share = max(float(rest @ rest) - noise, 0.0) / total if total > 0 else 0.0
        angles.append(float(np.degrees(np.arcsin(min(share, 1.0) ** 0.5))))
    return np.array(angles)
