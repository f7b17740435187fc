"""The identified parameters with their error bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

from drivers.core.errors import DynidError
from ident.assessment.validation import Fit
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import KIND_STYLES, Figure, plain
from ident.report.figures.panels import SMALL_PANEL, IntervalSeries, Panel, in_rows, interval_panel, panel_figure
from ident.report.figures.traces import points_trace
from ident.report.section import ReportData, ReportSection, Tile
from ident.result.consistent_model import ConsistentModel
from ident.result.result_file import stored_model
from ident.result.schema import BaseParameterResult, Result
from ident.result.tables import Column, Table
from ident.views.number_text import number, percent
from ident.views.result_tables import parameter_table


@dataclass(frozen=True)
class ReferenceValues:
    """Base parameters known from elsewhere."""

    label: str  # what they are, as a heading
    values: Mapping[str, float]  # name → value in the unit of the Result


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


REFERENCE_MARKER = "#7C828A"

SMALL_COLUMNS, MOST_NAMES = 3, 8
"""Sizes of the figure at a glance: panels of a row, names with room below it."""


def section(data: ReportData) -> ReportSection:
    """Base parameters with their error bars."""
    result = data.result
    reference = reference_values(data)
    context = {
        "parameters": _table(result, reference),
        "muted": [not parameter.significant for parameter in result.base_parameters],
        "figure": _figure(result, reference),
        "reference": reference,
        "reference_words": _reference_words(reference) if reference is not None else "",
        "threshold": _threshold(result),
        "correction": result.residuals.correction,
        "essential": result.essential,
    }
    return ReportSection("Parameters", "parameters", "parameters.html.j2", context)


def _table(result: Result, reference: ReferenceValues | None) -> Table:
    """The parameters, their kinds in words, and the reference values behind the unit."""
    columns = []
    for column in parameter_table(result).columns:
        if column.name == "kind":
            column = replace(column, cells=tuple(KIND_STYLES[str(kind)][0] for kind in column.cells))
        columns.append(column)
        if column.name == "unit" and reference is not None:
            references = tuple(reference.values.get(parameter.name) for parameter in result.base_parameters)
            columns.append(Column("reference", references, label=reference.label))
    return Table("Base parameters", tuple(columns))


def _threshold(result: Result) -> float | None:
    """Relative standard deviation [%] below which a parameter is significant, as the run's options say."""
    value = result.options.get("significance")
    return float(value) if isinstance(value, int | float) and value > 0 else None


def small_parameter_figure(anchor: str, data: ReportData) -> Figure | None:
    """Values with their intervals side by side, a panel per kind and unit: the same at a glance."""
    groups = _groups(data.result)
    if not groups:
        return None
    panels = [_small_panel(kind, unit, entries) for (kind, unit), entries in groups.items()]
    return panel_figure(anchor, in_rows(panels, SMALL_COLUMNS), "", showlegend=False)


def _small_panel(kind: str, unit: str, entries: Sequence[BaseParameterResult]) -> Panel:
    words, colour, symbol = KIND_STYLES[kind]
    half = [
        WITHIN_95_PERCENT * (entry.std or 0.0) if entry.std is None or isfinite(entry.std) else 0.0 for entry in entries
    ]
    trace = points_trace(
        [plain(entry.name) for entry in entries],
        [entry.value for entry in entries],
        {"color": colour, "symbol": symbol, "size": 4},
        f"%{{x}}: %{{y:.4g}} ± %{{error_y.array:.2g}} {unit}<extra></extra>",
        name=words,
        error_y={"type": "data", "array": half, "thickness": 1.2, "width": 2, "color": colour},
    )
    return Panel(
        f"{words} [{unit}]",
        f"<b>{words}</b> [{unit}]",
        [trace],
        x={"type": "category", "showgrid": False, "showticklabels": len(entries) <= MOST_NAMES, "tickangle": 0},
        y={"zeroline": True},
        height=SMALL_PANEL,
    )


def _groups(result: Result) -> dict[tuple[str, str], list[BaseParameterResult]]:
    """Parameters with a value by kind and unit, whose values can be compared."""
    groups: dict[tuple[str, str], list[BaseParameterResult]] = {}
    for parameter in result.base_parameters:
        if parameter.value is not None:
            groups.setdefault((parameter.kind, parameter.unit), []).append(parameter)
    return groups


def _figure(result: Result, reference: ReferenceValues | None) -> Figure | None:
    """Values with their intervals: a panel per kind and unit, so that values of one panel can be compared."""
    groups = _groups(result)
    if not groups:
        return None
    references = {} if reference is None else reference.values
    first = next((group for group, entries in groups.items() if any(p.name in references for p in entries)), None)
    rows = [
        [_panel(kind, unit, entries, references, reference.label if reference and (kind, unit) == first else "")]
        for (kind, unit), entries in groups.items()
    ]
    compared = f" Open diamond: {_reference_words(reference)}." if references and reference is not None else ""
    caption = (
        "Values of the full model with their 95 % intervals. A parameter whose interval contains 0 is not significant "
        f"in this recording.{compared}"
    )
    return panel_figure("parameters-plot", rows, caption)


def _reference_words(reference: ReferenceValues) -> str:
    return "the true value" if reference.label == "True value" else "the robot file's values for the links"


def _panel(
    kind: str, unit: str, entries: Sequence[BaseParameterResult], references: Mapping[str, float], legend: str
) -> Panel:
    words, colour, symbol = KIND_STYLES[kind]
    values = {parameter.name: parameter.value for parameter in entries}
    deviations = {parameter.name: parameter.std for parameter in entries}
    marker = {"color": colour, "symbol": symbol, "size": 6}
    series = [IntervalSeries("estimate ± 95 %", values, marker, deviations, shown=bool(legend))]
    having = {name: references[name] for name in values if name in references}
    if having:
        marker = {"color": REFERENCE_MARKER, "symbol": "diamond-open", "size": 9, "line": {"width": 1.5}}
        series.append(IntervalSeries(legend.lower() or "reference", having, marker, shown=bool(legend)))
    return interval_panel(f"{words} [{unit}]", f"<b>{words}</b> [{unit}]", list(values), series, unit)


def links_section(data: ReportData) -> ReportSection | None:
    """The links' bodies; None where no consistent model was found."""
    result = data.result
    if result.consistent is None or not result.standard_parameters:
        return None
    consistent = result.consistent
    context = {
        "links": result.standard_parameters,
        "joints": [entry for entry in consistent.parameters if entry.unit and not _of_link(entry.name)],
        "consistent": consistent,
        "simulated": _simulated(result.joints, consistent),
        "names": result.joints,
        "open_loop": [run for run in result.delivered.runs if run.open_loop],
        "tiles": _tiles(consistent, result.validation),
    }
    return ReportSection("Links", "links", "links.html.j2", context)


def _simulated(joints: Sequence[str], consistent: ConsistentModel) -> list[tuple[str, float | None, float, float]]:
    """Torque error [N·m], motion error and its largest value [rad or m] of each joint on held-out data."""
    if consistent.simulation is None or consistent.validation is None:
        return []
    motion = consistent.simulation
    return list(zip(joints, consistent.validation.rmse, motion.position_rmse, motion.max_position_error, strict=True))


def _of_link(name: str) -> bool:
    return name.rstrip("0123456789") in ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M")


def _tiles(consistent: ConsistentModel, unconstrained: Fit | None) -> tuple[Tile, ...]:
    tiles = []
    if consistent.validation is not None:
        free = None if unconstrained is None else unconstrained.relative_error
        tiles.append(
            Tile(
                "Validation error, consistent",
                percent(consistent.validation.relative_error),
                f"unconstrained: {percent(free)}",
            )
        )
    tiles.append(Tile("p-value of consistency", number(consistent.p_value, 2), "small: no bodies explain the data"))
    return tuple(tiles)
