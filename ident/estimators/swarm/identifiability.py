"""Which of the estimated parameters the torque shows, and which only together with others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.streams import FloatArray

SINGULAR = 1e-9
"""Singular values of the derivatives, scaled to the box, below this share of the largest are rounding."""

DETERMINED = 0.99
"""A parameter counts as identifiable where this share of it, in widths of the box, is seen."""

INVOLVED = 0.01
"""A parameter takes part in an invisible combination with more than this share of it."""


@dataclass(frozen=True)
class Identified:
    """One estimated parameter.

    Attributes:
        name: of the parameter.
        determined: share of it that the torque shows, 0 to 1.
        std: standard deviation [the parameter's unit], residuals assumed white; inf where it is not identifiable.
        confounded_with: names of the parameters that an invisible change compensates it with.
    """

    name: str
    determined: float
    std: float
    confounded_with: tuple[str, ...]

    @property
    def identifiable(self) -> bool:
        """Whether the torque determines it."""
        return self.determined >= DETERMINED


def identifiability(
    derivative: FloatArray, widths: FloatArray, noise: float, names: Sequence[str]
) -> tuple[Identified, ...]:
    """Identifiability of d parameters, to first order about the estimate.

    Args:
        derivative: (r, d) of the equations by the parameters.
        widths: (d,) of the search box: the unit in which a parameter is compared with the others.
        noise: standard deviation of one equation.
        names: (d,).
    """
    _, singular, vectors = np.linalg.svd(derivative * widths, full_matrices=False)
    seen = singular > SINGULAR * singular[0] if singular.size else np.zeros(0, dtype=np.bool_)
    rows = vectors[seen]
    shares = np.sum(rows**2, axis=0)
    invisible = np.eye(len(names)) - rows.T @ rows
    spread = noise * np.linalg.norm(rows.T / singular[seen], axis=1) * widths
    result = []
    for index, name in enumerate(names):
        determined = min(1.0, float(shares[index]))
        partners: tuple[str, ...] = ()
        if determined < DETERMINED:
            strength = np.abs(invisible[index])
            partners = tuple(
                names[other]
                for other in range(len(names))
                if other != index and strength[other] > INVOLVED and shares[other] < DETERMINED
            )
        std = float(spread[index]) if determined >= DETERMINED else np.inf
        result.append(Identified(name, determined, std, partners))
    return tuple(result)
