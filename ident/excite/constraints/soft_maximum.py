"""A smooth upper bound of the maximum of many values."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray


def soft_maximum(values: FloatArray, sharpness: float) -> tuple[FloatArray, FloatArray]:
    """(1/k)·log Σ exp(k·v) over the last axis, and its derivatives by the values.

    It lies between the maximum and the maximum + log(N)/k; no value is too large or too small for it.

    Args:
        values: (..., N), finite.
        sharpness: k > 0, in the inverse of the values' unit.

    Returns:
        The bound (...), and the derivatives (..., N): positive, of sum 1.
    """
    largest = values.max(axis=-1, keepdims=True)
    shares = np.exp(sharpness * (values - largest))
    total = shares.sum(axis=-1, keepdims=True)
    bound = largest + np.log(total) / sharpness
    return bound[..., 0], shares / total
