"""Units of a joint's own quantities: of a sliding joint N, m and kg in place of N·m, rad and kg·m²."""

from __future__ import annotations


def joint_unit(unit: str, *, sliding: bool) -> str:
    """The unit of a joint's quantity, given that of a turning joint."""
    if not sliding:
        return unit
    return unit.replace("(N·m)", "N").replace("N·m", "N").replace("rad", "m").replace("kg·m²", "kg")
