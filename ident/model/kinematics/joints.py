"""The tree of joints that the dynamics are computed on."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.core.arrays import FloatArray

BASE_INDEX = -1

Placement = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and translation (3,) [m] of a frame in another."""


def composed(outer: Placement, inner: Placement) -> Placement:
    """The placement of a frame that is placed in another one."""
    return outer[0] @ inner[0], outer[1] + outer[0] @ inner[1]


@dataclass(frozen=True)
class Joint:
    """A joint with one degree of freedom; its frame is fixed to the link that it moves."""

    name: str  # as in the robot file
    parent: int  # index of the parent joint; `BASE_INDEX` for the base
    prismatic: bool  # translation along the axis instead of rotation about it
    rotation: FloatArray  # (3, 3) of the joint frame in its parent's at position zero
    translation: FloatArray  # (3,) [m] of its origin in its parent's frame at position zero
    axis: FloatArray  # (3,) unit vector in the joint frame


def ancestors(joints: tuple[Joint, ...], index: int) -> tuple[int, ...]:
    """Indices of the joints between the base and joint `index`, the nearest to the base first, itself left out."""
    chain: list[int] = []
    parent = joints[index].parent
    while parent != BASE_INDEX:
        chain.append(parent)
        parent = joints[parent].parent
    return tuple(reversed(chain))
