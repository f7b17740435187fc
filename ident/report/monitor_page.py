"""The page of a watched recording: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence

from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from ident.report.figures.figures import PREDICTED, RESIDUAL
from ident.report.html_file import rendered
from ident.report.prediction_page import Line, joints_figure
from ident.result.tables import Table


def monitor_page(
    robot: Robot,
    recording: str,
    tables: Sequence[Table],
    explanation: Sequence[str],
    series: tuple[FloatArray, FloatArray, FloatArray],
) -> str:
    """The page: `series` are stamps (N,) [s], external torque (N, n) and its thresholds (N, n) [N·m or N]."""
    time, external, threshold = series
    lines: list[Line] = [
        ("external torque", RESIDUAL, [external]),
        ("threshold", PREDICTED, [threshold]),
        ("", PREDICTED, [-threshold]),
    ]
    caption = "External torque that acts on the arm, through the observer. Red: threshold of a contact."
    return rendered(
        "monitor_page",
        robot=robot.name,
        recording=recording,
        tables=tables,
        explanation=explanation,
        plot=joints_figure("external-plot", robot.joints, [time], lines, caption),
    )
