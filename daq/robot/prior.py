"""Prior knowledge of an arm's parameters: fixed values, ranges, and a body for each link."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from daq.robot.section import Finite, Positive, Section, Vector3

TOTAL_MASS = "total_mass"
"""Name, in `known`, of the mass of all links that move."""

OF_LINK = re.compile(r"(?:M|M[XYZ]|[XYZ]{2})(\d+)")
"""Names of a link's parameters, and its number."""

LEAST_POINTS = 4
"""Corners of the smallest body."""


class Known(Section):
    """A known value, written as a number; or where a value lies, open on a side that is absent."""

    value: Finite | None = None
    min: Finite | None = None
    max: Finite | None = None

    @model_validator(mode="before")
    @classmethod
    def _number(cls, content: Any) -> Any:
        return content if isinstance(content, dict) else {"value": content}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.value is None) == (self.min is None and self.max is None):
            raise ValueError("give a number, or 'min', 'max' or both")
        if self.min is not None and self.max is not None and not self.min < self.max:
            raise ValueError(f"min {self.min:g} is not below max {self.max:g}; give one number for a known value")
        return self


class PriorLink(Section):
    """A link as a data sheet or a CAD model has it, in the frame of its joint: its mass, then its centre, then all."""

    mass: Positive | None = Field(default=None, description="[kg]")
    com: Vector3 | None = Field(default=None, description="centre of mass [m]")
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | None = Field(
        default=None, description="xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]"
    )
    com_box: tuple[Vector3, Vector3] | None = Field(
        default=None, description="two corners of a box that holds the centre of mass [m]"
    )

    com_hull: Literal["urdf"] | tuple[Vector3, ...] | None = Field(
        default=None,
        description="points [m] whose convex hull holds the centre of mass, or 'urdf' for the link's shapes there",
    )

    @field_validator("com_hull", mode="before")
    @classmethod
    def _hull(cls, content: Any) -> Any:
        if isinstance(content, str) and content != "urdf":
            raise ValueError(f"'{content}': write 'urdf', or a list of points")
        if isinstance(content, list | tuple) and len(content) < LEAST_POINTS:
            raise ValueError(f"{len(content)} points enclose no volume: give {LEAST_POINTS} or more")
        return content

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.com is not None and self.mass is None:
            raise ValueError("'com' needs 'mass'")
        if self.inertia is not None and self.com is None:
            raise ValueError("'inertia' needs 'mass' and 'com'")
        if self.com_box is not None:
            low, high = self.com_box
            if not all(least < most for least, most in zip(low, high, strict=True)):
                raise ValueError("'com_box': every coordinate of the first corner must be below the second's")
        return self


class Prior(Section):
    """Bodies that determine what the torques do not, and how strongly the parameters are drawn to them."""

    links: dict[str, PriorLink] = Field(default_factory=dict, description="joint → the link that it moves")
    distance: Literal["entropic", "euclidean"] = "entropic"
    weight: Positive = Field(default=0.1, description="of each link's distance, in equations of unit variance")


def known_problems(known: Mapping[str, Known]) -> list[str]:
    """What contradicts itself in `known`, a sentence each: no body has these masses, moments and inertias at once."""
    low = {name: number.min if number.value is None else number.value for name, number in known.items()}
    high = {name: number.max if number.value is None else number.value for name, number in known.items()}
    links = sorted({int(match[1]) for name in known if (match := OF_LINK.fullmatch(name))})
    problems = [
        f"known.M{link}: no body has a mass of {most:g} kg or less"
        for link in links
        if (most := high.get(f"M{link}")) is not None and most <= 0
    ]
    masses = {f"M{link}": least for link in links if (least := low.get(f"M{link}")) is not None and least > 0}
    total = high.get(TOTAL_MASS)
    if total is not None and total <= 0:
        problems.append(f"known.{TOTAL_MASS}: {total:g} kg is not a mass")
    elif total is not None and sum(masses.values()) >= total:
        named = ", ".join(f"known.{name}" for name in masses)
        problems.append(
            f"no body satisfies all of: {named}, known.{TOTAL_MASS}: links of {sum(masses.values()):g} kg or more in "
            f"an arm of {total:g} kg or less"
        )
    for link in links:
        problems += _moment_problems(link, low, high)
    return problems


def _moment_problems(link: int, low: Mapping[str, float | None], high: Mapping[str, float | None]) -> Iterator[str]:
    """Moments of inertia about a link's joint that no body has.

    Each is below the sum of the other two, and above what the link's mass at its centre has already.
    """
    names = [f"{axis}{axis}{link}" for axis in "XYZ"]
    for place, name in enumerate(names):
        first, second = (other for other in names if other != name)
        most, others = low.get(name), (high.get(first), high.get(second))
        if most is not None and others[0] is not None and others[1] is not None and most >= others[0] + others[1]:
            yield (
                f"no body satisfies all of: known.{name}, known.{first}, known.{second}: a moment of inertia of "
                f"{most:g} kg·m² is not below the sum of the other two, {others[0]:g} and {others[1]:g}"
            )
        moment, mass = high.get(name), high.get(f"M{link}")
        if moment is None or mass is None or mass <= 0:
            continue
        across = [f"M{axis}{link}" for axis in "XYZ" if axis != "XYZ"[place]]
        named = [name, f"M{link}", *(value for value in across if value in low)]
        least = sum(_least_square(low.get(value), high.get(value)) for value in across) / mass
        if moment <= least:
            yield (
                f"no body satisfies all of: {', '.join(f'known.{key}' for key in named)}: the mass at its centre alone "
                f"has a moment of inertia of {least:g} kg·m²"
            )


def _least_square(low: float | None, high: float | None) -> float:
    """The least square of a value between two limits."""
    if low is not None and low > 0:
        return low**2
    return high**2 if high is not None and high < 0 else 0.0
