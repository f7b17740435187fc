"""Standard parameters: names, symbols and kinds (for their order see `ident.model.dynamic_model`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import SHAPED, TERMS, derivative_of

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
"""The ten standard inertial parameters of a link, in column order [kg·m², kg·m, kg] (SR400 .3.1)."""
LINK_SIZE, MASS = len(INERTIAL), INERTIAL.index("M")

JOINT_SYMBOLS: dict[str, str] = {
    "motor_inertia": "Ia",
    **{term.kind: term.symbol for term in TERMS},
    **{name: derivative_of(name).symbol for name in SHAPED},
}
"""Symbols of the parameters of a joint's motor, in column order, by kind: also the signal that the parameter
multiplies, the acceleration or a friction term's (`ident.friction.table`), the last ones a derivative by a shape."""

KINDS: tuple[str, ...] = ("inertial", "coupling", *JOINT_SYMBOLS)
"""All kinds of standard parameters."""

PAIR_FIELDS = {"Iac": "pair_inertia", "Fv": "pair_viscous", "Fs": "pair_coulomb"}
"""Keys of a coupled joint's own true parameters in the robot file, by symbol."""

PAIR_SYMBOLS: dict[str, str] = {"Iac": "motor_inertia", "Fv": "viscous", "Fs": "coulomb"}
"""What the columns of kind "coupling" are like, by symbol."""

MOTOR_SYMBOLS = {"Fv": "Fvm", "Fs": "Fsm"}
"""Symbols of a motor's friction where several joints move it (SR400 eq. 8)."""


@dataclass(frozen=True)
class StandardParameter:
    """One column of the standard regressor."""

    name: str  # as in the papers (`XX2`, `Fv1`); numbered from 1 in the order of the tree's joints
    kind: str  # one of `KINDS`
    joint: int  # number of its joint in the tree, from 0
    symbol: str  # the name without the number


def inertia_tensor(inertia: Sequence[float]) -> FloatArray:
    """The symmetric matrix (3, 3) of xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def link_parameters(mass: float, com: Sequence[float], inertia: Sequence[float]) -> FloatArray:
    """Ten standard parameters (10,) of a link from its mass [kg], centre of mass (3,) [m] and the inertia there.

    `inertia` is xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]; the parallel-axis theorem moves it to the
    joint frame's origin.
    """
    x, y, z = com
    xx, xy, xz, yy, yz, zz = inertia
    about_origin = [
        xx + mass * (y * y + z * z),
        xy - mass * x * y,
        xz - mass * x * z,
        yy + mass * (x * x + z * z),
        yz - mass * y * z,
        zz + mass * (x * x + y * y),
    ]
    return np.array([*about_origin, mass * x, mass * y, mass * z, mass])
