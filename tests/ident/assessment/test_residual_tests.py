"""The assumptions of least squares: residuals of a sound model pass, each deviation is recognised as what it is."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from each import each

from ident.assessment.residual_tests import LAGS, ResidualTests, filter_memory, residual_checks, residual_tests
from ident.regression.comparison import TorqueSeries
from ident.signals.filters import ZeroPhaseFilter, butterworth, chebyshev_decimation, no_filter

ASSUMPTIONS = ("linearity", "independence", "constant_variance", "normality")
FILTER = butterworth(10.0, 500.0, factor=10)
MEMORY = filter_memory(FILTER)


def motion(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Torque and velocity (N,) that never repeat."""
    time = np.arange(samples) / 50.0
    velocity = np.sin(1.1 * time) + 0.7 * np.cos(2.9 * time)
    return 20 * np.cos(1.7 * time) + 5 * np.sin(0.6 * time) + 3 * velocity, velocity


def series(residual: np.ndarray, used: np.ndarray | None = None) -> TorqueSeries:
    torque, velocity = motion(len(residual))
    every = np.ones(len(residual), dtype=bool) if used is None else used
    return TorqueSeries(np.arange(len(residual)) / 50.0, (torque + residual)[None], torque[None], velocity[None], every)


def judged(residual: np.ndarray, memory: int = 1) -> ResidualTests:
    part = series(residual)
    (test,) = residual_tests([part], [part.counted], memory, {0: "elbow"})
    return test


def violated(test: ResidualTests) -> set[str]:
    of_joint = {assumption: getattr(test, assumption) for assumption in ASSUMPTIONS}
    return {assumption for assumption, one in of_joint.items() if one is not None and one.violated}


def white(samples: int = 3000, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(samples)


def filtered_white(samples: int = 3000, seed: int = 0) -> np.ndarray:
    # An odd extension passes the noise of the first and the last sample unfiltered: no identification uses the ends.
    return FILTER.apply(white(10 * (samples + 40), seed)[None])[0, 20:-20]


@pytest.mark.parametrize("zero_phase", [FILTER, butterworth(20.0, 500.0, factor=5), chebyshev_decimation(10)])
def test_white_noise_is_forgotten_after_the_memory_of_the_filter(zero_phase: ZeroPhaseFilter) -> None:
    memory = filter_memory(zero_phase)
    noise = zero_phase.apply(white(300_000)[None])[0]
    correlation = [np.mean(noise[lag:] * noise[: len(noise) - lag]) / noise.var() for lag in (1, memory, 2 * memory)]
    assert abs(correlation[0]) > 0.1
    assert np.abs(correlation[1:]).max() < 0.1


def test_no_filter_has_no_memory() -> None:
    assert filter_memory(no_filter(4)) == 1


@functools.cache
def judged_white_noise() -> tuple[ResidualTests, ...]:
    return tuple(judged(filtered_white(1200, seed), MEMORY) for seed in range(100))


@pytest.mark.parametrize("name", ASSUMPTIONS)
def test_level_of_each_test_on_filtered_white_noise(name: str) -> None:
    """p-values of true hypotheses are uniform."""
    tests = [getattr(test, name) for test in judged_white_noise()]
    p_values = np.array([test.p_value for test in tests])
    assert np.mean(p_values < 0.1) < 0.25
    assert np.mean(p_values < 0.5) > 0.3
    assert not any(test.violated for test in tests[:20])


def test_residuals_of_a_real_model_lie_apart() -> None:
    test = judged(filtered_white(), MEMORY)
    assert test.residuals == 3000
    assert 3000 / 8 < test.independent <= 3000 / MEMORY


DEVIATIONS = {
    "linearity": lambda torque, velocity: white() + 1.5 * np.sign(velocity) * np.exp(-((velocity / 0.3) ** 2)),
    "linearity of torque": lambda torque, velocity: white() + 0.002 * torque**2,
    "independence": lambda torque, velocity: white() + np.sin(0.37 * np.arange(3000)),
    "constant_variance": lambda torque, velocity: white() * (0.3 + np.abs(velocity)),
    "constant_variance of torque": lambda torque, velocity: white() * (1.0 + 0.2 * np.abs(torque)),
    "normality": lambda torque, velocity: np.random.default_rng(0).standard_t(3, 3000),
    "normality, skewed": lambda torque, velocity: np.random.default_rng(0).exponential(size=3000),
}


@each("name", DEVIATIONS)
def test_each_deviation_is_recognised(name: str) -> None:
    residual = DEVIATIONS[name](*motion(3000))
    assumption = name.split()[0].rstrip(",")
    found = violated(judged(residual))
    assert assumption in found
    if assumption in ("independence", "normality"):
        assert found == {assumption}
    (note,) = [one for one in residual_checks([judged(residual)]) if one.joints == ("elbow",)][:1]
    assert note.severity == "note"


def test_a_small_deviation_is_significant_but_violates_nothing() -> None:
    """Effect sizes beside p-values: with enough samples every arm rejects everything."""
    samples = 200_000
    torque, _ = motion(samples)
    test = judged(white(samples) + 1e-3 * torque**2)
    assert test.linearity.p_value < 1e-6
    assert violated(test) == set()


def test_autocorrelated_residuals_do_not_look_uneven_or_bent() -> None:
    """Tests that take every sample for independent reject these; the spacing keeps them at their level."""
    found = 0
    for seed in range(20):
        noise = white(3000, seed)
        for index in range(1, 3000):
            noise[index] += 0.95 * noise[index - 1]
        found += bool(violated(judged(noise)) & {"linearity", "constant_variance", "normality"})
    assert found <= 1


def test_gaps_and_samples_that_are_left_out_count_for_nothing() -> None:
    used = np.ones(2000, dtype=bool)
    used[300:500] = False
    parts = [series(np.where(used, white(2000), 1e6), used), series(white(1000, seed=1))]
    (test,) = residual_tests(parts, [part.counted for part in parts], 1, {0: "elbow"})
    assert test.residuals == 2800
    assert violated(test) == set()


@pytest.mark.parametrize("residual", [np.zeros(3000), white(30)], ids=["exact fit", "few"])
def test_nothing_to_test(residual: np.ndarray) -> None:
    part = series(residual)
    assert residual_tests([part], [part.counted], 1, {0: "elbow"}) == []


def test_a_record_shorter_than_the_lags() -> None:
    parts = [series(white(LAGS - 2, seed)) for seed in range(12)]
    (test,) = residual_tests(parts, [part.counted for part in parts], 1, {0: "elbow"})
    assert np.isfinite(test.independence.statistic)


def test_a_joint_at_rest() -> None:
    torque, _ = motion(3000)
    part = TorqueSeries(
        np.arange(3000) / 50.0, (torque + white())[None], torque[None], np.zeros((1, 3000)), np.ones(3000, dtype=bool)
    )
    (test,) = residual_tests([part], [part.counted], 1, {0: "elbow"})
    assert violated(test) == set()


def test_where_too_few_are_independent_only_independence_is_tested() -> None:
    test = judged(np.sin(0.002 * np.arange(3000)) + 0.1 * white())
    assert violated(test) == {"independence"}
    assert test.independent < 40
    assert (test.linearity, test.constant_variance, test.normality) == (None, None, None)


def test_checks_name_the_worst_joint_and_the_others() -> None:
    parts = judged(white() + np.sin(0.37 * np.arange(3000))), judged(white() + 3 * np.sin(0.37 * np.arange(3000)))
    tests = [parts[0], replace(parts[1], joint="wrist")]
    (check,) = [one for one in residual_checks(tests) if one.name == "residuals-autocorrelated"]
    assert check.text.startswith("residuals of wrist are autocorrelated")
    assert check.text.endswith("; also elbow")
    assert check.joints == ("elbow", "wrist")
