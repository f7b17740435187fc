"""The regressor's rows of the links' parameters, and torques of given links, compiled (ident/compiled/rows.c)."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.compiled.library import address, kernels
from ident.model.kinematics.joints import Joint
from ident.model.kinematics.transmission import TreeMotion
from ident.model.newton_euler import rotation_coefficients


class CompiledTree(ctypes.Structure):
    """`struct tree` of arm.h; keeps its arrays."""

    _fields_ = [
        ("joints", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("parent", "prismatic", "turns", "translation", "axis", "gravity")),
    ]

    def __init__(self, joints: Sequence[Joint], gravity: FloatArray) -> None:
        arrays: dict[str, np.ndarray[Any, Any]] = {
            "parent": np.array([joint.parent for joint in joints], dtype=np.intc),
            "prismatic": np.array([joint.prismatic for joint in joints], dtype=np.intc),
            "turns": np.array([rotation_coefficients(joint) for joint in joints], dtype=np.float64),
            "translation": np.array([joint.translation for joint in joints], dtype=np.float64),
            "axis": np.array([joint.axis for joint in joints], dtype=np.float64),
            "gravity": np.array(gravity, dtype=np.float64),
        }
        super().__init__(len(joints), *(address(array) for array in arrays.values()))
        self.arrays = arrays


Share = float | tuple[int, int]
"""Factor of a joint's axis in a motor's: a number, or its entry (motor, joint) of R⁻ᵀGᵀ if it varies."""


TreeTorques = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Torques (n, m) of position, velocity and acceleration (n, m)."""


@dataclass(frozen=True)
class LinkRows:
    """Places of the packed rows of one link's inertial parameters."""

    kinds: tuple[int, ...]  # which of the ten parameters are selected, in the rows' order
    # of the tree, those that the link hangs on, the base's first, the link's own last; empty where nothing is selected
    joints: tuple[int, ...]
    # for each motor that moves the link, the first of its `len(kinds)` packed rows, and the combination (index in
    # `joints`, factor) of axes that makes up the motor's
    targets: tuple[tuple[int, tuple[tuple[int, Share], ...]], ...]


class _Rows(ctypes.Structure):
    """`struct rows` of rows.c."""

    _fields_ = [
        ("kinds_from", ctypes.c_void_p),
        ("kinds", ctypes.c_void_p),
        ("targets", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("target", "axis_joint", "axis_share", "axis_factor")),
    ]


class CompiledRows:
    """The rows that `RegressorKernel` gives the links, for one arm and choice of columns."""

    def __init__(self, joints: Sequence[Joint], gravity: FloatArray, links: Sequence[LinkRows]) -> None:
        """Prepare the kernel's tables; where there is a library only."""
        self._tree = CompiledTree(joints, gravity)
        targets: list[tuple[int, int, int, int]] = []
        axes: list[tuple[int, Share]] = []
        for number, link in enumerate(links):
            for row, combination in link.targets:
                targets.append((number, row, len(axes), len(combination)))
                axes += [(link.joints[index], share) for index, share in combination]
        factors = [share if isinstance(share, float) else 0.0 for _, share in axes]
        shares = [-1 if isinstance(share, float) else share[0] * len(joints) + share[1] for _, share in axes]
        self._arrays = [
            np.cumsum([0, *(len(link.kinds) for link in links)], dtype=np.intc),
            np.array([kind for link in links for kind in link.kinds], dtype=np.intc),
            np.array(targets, dtype=np.intc),
            np.array([joint for joint, _ in axes], dtype=np.intc),
            np.array(shares, dtype=np.intc),
            np.array(factors),
        ]
        first, second, *others = map(address, self._arrays)
        self._rows = _Rows(first, second, len(targets), *others)
        self._call = kernels().long.dynid_rows

    def write(self, tree: TreeMotion, shares: FloatArray, out: FloatArray) -> None:
        """Write the links' rows.

        Args:
            tree: motion of the tree's joints.
            shares: (dof, n, m) R⁻ᵀGᵀ where it varies; anything where it is constant.
            out: (row_count, m), each row contiguous.
        """
        count = out.shape[1]
        motions = [tree.position, tree.velocity, tree.acceleration, shares]
        rows = [np.ascontiguousarray(motion) for motion in motions]
        stride = out.strides[0] // out.itemsize
        pointers = [ctypes.c_void_p(address(row)) for row in rows]
        self._call(
            ctypes.byref(self._tree),
            ctypes.byref(self._rows),
            ctypes.c_int(count),
            ctypes.c_long(count),
            *pointers,
            ctypes.c_void_p(address(out)),
            ctypes.c_long(stride),
        )


def compiled_rows(joints: Sequence[Joint], gravity: FloatArray, links: Sequence[LinkRows]) -> CompiledRows | None:
    """The rows of an arm; None without a library."""
    return None if kernels().long is None else CompiledRows(joints, gravity, links)


def compiled_torques(joints: Sequence[Joint], gravity: FloatArray, inertial: FloatArray) -> TreeTorques | None:
    """Torques (n, m) of a tree's joints for its motion (n, m), of links (10·n,); None without a library."""
    if kernels().long is None:
        return None
    tree, links = CompiledTree(joints, gravity), np.array(inertial, dtype=np.float64)
    call = kernels().long.dynid_torques

    def torques(position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        count, torque = position.shape[1], np.empty(position.shape)
        rows = [links, *(np.ascontiguousarray(motion) for motion in (position, velocity, acceleration)), torque]
        first, *others = (ctypes.c_void_p(address(row)) for row in rows)
        call(ctypes.byref(tree), first, ctypes.c_int(count), ctypes.c_long(count), *others)
        return torque

    return torques
