"""Ways to q̇, q̈ and a smooth torque compared (docs/measurements/signals.md).

    python -m studies.signals.differentiation ../shared/data

1. Gain of q, q̇ and q̈ and phase of q̇ of each way, at its cut-off of 20 Hz at 500 Hz, as measured on sinusoids.
2. Root mean square errors of q̇, q̈ and τ of the simulated ROCR6, whose true motion and torque are known (as figure 2 of
   its paper compares torques), with the encoder's resolution alone and with white noise on the positions.
3. Held-out error, and the share of the 95 % intervals that hold the truth, of simulated arms, another motion held out.
4. Fit and held-out error of the public recordings, all options at their defaults but --differentiation, and the
   processor time of the identification.
"""

from __future__ import annotations

import os
import sys
import time as clock
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.signals.filters import butterworth
from ident.signals.joint_signals import JointSignals, read_joint_signals
from ident.signals.options import Differentiation, PreprocessChoices
from ident.signals.pipeline import prepare
from ident.signals.smoothing.five_point import five_point_cubic, passes_for
from ident.signals.smoothing.kalman import WHITE_CURVATURE, kalman_smoother, likeliest_cutoff
from ident.signals.smoothing.savitzky_golay import half_width_for, savitzky_golay
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks.mistaken_recordings import arms
from studies.synthetic.data_mistakes import with_values

WAYS: tuple[Differentiation, ...] = get_args(Differentiation)
SEEDS = (1, 2, 3)
DURATION = 30.0
MARGIN = 1.0
"""Left out at both ends of the signals of the first two tables [s]."""
TORQUE_CUTOFF = 20.0


def responses() -> None:
    """The first table."""
    rate, cutoff = 500.0, 20.0
    time = np.arange(round(20 * rate)) / rate
    inside = slice(round(5 * rate), -round(5 * rate))
    print("| way | f [Hz] | gain of q | of q̇ | of q̈ | phase of q̇ [°] |\n|---|---|---|---|---|---|")
    for way in WAYS:
        for frequency in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0):
            angular = 2 * np.pi * frequency
            position = np.sin(angular * time)
            motion = _motion_of(position, rate, cutoff, way)
            waves = np.exp(1j * angular * time[inside])
            amplitudes = [2 * np.mean(row[inside] * waves.conj()) for row in motion]
            exact = [-1j * (1j * angular) ** order for order in range(3)]
            ratio = [amplitude / one for amplitude, one in zip(amplitudes, exact, strict=True)]
            gains = " | ".join(f"{abs(value):.4f}" for value in ratio)
            print(f"| {way} | {frequency:g} | {gains} | {np.degrees(np.angle(ratio[1])):.1f} |")


def _motion_of(position: FloatArray, rate: float, cutoff: float, way: str) -> FloatArray:
    """(3, N) q, q̇, q̈ of one signal (N,)."""
    if way == "kalman":
        return kalman_smoother(position, rate, cutoff)[:3]
    if way == "savitzky-golay":
        smooth = savitzky_golay(position[None], rate, half_width_for(cutoff, rate, len(position)))
        return np.stack([rows[0] for rows in smooth])
    if way == "five-point":
        smooth_position = five_point_cubic(position[None], passes_for(cutoff, rate))[0]
    else:
        smooth_position = butterworth(cutoff, rate).apply(position[None])[0]
    velocity = np.gradient(smooth_position, 1 / rate, edge_order=2)
    return np.stack([smooth_position, velocity, np.gradient(velocity, 1 / rate, edge_order=2)])


def known_truth() -> None:
    """The second table, of q̇ and q̈ by the pipeline and of torques smoothed alone."""
    robot_file = load_robot("rocr6")
    model, truth = build_model(robot_file), truth_vector(robot_file)
    choices = {"kalman, cut-off of butterworth": PreprocessChoices(differentiation="kalman")}
    choices = {way: PreprocessChoices(differentiation=way) for way in WAYS} | choices
    print("\n| position noise [rad] | way | cut-off [Hz] | q̇ [mrad/s] | q̈ [mrad/s²] |\n|---|---|---|---|---|")
    torques: dict[str, list[tuple[float, float]]] = {}
    for noise in (0.0, 2e-5, 2e-4):
        errors: dict[str, list[tuple[float, float]]] = {way: [] for way in choices}
        cutoffs: dict[str, str] = {}
        for seed in SEEDS:
            motion = random_fourier_motion(model, 10.0, seed)
            recording = simulate_recording(robot_file, motion, DURATION, seed, rate=500.0)
            signals = read_joint_signals(recording, robot_file.robot)
            generator = np.random.default_rng(100 + seed)
            noisy = signals.position + noise * generator.standard_normal(signals.position.shape)
            signals = replace(signals, position=noisy)
            usual = prepare(signals, PreprocessChoices()).cutoffs.position
            for way, chosen in choices.items():
                with_cutoff = replace(chosen, position_cutoff=usual) if "cut-off" in way else chosen
                prepared = prepare(signals, with_cutoff)
                cutoffs[way] = _cutoff_text(prepared.choices.joint_cutoffs, prepared.cutoffs.position)
                (segment,) = prepared.segments
                inside = slice(round(MARGIN * segment.rate), -round(MARGIN * segment.rate))
                exact = motion.evaluate(segment.time)
                errors[way].append(
                    (
                        _rms(segment.velocity[:, inside] - exact[1][:, inside]),
                        _rms(segment.acceleration[:, inside] - exact[2][:, inside]),
                    )
                )
            if noise == 0.0:
                clean = model_torque(model, None, truth, *motion.evaluate(signals.time))
                reversing = np.diff(np.sign(motion.evaluate(signals.time)[1]), axis=1, append=0) != 0
                near = np.stack([np.convolve(row, np.ones(101), mode="same") > 0 for row in reversing])
                inside = slice(round(MARGIN * 500), -round(MARGIN * 500))
                for way, smooth in _torque_ways(signals, prepare(signals, PreprocessChoices()).cutoffs.band).items():
                    error = (smooth - clean)[:, inside]
                    torques.setdefault(way, []).append((_rms(error), _rms(error[~near[:, inside]])))
        for way, pairs in errors.items():
            velocity, acceleration = 1e3 * np.sqrt(np.mean(np.square(pairs), axis=0))
            print(f"| {noise:g} | {way} | {cutoffs[way]} | {velocity:.3f} | {acceleration:.2f} |", flush=True)
    print("\n| way | error of τ, RMS [N·m] | farther than 0.1 s from velocity reversals |\n|---|---|---|")
    for way, values in torques.items():
        everywhere, far = np.sqrt(np.mean(np.square(values), axis=0))
        print(f"| {way} | {everywhere:.3f} | {far:.3f} |")


def _cutoff_text(joint_cutoffs: Sequence[float] | None, cutoff: float) -> str:
    if joint_cutoffs is None or min(joint_cutoffs) == max(joint_cutoffs):
        return f"{cutoff:.3g}"
    return f"{min(joint_cutoffs):.3g} to {max(joint_cutoffs):.3g}"


def _torque_ways(signals: JointSignals, band: float) -> dict[str, FloatArray]:
    """Torques (n, N) smoothed in each way."""
    rows, rate = signals.torque.T, 500.0
    cutoffs = [likeliest_cutoff(row, rate, WHITE_CURVATURE, 2 * band) for row in rows]
    print("cut-offs of torque [Hz]:", ", ".join(f"{cutoff:.2f}" for cutoff in cutoffs))
    smoothed = [kalman_smoother(row, rate, own, WHITE_CURVATURE)[0] for row, own in zip(rows, cutoffs, strict=True)]
    return {
        "as measured": rows,
        f"butterworth {TORQUE_CUTOFF:g} Hz": butterworth(TORQUE_CUTOFF, rate).apply(rows),
        f"five-point, {passes_for(TORQUE_CUTOFF, rate)} passes": five_point_cubic(
            rows, passes_for(TORQUE_CUTOFF, rate)
        ),
        "savitzky-golay": savitzky_golay(rows, rate, half_width_for(TORQUE_CUTOFF, rate, rows.shape[1]))[0],
        "kalman": np.stack(smoothed),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def public_recordings(folder: Path) -> None:
    """The fourth table."""
    print("\n| arm | way | cut-off [Hz] | fit [%] | held out [%] | processor time [s] |\n|---|---|---|---|---|---|")
    for name, text, path, choices in arms(folder):
        robot_file = parse_robot(text, where=name, folder=folder)
        recording = import_file(path, robot_file, ImportChoices())
        assert JOINTS_STREAM in recording.streams
        for way in WAYS:
            chosen = replace(choices, preprocess=replace(choices.preprocess, differentiation=way))
            start = clock.process_time()
            identification = identify([recording], [], chosen)
            seconds = clock.process_time() - start
            prepared = identification.runs[0].prepared
            errors = (
                f"{100 * identification.fit.relative_error:.2f} | {100 * identification.validation.relative_error:.2f}"
            )
            cutoff = _cutoff_text(prepared.choices.joint_cutoffs, prepared.cutoffs.position)
            print(f"| {name} | {way} | {cutoff} | {errors} | {seconds:.1f} |", flush=True)


def simulated_identifications() -> None:
    """The third table."""
    columns = ("arm", "white noise [rad]", "way", "held out [%]", "intervals with the truth [%]", "median σ")
    print(f"\n| {' | '.join(columns)} |\n{len(columns) * '|---'}|")
    for robot in ("ur5e", "rocr6", "panda"):
        robot_file = load_robot(robot)
        model = build_model(robot_file)
        for noise in (0.0, 5e-5):
            for way in WAYS:
                held_out, deviations = [], []
                inside: list[bool] = []
                for seed in SEEDS:
                    runs = []
                    for part in (seed, seed + 10):
                        motion = random_fourier_motion(model, 10.0, part, candidates=5)
                        runs.append(
                            _noisy(simulate_recording(robot_file, motion, DURATION, part, rate=500.0), noise, part)
                        )
                    plain = ModelChoices(friction="coulomb-viscous")
                    choices = IdentifyChoices(preprocess=PreprocessChoices(differentiation=way), model=plain)
                    identification = identify(runs[:1], runs[1:], choices)
                    true = identification.base.projection @ truth_vector(robot_file)
                    used = list(identification.solution.active)
                    errors = (identification.solution.parameters - true)[used] / identification.std[used]
                    held_out.append(identification.validation.relative_error)
                    inside.extend(np.abs(errors) < WITHIN_95_PERCENT)
                    deviations.append(np.median(identification.std[used]))
                figures = f"{100 * np.mean(held_out):.3f} | {100 * np.mean(inside):.0f} | {np.mean(deviations):.3g}"
                print(f"| {robot} | {noise:g} | {way} | {figures} |", flush=True)


def _noisy(recording: Recording, noise: float, seed: int) -> Recording:
    """The recording with white noise on its positions."""
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    added = noise * np.random.default_rng(100 + seed).standard_normal(position.shape)
    return with_values(recording, position=position + added)


if __name__ == "__main__":
    responses()
    known_truth()
    simulated_identifications()
    if len(sys.argv) > 1:
        public_recordings(Path(sys.argv[1]))
