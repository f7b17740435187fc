"""`--method energy` and `power`: windows, equations, error bars, and the way through identify."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from sampled_arm import sampled
from true_results import truth_of

from daq.motion.trajectories import FourierSeries
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError, UsageError
from ident.assessment.plausibility import CLEARLY_SMALLER, critical_variance_ratio
from ident.estimators.energy_model import (
    OVERLAP,
    EnergyWindows,
    describe_windows,
    energy_jackknife,
    exchange_for,
    exchange_rate,
    moving_spans,
    reduce_energy,
    window_borders,
)
from ident.estimators.methods.power import PowerSamples
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.identify.revalidate import revalidate
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.energy import EnergyKernel
from ident.model.true_parameters import truth_vector
from ident.regression.comparison import compare_torques
from ident.regression.jackknife import FilteredRun
from ident.regression.least_squares import excited_columns, ordinary_least_squares
from ident.signals.filters import butterworth, no_filter
from ident.signals.pipeline import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_rows

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

METHODS = ("energy", "power")


@pytest.fixture(scope="module")
def perfect(noise_free) -> Recording:
    motion = random_fourier_motion(build_model(noise_free), 10.0, seed=1)
    return simulate_recording(noise_free, motion, 15.0, seed=1, rate=1000.0)


def recorded(robot_file, seed: int, seconds: float = 28.0) -> Recording:
    return simulate_recording(robot_file, motion_of(robot_file.text, seed), seconds, seed)


@functools.cache
def motion_of(text: str, seed: int) -> FourierSeries:
    model = build_model(parse_robot(text, where="arm", folder=None))
    return random_fourier_motion(model, 20.0, seed)


@pytest.fixture(scope="module")
def exact(three_joint, smooth_segment):
    model = build_model(three_joint)
    return model, smooth_segment(model, 3000, parameters=truth_vector(three_joint))


def equations_of(method: str, model, segments, duration: float = 0.2):
    kernel = EnergyKernel(model, base_parameters(model).columns)
    if method == "power":
        return PowerSamples(kernel)
    return EnergyWindows(kernel, exchange_for(model, segments, duration))


def test_windows_hold_the_same_exchange_and_lie_within_the_motion(exact):
    model, segment = exact
    used = segment.used.copy()
    used[:100] = used[1200:1350] = used[2900:] = False
    segment = replace(segment, used=used)
    exchange = exchange_for(model, [segment], 0.2)
    parts = moving_spans(segment)
    assert [(part.start, part.stop) for part in parts] == [(100, 1200), (1350, 2900)]
    rate = exchange_rate(model, segment)
    largest = np.max(rate) / segment.rate
    for part in parts:
        borders = window_borders(model, segment, part, exchange)
        assert borders[0] == part.start
        assert borders[-1] < part.stop
        held = [np.trapezoid(rate[a : b + 1]) / segment.rate for a, b in pairwise(borders[::OVERLAP])]
        assert np.allclose(held, exchange, rtol=0, atol=1.01 * largest)
        lengths = borders[OVERLAP:] - borders[:-OVERLAP]
        assert lengths.max() > 1.5 * lengths.min()  # slow where the arm turns
    count, duration = describe_windows(EnergyWindows(EnergyKernel(model), exchange), [segment])
    assert duration == pytest.approx(0.2, rel=0.1)
    assert count == pytest.approx(OVERLAP * used.sum() / segment.rate / 0.2, rel=0.1)


def test_nothing_is_exchanged_where_no_torque_acts(exact):
    model, segment = exact
    with pytest.raises(DataError, match="no energy is exchanged"):
        exchange_for(model, [replace(segment, torque=np.zeros_like(segment.torque))], 0.2)


@pytest.mark.parametrize("method", METHODS)
def test_equations_hold_for_the_true_parameters(exact, method, three_joint):
    """To the trapezoidal rule and the central difference at 100 Hz."""
    model, segment = exact
    equations = equations_of(method, model, [segment])
    truth = truth_of(three_joint)
    for parallel in (no_filter(), butterworth(5.0, 100.0, factor=4)):
        rows = list(equations.rows(segment, parallel))
        regressor = np.concatenate([part.regressor for part in rows], axis=1)
        work = np.concatenate([part.work for part in rows])
        sample = np.concatenate([part.sample for part in rows])
        assert len(work) == len(sample) == regressor.shape[1] > 100
        assert np.all(np.diff(sample) >= 0)
        assert sample[-1] < len(segment.used[:: parallel.factor])
        assert np.linalg.norm(truth @ regressor - work) < 4e-3 * np.linalg.norm(work)


def test_power_chunks_are_seamless(exact):
    """Longer than two chunks, against differences of the whole."""
    model, segment = exact
    names = ("position", "velocity", "acceleration", "torque")
    tiled = {name: np.tile(getattr(segment, name), 3) for name in names}
    long = replace(segment, time=np.arange(9000) / segment.rate, used=np.ones(9000, dtype=bool), **tiled)
    equations = equations_of("power", model, [long])
    rows = list(equations.rows(long, no_filter()))
    found = np.concatenate([part.regressor for part in rows], axis=1)
    expected = np.gradient(equations.kernel.energy(long.position, long.velocity), 1 / long.rate, axis=1, edge_order=2)
    expected[equations.kernel.friction_rows] = equations.kernel.friction_power(long.velocity)
    assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("method", METHODS)
def test_the_truth_comes_back_from_perfect_sensors(noise_free, perfect, method):
    found = identify([perfect], [], IdentifyChoices(method=method, search_delay=False))
    truth = truth_of(noise_free)
    size = np.maximum(np.abs(truth), 0.01 * np.max(np.abs(truth)))
    assert np.max(np.abs(found.solution.parameters - truth) / size) < 5e-3
    assert found.solution.method == method
    assert found.fit.relative_error < 1e-3
    assert found.validation.relative_error < 1e-3
    assert found.solution.active == tuple(range(found.base.count))


def test_energy_and_dynamic_model_agree_without_noise(perfect):
    models = [identify([perfect], [], IdentifyChoices(method=m, search_delay=False)) for m in ("wls", *METHODS)]
    dynamic = models[0].solution.parameters
    size = np.maximum(np.abs(dynamic), 0.01 * np.max(np.abs(dynamic)))
    for other in models[1:]:
        assert other.base.names == models[0].base.names
        assert np.max(np.abs(other.solution.parameters - dynamic) / size) < 5e-3


@pytest.fixture(scope="module")
def repeated(three_joint) -> Callable[[str], list[tuple[Recording, Identification]]]:
    """Makes identifications from five motions and noises, once per method."""

    @functools.cache
    def make(method: str) -> list[tuple[Recording, Identification]]:
        recordings = [recorded(three_joint, seed) for seed in range(5)]
        choices = IdentifyChoices(method=method, search_delay=False)
        return [(recording, identify([recording], [], choices)) for recording in recordings]

    return make


@pytest.mark.parametrize("method", METHODS)
def test_the_truth_is_within_the_error_bars(three_joint, repeated, method):
    """The jackknife is on the safe side where there are few equations per parameter."""
    truth = truth_of(three_joint)
    errors = [(found.solution.parameters - truth) / found.std for _, found in repeated(method)]
    assert 0.9 <= np.mean(np.abs(errors) < 1.96) <= 1.0
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.25
    assert all(found.validation.relative_error < 0.1 for _, found in repeated(method))


@pytest.mark.parametrize("method", METHODS)
def test_the_truth_is_within_the_error_bars_of_the_essential_model(three_joint, repeated, method):
    """The submodel's own deviations hold it less often: they know nothing of the selection."""
    held, by_submodel = [], []
    for _, found in repeated(method):
        truth = dict(zip(found.base.names, truth_of(three_joint), strict=True))
        for entry in found.result.base_parameters:
            if entry.essential_value is None:
                continue
            column = found.base.names.index(entry.name)
            own = found.pruned.solution.std[column] * found.std[column] / found.solution.std[column]
            error = abs(entry.essential_value - truth[entry.name])
            held.append(error <= 1.96 * entry.essential_std)
            by_submodel.append(error <= 1.96 * own)
    assert len(held) > 25
    assert np.mean(held) > 0.95
    assert np.mean(by_submodel) < 0.93


def test_the_wrist_of_a_coupled_closed_loop_arm():
    """SR400 .4.4: links 5 and 6 from the energy and from the dynamic model, the other joints locked."""
    robot_file = load_robot("sr400")
    model = build_model(robot_file)
    motion = random_fourier_motion(model, 20.0, seed=0, candidates=10)
    wrist = np.array([name in ("j5", "j6") for name in model.joint_names])[:, None]
    motion = replace(motion, sine=motion.sine * wrist, cosine=motion.cosine * wrist)
    recording = simulate_recording(robot_file, motion, 28.0, seed=0)
    choices = {method: IdentifyChoices(method=method, search_delay=False) for method in ("wls", "energy")}
    dynamic, energy = (identify([recording], [], chosen) for chosen in choices.values())
    truth = energy.base.projection @ truth_vector(robot_file)
    for name in ("MYR5", "Ia6", "Fs5", "Fv5", "Fsm6", "Fvm6", "Fs6", "Fv6"):
        place = energy.base.names.index(name)
        for found in (dynamic, energy):
            assert place in found.solution.active
            assert abs(found.solution.parameters[place] - truth[place]) < 4.0 * found.std[place], name


@pytest.mark.parametrize("method", METHODS)
def test_error_bars_are_the_jackknife_done_by_hand(exact, method):
    model, segment = exact
    noise = np.random.default_rng(1).standard_normal(segment.torque.shape)
    segment = replace(segment, torque=segment.torque + noise)
    equations = equations_of(method, model, [segment])
    reduction = reduce_energy(equations, [segment], no_filter())
    solution = ordinary_least_squares(reduction, excited_columns(reduction))
    series = compare_torques(model, equations.kernel.columns, solution.parameters, (segment,), no_filter())
    corrected = energy_jackknife(equations, [FilteredRun((segment,), no_filter(), series)], solution)
    rows = list(equations.rows(segment, no_filter()))
    W = np.concatenate([part.regressor for part in rows], axis=1).T
    work = np.concatenate([part.work for part in rows])
    number = np.concatenate([part.sample for part in rows]) // corrected.block_length
    assert len(np.unique(number)) == corrected.blocks
    scale = np.linalg.norm(W, axis=0)

    def fit(kept: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(W[kept] / scale, work[kept], rcond=None)[0] / scale

    everything = fit(np.ones(len(work), dtype=bool))
    assert np.allclose(everything, solution.parameters, rtol=1e-6)
    moves = np.array([fit(number != block) - everything for block in np.unique(number)])
    expected = (corrected.blocks - 1) / corrected.blocks * moves.T @ moves
    size = np.sqrt(np.diag(expected))
    assert np.allclose(corrected.covariance / np.outer(size, size), expected / np.outer(size, size), atol=1e-4)
    if method == "energy":  # a block is longer than a window, whose residuals overlap
        assert corrected.block_length > 0.2 * segment.rate


def test_a_repeated_motion_is_no_new_evidence(three_joint):
    model = build_model(three_joint)
    recording = simulate_recording(three_joint, random_fourier_motion(model, 10.0, seed=4), 48.0, seed=4)
    found = identify([recording], [], IdentifyChoices(method="energy", split=40.0, search_delay=False))
    assert found.corrected.repetitions == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("method", METHODS)
def test_result_is_complete_and_validates_again(three_joint, method, tmp_path):
    recording = recorded(three_joint, 1)
    found = identify([recording], [], IdentifyChoices(method=method, search_delay=False))
    result = found.result
    assert result.method == method
    assert len(result.residuals.joint_std) == len(result.residuals.autocorrelation) == 3
    assert result.residuals.joint_std == pytest.approx(result.fit.rmse)
    assert result.residuals.rows == found.solution.rows < len(result.joints) * found.fit.samples
    noted = [step for step in result.preprocessing if step.name == "energy windows"]
    assert len(noted) == (method == "energy")
    if noted:
        assert noted[0].settings["windows"] == found.solution.rows
    again = revalidate(result, recorded(three_joint, 2, 12.0))
    assert again.full.relative_error < 0.1


def test_recordings_stack_with_windows_of_the_same_exchange(three_joint):
    parts = [recorded(three_joint, seed, 14.0) for seed in (1, 2)]
    found = identify(parts, [], IdentifyChoices(method="energy", search_delay=False))
    notes = [run.prepared.steps[-1].settings for run in found.runs]
    assert notes[0]["exchange_j"] == notes[1]["exchange_j"]
    assert sum(int(note["windows"]) for note in notes) == found.solution.rows


def test_longer_windows_are_fewer(three_joint):
    recording = recorded(three_joint, 1)
    rows = [
        identify([recording], [], IdentifyChoices(f"energy:window={seconds}", search_delay=False)).solution.rows
        for seconds in (0.05, 0.2)
    ]
    assert rows[0] == pytest.approx(4 * rows[1], rel=0.1)


def test_windows_for_other_methods_are_refused():
    for method in ("wls:window=0.1", "power:window=0.1", "energy:window=0", "energy:window=-1", "energy:window=inf"):
        with pytest.raises(UsageError, match="window"):
            IdentifyChoices(method=method)


@pytest.mark.usefixtures("with_checks")
@pytest.mark.parametrize("method", METHODS)
def test_gravity_of_the_wrong_sign_is_warned_of(three_joint, method):
    """The noise is small: among much of it the energy's few equations cannot tell a wrong sign from chance."""
    quiet = three_joint.text.replace("{j1: 0.8, j2: 0.8, j3: 0.1}", "{j1: 0.1, j2: 0.1, j3: 0.02}")
    assert quiet != three_joint.text
    turned = quiet.replace("name: three_joint\nmodel:\n", "name: three_joint\nmodel:\n  gravity: [0, 0, 9.81]\n")
    recording = recorded(parse_robot(quiet, where="quiet", folder=None), 1)
    choices = IdentifyChoices(method=method, search_delay=False)
    right = identify([recording], [], choices)
    wrong = identify([recording], [], choices, parse_robot(turned, where="turned", folder=None))
    assert not any("opposite sign" in warning for warning in right.warnings)
    assert any("opposite sign" in warning for warning in wrong.warnings)


def test_luck_is_told_from_a_better_fit():
    shares = [critical_variance_ratio(freedom) for freedom in (0.5, 2, 10, 100, 1000, 1e9)]
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == CLEARLY_SMALLER
    assert 0.3 < critical_variance_ratio(20) < 0.4  # tables: F(0.99; 20, 20) = 2.94


@pytest.mark.parametrize("method", METHODS)
def test_a_gap_and_a_rest_are_no_trouble(three_joint, method):
    recording = recorded(three_joint, 3, 20.0)
    time = recording.streams[JOINTS_STREAM].time
    recording = with_rows(recording, (time < 8.0) | (time > 9.0))
    choices = IdentifyChoices(method=method, search_delay=False, preprocess=PreprocessChoices(torque_cutoff=5.0))
    found = identify([recording], [], choices)
    assert len(found.runs[0].prepared.segments) == 2
    assert found.validation.relative_error < 0.15


@pytest.mark.slow
def test_the_example_runs(capsys, monkeypatch):
    """On little data: each of its tables in small, the power model in the first; and what it is there to show."""
    example = importlib.import_module("studies.papers.energy_vs_dynamic")
    arm = sampled(load_robot("sr400"), 200.0)
    models = example.compare_parameters("wrist", arm, moves=8)
    assert [found.solution.method for found in models] == ["wls", *METHODS]
    assert all(len(found.solution.active) == 17 for found in models)
    monkeypatch.setattr(example, "METHODS", ("wls", "energy"))
    errors = example.compare_motions("whole arm", arm, 1, (24,))
    assert np.all(errors[0] < 1.5)  # many moves tell all parameters, five harmonics do not
    assert np.all(errors[1, 1:] > 5.0)
    table = example.compare_noise("wrist", arm, ("j5", "j6"), 16, 1, (0.0,))
    assert np.all(table < 10.0)
    assert "Fs6" in capsys.readouterr().out
