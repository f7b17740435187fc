"""The box that a population searches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError


@dataclass(frozen=True, eq=False)
class SearchBox:
    """Bounds of d variables.

    Attributes:
        lower, upper: (d,), each below the other, in the variables' units.
        names: (d,) of the variables, for messages; numbers where there are none.

    Raises:
        UsageError: a range is empty or not finite; names the variable.
    """

    lower: FloatArray
    upper: FloatArray
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.lower.ndim != 1 or self.lower.shape != self.upper.shape or not self.lower.size:
            raise ValueError("lower and upper must be vectors of the same length")
        usable = np.isfinite(self.lower) & np.isfinite(self.upper) & (self.lower < self.upper)
        for index in np.flatnonzero(~usable)[:1]:
            name = self.names[index] if self.names else f"variable {index + 1}"
            raise UsageError(
                f"the search range of {name} is empty: {self.lower[index]:g} to {self.upper[index]:g}",
                hint="give a lower bound below the upper one",
            )

    @classmethod
    def around(cls, centre: FloatArray, share: float, names: Sequence[str] = ()) -> SearchBox:
        """Centre ± share·|centre| (d,): ROCR6 takes 10 % of the absolute WLS solution.

        Raises:
            UsageError: the share is not positive, or a centre is 0.
        """
        reach = share * np.abs(centre)
        return cls(centre - reach, centre + reach, names)

    @property
    def width(self) -> FloatArray:
        """(d,) upper minus lower."""
        return self.upper - self.lower

    @property
    def size(self) -> int:
        """Number of variables d."""
        return len(self.lower)

    def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
        """(count, d) evenly distributed points."""
        return self.lower + self.width * generator.random((count, self.size))

    def clip(self, points: FloatArray) -> FloatArray:
        """The points (…, d), moved to the nearest ones of the box."""
        return np.clip(points, self.lower, self.upper)

    def at_bound(self, point: FloatArray, share: float = 1e-3) -> list[int]:
        """Indices of the variables of a point (d,) that lie within a share of the width of a bound."""
        near = np.minimum(point - self.lower, self.upper - point) <= share * self.width
        return [int(index) for index in np.flatnonzero(near)]
