"""The history of an arm in tables and sentences."""

from __future__ import annotations

from datetime import UTC, datetime

from drivers.core.text import in_percent
from ident.history.arm import STEP_LEVEL, TREND_LEVEL, ArmHistory, ParameterHistory
from ident.history.trend import LEAST_RESULTS, TrendStep
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.tables import Cell, Column, Table, table_of_rows
from ident.views.number_text import with_error

MINUTE, HOUR, DAY, WEEK = 60.0, 3600.0, 86400.0, 7 * 86400.0
MONTH, YEAR = 365.25 * DAY / 12, 365.25 * DAY

UNITS_OF_TIME = (
    (YEAR, "years"), (MONTH, "months"), (WEEK, "weeks"), (DAY, "days"), (HOUR, "hours"), (MINUTE, "minutes"),
)  # fmt: skip

LEAST_START = 3.0
"""A change is relative to a start that is this many times half of the change's interval; else it has a unit."""


def date_text(time: float) -> str:
    """A time [s since 1970] as a date, UTC."""
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d")


def span_text(seconds: float) -> str:
    """A time between two results in words: `6 weeks`, from two of a unit on."""
    size, name = next(((size, name) for size, name in UNITS_OF_TIME if seconds >= 2 * size), (1.0, "seconds"))
    return f"{seconds / size:.0f} {name}"


def trend_table(history: ArmHistory) -> Table:
    """A row per parameter: its value at first, its change and by the temperature, with half of the 95 % intervals."""
    rows: list[list[Cell]] = []
    for parameter in history.parameters:
        trend = parameter.trend
        cells: list[Cell] = [None] * 8
        if trend is not None:
            start = abs(trend.start)
            cells = [
                trend.start,
                trend.change,
                trend.change_half,
                in_percent(trend.change / start) if _relative(parameter) else None,
                trend.p_value,
                trend.scatter,
                trend.per_kelvin,
                len(trend.steps),
            ]
        rows.append(
            [
                parameter.name,
                parameter.joint,
                parameter.kind,
                len(parameter.series),
                *cells,
                parameter.unit,
                parameter.significant,
            ]
        )
    columns = [
        Column("name"),
        Column("joint"),
        Column("kind", kind="minor"),
        Column("results"),
        Column("start"),
        Column("change"),
        Column("change_half", label="± 95 %", digits=2),
        Column("change_percent", unit="%", label="change", digits=3),
        Column("p_value", label="p", digits=2),
        Column("scatter", label="σ between results", kind="minor", digits=2),
        Column("per_kelvin", label="per K", kind="minor", digits=3),
        Column("steps"),
        Column("unit"),
        Column("significant"),
    ]
    return table_of_rows(f"Parameters of {history.arm} over {span_text(history.end - history.start)}", columns, rows)


def step_table(history: ArmHistory) -> Table:
    """A row per step of a parameter."""
    rows: list[list[Cell]] = [
        [finding.name, finding.joint, finding.kind, date_text(step.before), date_text(step.after), step.size, step.half,
         step.p_value, finding.unit]
        for finding in history.findings
        for step in (finding.trend.steps if finding.trend is not None else ())
    ]  # fmt: skip
    columns = [
        *map(Column, ("name", "joint", "kind", "after", "before", "size")),
        Column("half", label="± 95 %", digits=2),
        Column("p_value", label="p", digits=2),
        Column("unit"),
    ]
    return table_of_rows(f"Steps of parameters of {history.arm}", columns, rows)


def sentences(history: ArmHistory) -> list[str]:
    """Return what changed, a sentence per parameter, the most significant first; and one where nothing did."""
    findings = [_sentence(finding) for finding in history.findings]
    if findings:
        return findings
    followed = [parameter for parameter in history.parameters if parameter.trend is not None]
    if followed:
        return [f"No significant change of {len(followed)} parameters."]
    if history.results < LEAST_RESULTS:
        return [f"A trend needs {LEAST_RESULTS} results of one arm; there are {history.results}."]
    return ["No trend: no parameter has enough comparable results at temperatures that do not just follow the time."]


def notes(history: ArmHistory) -> list[str]:
    """Return what was left out, and how certain findings are."""
    said = []
    if any(parameter.trend is not None for parameter in history.parameters):
        said.append(
            f"An arm that does not change shows a change or step in {100 * (TREND_LEVEL + STEP_LEVEL):.0f} % of cases."
        )
    if history.repeated:
        every = history.results + history.repeated
        said.append(f"Left out: {history.repeated} of {every} results, whose recordings were identified again later.")
    others = [parameter.not_comparable for parameter in history.parameters if parameter.not_comparable]
    if others:
        said.append(
            f"Left out of {len(others)} parameters: up to {max(others)} results with other friction terms, drive gains "
            "or groups of parameters."
        )
    return said


def _relative(parameter: ParameterHistory) -> bool:
    trend = parameter.trend
    return trend is not None and abs(trend.start) > LEAST_START * trend.change_half


def _size(parameter: ParameterHistory, change: float, half: float) -> str:
    if parameter.trend is None or not _relative(parameter):
        return f"{with_error(abs(change), half / WITHIN_95_PERCENT)} {parameter.unit}"
    scale = 100.0 / abs(parameter.trend.start)
    return f"{with_error(abs(change) * scale, half * scale / WITHIN_95_PERCENT)} %"


def _sentence(parameter: ParameterHistory) -> str:
    trend = parameter.trend
    assert trend is not None
    name = f"{parameter.kind} {parameter.name}" if parameter.kind.endswith("parameter") else parameter.kind
    subject = f"{parameter.joint}'s {name}"
    steps = [_step_text(parameter, step) for step in trend.steps]
    if not parameter.significant:
        return f"{subject} stepped {' and '.join(steps)}."
    verb = "rose" if trend.change > 0 else "fell"
    span = span_text(parameter.series.time[-1] - parameter.series.time[0])
    whole = f"{subject} {verb} by {_size(parameter, trend.change, trend.change_half)} in {span}"
    return f"{whole}; it stepped {' and '.join(steps)}." if steps else f"{whole}."


def _step_text(parameter: ParameterHistory, step: TrendStep) -> str:
    way = "up" if step.size > 0 else "down"
    when = f"between {date_text(step.before)} and {date_text(step.after)}"
    return f"{way} by {_size(parameter, step.size, step.half)} {when}"
