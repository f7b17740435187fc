"""A model without the friction that URDF, MJCF and Pinocchio models cannot hold, and what that was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.streams import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import Kind

KINDS: tuple[tuple[Kind, str], ...] = (
    ("stribeck", "Stribeck friction"),
    ("load", "load-dependent friction"),
    ("temperature", "temperature-dependent friction"),
)


def without_further_friction(
    model: DynamicModel, values: FloatArray
) -> tuple[DynamicModel, FloatArray, tuple[str, ...]]:
    """The model with Coulomb, linear viscous friction and offsets only, its standard parameters, and what it lacks.

    Args:
        model: as identified.
        values: (p,) its standard parameters.
    """
    terms = model.terms
    if terms is None:
        return model, values, ()
    linear = tuple(there and exponent == 1.0 for there, exponent in zip(model.viscous, terms.exponent, strict=True))
    simple = replace(model, terms=None, viscous=linear)
    value_of = dict(zip((parameter.name for parameter in model.parameters), values.tolist(), strict=True))
    kept = np.array([value_of[parameter.name] for parameter in simple.parameters])
    names, sentences = model.joint_names, []
    for kind, what in KINDS:
        joints = [name for name, there in zip(names, model.has(kind), strict=True) if there]
        if joints:
            sentences.append(f"{what} of {', '.join(joints)}")
    bent = [
        f"{name} {exponent:.3g}"
        for name, there, exponent in zip(names, model.viscous, terms.exponent, strict=True)
        if there and exponent != 1.0
    ]
    if bent:
        sentences.append(f"viscous friction that grows with |q̇|^α, α of {', '.join(bent)}")
    return simple, kept, tuple(sentences)
