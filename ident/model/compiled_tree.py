"""A tree of joints as the compiled kernels take it (ident/compiled/arm.h)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.compiled.library import address
from ident.model.kinematics.joints import Joint
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
