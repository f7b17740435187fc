"""The table of a friction experiment, and the parts of it that people read."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.core.units import common_unit
from ident.result.friction_experiment import FrictionExperimentResult
from ident.result.tables import Column, Table, table_of_rows

COEFFICIENTS = (
    "joint", "coulomb", "coulomb_std", "viscous", "viscous_std", "offset", "offset_std", "further_terms", "rmse",
)  # fmt: skip
"""What is printed, and stands first on the page."""

COVERED = (
    "joint", "fastest", "coldest", "warmest", "highest_load", "load_span_needed", "periods", "equations",
)  # fmt: skip
"""What the recordings cover."""


def friction_table(result: FrictionExperimentResult) -> Table:
    """One row per joint: coefficients and shapes with σ, what they hold for, and the residual."""
    named = ("coulomb", "viscous", "exponent", "offset", "stribeck", "stribeck_velocity", "load")
    units = ("N·m", "N·m·(s/rad)^α", "", "N·m", "N·m", "rad/s", "")
    labels = {"coulomb": "Coulomb"}
    sliding = [joint.sliding for joint in result.joints]
    torque, speed = common_unit("N·m", sliding), common_unit("rad/s", sliding)
    columns = [Column("joint")]
    for name, unit in zip(named, [common_unit(unit, sliding) for unit in units], strict=True):
        columns.append(Column(name, unit=unit, label=labels.get(name, "")))
        columns.append(Column(f"{name}_std", unit=unit, label="σ", kind="std"))
    for name in ("beta1", "beta2", "beta3"):
        columns += [Column(name), Column(f"{name}_std", label="σ", kind="std")]
    columns += [
        Column("further_terms", label="further terms ± 95 %"),
        Column("fastest", unit=speed, digits=3),
        Column("coldest", unit="°C", digits=3),
        Column("warmest", unit="°C", digits=3),
        Column("highest_load", unit=torque, digits=3),
        Column("load_span_needed", unit=torque, digits=3),
        Column("periods"),
        Column("equations"),
        Column("rmse", unit=torque, label="residual RMS", digits=3),
    ]
    rows = []
    for joint in result.joints:
        heat = joint.temperature_range
        beta: Sequence[float | None] = joint.temperature or (None,) * 3
        deviations: Sequence[float | None] = joint.temperature_std or (None,) * 3
        rows.append(
            (
                joint.joint,
                *(getattr(joint, field) for name in named for field in (name, f"{name}_std")),
                *(cell for pair in zip(beta, deviations, strict=True) for cell in pair),
                joint.terms_text,
                joint.speed_range.greatest,
                None if heat is None else heat.least,
                None if heat is None else heat.greatest,
                joint.load_range.greatest,
                joint.least_load_span,
                joint.periods,
                joint.samples,
                joint.rmse,
            )
        )
    return table_of_rows("Friction by experiment", columns, rows)
