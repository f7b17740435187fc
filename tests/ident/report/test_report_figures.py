"""Figures of the report: friction against its truth, correlation, panels that never lie on each other."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from html_page import Page
from hypothesis import given
from hypothesis import strategies as st

from ident.model.dynamic_model import build_model
from ident.regression.comparison import TorqueSeries
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.report.figures.panels import Panel, panel_figure
from ident.report.page import render_report
from ident.report.recorded_runs import MotionSegment, RecordedRuns, TemperatureSeries
from ident.report.section import ReportData
from ident.report.sections import correlation, friction
from ident.result.schema import Result
from ident.tasks.identification import IdentificationResult, identify
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording


def values(packed: Mapping[str, str]) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype="<f4")


@pytest.fixture(scope="module")
def identified(three_joint) -> IdentificationResult:
    motion = random_fourier_motion(build_model(three_joint), 8.0, seed=4, candidates=2)
    return identify(simulate_recording(three_joint, motion, 12.0, seed=4))


@pytest.fixture(scope="module")
def data(identified) -> ReportData:
    return ReportData(
        identified.result, identified.fit_series, identified.validation_series, recorded=identified.recorded
    )


def traces(figure, joint: str, name: str) -> list[dict[str, Any]]:
    return [trace for trace in figure.data if trace["meta"]["panel"] == joint and trace["name"] == name]


def test_friction_data_are_the_measured_torque_without_the_other_terms(data: ReportData):
    figure = friction.section(data).context["figure"]
    for joint, name in enumerate(data.result.joints):
        stored = data.result.friction[joint]
        (points,) = traces(figure, name, "data")
        velocity = np.concatenate([series.velocity[joint, series.used] for series in data.fit])
        residual = np.concatenate([series.residual[joint, series.used] for series in data.fit])
        expected = residual + stored.viscous * velocity + stored.coulomb * np.sign(velocity) + (stored.offset or 0.0)
        # The points are a random part of the samples.
        shown = dict(zip(velocity.astype(np.float32).tolist(), expected.tolist(), strict=True))
        for x, y in zip(values(points["x"]).tolist(), values(points["y"]).tolist(), strict=True):
            assert y == pytest.approx(shown[x], rel=1e-5, abs=1e-5)


def test_friction_band_holds_the_truth_and_is_that_of_the_covariance(data: ReportData, three_joint):
    figure = friction.section(data).context["figure"]
    inside = []
    for joint, name in enumerate(data.result.joints):
        (curve,) = traces(figure, name, "model")
        velocity, torque = values(curve["x"]), values(curve["y"])
        backward, forward = traces(figure, name, "95 % interval")
        truth = three_joint.robot.truth.joints[name]
        for side, outline in ((velocity < 0, backward), (velocity > 0, forward)):
            upper, lower = np.split(values(outline["y"]), 2)
            half = (upper - lower[::-1]) / 2
            np.testing.assert_allclose((upper + lower[::-1]) / 2, torque[side], rtol=1e-4, atol=1e-5)
            true = truth.viscous * velocity[side] + truth.coulomb * np.sign(velocity[side]) + truth.offset
            inside.append(np.mean(np.abs(true - torque[side]) <= half))
        # At standstill, what remains are Coulomb friction and offset.
        names = [
            p.name
            for kind in ("coulomb", "offset")
            for p in data.result.base_parameters
            if p.kind == kind and p.joint == name
        ]
        places = [data.result.estimate.parameters.index(one) for one in names]
        covariance = np.array(data.result.estimate.covariance)[np.ix_(places, places)]
        at_rest = WITHIN_95_PERCENT * np.sqrt(covariance.sum())
        assert values(forward["y"])[0] - torque[velocity > 0][0] == pytest.approx(at_rest, rel=0.05), joint
    assert np.mean(inside) > 0.5


def test_without_covariance_friction_has_no_band_and_correlation_no_section(data: ReportData):
    bare = replace(data, result=data.result.model_copy(update={"estimate": None}))
    figure = friction.section(bare).context["figure"]
    assert {trace["name"] for trace in figure.data} == {"data", "model"}
    assert correlation.section(bare) is None


def test_correlation_is_that_of_the_covariance(data: ReportData):
    section = correlation.section(data)
    (shown,) = section.context["figure"].data
    covariance = np.array(data.result.estimate.covariance)
    expected = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(np.array(shown["z"]), expected, atol=1e-4)
    pairs = section.context["pairs"]
    strengths = [abs(value) for _, _, value in pairs]
    assert strengths == sorted(strengths, reverse=True)
    assert section.context["strong"] == np.sum(
        np.abs(expected[np.triu_indices(len(expected), 1)]) >= correlation.STRONG
    )


def test_an_unknown_variance_leaves_holes(data: ReportData):
    estimate = data.result.estimate
    rows = [
        [None if 0 in (i, j) else value for j, value in enumerate(row)] for i, row in enumerate(estimate.covariance)
    ]
    result: Result = data.result.model_copy(update={"estimate": estimate.model_copy(update={"covariance": rows})})
    (shown,) = correlation.section(replace(data, result=result)).context["figure"].data
    assert shown["z"][0] == [None] * len(rows)
    assert shown["z"][1][1] == 1.0


def test_the_robot_files_inertias_stand_beside_the_estimates(data: ReportData):
    page = Page(render_report(data))
    (known,) = [trace for trace in page.figures["parameters-plot"]["data"] if trace["name"] == "robot file"]
    assert {"ZZR1", *known["y"]} >= {"ZZR1"}
    assert "the robot file's values for the links" in page.words
    without = data.result.model_copy(update={"robot_file": data.result.robot_file.partition("truth:")[0]})
    assert "the robot file's values for the links" not in Page(render_report(replace(data, result=without))).words


def test_motion_and_temperature_are_shown_as_they_are(data: ReportData):
    time = np.linspace(5.0, 6.0, 50)
    values_of = np.vstack([np.sin(time), np.cos(time), time])
    motion = (
        MotionSegment(time, values_of, -values_of, held_out=False),
        MotionSegment(time + 3.0, values_of, -values_of, held_out=True),
    )
    warm = TemperatureSeries("thermometer/temperature", ("base",), time, 30.0 + time[:, None])
    page = Page(render_report(replace(data, recorded=RecordedRuns(motion, (warm,)))))
    held_out = page.traces("motion-plot", "validation")
    np.testing.assert_allclose(values(held_out[0]["x"])[[0, -1]], [3.0, 4.0], rtol=1e-6)
    np.testing.assert_allclose(values(held_out[1]["y"]), -values_of[0], rtol=1e-6)
    (shown,) = page.traces("temperature-plot", "base")
    np.testing.assert_allclose(values(shown["y"]), 30.0 + time, rtol=1e-6)
    assert "No temperature was recorded" in Page(render_report(replace(data, recorded=RecordedRuns(motion)))).words


def test_a_saved_report_has_all_figures(identified, tmp_path):
    identified.save(tmp_path)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert {"friction-plot", "motion-plot", "correlation-plot", "parameters-plot"} < set(page.figures)
    assert "temperature-plot" not in page.figures
    assert page.traces("motion-plot", "validation")


def test_the_worst_joint_comes_first(data: ReportData):
    result = data.result
    order = [judged.joint for judged in result.verdict.joints]
    assert [result.joints[joint] for joint in data.worst_first] == order
    verdict = replace(result.verdict, joints=())
    unjudged = replace(data, result=result.model_copy(update={"verdict": verdict}))
    errors = [result.validation.joint_relative_error[joint] for joint in unjudged.worst_first]
    assert errors == sorted(errors, reverse=True)
    page = Page(render_report(data))
    shown = [trace["meta"]["panel"] for trace in page.traces("torques-fit-plot", "measured")]
    assert shown == order


def panel(height: int, title: str) -> Panel:
    return Panel("name", "heading", [{"type": "scatter"}], x={"title": {"text": title}}, height=height)


@given(
    st.lists(
        st.lists(st.tuples(st.integers(60, 300), st.sampled_from(["", "time", "lag"])), min_size=1, max_size=3),
        min_size=1,
        max_size=8,
    ),
    st.booleans(),
)
def test_panels_never_lie_on_each_other(grid: Sequence[Sequence[tuple[int, str]]], linked: bool):
    rows = [[panel(*cell) for cell in row] for row in grid]
    figure = panel_figure("plot", rows, "", linked=linked)
    count = sum(map(len, rows))
    for layout in (figure.layout, {**figure.layout, **figure.narrow}):
        inner = layout["height"] - layout["margin"]["t"] - layout["margin"]["b"]
        boxes = []
        for k in range(1, count + 1):
            suffix = "" if k == 1 else str(k)
            x, y = layout[f"xaxis{suffix}"]["domain"], layout[f"yaxis{suffix}"]["domain"]
            assert 0 <= x[0] < x[1] <= 1
            assert 0 <= y[0] < y[1] <= 1
            boxes.append((*x, *y))
        for i, (left, right, low, high) in enumerate(boxes):
            for other_left, other_right, other_low, other_high in boxes[i + 1 :]:
                beside = right <= other_left or other_right <= left
                apart = max(low - other_high, other_low - high) * inner
                assert beside or apart >= 24  # room for a heading
    assert all(figure.narrow[f"xaxis{'' if k == 1 else k}"]["domain"] == [0.0, 1.0] for k in range(1, count + 1))


def test_series_without_used_samples_have_no_friction_figure(data: ReportData):
    still = tuple(replace(series, used=np.zeros_like(series.used)) for series in data.fit)
    assert friction.section(replace(data, fit=still)).context["figure"] is None
    assert isinstance(still[0], TorqueSeries)
