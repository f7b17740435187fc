"""One closed loop as a serial chain from one closing frame through the common ancestor to the other.

Seen from the first closing frame, the joints of its own side count backwards, those of the other side forwards. The
opened joint is closed where the second frame's origin e lies in the first one's, and, for a revolute joint, its z axis
z along the first one's. With the unit twist (w_k, v_k) of joint k of the chain in the first closing frame,

    ∂e/∂q_k = v_k + w_k × e        ∂z/∂q_k = w_k × z

and a second derivative turns with the joint that is nearer to the first frame: ∂²e/∂q_j∂q_k = w_j × ∂e/∂q_k for j
before k, third derivatives likewise. So all of them follow from the first derivatives by cross products.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.vectors import cross, cross_matrix
from ident.model.kinematics.joints import BASE_INDEX, Joint, Placement, composed

POSITION_ROWS = 3
REVOLUTE_ROWS = 5
"""Equations of an opened joint: e = 0 of a spherical one; of a revolute one the x and y components of z too."""


@dataclass(frozen=True)
class Link:
    """One joint of a chain."""

    joint: int  # its index in the tree
    sign: float  # 1, or -1 where it counts backwards
    axis: FloatArray  # (3,) in its frame
    prismatic: bool  # as in the tree
    after: Placement  # placement of the next joint's frame in this one's, position aside

    @cached_property
    def turn(self) -> FloatArray:
        """(3, 6) [axis]× and [axis]×²."""
        matrix = cross_matrix(self.axis)
        return np.hstack([matrix, matrix @ matrix])

    def onward(self, following: Link | None) -> FloatArray:
        """(3, 5) rotation and origin of `after`, then the axis of the following joint, signed; in this one's frame."""
        rotation, origin = self.after
        axis = np.zeros(3) if following is None else rotation @ (following.sign * following.axis)
        return np.column_stack([rotation, origin, axis])


@dataclass(frozen=True)
class ClosingChain:
    """The joints between two closing frames."""

    name: str  # name of the loop in messages
    spherical: bool  # whether the opened joint is spherical, not revolute
    before: Placement  # placement of the first joint's frame in the first closing frame
    links: tuple[Link, ...]  # the joints, the first closing frame's side first

    @property
    def rows(self) -> int:
        """Number of closing equations."""
        return POSITION_ROWS if self.spherical else REVOLUTE_ROWS

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Numbers of its joints in the tree."""
        return tuple(link.joint for link in self.links)

    @cached_property
    def _onward(self) -> tuple[FloatArray, ...]:
        return tuple(link.onward(after) for link, after in zip(self.links, (*self.links[1:], None), strict=True))

    def at(self, position: FloatArray) -> ChainState:
        """The chain at tree positions (n, N) [rad or m]."""
        count = position.shape[1]
        rotation = np.repeat(self.before[0][None], count, axis=0)
        origin = np.broadcast_to(self.before[1], (count, 3))
        turning = np.zeros((len(self.links), 3, count))
        sliding, origins = np.zeros_like(turning), np.zeros_like(turning)
        axis = _times(rotation, self.links[0].sign * self.links[0].axis) if self.links else origin
        for index, (link, onward) in enumerate(zip(self.links, self._onward, strict=True)):
            travel = link.sign * position[link.joint]
            if link.prismatic:
                sliding[index] = axis.T
                origin = origin + link.sign * travel[:, None] * axis
            else:
                turning[index], origins[index] = axis.T, origin.T
                sine, versine = np.sin(travel)[:, None, None], 1.0 - np.cos(travel)[:, None, None]
                turned = _times(rotation, link.turn)
                rotation = rotation + turned[..., :3] * sine + turned[..., 3:] * versine
            following = _times(rotation, onward)
            rotation, origin, axis = following[..., :3], origin + following[..., 3], following[..., 4]
        end, direction = origin.T, rotation[:, :, 2].T
        moved = np.empty((len(self.links), 2, 3, count))
        moved[:, 0], moved[:, 1] = end - origins, direction
        moved = cross(turning[:, None], moved)
        moved[:, 0] += sliding
        return ChainState(self.rows, np.array((end, direction)), turning, moved)


@dataclass(frozen=True)
class ChainState:
    """A chain of K joints at N positions."""

    rows: int  # number of closing equations
    value: FloatArray  # (2, 3, N) e [m] and z
    turning: FloatArray  # (K, 3, N) w_k
    moved: FloatArray  # (K, 2, 3, N) first derivatives of e and z

    def residual(self) -> FloatArray:
        """(rows, N) what the closing equations miss zero by [m, rad]."""
        return self._equations(self.value)

    def jacobian(self) -> FloatArray:
        """(rows, K, N) first derivatives."""
        return self._equations(self.moved).transpose(1, 0, 2)

    def second(self, rate: FloatArray) -> FloatArray:
        """(rows, K, N) second derivatives, once along `rate` (K, N): of the motion `rate`, the Jacobian's change."""
        return self._equations(self._second(rate)).transpose(1, 0, 2)

    def third(self, rate: FloatArray) -> FloatArray:
        """(rows, K, N) third derivatives, twice along `rate` (K, N)."""
        turned, moved = self.turning * rate[:, None], self.moved * rate[:, None, None]
        upto = np.cumsum(turned, axis=0)
        doubled = 2.0 * upto - turned  # twice what is before a joint, and the joint itself
        beyond = moved.sum(axis=0) - np.cumsum(moved, axis=0)
        pairs = cross(doubled[:, None], moved)
        beyond_pairs = pairs.sum(axis=0) - np.cumsum(pairs, axis=0) - 2.0 * cross(upto[:, None], beyond)
        # a × (b × v) = b (a·v) − v (a·b), summed over the joints up to each.
        products = np.cumsum(np.einsum("kiN,kjN->kijN", turned, doubled), axis=0)
        own = np.einsum("kijN,kbjN->kbiN", products, self.moved)
        own -= np.einsum("kiiN->kN", products)[:, None, None] * self.moved
        turning = self.turning[:, None]
        total = own + 2.0 * cross(upto[:, None], cross(turning, beyond)) + cross(turning, beyond_pairs)
        return self._equations(total).transpose(1, 0, 2)

    def _second(self, rate: FloatArray) -> FloatArray:
        moved = self.moved * rate[:, None, None]
        upto = np.cumsum(self.turning * rate[:, None], axis=0)
        beyond = moved.sum(axis=0) - np.cumsum(moved, axis=0)
        return cross(upto[:, None], self.moved) + cross(self.turning[:, None], beyond)

    def _equations(self, values: FloatArray) -> FloatArray:
        """(…, rows, N) of (…, 2, 3, N): the components that the opened joint holds at zero."""
        return values.reshape(*values.shape[:-3], 6, values.shape[-1])[..., : self.rows, :]


def closing_chain(
    name: str, joints: tuple[Joint, ...], ends: tuple[tuple[int, Placement], tuple[int, Placement]], *, spherical: bool
) -> ClosingChain:
    """The chain between two closing frames."""
    (first, first_end), (second, second_end) = ends
    back, out = _to_base(joints, first), _to_base(joints, second)
    while back and out and back[-1] == out[-1]:
        back.pop()
        out.pop()
    out.reverse()
    links: list[Link] = []
    before = _inverse(first_end)
    between = before
    for sign, path in ((-1.0, back), (1.0, out)):
        for index in path:
            joint = joints[index]
            own = (joint.rotation, joint.translation)
            if sign > 0:
                between = composed(between, own)
            if links:
                links[-1] = _followed(links[-1], between)
            else:
                before = between
            links.append(Link(index, sign, joint.axis, joint.prismatic, (np.eye(3), np.zeros(3))))
            between = _inverse(own) if sign < 0 else (np.eye(3), np.zeros(3))
    between = composed(between, second_end)
    if links:
        links[-1] = _followed(links[-1], between)
    else:
        before = between
    return ClosingChain(name, spherical, before, tuple(links))


def _times(rotation: FloatArray, right: FloatArray) -> FloatArray:
    """Rotations (N, 3, 3) times one matrix (3, 3) or vector (3,); as one product, ten times faster."""
    return (rotation.reshape(-1, 3) @ right).reshape(-1, 3, *right.shape[1:])


def _followed(link: Link, after: Placement) -> Link:
    return Link(link.joint, link.sign, link.axis, link.prismatic, after)


def _to_base(joints: tuple[Joint, ...], index: int) -> list[int]:
    """The joint and those before it, the base's last."""
    chain = []
    while index != BASE_INDEX:
        chain.append(index)
        index = joints[index].parent
    return chain


def _inverse(placement: Placement) -> Placement:
    return placement[0].T, -placement[0].T @ placement[1]
