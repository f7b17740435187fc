"""Null vectors of systems whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.core.errors import IdentificationError
from ident.linear_algebra.triangular import triangular
from ident.regression.total_least_squares import null_vector, null_vector_of_gram, signal_noise

GAINS = np.array([12.0, -7.0, 3.0])
UNKNOWNS = np.array([0.4, -2.0, 1.5, 0.7, 1.0])
ROWS = np.full(3, 400.0)


def system(noise: float, seed: int = 0):
    """Factors of three blocks, and the noise of their signals."""
    generator = np.random.default_rng(seed)
    factors = []
    for gain in GAINS:
        columns = generator.standard_normal((400, 5))
        signal = columns @ UNKNOWNS / gain + noise * generator.standard_normal(400)
        factors.append(triangular(np.column_stack([columns, signal])))
    return factors


def test_without_noise_it_is_exact():
    factors = system(0.0)
    found = null_vector(factors, ROWS, np.ones(3))
    assert found.factors == pytest.approx(GAINS, rel=1e-7)
    assert found.unknowns == pytest.approx(UNKNOWNS, rel=1e-7)


def test_noise_is_found_without_the_gains():
    assert signal_noise(system(0.05), ROWS) == pytest.approx(0.05, rel=0.15)


def test_noise_of_dependent_columns():
    columns = np.random.default_rng(1).standard_normal((300, 3))
    signal = columns @ [1.0, 2.0, 3.0] + 0.1 * np.random.default_rng(2).standard_normal(300)
    plain = signal_noise([triangular(np.column_stack([columns, signal]))], np.array([300.0]))
    doubled = signal_noise([triangular(np.column_stack([columns, columns[:, :1], signal]))], np.array([300.0]))
    assert doubled == pytest.approx(plain, rel=1e-6)


def test_noise_does_not_draw_the_gains_to_one_side():
    """The mean over many seeds lies at the truth, although the signals' noise is a tenth of their unit."""
    found = []
    for seed in range(40):
        factors = system(0.1, seed)
        found.append(null_vector(factors, ROWS, signal_noise(factors, ROWS)).factors)
    mean, spread = np.mean(found, axis=0), np.std(found, axis=0) / np.sqrt(len(found))
    assert np.all(np.abs(mean - GAINS) < 4 * spread)
    assert np.all(spread < 0.02 * np.abs(GAINS))


def test_the_smallest_singular_value_is_one_where_the_model_is_right():
    factors = system(0.02)
    found = null_vector(factors, ROWS, signal_noise(factors, ROWS))
    assert found.singular[-1] == pytest.approx(1.0, abs=0.15)
    assert found.gap > 10


def test_the_gram_matrix_gives_the_same():
    factors = system(0.02)
    found = null_vector(factors, ROWS, signal_noise(factors, ROWS))
    gram = np.zeros((8, 8))
    for number, (factor, weight) in enumerate(zip(factors, found.weights, strict=True)):
        place = [*range(5), 5 + number]
        gram[np.ix_(place, place)] += weight**2 * factor.T @ factor
    gains, unknowns = null_vector_of_gram(gram, found.scale)
    assert gains == pytest.approx(found.factors, rel=1e-8)
    assert unknowns == pytest.approx(found.unknowns, rel=1e-8)


def test_a_signal_that_is_zero_is_refused():
    factors = system(0.02)
    factors[1][:, -1] = 0.0
    with pytest.raises(IdentificationError, match="signal 2 is zero"):
        null_vector(factors, ROWS, signal_noise(factors, ROWS))


def test_dependent_columns_are_refused():
    factors = [np.column_stack([factor[:, :1], factor]) for factor in system(0.02)]
    with pytest.raises(IdentificationError, match="linearly dependent"):
        null_vector(factors, ROWS, np.full(3, 0.02))
