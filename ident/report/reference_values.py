"""Values that the estimates can be compared with: a simulated arm's truth, or what the robot file says of the links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.core.errors import DynidError
from ident.model.true_parameters import truth_vector
from ident.report.section import ReportData
from ident.result.stored_model import stored_model


@dataclass(frozen=True)
class ReferenceValues:
    """Base parameters known from elsewhere.

    Attributes:
        label: what they are, as a heading.
        values: name → value in the unit of the Result.
    """

    label: str
    values: Mapping[str, float]


def reference_values(data: ReportData) -> ReferenceValues | None:
    """The truth of a simulated arm, else the links' inertias of the robot file; None where neither is known.

    The robot file's friction is left out: it describes a simulated arm, its inertias may be those of a data sheet.
    """
    if data.truth is not None:
        return ReferenceValues("True value", dict(zip(data.truth.names, map(float, data.truth.values), strict=True)))
    try:
        stored = stored_model(data.result)
        values = stored.base.projection @ truth_vector(stored.robot_file, stored.model)
    except DynidError:  # the robot file names no links, or not these base parameters
        return None
    inertial = {
        name: float(value)
        for name, value, kind in zip(stored.base.names, values, stored.base.kinds, strict=True)
        if kind == "inertial"
    }
    return ReferenceValues("Robot file", inertial) if inertial else None
