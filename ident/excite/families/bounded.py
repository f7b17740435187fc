"""Variables without bounds for values that lie between two."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray

_INMOST = 1.0 - 1e-4


def to_share(variables: FloatArray) -> FloatArray:
    """Places between −1 and 1 for any variables: their sine, whose slope is that of the variable in the middle.

    The sine reaches both ends, where it turns back; its slope there vanishes more slowly than that of a sigmoid.
    """
    return np.sin(variables)


def from_share(share: FloatArray) -> FloatArray:
    """Variables between −π/2 and π/2 for places between −1 and 1.

    Places at the very ends are moved inwards by 1e-4, so that a local search sees a slope there.
    """
    return np.arcsin(np.clip(share, -_INMOST, _INMOST))
