"""The text of `--friction`: a base model, and terms joined with plus signs.

    none | viscous | coulomb | coulomb-viscous, then +power, +stribeck, +load or +load-linear, +temperature or
    +temperature-linear; or auto

Shapes that the robot file states (exponent, Stribeck velocity) are kept, others are estimated.
"""

from __future__ import annotations

from typing import Any

from daq.robot.schema import Friction
from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean

AUTO = "auto"
BASES = ("none", "viscous", "coulomb", "coulomb-viscous")
TERMS: dict[str, tuple[str, Any]] = {
    "power": ("exponent", "estimated"),
    "stribeck": ("stribeck", True),
    "load": ("load", "quadratic"),
    "load-linear": ("load", "linear"),
    "temperature": ("temperature", "full"),
    "temperature-linear": ("temperature", "linear"),
}
"""Key of the robot file's `friction` that a term sets, and the value."""


def check_friction(text: str) -> None:
    """Refuse a text that names no friction model.

    Raises:
        UsageError: names what is not known, or terms that exclude each other.
    """
    if text == AUTO:
        return
    base, *terms = text.split("+")
    if base not in BASES:
        hint = did_you_mean(base, BASES) or f"{', '.join(BASES)} or {AUTO}"
        raise UsageError(f"no friction model is called '{base}'", where="--friction", hint=hint)
    for term in terms:
        if term not in TERMS:
            hint = did_you_mean(term, tuple(TERMS)) or f"terms are {', '.join(TERMS)}"
            raise UsageError(f"no friction term is called '{term}'", where="--friction", hint=hint)
    keys = [TERMS[term][0] for term in terms]
    if len(set(keys)) < len(keys):
        raise UsageError(f"'{text}' names a term twice", where="--friction", hint="load or load-linear, not both")
    if "exponent" in keys and "viscous" not in base.split("-"):
        raise UsageError("+power is the exponent of viscous friction", where="--friction", hint="coulomb-viscous+power")


def friction_columns(text: str) -> tuple[str, ...]:
    """Which of the columns viscous and coulomb every joint has."""
    return ("coulomb", "viscous") if text == AUTO else tuple(text.split("+")[0].split("-"))


def chosen_friction(friction: Friction, text: str) -> Friction:
    """The robot file's `friction` with the terms of a text for every joint; its shapes are kept."""
    terms = [] if text == AUTO else text.split("+")[1:]
    update: dict[str, Any] = {"exponent": 1.0, "stribeck": False, "load": "none", "temperature": "none"}
    for term in terms:
        key, value = TERMS[term]
        update[key] = value if key != "exponent" or friction.exponent == 1.0 else friction.exponent
    joints = {}
    for name, joint in friction.joints.items():
        exponent = joint.exponent if "power" in terms and joint.exponent != 1.0 else None
        joints[name] = joint.model_copy(
            update={"exponent": exponent, "stribeck": None, "load": None, "temperature": None}
        )
    return friction.model_copy(update={**update, "joints": joints})
