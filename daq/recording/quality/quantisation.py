"""The grid that a quantised signal lies on."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray

LATTICE_TOLERANCE = 0.05
"""Values count as quantised when all gaps between them are whole multiples of the smallest within this part of it."""

_LATTICE_VALUES = 2000
_UNIT_ROUNDING = 1e-9  # of the largest value: what a change of units or of coordinates leaves
_SMALL = 0.1
_FEWEST_GAPS = 5  # fewer gaps can be multiples of each other by chance


def quantisation_step(values: FloatArray) -> float:
    """Step of the grid that all values (N,) lie on; nan where they lie on none or are all equal."""
    levels = np.unique(values[:_LATTICE_VALUES])
    if len(levels) < 2:
        return float("nan")
    gaps = np.diff(levels)
    # Rounding splits one level into several that differ by next to nothing.
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(levels))]
    if len(gaps) == 0:
        return float("nan")
    step = float(gaps.min())
    if len(gaps) < _FEWEST_GAPS:
        return float("nan")
    multiples = gaps / step
    return step if np.max(np.abs(multiples - np.round(multiples))) < LATTICE_TOLERANCE else float("nan")


def encoder_step(values: FloatArray) -> float:
    """Step of an encoder with positions (N,), also of one that shows few of its levels; nan where there is none."""
    spread = values[:: max(1, len(values) // _LATTICE_VALUES)]
    step = quantisation_step(spread)
    if np.isfinite(step):
        return step
    levels = np.unique(spread)
    return float(np.diff(levels).min()) if 1 < len(levels) <= _FEWEST_GAPS else float("nan")


def resolution(values: FloatArray) -> float:
    """Encoder's step of positions (N,), else what few of their changes are below; inf where they never change."""
    step = encoder_step(values)
    if np.isfinite(step):
        return step
    changes = np.abs(np.diff(values))
    changes = changes[changes > _UNIT_ROUNDING * float(np.max(np.abs(values), initial=0.0))]
    return float(np.quantile(changes, _SMALL)) if len(changes) else np.inf
