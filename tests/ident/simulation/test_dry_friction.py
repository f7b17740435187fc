"""Dry friction of a step keeps its law, whatever the coupling of the joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ident.simulation.dry_friction import dry_friction, quick_dry_friction

GUESSES = ("random", "none", "limits", "far")


def violation(matrix, free, limit, torque) -> float:
    """Largest velocity that the law forbids, as a share of |u_free| + |W|·f of its direction; inf outside the box.

    Within its limit λ must leave no velocity, at a limit none that opposes it.
    """
    velocity = free - matrix @ torque
    at_limit = np.abs(torque) == limit
    forbidden = np.where(at_limit, np.maximum(0.0, -velocity * np.sign(torque)), np.abs(velocity))
    forbidden[np.abs(torque) > limit] = np.inf
    scale = np.abs(free) + np.abs(matrix) @ limit
    return float(np.max(np.divide(forbidden, scale, out=np.zeros_like(scale), where=forbidden > 0.0)))


def guessed(kind: str, limit, generator) -> np.ndarray:
    """A guess of λ (m,), good or bad."""
    count = len(limit)
    if kind == "random":
        return generator.uniform(-1.0, 1.0, count) * limit
    if kind == "limits":
        return generator.choice([-1.0, 1.0], count) * limit
    return np.zeros(count) if kind == "none" else 100.0 * generator.normal(size=count) * limit


@given(
    count=st.integers(1, 8),
    rank=st.integers(1, 8),
    size=st.floats(-3, 3),
    spread=st.floats(0, 4),
    guess=st.sampled_from(GUESSES),
    seed=st.integers(0, 2**32 - 1),
)
@example(count=7, rank=4, size=0.0, spread=0.0, guess="random", seed=34129)  # a method that cycled ended here
@example(count=4, rank=8, size=0.0, spread=0.0, guess="none", seed=1)
def test_the_law_holds(count: int, rank: int, size: float, spread: float, guess: str, seed: int) -> None:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, rank))
    free = directions @ generator.normal(size=rank)
    limit = 10.0**size * generator.uniform(0.01, 1.0, count)
    start = guessed(guess, limit, generator)
    unit = 10.0 ** generator.uniform(-spread, spread, count)  # metres beside radians, a wrist beside a base
    matrix = (unit[:, None] * directions) @ (unit[:, None] * directions).T  # singular where count > rank
    for solve in (dry_friction, quick_dry_friction):
        found = solve(matrix, unit * free, limit / unit, start / unit)
        assert violation(matrix, unit * free, limit / unit, found) <= 1e-12


@given(count=st.integers(2, 8), near=st.floats(-16, -4), seed=st.integers(0, 2**32 - 1))
def test_nearly_dependent_directions_keep_it_too(count: int, near: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, count))
    directions[-1] = directions[0] + 10.0**near * directions[-1]
    matrix, limit = directions @ directions.T, generator.uniform(0.01, 1.0, count)
    free = generator.normal(size=count)
    for solve in (dry_friction, quick_dry_friction):
        assert violation(matrix, free, limit, solve(matrix, free, limit, np.zeros(count))) <= 1e-12


def test_a_good_guess_is_kept():
    matrix, free, limit = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([0.3, 5.0]), np.array([1.0, 1.0])
    found = dry_friction(matrix, free, limit, np.zeros(2))
    assert found == pytest.approx([-0.35, 1.0], abs=1e-15)
    assert np.array_equal(dry_friction(matrix, free, limit, found), found)
