"""Derivatives of the regressor against finite differences."""

from __future__ import annotations

import numpy as np

from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.model.regressor_gradient import pull_back_regressor

STEP = 1e-6


def check_gradient(model: DynamicModel, motion: np.ndarray, seed: int, tolerance: float) -> None:
    """Compare the gradient of a combination of regressor entries along a motion (3, n, N) with finite differences.

    The tolerance counts relative to the largest derivative, at least 1.
    """
    kernel = RegressorKernel(model, chunk=motion.shape[2] + seed % 3)
    packed = np.empty((kernel.row_count, motion.shape[2]))
    weights = np.random.default_rng(seed).standard_normal(packed.shape)

    def total(motion: np.ndarray) -> np.ndarray:
        kernel.evaluate(*motion, packed)
        return np.einsum("rN,rN->N", weights, packed)

    total(motion)
    gradient = pull_back_regressor(kernel, *motion, weights)
    for kind in range(3):
        for joint in range(model.dof):
            ahead, behind = motion.copy(), motion.copy()
            ahead[kind, joint] += STEP
            behind[kind, joint] -= STEP
            difference = (total(ahead) - total(behind)) / (2 * STEP)
            atol = tolerance * (1.0 + np.abs(gradient).max())
            np.testing.assert_allclose(gradient[kind, joint], difference, atol=atol)
