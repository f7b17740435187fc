"""The section `workspace` of a robot file: where the arm may be, and how thick its links are.

All lengths are in m. Points are in the base frame, the one that `model` and `gravity` refer to; the tool point is in
the frame of the last joint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from daq.robot.section import Finite, NonNegative, Section, TableAngle, Vector3
from drivers.core.validation import describe

DEFAULT_LINK_RADIUS = 0.05
"""Radius [m] of a link whose thickness the file does not say."""

DEFAULT_CLEARANCE = 0.02
"""Distance [m] kept from the mounting surface and from obstacles by default."""

Mounting = Literal["table", "wall", "ceiling", "free"]
"""How the base is mounted; the mounting surface is a plane z = constant of the base frame, with the arm above it."""

_LONGEST_REACH = 100.0
"""No arm reaches this far [m]: a length beyond it was written in millimetres."""


def _check_range(values: tuple[float, float] | None, key: str) -> None:
    if values is None:
        return
    if not values[0] < values[1]:
        raise ValueError(f"{key} {list(values)} is not in ascending order")
    _check_lengths(values, key)


def _check_lengths(values: tuple[float, ...], key: str) -> None:
    largest = max(values, key=abs)
    if abs(largest) > _LONGEST_REACH:
        raise ValueError(f"{key} {list(values)} goes beyond {_LONGEST_REACH:g} m; lengths are in m")


class HalfSpace(Section):
    """The arm stays where n·p ≥ offset, n being `normal` scaled to length 1: `normal` points to where the arm is."""

    normal: Vector3 = Field(description="direction, base frame; its length does not matter")
    offset: Finite = Field(description="[m], distance of the plane from the base frame's origin along the normal")

    @model_validator(mode="after")
    def _check(self) -> Self:
        length = math.hypot(*self.normal)
        if not (1e-6 < length < 1e6):
            raise ValueError(f"normal {list(self.normal)} has no direction")
        _check_lengths((self.offset,), "offset")
        return self


class Box(Section):
    """The arm stays out of this box, whose edges are parallel to the base frame's axes."""

    lower: Vector3 = Field(description="corner with the smallest x, y, z [m]")
    upper: Vector3 = Field(description="corner with the largest x, y, z [m]")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise ValueError(f"{axis}: lower {low:g} is not below upper {high:g}")
        _check_lengths(self.lower, "lower")
        _check_lengths(self.upper, "upper")
        return self


class KeepOut(Section):
    """An obstacle that no link may enter: exactly one of `half_space` and `box`."""

    half_space: HalfSpace | None = None
    box: Box | None = None
    name: str = Field(default="", description="what it is called in messages and figures")
    clearance: NonNegative | None = Field(
        default=None, description="distance that is kept [m]; the workspace's where absent"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.half_space is None) == (self.box is None):
            raise ValueError("give exactly one of 'half_space' and 'box'")
        if self.clearance is not None:
            _check_lengths((self.clearance,), "clearance")
        return self

    @property
    def shape(self) -> HalfSpace | Box:
        """The half-space or the box."""
        shape = self.half_space or self.box
        assert shape is not None
        return shape


def _parse_link_radius(value: Any) -> float | dict[str, float]:
    # By hand: pydantic's message for a union would describe the alternative that was not meant.
    if isinstance(value, Mapping):
        for joint, radius in value.items():
            if not isinstance(joint, str):
                raise ValueError(f"found the key {describe(joint)}, but expected the name of a joint")
            _check_radius(radius, f"of joint '{joint}' ")
        return {str(joint): float(radius) for joint, radius in value.items()}
    _check_radius(value, "")
    return float(value)


def _check_radius(value: Any, whose: str) -> None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not (is_number and 0 < value <= 1):
        raise ValueError(
            f"the radius {whose}is {describe(value)}, but it should be a number above 0 and at most 1 [m]; "
            "give one number, or a mapping joint: number"
        )


class Workspace(Section):
    """Space in which the arm may move (AUBO eq. 21: r_min..r_max, h_min..h_max), and what it keeps clear of."""

    tool: Vector3 = Field(default=(0.0, 0.0, 0.0), description="tool point [m] in the frame of the last joint")
    tool_rotation: tuple[TableAngle, TableAngle, TableAngle] = Field(
        default=(0.0, 0.0, 0.0),
        description="the tool's axes there as a rotation vector [rad], for the pose that is compared with the pendant",
    )
    radius: tuple[NonNegative, Finite] | None = Field(
        default=None, description="smallest and largest distance from the base frame's z axis [m]"
    )
    height: tuple[Finite, Finite] | None = Field(
        default=None, description="smallest and largest z in the base frame [m]"
    )
    floor: Finite | None = Field(
        default=None, description="z of the mounting surface in the base frame [m]; 0 where absent (`model.mounting`)"
    )
    keep_out: tuple[KeepOut, ...] = ()
    clearance: NonNegative = Field(
        default=DEFAULT_CLEARANCE, description="distance [m] kept from the mounting surface and from obstacles"
    )
    link_radius: Annotated[float | dict[str, float], BeforeValidator(_parse_link_radius)] = Field(
        default=DEFAULT_LINK_RADIUS,
        description="half the thickness of all links [m], or of the link behind each joint named ('base' for the base)",
    )
    ignore_pairs: tuple[tuple[str, str], ...] = Field(
        default=(), description="pairs of joints (or 'base') whose links may touch"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        _check_lengths(self.tool, "tool")
        _check_lengths((self.clearance, self.floor or 0.0), "clearance or floor")
        names = [keep_out.name for keep_out in self.keep_out if keep_out.name]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"'keep_out' names two obstacles '{name}'")
        _check_range(self.radius, "radius")
        _check_range(self.height, "height")
        for first, second in self.ignore_pairs:
            if first == second:
                raise ValueError(f"'ignore_pairs' pairs '{first}' with itself")
        return self

    def named_links(self) -> tuple[tuple[str, str], ...]:
        """Every joint that the section names, with the key that names it."""
        keys = self.link_radius if isinstance(self.link_radius, dict) else {}
        radii = [("workspace.link_radius", name) for name in keys]
        return (*radii, *(("workspace.ignore_pairs", name) for pair in self.ignore_pairs for name in pair))

    def radius_of(self, link: str) -> float:
        """Radius [m] of the link behind a joint, or of 'base'."""
        if isinstance(self.link_radius, dict):
            return self.link_radius.get(link, DEFAULT_LINK_RADIUS)
        return self.link_radius
