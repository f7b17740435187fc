"""The Newton-Euler recursion over all samples of a chunk: motion of every link, and of every axis below it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.linear_algebra.vectors import cross_matrix
from ident.model.kinematics.joints import BASE_INDEX, Joint

Direction = tuple["FloatArray | float", "FloatArray | float", "FloatArray | float"]
"""Three components, each a number where it is constant or an array (chunk,)."""


@dataclass
class AxisMotion:
    """Motion of a link's frame per unit velocity of a joint below it, in the link's frame."""

    angular: Direction
    linear: Direction


@dataclass
class FrameMotion:
    """Motion of one link's frame, in that frame; arrays (3, chunk)."""

    angular_velocity: FloatArray
    angular_acceleration: FloatArray
    linear: FloatArray
    axes: list[AxisMotion]


def stacked(motions: Sequence[AxisMotion], count: int) -> tuple[FloatArray, FloatArray]:
    """Angular and linear components (J, 3, count) of J axes."""
    angular, linear = np.empty((2, len(motions), 3, count))
    for index, axis in enumerate(motions):
        for component in range(3):
            for target, value in ((angular, axis.angular[component]), (linear, axis.linear[component])):
                target[index, component] = value if isinstance(value, float) else value[:count]
    return angular, linear


def scaled(factor: FloatArray | float, values: FloatArray, count: int, out: FloatArray) -> bool:
    """Write factor · values; False where the factor is the number 0 and nothing was written."""
    if isinstance(factor, float):
        if factor == 0.0:
            return False
        np.multiply(values, factor, out=out)
    else:
        np.multiply(values, factor[:count], out=out)
    return True


def combine(direction: Direction, rows: FloatArray, count: int, out: FloatArray, scratch: FloatArray) -> None:
    """Write Σ_j direction_j · rows[j] into `out`; rows (3, r, count), out (r, count)."""
    written = False
    term = scratch[: out.shape[0], :count]
    for component, row in zip(direction, rows, strict=True):
        if not written:
            written = scaled(component, row, count, out)
        elif scaled(component, row, count, term):
            out += term
    if not written:
        out[:] = 0.0


class Recursion:
    """The forward recursion: velocities, accelerations and axes of the joints in `chains` in every link's frame."""

    def __init__(
        self, joints: tuple[Joint, ...], chains: tuple[tuple[int, ...], ...], gravity: FloatArray, chunk: int
    ) -> None:
        self._joints = joints
        self._gravity = gravity
        self._turns = [rotation_coefficients(joint) for joint in joints]
        self.frames = []
        self._stacks = []
        for index, joint in enumerate(joints):
            # One stack a link: ω, α, a, then the angular and the linear component of every joint axis below it.
            below = len(chains[index])
            stack = np.empty((3, 3 + 2 * below, chunk))
            self._stacks.append(stack)
            axes = [
                AxisMotion(
                    angular=(stack[0, 3 + k], stack[1, 3 + k], stack[2, 3 + k]),
                    linear=(stack[0, 3 + below + k], stack[1, 3 + below + k], stack[2, 3 + below + k]),
                )
                for k in range(below)
            ]
            own = (float(joint.axis[0]), float(joint.axis[1]), float(joint.axis[2]))
            still = (0.0, 0.0, 0.0)
            axes.append(
                AxisMotion(angular=still, linear=own) if joint.prismatic else AxisMotion(angular=own, linear=still)
            )
            self.frames.append(FrameMotion(stack[:, 0], stack[:, 1], stack[:, 2], axes))
        widest = max(stack.shape[1] for stack in self._stacks)
        self._carried = np.empty((3, widest, chunk))
        self._term = np.empty((widest, chunk))
        self._vector = np.empty((3, chunk))
        self._entry = np.empty((3, 3, chunk))
        self._sines, self._cosines = np.empty((2, len(joints), chunk))

    def run(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> None:
        """Update every frame's motion for (n, m) joint motions."""
        count = position.shape[1]
        for index, joint in enumerate(self._joints):
            self._carry(index, joint, position[index], count)
            if not joint.prismatic:
                np.sin(position[index], out=self._sines[index, :count])
                np.cos(position[index], out=self._cosines[index, :count])
            rotation = self._rotation(index, count)
            stack = self._stacks[index]
            width = stack.shape[1]
            for row in range(3):
                combine(rotation[row], self._carried[:, :width, :count], count, stack[row, :, :count], self._term)
            self._add_own_motion(index, joint, velocity[index], acceleration[index], count)

    def _carry(self, index: int, joint: Joint, position: FloatArray, count: int) -> None:
        """Move the parent's quantities to this joint's origin, still in the parent's axes."""
        carried = self._carried[..., :count]
        if joint.parent == BASE_INDEX:
            carried[:, 0:2] = 0.0
            carried[:, 2] = -self._gravity[:, None]
            return
        parent = self._stacks[joint.parent][..., :count]
        carried[:, 0:3] = parent[:, 0:3]
        offset = self._offset(joint, position)
        if self._stacks[index].shape[1] > 3:
            self._carry_axes(joint, parent, offset, count)
        omega, alpha, linear = carried[:, 0:1], carried[:, 1:2], carried[:, 2:3]
        term = self._term[:1, :count]
        _add_cross(alpha, offset, count, linear, term)
        swing = self._vector[:, None, :count]
        swing[:] = 0.0
        _add_cross(omega, offset, count, swing, term)
        _add_cross(omega, (swing[0, 0], swing[1, 0], swing[2, 0]), count, linear, term)

    def _carry_axes(self, joint: Joint, parent: FloatArray, offset: Direction, count: int) -> None:
        """Move the axes of the joints below, too."""
        carried = self._carried[..., :count]
        frame = self.frames[joint.parent]
        below = len(frame.axes) - 1
        carried[:, 3 : 3 + below] = parent[:, 3 : 3 + below]
        carried[:, 4 + below : 4 + 2 * below] = parent[:, 3 + below :]
        own = frame.axes[-1]
        for axis in range(3):
            carried[axis, 3 + below] = own.angular[axis]
            carried[axis, 4 + 2 * below] = own.linear[axis]
        angulars = carried[:, 3 : 4 + below]
        linears = carried[:, 4 + below : 5 + 2 * below]
        _add_cross(angulars, offset, count, linears, self._term[: below + 1, :count])

    def _offset(self, joint: Joint, position: FloatArray) -> Direction:
        """Origin of the joint's frame in its parent's."""
        constant = joint.translation
        if not joint.prismatic:
            return (float(constant[0]), float(constant[1]), float(constant[2]))
        direction = joint.rotation @ joint.axis
        along = [constant[i] + direction[i] * position if direction[i] != 0.0 else float(constant[i]) for i in range(3)]
        return (along[0], along[1], along[2])

    def _rotation(self, index: int, count: int) -> list[Direction]:
        """Rows of the rotation from the parent's axes to the joint's, entries as numbers where they are constant."""
        constant, sine, cosine = self._turns[index]
        sines, cosines = self._sines[index, :count], self._cosines[index, :count]
        rows: list[Direction] = []
        for i in range(3):
            entries: list[FloatArray | float] = []
            for j in range(3):
                if sine[i, j] == 0.0 and cosine[i, j] == 0.0:
                    entries.append(float(constant[i, j]))
                    continue
                entry = self._entry[i, j, :count]
                np.multiply(sines, sine[i, j], out=entry)
                if cosine[i, j] != 0.0:
                    entry += cosines * cosine[i, j]
                if constant[i, j] != 0.0:
                    entry += constant[i, j]
                entries.append(entry)
            rows.append((entries[0], entries[1], entries[2]))
        return rows

    def _add_own_motion(
        self, index: int, joint: Joint, velocity: FloatArray, acceleration: FloatArray, count: int
    ) -> None:
        frame = self.frames[index]
        omega, alpha, linear = (
            frame.angular_velocity[:, :count],
            frame.angular_acceleration[:, :count],
            frame.linear[:, :count],
        )
        relative = [joint.axis[i] * velocity if joint.axis[i] != 0.0 else 0.0 for i in range(3)]
        target = linear if joint.prismatic else alpha
        factor = 2.0 if joint.prismatic else 1.0  # Coriolis 2·ω × v, or the change of the relative ω's direction
        term = self._term[0, :count]
        for i in range(3):
            first, second = (i + 1) % 3, (i + 2) % 3
            for left, right, sign in ((first, second, factor), (second, first, -factor)):
                value = relative[right]
                if isinstance(value, float):
                    continue
                np.multiply(omega[left], value, out=term)
                term *= sign
                target[i] += term
        for i in range(3):
            if joint.axis[i] == 0.0:
                continue
            target[i] += joint.axis[i] * acceleration
            if not joint.prismatic:
                omega[i] += relative[i]


def _add_cross(vectors: FloatArray, offset: Direction, count: int, out: FloatArray, scratch: FloatArray) -> None:
    """Add vectors × offset; vectors, out (3, k, count)."""
    for i in range(3):
        first, second = (i + 1) % 3, (i + 2) % 3
        if scaled(offset[second], vectors[first], count, scratch):
            out[i] += scratch
        if scaled(offset[first], vectors[second], count, scratch):
            out[i] -= scratch


def rotation_coefficients(joint: Joint) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B, C (3, 3) with rotation parent → joint = A + B·sin q + C·cos q (Rodrigues' formula)."""
    to_joint = joint.rotation.T
    if joint.prismatic:
        return to_joint, np.zeros((3, 3)), np.zeros((3, 3))
    along = np.outer(joint.axis, joint.axis)
    return along @ to_joint, -cross_matrix(joint.axis) @ to_joint, (np.eye(3) - along) @ to_joint
