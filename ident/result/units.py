"""Unit of each standard parameter."""

from __future__ import annotations

from drivers.core.units import joint_unit
from ident.friction.table import TERM, TERMS
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import joint_column

UNITS: dict[str, str] = {
    **dict.fromkeys(("XX", "XY", "XZ", "YY", "YZ", "ZZ", "Ia", "Iac"), "kg·m²"),
    **dict.fromkeys(("MX", "MY", "MZ"), "kg·m"),
    "M": "kg",
    **{term.symbol: term.unit(1.0) for term in TERMS},
    "Fvm": "N·m·s/rad",
    "Fsm": "N·m",
}
"""Units by symbol, for revolute joints; of friction with a shape where that is 1."""


def parameter_unit(model: DynamicModel, column: int) -> str:
    """Unit of a standard parameter; of a joint's own it follows from its kind, of friction also from the exponent."""
    parameter = model.parameters[column]
    unit = UNITS[parameter.symbol]
    if parameter.kind == "inertial":
        return unit
    if parameter.kind in TERM:
        unit = TERM[parameter.kind].unit(joint_column(model, parameter).shape)
    return joint_unit(unit, sliding=model.joints[parameter.joint].prismatic)
