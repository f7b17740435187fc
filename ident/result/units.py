"""Unit of each standard parameter."""

from __future__ import annotations

from drivers.core.units import joint_unit
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import joint_column
from ident.result.schema import UNITS


def parameter_unit(model: DynamicModel, column: int) -> str:
    """Unit of a standard parameter; of a joint's own it follows from its kind, of friction also from the exponent."""
    parameter = model.parameters[column]
    unit = UNITS[parameter.symbol]
    if parameter.kind == "inertial":
        return unit
    if parameter.kind != "coupling" and model.terms is not None:
        shape = joint_column(model, parameter).shape
        if parameter.kind == "viscous" and shape != 1.0:
            unit = f"N·m·(s/rad)^{shape:.3g}"
        elif parameter.kind == "load":
            unit = "1" if shape == 1.0 else "1/(N·m)"
    return joint_unit(unit, sliding=model.joints[parameter.joint].prismatic)
