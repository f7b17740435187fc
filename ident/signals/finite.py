"""Signals are numbers throughout, or they are refused with the place of the first that is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.errors import DataError
from drivers.streams import FloatArray


def check_finite(quantity: str, values: FloatArray, joints: Sequence[str], label: str = "") -> None:
    """Refuse a signal with something that is not a number.

    Args:
        quantity: what messages call the signal.
        values: (N, n), a column each joint.
        joints: (n,) names.
        label: what messages call the recording.

    Raises:
        DataError: naming the first bad sample and its joint.
    """
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        sample, joint = bad[0]
        recording = f"{label}: " if label else ""
        raise DataError(
            f"{len(bad)} value(s) are not numbers, the first at sample {sample}",
            where=f"{recording}{quantity} of {joints[joint]}",
            hint="import the source again with --repair drop-nan",
        )
