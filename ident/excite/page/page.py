"""The page of a designed excitation: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from daq.motion.trajectories import Motion
from daq.output_files import replace_files
from daq.robot.loader import RobotFile
from drivers.core.units import common_unit
from ident.excite.constraints.constraints import unchecked_pairs
from ident.excite.forecast import ExcitationFigures
from ident.excite.page.arm_scene import arm_figure
from ident.excite.page.plots import clearance_figure, joints_figure, shown_part, tool_figure
from ident.excite.prior import PriorKnowledge
from ident.model.dynamic_model import build_model
from ident.regression.options import SIGNIFICANT_RSD
from ident.report.figures.figures import KIND_STYLES
from ident.report.html_file import page_templates
from ident.report.section import Tile
from ident.views import number_text
from ident.views.number_text import number, percent


def write_page(
    path: Path,
    robot_file: RobotFile,
    motion: Motion,
    prior: PriorKnowledge,
    figures: ExcitationFigures,
    notes: Sequence[tuple[str, str]],
) -> None:
    """Write the page.

    Args:
        path: of the file.
        robot_file: the arm.
        motion: what is played.
        prior: parameters for the torques.
        figures: of the motion.
        notes: options and outcome of the design, as pairs of a name and a text.

    Raises:
        UsageError, DiskError: it cannot be written.
    """
    replace_files({path: render_page(robot_file, motion, prior, figures, notes)})


def render_page(
    robot_file: RobotFile,
    motion: Motion,
    prior: PriorKnowledge,
    figures: ExcitationFigures,
    notes: Sequence[tuple[str, str]],
) -> str:
    """The page as text."""
    shown = shown_part(robot_file, motion, prior)
    unchecked = "; ".join(unchecked_pairs(robot_file, build_model(robot_file))) or "neighbours only"
    return (
        page_templates("ident.excite.page")
        .get_template("excitation_page.html.j2")
        .render(
            robot=robot_file.robot.name,
            tiles=_tiles(figures),
            figures=figures,
            unit=partial(common_unit, sliding=robot_file.robot.sliding),
            notes=[*notes, ("Parameters and noise", figures.prior), ("Links that are not kept apart", unchecked)],
            kinds={kind: words for kind, (words, _, _) in KIND_STYLES.items()},
            threshold=SIGNIFICANT_RSD,
            plots={
                "arm": arm_figure(robot_file, motion, shown),
                "joints": joints_figure(robot_file.robot.joints, shown),
                "tool": tool_figure(robot_file, shown),
                "clearances": clearance_figure(robot_file, shown),
            },
        )
    )


def _tiles(figures: ExcitationFigures) -> list[Tile]:
    forecast = figures.forecast
    known = [p.rsd_percent for p in forecast.parameters if p.rsd_percent is not None]
    significant = sum(value < SIGNIFICANT_RSD for value in known)
    count = len(forecast.parameters)
    return [
        Tile("Duration", f"{number(figures.duration, 4)} s", "from rest to rest"),
        Tile("Condition number", number(forecast.scaled_condition, 3), "columns of unit length; below 50 is good"),
        Tile("Condition", number(forecast.condition, 3), "depends on units"),
        Tile("Largest limit utilisation", percent(figures.worst_use), _worst(figures)),
        Tile("Significant", str(significant) if known else number_text.DASH, _significance(known, count)),
    ]


def _worst(figures: ExcitationFigures) -> str:
    return f"{figures.worst_limit}, at {number(figures.worst_time, 3)} s"


def _significance(known: Sequence[float], count: int) -> str:
    if not known:
        return "without prior parameters no relative standard deviation can be predicted"
    return f"of {count}: predicted RSD below {SIGNIFICANT_RSD:g} %"
