"""The text of `--friction`: a base model, and terms joined with plus signs.

    none | viscous | coulomb | coulomb-viscous, then +power, +stribeck, +load or +load-linear, +temperature or
    +temperature-linear, and the others of `ident.friction.table`; or auto

Shapes that the robot file states (exponent, Stribeck velocity) are kept, others are estimated.
"""

from __future__ import annotations

from typing import Any

from daq.robot.schema import Friction
from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean
from ident.friction.table import OPTIONS

AUTO = "auto"
BASES = ("none", "viscous", "coulomb", "coulomb-viscous")
GROUPS = list(dict.fromkeys(option.group for option in OPTIONS))
WORDS = {
    option.word: option for option in sorted(OPTIONS, key=lambda option: (GROUPS.index(option.group), option.word))
}
"""What each word asks for."""


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
        if term not in WORDS:
            hint = did_you_mean(term, tuple(WORDS)) or f"terms are {', '.join(WORDS)}"
            raise UsageError(f"no friction term is called '{term}'", where="--friction", hint=hint)
    keys = [WORDS[term].group for term in terms]
    if len(set(keys)) < len(keys):
        raise UsageError(f"'{text}' names a term twice", where="--friction", hint="load or load-linear, not both")
    if any(WORDS[term].bends for term in terms) and "viscous" not in base.split("-"):
        raise UsageError("+power is the exponent of viscous friction", where="--friction", hint="coulomb-viscous+power")


def friction_columns(text: str) -> tuple[str, ...]:
    """Return which of the columns viscous and coulomb every joint has."""
    return ("coulomb", "viscous") if text == AUTO else tuple(text.split("+")[0].split("-"))


def chosen_friction(friction: Friction, text: str) -> Friction:
    """The robot file's `friction` with the terms of a text for every joint; its shapes are kept."""
    words = [] if text == AUTO else text.split("+")[1:]
    options = {WORDS[word].group: WORDS[word] for word in words}
    nothing: dict[str, Any] = {"exponent": 1.0, "stribeck": False, "load": "none", "temperature": "none"}
    update: dict[str, Any] = dict(nothing)
    for key in nothing.keys() & options.keys():
        update[key] = options[key].value if key != "exponent" or friction.exponent == 1.0 else friction.exponent
    update["terms"] = tuple(option.word for group, option in options.items() if group not in nothing)
    joints = {}
    for name, joint in friction.joints.items():
        kept = joint.exponent if "exponent" in options and joint.exponent != 1.0 else None
        joints[name] = joint.model_copy(update={**dict.fromkeys((*nothing, "terms")), "exponent": kept})
    return friction.model_copy(update={**update, "joints": joints})
