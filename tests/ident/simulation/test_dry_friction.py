"""Dry friction of a step keeps its law, whatever the coupling of the joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.simulation import dry_friction as module
from ident.simulation.dry_friction import dry_friction


def keeps_the_law(matrix, free, limit, torque) -> None:
    """λ within the box; where it is not at the limit the velocity is 0, at the limit it does not oppose λ."""
    velocity = free - matrix @ torque
    scale = np.abs(free).max() + np.abs(matrix @ limit).max()
    assert np.all(np.abs(torque) <= limit * (1 + 1e-9))
    inside = np.abs(torque) < limit * (1 - 1e-6)
    assert np.all(np.abs(velocity[inside]) <= 1e-7 * scale)
    assert np.all((velocity * np.sign(torque))[~inside] >= -1e-7 * scale)


@given(count=st.integers(1, 8), rank=st.integers(1, 8), size=st.floats(-3, 3), seed=st.integers(0, 2**32 - 1))
def test_the_law_holds(count: int, rank: int, size: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, rank))
    matrix = directions @ directions.T  # singular where there are more directions than joints
    free = directions @ generator.normal(size=rank)
    limit = 10.0**size * generator.uniform(0.01, 1.0, count)
    guess = generator.uniform(-1.0, 1.0, count) * limit
    keeps_the_law(matrix, free, limit, dry_friction(matrix, free, limit, guess))


def test_the_sweeps_keep_the_law_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CHANGES", 0)
    generator = np.random.default_rng(1)
    root = np.eye(4) + 0.3 * generator.normal(size=(4, 4))
    matrix, free, limit = root @ root.T, generator.normal(size=4), np.array([0.1, 0.2, 0.5, 3.0])
    keeps_the_law(matrix, free, limit, dry_friction(matrix, free, limit, np.zeros(4)))
