"""Energy and power model against the dynamic model, without accelerations and with; takes about three minutes.

The SR400 (closed loop, coupled wrist) is simulated: first with the wrist alone in motion, as its paper validates links
5 and 6 (§4.4), then with all joints. Tables:

1. Parameters of links 5 and 6 by each model, with two standard deviations, beside the truth. Listed are those that mean
   the same with the other joints locked; locked joints regroup the rest.
2. White noise on the encoders, growing: how far the identified model's torque is from the true one along another
   motion, known exactly, ‖Y·(π̂ − π)‖/‖Y·π‖ [%], median over the seeds. Once with the positions low-passed as
   `dynid identify` chooses it, once at 80 Hz only, where little shields the accelerations.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording import JOINTS_STREAM, Recording
from daq.robot import RobotFile, load_robot
from daq.trajectories import FourierSeries
from drivers.errors import IdentificationError
from ident.identify import Identification, IdentifyChoices, identify
from ident.kinematics import FloatArray
from ident.least_squares import Method
from ident.model import build_model, truth_vector
from ident.preprocess import PreprocessChoices
from ident.regressor import model_torque, regressor
from sim_drivers.measurement import simulate_recording
from sim_drivers.motion import random_fourier_motion

METHODS: tuple[Method, ...] = ("wls", "energy", "power")
NOISE = (0.0, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3)
PERIOD = 20.0
HELD_OUT = 5.0
WEAK_LOW_PASS = 80.0
ROBOT = "sr400"
WRIST = ("j5", "j6")


def motion_of(robot_file: RobotFile, moving: tuple[str, ...], seed: int, candidates: int = 10) -> FourierSeries:
    """A random motion of some joints, the others still in the middle of their ranges."""
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed, candidates)
    moves = np.array([name in moving for name in robot_file.robot.joint_names])[:, None]
    return replace(motion, sine=motion.sine * moves, cosine=motion.cosine * moves)


def with_encoder_noise(recording: Recording, std: float, seed: int) -> Recording:
    """White noise [rad] on every position."""
    stream = recording.streams[JOINTS_STREAM]
    channel = stream.channels["position"]
    noise = std * np.random.default_rng(seed).standard_normal(channel.values.shape)
    channels = stream.channels | {"position": replace(channel, values=channel.values + noise)}
    return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})


def identified(recording: Recording, method: Method, position_cutoff: float | None = None) -> Identification | None:
    """The model; None where the data do not determine it."""
    filters = PreprocessChoices(position_cutoff=position_cutoff)
    try:
        return identify([recording], [], IdentifyChoices(method, preprocess=filters, split=PERIOD, search_delay=False))
    except IdentificationError:
        return None


def torque_error(robot_file: RobotFile, found: Identification | None, motion: FourierSeries) -> float:
    """‖Y·(π̂ − π)‖/‖Y·π‖ of the joints that move; inf without a model."""
    if found is None:
        return float("inf")
    samples = motion.evaluate(np.arange(0.0, PERIOD, 0.02))
    expected = model_torque(found.model, None, truth_vector(robot_file), *samples)
    predicted = model_torque(found.model, found.base.columns, found.solution.parameters, *samples)
    moving = np.any(motion.sine != 0, axis=1)
    return float(np.linalg.norm((predicted - expected)[moving]) / np.linalg.norm(expected[moving]))


def truth_seen(robot_file: RobotFile, found: Identification, motion: FourierSeries) -> FloatArray:
    """True values (b,) of the estimated parameters, those that were not estimated regrouped on them; else nan."""
    columns, active = found.base.columns, list(found.solution.active)
    rows = regressor(found.model, *motion.evaluate(np.arange(0.0, PERIOD, 0.02)), columns)
    if found.choices.method != "wls":  # a joint at rest does no work
        rows = rows[np.any(motion.sine != 0, axis=1)]
    system = rows.transpose(0, 2, 1).reshape(-1, len(columns))
    scale = np.linalg.norm(system[:, active], axis=0)
    truth = found.base.projection @ truth_vector(robot_file)
    seen = np.full(len(columns), np.nan)
    seen[active] = np.linalg.lstsq(system[:, active] / scale, system @ truth, rcond=None)[0] / scale
    return seen


def compare_parameters(robot: str, moving: tuple[str, ...], seed: int = 0) -> int:
    """Print table 1; the number of its rows."""
    robot_file = load_robot(robot)
    motion = motion_of(robot_file, moving, seed)
    recording = simulate_recording(robot_file, motion, PERIOD + HELD_OUT, seed)
    models = [found for method in METHODS if (found := identified(recording, method)) is not None]
    seen = [truth_seen(robot_file, found, motion) for found in models]
    truth = models[0].base.projection @ truth_vector(robot_file)
    print(f"\n{robot}, {', '.join(moving)} in motion: value ± two standard deviations")
    print(f"{'':8}{'truth':>9}" + "".join(f"{found.solution.method:>20}" for found in models))
    count = 0
    for i, name in enumerate(models[0].base.names):
        if not all(np.isclose(values[i], truth[i], rtol=1e-3, atol=1e-6) for values in seen):
            continue
        figures = (f"{found.solution.parameters[i]:11.4f} ± {2 * found.std[i]:.4f}" for found in models)
        print(f"{name:8}{truth[i]:9.4f}" + "".join(f"{text:>20}" for text in figures))
        count += 1
    return count


def compare_noise(robot: str, moving: tuple[str, ...], seeds: int, levels: tuple[float, ...] = NOISE) -> FloatArray:
    """Print table 2; its entries (2, levels, methods)."""
    robot_file = load_robot(robot)
    moving = moving or robot_file.robot.joint_names
    print(f"\n{robot}, {', '.join(moving)} in motion, {seeds} seeds: error of the torque [%]")
    print(f"{'noise [rad]':>12}" + "".join(f"{name:>10}" for name in METHODS) + "  | at 80 Hz:" + "".join(
        f"{name:>10}" for name in METHODS
    ))  # fmt: skip
    table = np.empty((2, len(levels), len(METHODS)))
    for row, std in enumerate(levels):
        errors = np.empty((2, len(METHODS), seeds))
        for seed in range(seeds):
            motion, other = motion_of(robot_file, moving, seed), motion_of(robot_file, moving, 1000 + seed, 1)
            recording = simulate_recording(robot_file, motion, PERIOD + HELD_OUT, seed)
            recording = with_encoder_noise(recording, std, seed)
            for block, cutoff in enumerate((None, WEAK_LOW_PASS)):
                for column, method in enumerate(METHODS):
                    found = identified(recording, method, cutoff)
                    errors[block, column, seed] = 100.0 * torque_error(robot_file, found, other)
        table[:, row] = np.median(errors, axis=2)
        halves = ["".join(f"{value:10.2f}" for value in table[block, row]) for block in (0, 1)]
        print(f"{std:12.0e}{halves[0]}  |          {halves[1]}")
    return table


def main(seeds: int = 5) -> None:
    """Print all tables."""
    compare_parameters(ROBOT, WRIST)
    compare_noise(ROBOT, WRIST, seeds)
    compare_noise(ROBOT, (), seeds)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
