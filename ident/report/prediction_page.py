"""The page of a prediction: one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.schema import JointLimits, Robot
from drivers.core.arrays import FloatArray
from ident.identify.predict import PARTS, RecordingPrediction, SegmentPrediction
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.figures import MEASURED, PREDICTED, RESIDUAL, Figure, bold, titled
from ident.report.figures.panels import TIME_AXIS, Panel, panel_figure
from ident.report.figures.traces import broken_line, curve_trace, legend, points_per_trace
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.result.tables import Table

PANEL = 150
"""Height of a panel [px]."""

PART_COLOURS = {"inertial": "#CC79A7", "coriolis": "#E69F00", "gravity": "#009E73", "friction": "#56B4E9"}

Line = tuple[str, str, list[FloatArray]]
"""Label, colour, and a signal (N, n) for each segment."""


def prediction_page(robot: Robot, recording: str, summary: Table, predicted: RecordingPrediction) -> str:
    """The page: torques, residual, and the parts of the prediction."""
    joints, segments = robot.joints, predicted.segments
    samples = sum(len(segment.time) for segment in segments)
    return rendered(
        "prediction_page",
        robot=robot.name,
        recording=recording,
        tiles=[
            Tile("Samples", f"{samples:,}".replace(",", "\u202f"), f"{segments[0].rate:.6g} Hz"),
            Tile("Segments", str(len(segments)), "gap-free"),
        ],
        summary=summary,
        steps=predicted.steps,
        plots={
            "torque": prediction_figure(joints, predicted),
            "residual": _residual_figure(joints, predicted),
            "parts": joints_figure(
                "parts-plot",
                joints,
                _stamps(segments),
                [(part, PART_COLOURS[part], [segment.parts[part] for segment in segments]) for part in PARTS],
                "The parts whose sum is the predicted torque.",
            ),
        },
    )


def prediction_figure(joints: Sequence[JointLimits], predicted: RecordingPrediction) -> Figure:
    """Measured and predicted torque, a panel per joint."""
    segments, origin = predicted.segments, predicted.torque_origin
    measured = [segment.measured for segment in segments if segment.measured is not None]
    lines: list[Line] = [("measured", MEASURED, measured)] if measured else []
    lines.append(("predicted", PREDICTED, [segment.torque for segment in segments]))
    caption = f"Measured: {origin}, shifted by the delay, not filtered." if origin else "No torque was recorded."
    return joints_figure("torque-plot", joints, _stamps(segments), lines, caption)


def _residual_figure(joints: Sequence[JointLimits], predicted: RecordingPrediction) -> Figure | None:
    """The residual with the band that it leaves without contact in one of 20 samples."""
    residual = [segment.residual for segment in predicted.segments if segment.residual is not None]
    if not residual:
        return None
    lines: list[Line] = [("residual", RESIDUAL, residual)]
    caption = (
        "Measured minus predicted torque, both low-passed as at the identification: what the arm exerts on its "
        "surroundings. An external torque that acts on the arm has the opposite sign."
    )
    if predicted.noise is not None:
        band = [WITHIN_95_PERCENT * np.sqrt(segment.std**2 + predicted.noise**2) for segment in predicted.segments]
        lines += [("95 %", PREDICTED, band), ("", PREDICTED, [-limit for limit in band])]
        caption += " Red: its 95 % interval without contact."
    return joints_figure("residual-plot", joints, _stamps(predicted.segments), lines, caption)


def _stamps(segments: Sequence[SegmentPrediction]) -> list[FloatArray]:
    return [segment.time for segment in segments]


def joints_figure(
    anchor: str, joints: Sequence[JointLimits], stamps: Sequence[FloatArray], lines: Sequence[Line], caption: str
) -> Figure:
    """One panel a joint over one time axis; a line without a label belongs to the one before."""
    start = float(stamps[0][0])
    times = [time - start for time in stamps]
    points = points_per_trace(len(joints))
    rows = []
    for joint, limits in enumerate(joints):
        unit, group = limits.unit("N·m"), ""
        traces = []
        for label, colour, signals in lines:
            group = label or group
            x, y = broken_line(times, [np.ascontiguousarray(signal[:, joint]) for signal in signals], points)
            entry = legend(group, shown=joint == 0 and bool(label))
            traces.append(curve_trace(x, y, {"color": colour, "width": 1.3}, f"%{{y:.4g}} {unit}", **entry))
        rows.append([Panel(limits.name, bold(limits.name), traces, x=TIME_AXIS, y=titled(unit), height=PANEL)])
    caption = f"{caption} Time counts from the first sample. Drag to zoom."
    return panel_figure(anchor, rows, caption, linked=True, hovermode="x unified")
