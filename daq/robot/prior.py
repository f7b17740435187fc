"""Prior knowledge of an arm's parameters: fixed values, ranges, and a body for each link."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from daq.robot.section import Finite, Positive, Section, Vector3

TOTAL_MASS = "total_mass"
"""Name, in `known`, of the mass of all links that move."""

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
            raise ValueError(f"{len(content)} points enclose nothing: give {LEAST_POINTS} or more")
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
