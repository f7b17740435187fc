"""Two things are timed against each other only after they were seen to give the same."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray


class DisagreementError(Exception):
    """Two sides of a benchmark give different results."""


def check(what: str, ours: FloatArray, reference: FloatArray, tolerance: float) -> None:
    """Compare two arrays; `tolerance` is relative to the reference's largest entry.

    Raises:
        DisagreementError: the shapes differ, or the entries by more.
    """
    if ours.shape != reference.shape:
        raise DisagreementError(f"{what}: shapes {ours.shape} and {reference.shape}")
    difference = float(np.max(np.abs(ours - reference)) / np.max(np.abs(reference)))
    if not difference <= tolerance:
        raise DisagreementError(f"{what}: differs by {difference:.1e} of the largest entry, {tolerance:.0e} is allowed")
