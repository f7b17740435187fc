"""The page of a servo model: one self-contained HTML file."""

from __future__ import annotations

from typing import Any

import numpy as np

from ident.report.figures.figures import MEASURED, PREDICTED, RESIDUAL, Figure, plain, titled
from ident.report.figures.panels import TIME_AXIS, Panel, panel_figure
from ident.report.figures.traces import broken_line, curve_trace, legend, points_per_trace
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.servo.identify import ServoIdentification
from ident.servo.result import ServoResult

ROLLOUT_CAPTION = (
    "Measured positions of the held-out motions, and the model's on the same commands alone; the first second does "
    "not count. Motions are shown side by side."
)


def servo_page(result: ServoResult, identification: ServoIdentification | None) -> str:
    """The page: verdict, errors beside the references, roll-outs, parameters; a result that was read has no motions."""
    rollout = None if identification is None else rollout_figure(result, identification)
    return rendered("servo_page", result=result, tiles=_tiles(result), rollout=rollout)


def _tiles(result: ServoResult) -> list[Tile]:
    shown = result.validation or result.fit
    references = shown.references
    unit = "mm" if all(result.sliding) else "mrad"

    def mean(errors: list[float]) -> str:
        return f"{1e3 * float(np.mean(errors)):.3g} {unit}"

    tiles = [
        Tile("Roll-out error", mean(shown.rollout_error), "held out" if shown.held_out else "not held out"),
        Tile("Encoder step", mean(result.resolution), "mean of the joints"),
        Tile("Command itself", mean(references.command), "without a model"),
        Tile("Delay and lag", mean(references.delay_and_lag), "one for all joints"),
    ]
    if references.model_file is not None:
        tiles.append(Tile("Model file", mean(references.model_file), "original MJCF in MuJoCo"))
    return tiles


def rollout_figure(result: ServoResult, identification: ServoIdentification) -> Figure:
    """Measured and rolled-out positions of each joint over the motions."""
    offsets = np.concatenate([[0.0], np.cumsum([motion.time[-1] + 1.0 for motion in identification.motions])])
    times = [motion.time + offset for motion, offset in zip(identification.motions, offsets, strict=False)]
    points = points_per_trace(len(result.joints))
    rows = []
    for joint, name in enumerate(result.joints):
        traces: list[dict[str, Any]] = []
        for label, colour, series in (
            ("commanded", RESIDUAL, [_commanded(motion, joint) for motion in identification.motions]),
            ("measured", MEASURED, [motion.position[:, joint] for motion in identification.motions]),
            ("rolled out", PREDICTED, [path[:, joint] for path in identification.paths]),
        ):
            x, y = broken_line(times, series, points)
            style = {"color": colour, "width": 1}
            traces.append(curve_trace(x, y, style, type="scattergl", **legend(label, shown=joint == 0)))
        unit = "m" if result.sliding[joint] else "rad"
        last = joint == len(result.joints) - 1
        x_axis = TIME_AXIS if last else {}
        rows.append([Panel(name, f"<b>{plain(name)}</b>", traces, x=x_axis, y=titled(unit))])
    return panel_figure("rollout-plot", rows, ROLLOUT_CAPTION, linked=True)


def _commanded(motion: Any, joint: int) -> Any:
    return np.interp(motion.time, motion.grid, motion.command[motion.history :, joint])
