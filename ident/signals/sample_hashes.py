"""Hashes of a recording's samples: whether two recordings hold the same data, whatever their files are called.

A sample is one instant: positions and torques of all joints, rounded coarser than a copy in single precision or as text
rounds them and finer than the noise between two runs of one motion. A copy, a part and a decimated copy share its
hashes; an interpolated copy shares those of the stamps that both have. Only the smallest hashes are kept (a bottom-k
sketch: A. Broder, On the resemblance and containment of documents, 1997): the share of common samples is estimated from
the samples of one recording whose hash lies below the largest that is kept of the other.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.text import percent_text

KEPT = 1024
"""Hashes that are kept of a recording."""

BITS = 48
"""Bits of a hash: every JSON reader holds such an integer exactly."""

SMALLEST_VALUE = 1e-200
"""Smaller values count as 0: ten to the power of their digits would overflow."""
LEAST_OVERLAP = 0.02
"""Share of common samples up to which it may be coincidence: a joint that passes a pose again with the same torque."""

SAME_DATA = 0.8
"""Share of common samples from which on nothing new is in a recording; rounding loses some of them."""

MANY_JOINTS = 4
"""From so many joints on, coarse rounding is enough to tell samples apart."""

HashArray = npt.NDArray[np.uint64]


def sample_hashes(position: FloatArray, torque: FloatArray) -> HashArray:
    """The hashes (M,) of the samples, each once; a sample that repeats the one before does not count.

    Args:
        position: (N, n) as recorded [rad or m].
        torque: (N, n) [N·m or N].
    """
    decimals, digits = (4, 3) if position.shape[1] >= MANY_JOINTS else (6, 5)
    values = np.concatenate([position, torque], axis=1)
    changed = np.ones(len(values), dtype=np.bool_)
    changed[1:] = np.any(np.diff(values, axis=0) != 0.0, axis=1)
    changed &= np.all(np.isfinite(values), axis=1)
    rounded = np.rint(position[changed] * 10.0**decimals).astype(np.int64)
    return np.unique(_mixed(np.concatenate([rounded, *_significant(torque[changed], digits)], axis=1)))


def kept_hashes(hashes: HashArray) -> list[int]:
    """The smallest `KEPT` of the hashes, rising."""
    return [int(value) for value in np.sort(hashes)[:KEPT]]


def overlap(hashes: HashArray, others: Iterable[Sequence[int]]) -> float:
    """The share of a recording's samples that others hold, too; 0 up to `LEAST_OVERLAP`, 1 from `SAME_DATA` on.

    Args:
        hashes: (M,) of all its samples.
        others: those kept of each of the other recordings.
    """
    kept = [other for other in others if len(other)]
    if not kept or not len(hashes):
        return 0.0
    complete = min((max(of_run) for of_run in kept if len(of_run) >= KEPT), default=1 << BITS)
    comparable = hashes[hashes <= np.uint64(complete)]
    if not len(comparable):
        return 0.0
    common = np.isin(comparable, np.concatenate([np.asarray(of_run, dtype=np.uint64) for of_run in kept]))
    share = float(np.mean(common))
    return 0.0 if share <= LEAST_OVERLAP else 1.0 if share >= SAME_DATA else share


def check_counted_once(
    labels: Sequence[str], hashes: Sequence[HashArray], least: float = LEAST_OVERLAP
) -> list[list[int]]:
    """Refuse recordings that share samples: these would count twice, and part of them be held out from themselves.

    Args:
        labels: of the recordings.
        hashes: of all their samples.
        least: share of common samples from which on they are refused.

    Returns:
        The hashes that are kept of each.

    Raises:
        UsageError: two share samples.
    """
    kept = [kept_hashes(own) for own in hashes]
    for first, second in combinations(range(len(labels)), 2):
        share = max(overlap(hashes[second], [kept[first]]), overlap(hashes[first], [kept[second]]))
        if share > 0.0 and share >= least:
            raise UsageError(
                f"up to {percent_text(share, 2)} of its samples are those of {labels[first]}; they would count twice",
                where=labels[second],
                hint="give each recording once, without copies or parts of it",
            )
    return kept


def _significant(values: FloatArray, digits: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Mantissas of so many decimal digits and their exponents."""
    size = np.abs(values)
    exponent = np.where(size > SMALLEST_VALUE, np.floor(np.log10(np.where(size > SMALLEST_VALUE, size, 1.0))), 0.0)
    mantissa = np.rint(values * 10.0 ** (digits - 1 - exponent))
    return mantissa.astype(np.int64), exponent.astype(np.int64)


def _mixed(rows: npt.NDArray[np.int64]) -> HashArray:
    """A hash of `BITS` bits per row (N, m): the finaliser of SplitMix64, column after column (Steele et al. 2014)."""
    state = np.full(len(rows), 0x9E3779B97F4A7C15, dtype=np.uint64)
    with np.errstate(over="ignore"):
        for column in rows.T:
            state = state ^ column.astype(np.uint64)
            state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            state = (state ^ (state >> np.uint64(31))) + np.uint64(0x9E3779B97F4A7C15)
    return np.asarray(state >> np.uint64(64 - BITS))
