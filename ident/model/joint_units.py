"""Units of a joint's own quantities: of a sliding joint N, m and kg in place of N·m, rad and kg·m²."""

from __future__ import annotations

from collections.abc import Iterable


def joint_unit(unit: str, *, sliding: bool) -> str:
    """The unit of a joint's quantity, given that of a turning joint."""
    if not sliding:
        return unit
    return unit.replace("(N·m)", "N").replace("N·m", "N").replace("rad", "m").replace("kg·m²", "kg")


def common_unit(unit: str, sliding: Iterable[bool]) -> str:
    """Unit of a column of several joints, "N·m or N" where some slide and others turn."""
    units = {joint_unit(unit, sliding=slides) for slides in sliding} or {unit}
    return " or ".join(sorted(units, key=lambda one: one != unit))
