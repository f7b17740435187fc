"""The page of a watched recording: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daq.output_files import replace_files
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from ident.report.figures.figures import PREDICTED, RESIDUAL
from ident.report.html_file import page_templates
from ident.report.prediction_page import Line, joints_figure
from ident.result.tables import Table


def write_monitor_page(
    path: Path,
    robot: Robot,
    recording: str,
    tables: Sequence[Table],
    explanation: Sequence[str],
    series: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Write the page.

    Args:
        path: of the file.
        robot: the arm.
        recording: what was watched.
        tables: contacts first.
        explanation: where the thresholds come from, a sentence each.
        series: stamps (N,) [s], external torque (N, n) and its thresholds (N, n) [N·m or N].

    Raises:
        UsageError, DiskError: it cannot be written.
    """
    time, external, threshold = series
    lines: list[Line] = [
        ("external torque", RESIDUAL, [external]),
        ("threshold", PREDICTED, [threshold]),
        ("", PREDICTED, [-threshold]),
    ]
    caption = "External torque that acts on the arm, through the observer. Red: beyond it, a contact is noticed."
    text = (
        page_templates()
        .get_template("monitor_page.html.j2")
        .render(
            robot=robot.name,
            recording=recording,
            tables=tables,
            explanation=explanation,
            plot=joints_figure("external-plot", robot.joints, [time], lines, caption),
        )
    )
    replace_files({path: text})
