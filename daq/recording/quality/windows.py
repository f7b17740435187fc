"""Extremes of samples within a window that moves along with them."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

Scalar = TypeVar("Scalar", np.float64, np.bool_)


def least_within(values: npt.NDArray[Scalar], before: int, after: int) -> npt.NDArray[Scalar]:
    """Least (…, N) of each sample, the `before` ones that precede it and the `after` ones that follow, as there are.

    As `scipy.ndimage.minimum_filter1d`, whose import takes longer than the few passes over the samples.
    """
    least = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(before, after)], constant_values=np.inf)
    width = 1
    while width <= before + after:
        step = min(width, before + after + 1 - width)
        least = np.minimum(least[..., :-step], least[..., step:])
        width += step
    return least
