"""Standard parameters: names, symbols and kinds (for their order see `ident.model.dynamic_model`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.core.arrays import FloatArray

INERTIAL = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")
"""The ten standard inertial parameters of a link, in column order [kg·m², kg·m, kg] (SR400 .3.1)."""
LINK_SIZE, MASS = len(INERTIAL), INERTIAL.index("M")

Quantity = Literal[
    "motor_inertia",
    "viscous",
    "coulomb",
    "offset",
    "stribeck",
    "load",
    "temperature",
    "temperature_slope",
    "temperature_curvature",
    "exponent",
    "stribeck_velocity",
]
"""Signal that a joint parameter multiplies: the acceleration, the velocity, its sign, 1, or one of the further friction
terms (`ident.model.friction_terms`), the last two of which are derivatives by a shape."""

Kind = Literal["inertial", "coupling"] | Quantity
KIND_SYMBOLS: dict[Quantity, str] = {
    "motor_inertia": "Ia",
    "viscous": "Fv",
    "coulomb": "Fs",
    "offset": "Fo",
    "stribeck": "Fb",
    "load": "Fl",
    "temperature": "Ft",
    "temperature_slope": "Fts",
    "temperature_curvature": "Ftc",
    "exponent": "Fve",
    "stribeck_velocity": "Fbv",
}
"""Symbols of the joint parameters, in column order (SR400 eq. 6-7; Fo as f_o in AUBO eq. 6)."""

FRICTION_KINDS: tuple[Quantity, ...] = tuple(kind for kind in KIND_SYMBOLS if kind != "motor_inertia")
"""Kinds of the columns of a motor's own friction, offset included."""

DISSIPATIVE_KINDS: tuple[Quantity, ...] = ("viscous", "coulomb", "stribeck", "load")
"""Those whose coefficient is not negative on any arm."""

PAIR_FIELDS = {"Iac": "pair_inertia", "Fv": "pair_viscous", "Fs": "pair_coulomb"}
"""Keys of a coupled joint's own true parameters in the robot file, by symbol."""

PAIR_SYMBOLS: dict[str, Quantity] = {"Iac": "motor_inertia", "Fv": "viscous", "Fs": "coulomb"}
"""What the columns of kind "coupling" are like, by symbol."""

MOTOR_SYMBOLS = {"Fv": "Fvm", "Fs": "Fsm"}
"""Symbols of a motor's friction where several joints move it (SR400 eq. 8)."""


@dataclass(frozen=True)
class StandardParameter:
    """One column of the standard regressor.

    Attributes:
        name: as in the papers (`XX2`, `Fv1`); numbered from 1 in the order of the tree's joints.
        kind: of the parameter.
        joint: number of its joint in the tree, from 0.
        symbol: the name without the number.
    """

    name: str
    kind: Kind
    joint: int
    symbol: str


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
