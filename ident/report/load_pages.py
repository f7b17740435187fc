"""Pages of experiments with a load on the tool: the load, or the drive gains."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from ident.experiments.gains.drive_gains import DriveGains, JointGain
from ident.experiments.gains.up_and_down import SlowGainsResult
from ident.experiments.load.load_estimate import LoadParameter
from ident.experiments.load.payload import BaseParameterChange, Payload
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT, SignificanceTest
from ident.report.figures.figures import MEASURED, PREDICTED, Figure
from ident.report.figures.panels import IntervalSeries, interval_panel, panel_figure
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.views.load_tables import gains_tables, payload_tables
from ident.views.number_text import DASH, number, with_error

IDENTIFIED = {"color": MEASURED, "symbol": "circle", "size": 6}
COMPARED = {"color": PREDICTED, "symbol": "diamond-open", "size": 9, "line": {"width": 1.5}}


def payload_page(result: Payload) -> str:
    """The page of a load: the tests in words, its parameters, the body, what it changes."""
    tables = payload_tables(result)
    return rendered(
        "payload_page",
        result=result,
        tiles=_payload_tiles(result),
        load=_load_figure(result),
        load_table=tables[0],
        known_table=None if result.load_with_known is None else tables[1],
        body_table=None if result.consistent_load is None else tables[-2],
        changes_table=tables[-1],
        body_sentences=() if result.consistent_load is None else result.consistent_load.sentences,
        changes=_changes_figure(result.base_parameters),
    )


def _payload_tiles(result: Payload) -> list[Tile]:
    weighed = DASH if result.known is None else f"{number(result.known.mass)} kg"
    tiles = [
        Tile(
            "Mass ± 95 % [kg]",
            with_error(result.mass.value, result.mass.std) if result.mass else DASH,
            f"known: {weighed}",
        ),
        Tile("A load explains the change", _test_word(result.tests.load), _p_value(result.tests.load)),
        Tile("Friction and the rest unchanged", _test_word(result.tests.unchanged), _p_value(result.tests.unchanged)),
    ]
    if result.known is not None:
        tiles.insert(1, Tile("Mass agrees", _test_word(result.tests.mass), _p_value(result.tests.mass)))
    return tiles


def _test_word(test: SignificanceTest | None) -> str:
    return DASH if test is None else "yes" if test.passed else "no"


def _p_value(test: SignificanceTest | None) -> str:
    return "too little data to decide" if test is None else test.p_text


def _load_figure(result: Payload) -> Figure | None:
    """The load's parameters, a panel per unit."""
    units = list(dict.fromkeys(row.unit for row in result.load if isfinite(row.value)))
    if not units:
        return None
    sets = [("identified ± 95 %", result.load, IDENTIFIED)]
    if result.load_with_known is not None:
        sets.append(("with known values held fixed", result.load_with_known, COMPARED))
    panels = []
    for unit in units:
        rows = [row.name for row in result.load if row.unit == unit]
        series = [_load_series(label, of, marker, shown=unit == units[0]) for label, of, marker in sets]
        panels.append([interval_panel(f"load [{unit}]", f"<b>load</b> [{unit}]", rows, series, unit)])
    caption = "Load parameters in the tool frame with their 95 % intervals, noise and drive gains together."
    return panel_figure("load-plot", panels, caption)


def _load_series(label: str, rows: Sequence[LoadParameter], marker: dict[str, Any], *, shown: bool) -> IntervalSeries:
    values, deviations = ({row.name: getattr(row, field) for row in rows} for field in ("value", "std"))
    return IntervalSeries(label, values, marker, deviations, shown=shown)


def _changes_figure(changes: Sequence[BaseParameterChange]) -> Figure | None:
    """Return what the load changed, and what remains once the estimated load is taken off, in σ."""
    sigma = {
        row.name: (row.free_std**2 + row.loaded_std**2) ** 0.5
        for row in changes
        if isfinite(row.free_std + row.loaded_std) and row.free_std + row.loaded_std > 0
    }
    if not sigma:
        return None
    changed = {row.name: (row.loaded - row.free) / sigma[row.name] for row in changes if row.name in sigma}
    left = {
        row.name: (row.loaded - row.predicted) / sigma[row.name]
        for row in changes
        if row.name in sigma and isfinite(row.predicted)
    }
    series = [
        IntervalSeries("loaded − free", changed, COMPARED),
        IntervalSeries("loaded − (free + load)", left, IDENTIFIED),
    ]
    panel = interval_panel("changes [σ]", "<b>base parameters</b> [σ of their difference]", list(sigma), series, "σ")
    caption = (
        "Base parameters that a load changes: their difference between the two runs, over σ of both, and what remains "
        f"when the identified load is added to the free run's. Within ±{WITHIN_95_PERCENT:g} nothing significant "
        "remains."
    )
    return panel_figure("changes-plot", [[panel]], caption)


def gains_page(result: DriveGains | SlowGainsResult) -> str:
    """The page of drive gains: beside those of the robot file, with their intervals, and the text for it."""
    slow = isinstance(result, SlowGainsResult)
    gains, *parameters = gains_tables(result)
    return rendered(
        "gains_page",
        result=result,
        slow=slow,
        tiles=_gain_tiles(result),
        gains=gains,
        muted=[not isfinite(gain.gain) for gain in result.gains],
        figure=_gains_figure(result.gains, result.unit),
        parameters=parameters[0] if parameters else None,
    )


def _gain_tiles(result: DriveGains | SlowGainsResult) -> list[Tile]:
    identified = sum(isfinite(gain.gain) for gain in result.gains)
    return [
        Tile("Gains identified", str(identified), f"of {len(result.gains)}"),
        Tile("Signal", result.signal, f"joint torque = gain · {result.signal}"),
        Tile("Known mass", f"{number(result.known.mass)} kg"),
        Tile("Gap of the null vector", number(result.gap, 3), "times below the next singular value; above 2 is needed"),
    ]


def _gains_figure(gains: Sequence[JointGain], unit: str) -> Figure | None:
    having = [gain for gain in gains if isfinite(gain.gain)]
    if not having:
        return None
    rows = [gain.joint for gain in gains]
    identified = IntervalSeries(
        "identified ± 95 %",
        {gain.joint: gain.gain for gain in gains},
        IDENTIFIED,
        {gain.joint: gain.std for gain in gains},
    )
    file = IntervalSeries("robot file", {gain.joint: gain.file_gain for gain in gains}, COMPARED)
    panels = [interval_panel(f"gain [{unit}]", f"<b>gain</b> [{unit}]", rows, [identified, file], unit)]
    if any(gain.file_gain for gain in having):
        change = IntervalSeries(
            "change",
            {gain.joint: gain.change for gain in gains},
            IDENTIFIED,
            {gain.joint: 100.0 * gain.std / abs(gain.file_gain) for gain in gains if gain.file_gain and gain.std},
            shown=False,
        )
        panels.append(interval_panel("change [%]", "<b>against the robot file</b> [%]", rows, [change], "%"))
    caption = "Identified gains with their 95 % intervals, and their change against the robot file's."
    return panel_figure("gains-plot", [[panel] for panel in panels], caption)
