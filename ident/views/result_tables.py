"""Tables of an identified model: parameters, friction, errors, what was merged."""

from __future__ import annotations

from collections.abc import Sequence

from ident.assessment.validation import Fit
from ident.result.estimate import Merge
from ident.result.schema import Result
from ident.result.tables import Cell, Column, Table, table_of, table_of_rows


def parameter_table(result: Result) -> Table:
    """Base parameters of the full model and of the essential one; σ is corrected for autocorrelated residuals."""
    columns = (
        Column("name"),
        Column("expression", kind="detail"),
        Column("value"),
        Column("std", label="σ", kind="std"),
        Column("unit"),
        Column("rsd", unit="%", label="RSD"),
        Column("f_value", label="partial F", kind="minor", digits=3),
        Column("significant"),
        Column("joint"),
        Column("kind", kind="detail"),
        Column("classical_std", label="classical σ", kind="minor", digits=3),
        Column("essential_value", label="essential"),
        Column("essential_std", label="essential σ", kind="std"),
    )
    rows = [
        [getattr(parameter, {"rsd": "rsd_percent"}.get(column.name, column.name)) for column in columns]
        for parameter in result.base_parameters
    ]
    title = f"Base parameters of {result.robot} ({result.method}); σ corrected for autocorrelated residuals"
    return table_of_rows(title, columns, rows)


def joint_friction_table(result: Result) -> Table:
    """Friction of each joint, σ between several runs where it is known, and further terms where there are some."""
    torque, viscous = result.unit("N·m"), result.unit("N·m·s/rad")
    columns = [
        Column("joint"),
        Column("viscous", unit=viscous),
        Column("viscous_std", unit=viscous, label="σ", kind="std"),
        Column("coulomb", unit=torque, label="Coulomb"),
        Column("coulomb_std", unit=torque, label="σ", kind="std"),
        Column("offset", unit=torque),
        Column("offset_std", unit=torque, label="σ", kind="std"),
    ]
    if any(joint.repeatability_text for joint in result.friction):
        for name, unit in (("viscous", viscous), ("coulomb", torque), ("offset", torque)):
            columns.append(Column(f"{name}_repeatability", unit=unit, label=f"{name}: σ between runs", digits=2))
    if any(joint.terms_text for joint in result.friction):
        columns.append(Column("terms_text", label="further terms ± 95 %"))
    table = table_of(f"Friction of {result.robot}", columns, result.friction)
    return Table(table.title, table.columns, result.friction_note)


def friction_step_table(result: Result) -> Table:
    """Terms that `--friction auto` tried for each joint, the best at that point."""
    columns = (
        Column("joint"),
        Column("term"),
        Column("f_value", label="F", digits=3),
        Column("p_value", label="p", digits=2),
        Column("error_before", label="held-out error before"),
        Column("error_after", label="after"),
        Column("accepted", label="added"),
    )
    return table_of("Friction terms tried", columns, result.friction_steps)


ERRORS = {
    "rmse": "RMSE",
    "low_speed_rmse": "at low speed",
    "high_speed_rmse": "at high speed",
    "max_error": "largest",
    "relative_error": "relative",
}
"""Errors of a joint's torque, and what they are called in a table of one fit."""


def error_table(title: str, joints: Sequence[str], torque: str, fits: dict[str, Fit | None]) -> Table:
    """Errors per joint of one or several fits, by their names; `torque` is the unit of the joints' torques."""
    columns = [Column("joint", tuple(joints))]
    for name, fit in fits.items():
        for error, words in ERRORS.items():
            if error == "max_error" and name:
                continue
            unit, factor = ("%", 100.0) if error == "relative_error" else (torque, 1.0)
            given = None if fit is None else getattr(fit, f"joint_{error}" if unit == "%" else error)
            cells: tuple[Cell, ...] = tuple(
                None if value is None else factor * value for value in given or [None] * len(joints)
            )
            label = f"{name} {words}".strip().replace("_", " ")
            columns.append(Column(f"{name}_{error}".lstrip("_"), cells, unit, label))
    return Table(title, tuple(columns))


def result_errors(result: Result) -> Table:
    """Errors of the delivered model's filtered torque: on the identification data, on held-out data, in motion."""
    delivered = result.delivered
    return error_table(
        f"Errors of {result.robot}",
        result.joints,
        result.unit("N·m"),
        {"fit": delivered.fit, "validation": delivered.validation_all_samples, "in_motion": delivered.validation},
    )


def merge_tables(merge: Merge) -> list[Table]:
    """The models that were merged, and the values that differ significantly."""
    models = [
        (
            model.file,
            model.method,
            model.parameters,
            model.variance_ratio,
            "; ".join(dict.fromkeys(", ".join(experiment.locked) or "none" for experiment in model.experiments)),
            "; ".join(dict.fromkeys(", ".join(experiment.torques_of) for experiment in model.experiments)),
        )
        for model in merge.models
    ]
    names = ("model", "method", "values", "variance / white", "locked", "torques of")
    apart = (
        Column("parameter"),
        Column("file", label="model"),
        Column("value", label="its value"),
        Column("merged"),
        Column("deviations", unit="σ", label="difference", digits=3),
    )
    contradictions = [] if merge.consistency is None else merge.consistency.contradictions
    return [
        table_of_rows("Models that were merged", [Column(name) for name in names], models),
        table_of("Values that differ significantly from the merged model", apart, contradictions),
    ]
