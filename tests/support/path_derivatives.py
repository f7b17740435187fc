"""Checks of an excitation constraint on random paths: its bound and its derivatives."""

from __future__ import annotations

import numpy as np

from ident.excite.path import JointPath
from ident.model.dynamic_model import DynamicModel

STEP = 1e-6


def random_path(model: DynamicModel, seed: int = 0, count: int = 7, size: float = 2.0) -> JointPath:
    """Positions, velocities and accelerations without any relation to each other."""
    state = np.random.default_rng(seed).uniform(-size, size, (3, model.dof, count))
    return JointPath(np.arange(count, dtype=float), *state)


def assert_derivatives(constraint, path: JointPath, sharpness: float, *, tolerance: float = 1e-5) -> None:
    """smooth_use's derivatives against central differences along random directions and for single entries."""
    generator = np.random.default_rng(0)
    bound, gradient = constraint.smooth_use(path, sharpness)
    state = np.array([path.position, path.velocity, path.acceleration])
    assert bound.shape == (len(constraint.names),)
    assert gradient.shape == (len(bound), *state.shape)
    directions = []
    for quantity in range(3):
        whole = np.zeros_like(state)
        whole[quantity] = generator.standard_normal(state.shape[1:])
        single = np.zeros_like(state)
        single[quantity, generator.integers(state.shape[1]), generator.integers(state.shape[2])] = 1.0
        directions += [whole, single]
    for direction in directions:
        above, below = (
            constraint.smooth_use(JointPath(path.time, *(state + sign * STEP * direction)), sharpness)[0]
            for sign in (1.0, -1.0)
        )
        along = np.einsum("mqnt,qnt->m", gradient, direction)
        assert np.allclose((above - below) / (2 * STEP), along, rtol=tolerance, atol=tolerance * max(1.0, sharpness))


def assert_upper_bound(constraint, path: JointPath) -> None:
    """The smooth bound lies above the use and comes close to it as the sharpness grows."""
    use = constraint.use(path)
    excess = [constraint.smooth_use(path, sharpness)[0] - use for sharpness in (5.0, 50.0, 5e4)]
    assert all(np.all(bound >= -1e-12) for bound in excess)
    assert np.all(excess[0] >= excess[1] - 1e-12)
    assert np.all(excess[2] < 1e-3)
