"""Energy and power model against the dynamic model, by the SR400 paper's protocol.

The simulated SR400 (closed loop, coupled wrist, Table 4 as truth) goes from point to point by fifth-order moves, 1 kHz,
encoder steps, current noise and ripple, unloaded and with Table 3's load. The drives' gains are those of the robot file
here, so that the methods' own errors show; the effect of uncertain gains is in `sr400_table4.py`. Run it as
python -m studies.papers.energy_vs_dynamic [seeds [which tables, as 13]]. Tables 1 and 2 of 3 seeds: 3 minutes.

1. Links 5 and 6 from the wrist's motion, the other joints locked, as the paper validates them (.4.4): each model's
   values ± the 95 % interval, beside the truth, of the base parameters that are left with these joints locked.
2. The whole arm, by the number of moves, and by a Fourier motion of five harmonics as a contrast: the error of the
   identified model's torque along another motion, known exactly, ‖Y·(π̂ − π)‖/‖Y·π‖; the condition number; how many
   parameters are essential (15 %); the share of 95 % intervals that hold the truth.
3. White noise on the encoders, growing: the same error of the torque, for the wrist and for the whole arm. Once with
   the positions low-passed as `dynid identify` chooses it, once at 80 Hz only, where little shields the accelerations.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.signals.pipeline import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.papers.sr400_table4 import with_paper_load
from studies.synthetic.data_mistakes import with_values
from studies.synthetic.random_points import random_points_motion

METHODS: tuple[str, ...] = ("wls", "energy", "power")
NOISE = (0.0, 1e-4, 3e-4, 1e-3, 3e-3)
WRIST = ("j5", "j6")
WRIST_MOVES = 40
NOISE_MOVES = 24
MOVES = (12, 24, 48)
FOURIER_PERIOD = 20.0
WEAK_LOW_PASS = 80.0


def with_encoder_noise(recording: Recording, std: float, seed: int) -> Recording:
    """White noise [rad] on every position."""
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    return with_values(recording, position=position + std * np.random.default_rng(seed).standard_normal(position.shape))


def identified(
    recording: Recording, held_out: Recording, method: str, position_cutoff: float | None = None
) -> Identification | None:
    """The model; None where the data do not determine it."""
    filters = PreprocessChoices(position_cutoff=position_cutoff)
    try:
        return identify(
            [recording], [held_out], IdentifyChoices(method, preprocess=filters, search_delay=False, reversals=0.0)
        )
    except IdentificationError:
        return None


def recorded(robot_file: RobotFile, motion: Motion, seed: int) -> Recording:
    return simulate_recording(robot_file, motion, motion.duration, seed)


def another_motion(robot_file: RobotFile, moving: Sequence[str], seed: int) -> Motion:
    return random_points_motion(robot_file.robot, 1000 + seed, 8, moving)


def samples_of(motion: Motion) -> tuple[FloatArray, FloatArray, FloatArray]:
    return motion.evaluate(np.arange(0.0, motion.duration, 0.02))


def torque_error(robot_file: RobotFile, fit: Identification | None, motion: Motion) -> float:
    """‖Y·(π̂ − π)‖/‖Y·π‖ [%] of the joints that move; inf without a model."""
    if fit is None:
        return float("inf")
    samples = samples_of(motion)
    expected = model_torque(fit.model, None, truth_vector(robot_file), *samples)
    predicted = model_torque(fit.model, fit.base.columns, fit.solution.parameters, *samples)
    moving = np.any(samples[1] != 0, axis=1)
    return 100.0 * float(np.linalg.norm((predicted - expected)[moving]) / np.linalg.norm(expected[moving]))


def print_heads(*heads: str) -> None:
    """A table's heading."""
    print(f"\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}")


def compare_parameters(label: str, arm: RobotFile, seed: int = 0, moves: int = WRIST_MOVES) -> list[Identification]:
    """Print table 1 of one arm; its models."""
    motion = random_points_motion(arm.robot, seed, moves, WRIST)
    recording, held_out = recorded(arm, motion, seed), recorded(arm, another_motion(arm, WRIST, seed), seed + 1)
    models = [fit for method in METHODS if (fit := identified(recording, held_out, method)) is not None]
    truth = models[0].base.projection @ truth_vector(arm)
    print_heads(label, "truth", *(f"`{fit.solution.method}`" for fit in models))
    for i, name in enumerate(models[0].base.names):
        figures = (f"{fit.solution.parameters[i]:.4f} ± {WITHIN_95_PERCENT * fit.std[i]:.4f}" for fit in models)
        print(f"| {name} | {truth[i]:.4f} | {' | '.join(figures)} |", flush=True)
    return models


def compare_motions(label: str, arm: RobotFile, seeds: int, rows: Sequence[int] = MOVES) -> FloatArray:
    """Print table 2 of one arm; its errors of the torque [%] (motions, methods)."""
    print_heads(label, *(head for method in METHODS for head in (f"`{method}` error", "cond", "ess.", "held")))
    table = []
    for row in (*rows, 0):
        figures = np.empty((seeds, len(METHODS), 4))
        duration = 0.0
        for seed in range(seeds):
            motion: Motion
            if row:
                motion = random_points_motion(arm.robot, seed, row)
            else:
                motion = random_fourier_motion(build_model(arm), FOURIER_PERIOD, seed, candidates=10)
            other = another_motion(arm, (), seed)
            recording, held_out = recorded(arm, motion, seed), recorded(arm, other, seed + 1)
            duration += motion.duration / seeds
            for column, method in enumerate(METHODS):
                fit = identified(recording, held_out, method)
                figures[seed, column] = np.inf, np.inf, 0.0, np.nan
                if fit is None:
                    continue
                truth = fit.base.projection @ truth_vector(arm)
                held = np.abs(fit.solution.parameters - truth) < WITHIN_95_PERCENT * fit.std
                essential = len(fit.pruned.solution.active)
                condition = fit.solution.scaled_condition
                figures[seed, column] = torque_error(arm, fit, other), condition, essential, held.mean()
        middle, held_share = np.median(figures, axis=0), np.mean(figures[:, :, 3], axis=0)
        cells = (
            f"{error:.2f} | {condition:.2g} | {essential:.0f} | {share:.0%}".replace("%", " %")
            for (error, condition, essential, _), share in zip(middle, held_share, strict=True)
        )
        print(f"| {f'{row} moves' if row else '5 harmonics'}, {duration:.0f} s | {' | '.join(cells)} |", flush=True)
        table.append(middle[:, 0])
    return np.array(table)


def compare_noise(
    label: str, arm: RobotFile, moving: Sequence[str], moves: int, seeds: int, levels: Sequence[float] = NOISE
) -> FloatArray:
    """Print table 3 for the joints that move (all where empty); its entries (levels, methods twice) [%]."""
    cutoffs = {"": None, f" {WEAK_LOW_PASS:g} Hz": WEAK_LOW_PASS}
    print_heads(label, *(f"`{method}`{at}" for at in cutoffs for method in METHODS))
    table = []
    for std in levels:
        errors = np.empty((seeds, len(cutoffs) * len(METHODS)))
        for seed in range(seeds):
            motion, other = random_points_motion(arm.robot, seed, moves, moving), another_motion(arm, moving, seed)
            recording = with_encoder_noise(recorded(arm, motion, seed), std, seed)
            held_out = recorded(arm, other, seed + 1)
            fits = [identified(recording, held_out, method, at) for at in cutoffs.values() for method in METHODS]
            errors[seed] = [torque_error(arm, fit, other) for fit in fits]
        table.append(np.median(errors, axis=0))
        print(f"| {std:g} | {' | '.join(f'{error:.3g}' for error in table[-1])} |", flush=True)
    return np.array(table)


def main(seeds: int = 3, tables: str = "123") -> None:
    """Print the tables."""
    free = load_robot("sr400")
    if "1" in tables:
        compare_parameters(f"wrist, {WRIST_MOVES} moves", free)
    if "2" in tables:
        compare_motions("unloaded", free, seeds)
        compare_motions("with Table 3's load", with_paper_load(free), seeds)
    if "3" in tables:
        compare_noise(f"wrist, {WRIST_MOVES} moves [rad]", free, WRIST, WRIST_MOVES, seeds)
        compare_noise(f"whole arm, {NOISE_MOVES} moves [rad]", free, (), NOISE_MOVES, seeds)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3, sys.argv[2] if len(sys.argv) > 2 else "123")
