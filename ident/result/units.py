"""Unit of each standard parameter."""

from __future__ import annotations

from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import joint_column
from ident.result.schema import UNITS


def parameter_unit(model: DynamicModel, column: int) -> str:
    """Unit of a standard parameter; of viscous and load friction it follows from the exponent."""
    parameter = model.parameters[column]
    unit = UNITS[parameter.symbol]
    if parameter.kind == "inertial" or parameter.kind == "coupling" or model.terms is None:
        return unit
    shape = joint_column(model, parameter).shape
    if parameter.kind == "viscous" and shape != 1.0:
        return f"N·m·(s/rad)^{shape:.3g}"
    if parameter.kind == "load":
        return "1" if shape == 1.0 else "1/(N·m)"
    return unit
