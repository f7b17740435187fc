"""Which of the estimated parameters the torque shows, and which only together with others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.row_space import DETERMINED, row_space

INVOLVED = 0.01
"""A parameter takes part in an invisible combination with more than this share of it, in units of its effect."""


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


def identifiability(derivative: FloatArray, noise: float, names: Sequence[str]) -> tuple[Identified, ...]:
    """Identifiability of d parameters, to first order about the estimate; it does not depend on their units.

    Args:
        derivative: (r, d) of the equations by the parameters.
        noise: standard deviation of one equation.
        names: (d,).
    """
    space = row_space(derivative)
    hidden = space.shares < DETERMINED
    invisible = np.abs(np.eye(len(names)) - space.rows.T @ space.rows)
    spread = noise * np.linalg.norm(space.rows.T / space.singular, axis=1)
    result = []
    for index, (name, share) in enumerate(zip(names, space.shares.tolist(), strict=True)):
        if not hidden[index]:
            result.append(Identified(name, share, float(spread[index] / space.lengths[index]), ()))
            continue
        involved = hidden & (invisible[index] > INVOLVED)
        partners = tuple(names[other] for other in np.flatnonzero(involved).tolist() if other != index)
        result.append(Identified(name, share, np.inf, partners))
    return tuple(result)
