"""The page of a gravity identification: one self-contained HTML file."""

from __future__ import annotations

import numpy as np

from drivers.core.text import percent_text
from drivers.core.units import common_unit
from ident.experiments.gravity.experiment import GravityExperiment
from ident.report.figures.figures import MEASURED, PREDICTED, Figure, bold, titled
from ident.report.figures.panels import Panel, in_rows, panel_figure
from ident.report.figures.traces import legend, points_trace
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.result.gravity import GravityJoint, GravityResult
from ident.views.number_text import number

CAPTION = (
    "Torque without friction in every pose (the mean of both directions), and its prediction from the other poses, in "
    "the order of the recording."
)


def gravity_page(experiment: GravityExperiment) -> str:
    """The page: verdict, errors beside gravity and friction, poses, parameters."""
    result = experiment.result
    return rendered("gravity_page", result=result, tiles=_tiles(result), poses=poses_figure(result))


def _tiles(result: GravityResult) -> list[Tile]:
    unit = common_unit("N·m", result.sliding)
    shares = [
        joint.held_out_rms / joint.gravity for joint in result.of_joints if joint.held_out_rms and joint.gravity > 0
    ]
    worst = max((joint.held_out_max for joint in result.of_joints if joint.held_out_max is not None), default=None)
    determined = sum(parameter.value is not None for parameter in result.gravity_parameters)
    return [
        Tile("Error of gravity", percent_text(float(np.median(shares)), 2) if shares else "–", "median of the joints"),
        Tile("Largest error", "–" if worst is None else f"{number(worst, 2)} {unit}", "in a pose left out"),
        Tile("Poses", str(len(result.poses))),
        Tile("Parameters", str(determined), f"of {len(result.gravity_parameters)} determined"),
    ]


def poses_figure(result: GravityResult) -> Figure | None:
    """Measured and predicted gravity of each joint in the poses; None where none was passed in both directions."""
    panels = [_panel(result, row, joint, row == 0) for row, joint in enumerate(result.of_joints) if joint.poses]
    if not panels:
        return None
    return panel_figure("poses-plot", in_rows(panels), CAPTION)


def _panel(result: GravityResult, row: int, joint: GravityJoint, first: bool) -> Panel:
    shown = [place for place, pose in enumerate(result.poses) if pose.measured[row] is not None]
    traces = [
        points_trace(
            [place + 1 for place in shown],
            [getattr(result.poses[place], signal)[row] for place in shown],
            {"color": colour, "symbol": symbol, "size": size, "line": {"width": 1.5, "color": colour}},
            hoverinfo="all",
            **legend(signal, shown=first),
        )
        for signal, colour, symbol, size in (
            ("measured", MEASURED, "circle", 6),
            ("predicted", PREDICTED, "circle-open", 11),
        )
    ]
    return Panel(joint.joint, bold(joint.joint, 36), traces, x=titled("pose"), y=titled(joint.unit), height=170)
