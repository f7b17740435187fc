"""Bias and coverage of the estimators under coloured noise, and their held-out error on the public recordings.

    python -m studies.coverage.estimators_bias [seeds [methods, separated by commas]]
    python -m studies.coverage.estimators_bias SEEDS METHODS controlled      (the controlled arm alone)

A simulated UR5e follows one periodic motion exactly, three periods of 10 s, and then once more under a position
controller that believes in 90 % of the arm's parameters, whose targets are recorded; every seed draws other noise: on
positions an encoder's steps and coloured noise, on torques AR(1) noise. Preprocessed by default, and poorly, with cut-
offs far above the motion's band. `bias` is the error of the torque of the mean of all seeds' parameters along another
motion, relative to that torque, `error` the median over the seeds of the same; `bias/σ` the root mean square over the
parameters of their mean error over the spread of the seeds (1/√seeds where there is no bias); `inside` the share of
true values in the 95 % intervals. Then the held-out error (last 30 %) of the public recordings in `DYNID_DATA`.
With 20 seeds some ten minutes of processor time.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

from daq.motion.trajectories import FourierSeries
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from ident.assessment.excitation import excited_base_columns
from ident.estimators.estimator import Setup
from ident.estimators.method_choice import chosen_method
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.comparison import compare_torques
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import FilteredRun
from ident.regression.observability import whole_arm
from ident.regression.options import REVERSAL_SHARE
from ident.regression.velocity_reversals import leave_out_reversals
from ident.signals.joint_signals import JointSignals, read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare
from sim_drivers.plant.plant import Plant, PlantSettings
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.coverage.reversals import public_recordings
from studies.synthetic.controlled_run import record_plant

METHODS = (*("ols", "wls", "tls", "iv:instruments=repetition"), "output-error")
TARGET_METHODS = ("iv:instruments=target",)
"""Need the controller's targets."""
PERIOD, DURATION = 10.0, 30.0
ENCODER = 2e-5
POSITION_STD, POSITION_CORRELATION = 5e-5, 0.7
"""Standard deviation [rad] of the coloured noise on positions, and its lag-one correlation at 500 Hz."""
TORQUE_SHARE, TORQUE_CORRELATION = 0.03, 0.95
"""Standard deviation of the noise on torques, over their root mean square, and its lag-one correlation."""

PREPROCESSING = {"default": PreprocessChoices(), "poor": PreprocessChoices(position_cutoff=80.0, torque_cutoff=40.0)}


@dataclass(frozen=True)
class Fit:
    """Parameters (b,), their standard deviations, and the processor time [s] of the method."""

    parameters: FloatArray
    std: FloatArray
    seconds: float


def coloured(generator: np.random.Generator, shape: tuple[int, int], std: FloatArray, correlation: float) -> FloatArray:
    """AR(1) noise (N, n) of standard deviations `std` (n,)."""
    white = generator.standard_normal((shape[0] + 500, shape[1])) * np.sqrt(1.0 - correlation**2)
    return np.asarray(std * lfilter([1.0], [1.0, -correlation], white, axis=0)[500:])


def noisy(exact: JointSignals, seed: int) -> JointSignals:
    """The same signals with noise."""
    generator = np.random.default_rng(seed)
    shape = (exact.position.shape[0], exact.position.shape[1])
    position = exact.position + coloured(generator, shape, np.full(shape[1], POSITION_STD), POSITION_CORRELATION)
    size = TORQUE_SHARE * np.sqrt(np.mean(exact.torque**2, axis=0))
    return replace(
        exact,
        position=np.round(position / ENCODER) * ENCODER,
        torque=exact.torque + coloured(generator, shape, size, TORQUE_CORRELATION),
    )


def exact_signals(robot_file: RobotFile) -> JointSignals:
    """Signals of the arm with perfect sensors."""
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed=1)
    recording = simulate_recording(with_perfect_sensors(robot_file), motion, DURATION, seed=0)
    return read_joint_signals(recording, robot_file.robot)


def with_perfect_sensors(robot_file: RobotFile) -> RobotFile:
    """The arm without noise."""
    robot = robot_file.robot
    silent = robot.truth.noise.model_copy(
        update={"encoder_resolution": 0.0, "torque_std": {}, "ripple_amplitude": {}, "torque_delay": 0.0}
    )
    truth = robot.truth.model_copy(update={"noise": silent})
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"truth": truth})})


def controlled_signals(robot_file: RobotFile) -> JointSignals:
    """Signals of the arm under a controller, with perfect sensors, and the controller's targets."""
    perfect = with_perfect_sensors(robot_file)
    once = random_fourier_motion(build_model(robot_file), PERIOD, seed=1)
    periods = round(DURATION / PERIOD)
    harmonics = [np.zeros((once.sine.shape[0], periods * once.sine.shape[1])) for _ in range(2)]
    for every, amplitudes in zip(harmonics, (once.sine, once.cosine), strict=True):
        every[:, periods - 1 :: periods] = amplitudes
    motion = FourierSeries(DURATION, once.offset, *harmonics)
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    plant = Plant(perfect, PlantSettings(nominal_share=0.9), position=start)
    recording = record_plant(perfect, plant, motion, robot_file.robot.truth.noise.rate)
    return read_joint_signals(recording, robot_file.robot)


def fitted(robot_file: RobotFile, signals: JointSignals, choices: PreprocessChoices, method: str) -> Fit:
    """The estimate of one method."""
    model = build_model(robot_file)
    base = base_parameters(model)
    kernel = RegressorKernel(model, base.columns)
    run = leave_out_reversals(kernel, prepare(signals, choices), REVERSAL_SHARE)
    start = time.process_time()
    estimator = chosen_method(method).estimator(Setup(kernel, base, whole_arm(model), robot_file, (run,)))
    plain = estimator.reduce([run])
    estimation = estimator.estimate([run], plain, excited_base_columns(plain, base, [run]))
    parameters = estimation.solution.parameters
    seconds = time.process_time() - start
    series = compare_torques(model, kernel.columns, parameters, run.segments, run.parallel_filter)
    corrected = estimator.covariance([FilteredRun(run.segments, run.parallel_filter, series)], estimation)
    return Fit(parameters, np.sqrt(np.diag(corrected.covariance)), seconds)


def compare(robot_file: RobotFile, exact: JointSignals, seeds: int, methods: Sequence[str]) -> None:
    """Print a table for each preprocessing of signals without noise."""
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    other = random_fourier_motion(model, PERIOD, seed=2).evaluate(np.arange(0.0, PERIOD, 0.02))
    torque = model_torque(model, base.columns, truth, *other)

    def off(parameters: FloatArray) -> float:
        predicted = model_torque(model, base.columns, parameters, *other)
        return float(np.linalg.norm(predicted - torque) / np.linalg.norm(torque))

    for name, choices in PREPROCESSING.items():
        print(f"\n{name} preprocessing, {seeds} seeds")
        print(f"{'method':28}{'bias':>9}{'error':>9}{'bias/σ':>8}{'inside':>8}{'× ols':>8}", flush=True)
        seconds_ols = 0.0
        for method in methods:
            try:
                fits = [fitted(robot_file, noisy(exact, seed), choices, method) for seed in range(seeds)]
            except DynidError as refusal:
                print(f"{method:28}{refusal}", flush=True)
                continue
            errors = np.array([fit.parameters - truth for fit in fits])
            spread = np.maximum(errors.std(axis=0, ddof=1), np.finfo(float).tiny)
            ratio = np.sqrt(np.mean((errors.mean(axis=0) / spread) ** 2))
            inside = np.mean([np.abs(e) <= WITHIN_95_PERCENT * fit.std for e, fit in zip(errors, fits, strict=True)])
            seconds = float(np.median([fit.seconds for fit in fits]))
            seconds_ols = seconds_ols or seconds
            error = np.median([off(fit.parameters) for fit in fits])
            print(
                f"{method:28}{off(truth + errors.mean(axis=0)):9.3%}{error:9.3%}{ratio:8.2f}{inside:8.1%}"
                f"{seconds / seconds_ols:8.1f}",
                flush=True,
            )


def held_out(methods: Sequence[str], folder: Path) -> None:
    """Print the held-out errors of the public recordings."""
    recordings = public_recordings(folder)
    print(f"\n{'held-out error':28}" + "".join(f"{name:>10}" for name in recordings))
    for method in methods:
        line = ""
        for recording, preprocess in recordings.values():
            try:
                fit = identify([recording], [], IdentifyChoices(method, preprocess=preprocess))
                line += f"{fit.validation.relative_error:10.3%}"
            except DynidError as error:
                line += f"{'–':>10}"
                print(f"{method}: {error}", file=sys.stderr)
        print(f"{method:28}{line}", flush=True)


def main(seeds: int = 20, methods: Sequence[str] = (), *, controlled_only: bool = False) -> None:
    """Print the tables."""
    robot_file = load_robot("ur5e")
    if seeds > 1 and not controlled_only:
        compare(robot_file, exact_signals(robot_file), seeds, methods or METHODS)
    if seeds > 1:
        print("\nunder a controller, targets recorded")
        compare(robot_file, controlled_signals(robot_file), seeds, methods or (*METHODS, *TARGET_METHODS))
    if controlled_only:
        return
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    if folder.is_dir():
        held_out(methods or METHODS, folder)
    else:
        print(f"\nno public recordings: {folder} is no folder")


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 20,
        sys.argv[2].split(",") if len(sys.argv) > 2 else (),
        controlled_only=sys.argv[3:] == ["controlled"],
    )
