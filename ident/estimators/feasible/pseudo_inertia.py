"""Pseudo-inertia matrices of links, and the bodies that they describe.

A link's mass density is non-negative somewhere in space exactly when its pseudo-inertia

    J = [[Σ, h], [hᵀ, m]],  Σ = ½·tr(I)·1 − I,

is positive definite, h its first moments and I its inertia about the frame's origin (Wensing, Kim and Slotine 2018,
"Linear matrix inequalities for physically consistent inertial parameter identification"). The triangle inequalities of
the principal moments are contained in it.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.model.parameters import INERTIAL
from ident.stored import Stored, Value

INERTIA_ELEMENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Elements of an inertia, in the order of the ten standard parameters."""

PSEUDO_INERTIA_ROWS = 4
"""A pseudo-inertia has so many rows."""


def _basis() -> FloatArray:
    basis = np.zeros((len(INERTIAL), PSEUDO_INERTIA_ROWS, PSEUDO_INERTIA_ROWS))
    for index, symbol in enumerate(INERTIAL):
        axes = ["XYZ".index(letter) for letter in symbol if letter != "M"]
        if symbol == "M":
            basis[index, 3, 3] = 1.0
        elif len(axes) == 1:
            basis[index, axes[0], 3] = basis[index, 3, axes[0]] = 1.0
        elif axes[0] == axes[1]:
            basis[index, range(3), range(3)] = 0.5
            basis[index, axes[0], axes[0]] = -0.5
        else:
            basis[index, axes[0], axes[1]] = basis[index, axes[1], axes[0]] = -1.0
    return basis


BASIS = _basis()
"""(10, 4, 4): J = Σ x_i · BASIS[i] over a link's ten standard parameters x."""


def pseudo_inertia(links: FloatArray) -> FloatArray:
    """Pseudo-inertias (…, 4, 4) of links (…, 10) of standard parameters."""
    return np.asarray(np.tensordot(links, BASIS, axes=1))


def standard_parameters(pseudo: FloatArray) -> FloatArray:
    """Ten standard parameters (…, 10) of pseudo-inertias (…, 4, 4)."""
    moments = pseudo[..., :3, :3]
    inertia = np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments
    return np.concatenate([inertia[..., *np.triu_indices(3)], pseudo[..., :3, 3], pseudo[..., 3:, 3]], axis=-1)


class Body(Stored):
    """A rigid body in the frame of its link."""

    mass: Value = Field(description="[kg]")
    com: list[Value] = Field(description="centre of mass [m]", min_length=3, max_length=3)
    inertia: dict[str, Value] = Field(description="xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]")


def body_of(link: FloatArray) -> Body:
    """The body that ten standard parameters (10,) describe; ModelError where its mass is not positive."""
    pseudo = pseudo_inertia(link)
    mass = float(pseudo[3, 3])
    if not mass > 0.0:
        raise ModelError(f"a link of {mass:g} kg has no centre of mass", hint="identify again")
    com = pseudo[:3, 3] / mass
    central = pseudo[:3, :3] - mass * np.outer(com, com)
    inertia = np.trace(central) * np.eye(3) - central
    elements = dict(zip(INERTIA_ELEMENTS, inertia[np.triu_indices(3)].tolist(), strict=True))
    return Body(mass=mass, com=com.tolist(), inertia=elements)
