"""Arrays at the public border: (N, n) outside, (n, N) within; a single sample (n,) goes in and out as such."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError


def samples(names: Sequence[str], **given: npt.ArrayLike | None) -> tuple[tuple[FloatArray, ...], bool]:
    """The signals as arrays (n, N), and whether all of them were single samples.

    Args:
        names: of the n joints.
        given: signal → (N, n), or (n,) for each of the N samples; None for zeros.

    Raises:
        DataError: not numbers, other shapes, NaN or infinite values; names signal, sample and joint.
    """
    arrays: list[FloatArray] = []
    count, longest = 1, ""
    for name, values in given.items():
        array = numbers(name, np.zeros(len(names)) if values is None else values)
        if array.ndim not in (1, 2) or array.shape[-1] != len(names):
            raise DataError(
                f"has shape {array.shape}; ({len(names)},) or (N, {len(names)}) is needed",
                where=name,
                hint=f"joints in the order {', '.join(names)}; time first, joints last",
            )
        if array.ndim == 2:
            if longest and len(array) != count:
                raise DataError(f"has shape {array.shape}, {longest} has {(count, len(names))}", where=name)
            count, longest = len(array), longest or name
        if not np.isfinite(array).all():
            sample, joint = np.argwhere(~np.isfinite(np.atleast_2d(array)))[0]
            raise DataError(f"is not finite at sample {sample}, joint {names[joint]}", where=name)
        arrays.append(array)
    shape = count, len(names)
    return tuple(np.ascontiguousarray(np.broadcast_to(array, shape).T) for array in arrays), not longest


def numbers(name: str, values: npt.ArrayLike) -> FloatArray:
    """Values as an array of numbers.

    Raises:
        DataError: they are none; a tensor's own reason is the hint.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError("does not consist of numbers", where=name) from error
    except RuntimeError as error:  # a tensor with a gradient
        raise DataError("does not consist of numbers", where=name, hint=str(error).partition("\n")[0]) from error


def outward(values: FloatArray, *, single: bool) -> FloatArray:
    """(n, N) as the public border has it: (N, n), or (n,) of a single sample."""
    return np.ascontiguousarray(values[:, 0] if single else values.T)
