"""The page of an arm's history: one self-contained HTML file."""

from __future__ import annotations

from ident.history.arm import ArmHistory, ParameterHistory
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import MEASURED, PREDICTED, RESIDUAL, Figure, plain, titled
from ident.report.figures.panels import Panel, in_rows, panel_figure
from ident.report.figures.traces import curve_trace, legend, points_trace
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.views.history_tables import date_text, notes, sentences, span_text, step_table, trend_table

MOST_PANELS = 24
CAPTION = (
    "Each result with the 95 % interval of its identification, at the mean temperature where a line says so, and the "
    "estimated trend. Findings come first; vertical lines are steps."
)


def history_page(history: ArmHistory) -> str:
    """The page: what changed, every series, trends and steps as tables."""
    tiles = [
        Tile("Results", str(history.results), f"over {span_text(history.end - history.start)}"),
        Tile("Parameters", str(sum(parameter.trend is not None for parameter in history.parameters)), "with a trend"),
        Tile("Findings", str(len(history.findings)), "changes and steps"),
        Tile("Latest result", date_text(history.end)),
    ]
    return rendered(
        "history_page",
        history=history,
        tiles=tiles,
        sentences=sentences(history),
        notes=notes(history),
        trends=trend_table(history),
        steps=step_table(history),
        series=series_figure(history),
    )


def series_figure(history: ArmHistory) -> Figure:
    """Values and trends of the parameters over time, at most `MOST_PANELS`."""
    panels = [_panel(parameter, place == 0) for place, parameter in enumerate(history.parameters[:MOST_PANELS])]
    return panel_figure("series-plot", in_rows(panels), CAPTION)


def _panel(parameter: ParameterHistory, first: bool) -> Panel:
    trend, series = parameter.trend, parameter.series
    times = [1000.0 * time for time in series.time]
    values = series.value if trend is None else trend.corrected
    bars = {"type": "data", "array": (WITHIN_95_PERCENT * series.std).tolist(), "thickness": 1, "width": 0}
    marker, line = {"color": MEASURED, "size": 5}, {"color": PREDICTED, "width": 2}
    error = {**bars, "color": MEASURED}
    result, estimate = ({**legend(name, shown=first), "hoverinfo": "all"} for name in ("result", "trend"))
    traces = [points_trace(times, values.tolist(), marker, error_y=error, **result)]
    if trend is not None:
        traces.append(curve_trace(times, trend.line.tolist(), line, **estimate))
    at = "" if trend is None or trend.mean_temperature is None else f", at {trend.mean_temperature:.1f} °C"
    steps = () if trend is None else trend.steps
    return Panel(
        parameter.name,
        f"<b>{plain(parameter.name)}</b> {plain(parameter.joint)}: {plain(parameter.kind)}{at}",
        traces,
        x={"type": "date", "nticks": 4},
        y=titled(parameter.unit),
        vertical=[(1000.0 * step.after, {"color": RESIDUAL, "width": 1, "dash": "dot"}) for step in steps],
        height=170,
    )
