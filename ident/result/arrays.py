"""Arrays at the public border: (N, n) outside, (n, N) within; a single sample (n,) goes in and out as such."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError


def samples(names: Sequence[str], **given: npt.ArrayLike) -> tuple[tuple[FloatArray, ...], bool]:
    """The signals as arrays (n, N), and whether a single sample was given.

    Args:
        names: of the n joints.
        given: signal → (N, n) or (n,); all of one shape.

    Raises:
        DataError: not numbers, other shapes, NaN or infinite values; names signal, sample and joint.
    """
    arrays: list[FloatArray] = []
    shape: tuple[int, ...] | None = None
    for name, values in given.items():
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise DataError("does not consist of numbers", where=name) from error
        if array.ndim not in (1, 2) or array.shape[-1] != len(names):
            raise DataError(
                f"has shape {array.shape}; ({len(names)},) or (N, {len(names)}) is needed",
                where=name,
                hint=f"joints in the order {', '.join(names)}; time first, joints last",
            )
        if shape is not None and array.shape != shape:
            raise DataError(f"has shape {array.shape}, {next(iter(given))} has {shape}", where=name)
        shape = array.shape
        if not np.isfinite(array).all():
            sample, joint = np.argwhere(~np.isfinite(np.atleast_2d(array)))[0]
            raise DataError(f"is not finite at sample {sample}, joint {names[joint]}", where=name)
        arrays.append(np.ascontiguousarray(np.atleast_2d(array).T))
    return tuple(arrays), shape is not None and len(shape) == 1


def outward(values: FloatArray, *, single: bool) -> FloatArray:
    """(n, N) as the public border has it: (N, n), or (n,) of a single sample."""
    return np.ascontiguousarray(values[:, 0] if single else values.T)
