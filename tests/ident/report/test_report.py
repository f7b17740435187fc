"""The HTML report: complete, self-contained, safe, honest about what was left out."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from html_page import Page
from torque_series import series

from drivers.core.errors import UsageError
from ident.assessment.delay.delay import DelaySearch, JointDelay
from ident.assessment.validation import Fit
from ident.report import TruthTable, render_report
from ident.report.figures.traces import POINTS_PER_TRACE
from ident.report.section import ReportData
from ident.result.delivered import Delivered
from ident.result.friction import JointFrictionResult
from ident.result.schema import (
    BaseParameterResult,
    DriveGainResult,
    Essential,
    Excitation,
    ModelOptions,
    RecordingUse,
    Residuals,
    Result,
)
from ident.signals.prepared import Step
from ident.tasks.identification import IdentificationResult
from ident.verdict.catalogue import raised
from ident.verdict.check import Check
from ident.verdict.verdict import JointVerdict, PurposeVerdict, Verdict, judge

JOINTS = ["j1", "j2"]
ANCHORS = [
    "summary",
    "errors",
    "torques-validation",
    "torques-fit",
    "residuals",
    "friction",
    "parameters",
    "excitation",
    "data-quality",
    "provenance",
]


def values(packed: dict[str, str]) -> np.ndarray[Any, np.dtype[np.float32]]:
    assert packed["dtype"] == "f4"
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype="<f4")


def fit(samples: int = 600) -> Fit:
    return Fit(
        relative_error=0.0731,
        joint_relative_error=[0.05, None],
        rmse=[0.1, 0.2],
        low_speed_rmse=[None, 0.3],
        high_speed_rmse=[0.1, 0.2],
        max_error=[0.4, 0.5],
        samples=samples,
    )


def parameter(name: str, kind: Any = "inertial", *, value: float | None = 1.25, std: float | None = 0.01) -> Any:
    significant = value is not None
    return BaseParameterResult(
        name=name,
        expression=f"{name} + 0.1·M2",
        kind=kind,
        joint="j1",
        unit="kg·m²",
        value=value,
        std=std,
        rsd_percent=None if value is None or std is None else 100 * std / abs(value),
        classical_std=std,
        significant=significant,
        essential_value=value,
        essential_std=std,
    )


def result(**changes: Any) -> Result:
    found = Result(
        created="2025-01-01T00:00:00+00:00",
        robot="two-joint arm",
        robot_file="name: two\n",
        urdf="",
        joints=JOINTS,
        method="wls",
        options={"torque_cutoff": None, "decimate": 10, "significance": 30.0},
        model_options=ModelOptions(
            motor_inertia=[True, False],
            viscous=[True, True],
            coulomb=[True, True],
            offset=[False, False],
            smoothing=0.0,
        ),
        preprocessing=[Step(name="filter", settings={"cutoff": 12.5}, text="low-passed at 12.5 Hz")],
        delay=DelaySearch(
            used=0.004,
            best=0.004,
            note="torque lags the motion by 4.00 ± 0.30 ms",
            interval=0.0003,
            gain=0.05,
            joints=[
                JointDelay(joint=JOINTS[0], used=0.004, best=None, interval=None),
                JointDelay(joint=JOINTS[1], used=0.00625, best=0.00625, interval=0.0004),
            ],
        ),
        base_parameters=[
            parameter("ZZ1R"),
            parameter("XX2R", value=None, std=None),
            parameter("Fv1", "viscous", value=-3.5),
        ],
        standard_parameters=None,
        friction=[
            JointFrictionResult(
                joint=name, viscous=1.0, viscous_std=0.1, coulomb=2.0, coulomb_std=None, offset=None, offset_std=None
            )
            for name in JOINTS
        ],
        drive_gains=[DriveGainResult(joint=name, signal="current", gain=10.0, std=None) for name in JOINTS],
        fit=fit(),
        validation=fit(300),
        validation_source="another recording",
        delivered=Delivered(parameters="full", fit=fit(), validation=fit(300), validation_all_samples=fit(300)),
        essential=Essential(
            count=2, dropped=["XX2R"], stopped_by="all are significant", fit=fit(), validation=fit(300)
        ),
        excitation=Excitation(condition=120.0, scaled_condition=30.0, singular_values=[2.0, 0.1], unexcited=["XX2R"]),
        condition=120.0,
        residuals=Residuals(
            rows=1200,
            effective_rows=400.0,
            joint_std=[0.1, 0.1],
            autocorrelation=[0.1, 0.1],
            block_length=5,
            blocks=60,
            repetitions=1.0,
            correction="HAC",
        ),
        rank_margin=None,
        recordings=[
            RecordingUse(
                file="run.h5",
                sha256="ab" * 32,
                role="identification",
                window=(0.0, 6.0),
                samples=6000,
                rate_hz=1000.0,
                events=["warning: gap of 0.2 s"],
            )
        ],
        versions={"dynid": "0.1.0"},
        verdict=judge([raised("overfitting", "watch joint j2")], None, "That is usable."),
    )
    return found.model_copy(update=changes)


def page(found: Result | None = None, **changes: Any) -> Page:
    data = {"fit": (series(), series(3.5)), "validation": (series(seed=1),), "truth": None, **changes}
    return Page(render_report(ReportData(result() if found is None else found, **data)))


@pytest.fixture(scope="module")
def usual() -> Page:
    return page()


def test_every_section_is_there_and_linked(usual: Page) -> None:
    assert [name for name in usual.ids() if name in ANCHORS] == ANCHORS
    links = [attributes["href"] for tag, attributes in usual.elements if tag == "a"]
    assert links[: len(ANCHORS)] == [f"#{anchor}" for anchor in ANCHORS]
    assert {link[1:] for link in links} == set(ANCHORS)  # those of the first screen lead to sections, too
    folded = [attributes["id"] for tag, attributes in usual.elements if tag == "details" and attributes.get("id")]
    assert [name for name in ANCHORS if name not in folded] == ["summary"]
    assert len(usual.ids()) == len(set(usual.ids()))
    for text in ("That is usable.", "watch joint j2", "7.31 %", "ab" * 32, "low-passed at 12.5 Hz", "gap of 0.2 s"):
        assert text in usual.words


def test_every_figure_has_its_place(usual: Page) -> None:
    assert usual.figures
    assert set(usual.figures) <= set(usual.ids())
    for figure in usual.figures.values():
        axes = {key.replace("axis", "") for key in figure["layout"] if re.fullmatch(r"[xy]axis\d*", key)}
        assert {trace.get(axis, axis[0]) for trace in figure["data"] for axis in ("xaxis", "yaxis")} <= axes


def test_nothing_is_fetched(usual: Page) -> None:
    for tag, attributes in usual.elements:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "form")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")
    policies = [attributes["content"] for tag, attributes in usual.elements if attributes.get("http-equiv")]
    assert policies[0] is not None
    assert policies[0].startswith("default-src 'none'")
    assert "http" not in policies[0]


def test_own_style_and_script_name_no_address() -> None:
    text = render_report(ReportData(result(), (series(),), ()))
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)
    script = text[text.rindex("<script>") :]
    assert style is not None
    assert "Plotly.newPlot" in script
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", style[1] + re.sub(r"//[^\n]*", "", script))
    # plotly.js from version 4 on offers to upload a figure unless told otherwise.
    assert "showSendToCloud: false" in script


def test_plotly_is_there_once(usual: Page) -> None:
    scripts = [attributes for tag, attributes in usual.elements if tag == "script"]
    assert sum("data-figure" not in attributes for attributes in scripts) == 2  # plotly.js and the page's own


@pytest.mark.parametrize(
    "evil", ["</script><script>alert(1)</script>", '<img src=x onerror="alert(1)">', "{{ 7 * 7 }}", "&amp; %{x} $x$"]
)
def test_names_stay_text(evil: str) -> None:
    found = result(
        robot=evil,
        joints=[evil, "j2"],
        robot_file=evil,
        urdf=evil,
        verdict=Verdict(
            evil,
            {"simulation": PurposeVerdict("poor", evil)},
            (JointVerdict(evil, "poor", evil),),
            (Check(evil, "serious", ("simulation",), evil, (evil,)),),
            evil,
        ),
        options={evil: evil},
        versions={evil: evil},
        validation_source=evil,
        base_parameters=[
            parameter(evil).model_copy(update={"joint": evil, "expression": evil}),
            parameter("Fv1", "viscous"),
        ],
    )
    attacked = page(found, truth=TruthTable((evil, "Fv1"), np.array([1.0, 2.0])))
    plain = page(
        found.model_copy(update={"robot": "r", "robot_file": "r"}), truth=TruthTable(("Fv1",), np.array([2.0]))
    )
    assert [tag for tag, _ in attacked.elements].count("script") == [tag for tag, _ in plain.elements].count("script")
    assert not any(name.startswith("on") for _, attributes in attacked.elements for name in attributes)
    assert evil in attacked.words
    labels = [note["text"] for note in attacked.figures["torques-fit-plot"]["layout"]["annotations"]]
    assert not any("<img" in label or "<script" in label for label in labels)


def test_what_is_missing_is_a_dash() -> None:
    nothing = Fit(
        relative_error=None,
        joint_relative_error=[None, None],
        rmse=[None, None],
        low_speed_rmse=[],
        high_speed_rmse=[None, None],
        max_error=[None, None],
        samples=0,
    )
    found = result(
        base_parameters=[parameter("ZZ1R", value=None, std=None)],
        fit=nothing,
        condition=None,
        excitation=Excitation(condition=None, scaled_condition=None, singular_values=[], unexcited=[]),
        residuals=result().residuals.model_copy(update={"effective_rows": None, "joint_std": [None, None]}),
        options={},
        recordings=[],
        preprocessing=[],
    )
    words = page(found).words
    assert "–" in words
    assert not re.search(r"\b(None|nan|inf)\b", words)


def test_no_validation() -> None:
    found = result(validation=None, validation_source="")
    without = page(found, validation=())
    assert "No data were held out" in without.words
    assert "torques-validation-plot" not in without.figures
    assert "torques-fit-plot" in without.figures


def test_no_series_at_all() -> None:
    bare = page(fit=(), validation=(series(samples=0),))
    assert not {"torques-fit-plot", "torques-validation-plot", "residuals-plot"} & set(bare.figures)
    assert "No torques of the identification data" in bare.words


def test_long_series_are_thinned_to_their_envelope() -> None:
    long = series(samples=200_000, rate=1000.0)
    long.measured[1, 123_456] = 99.0
    long.measured[1, 65_432] = -77.0
    text = render_report(ReportData(result(), (long, series(201.0, 100_000, rate=1000.0)), (long,)))
    thinned = Page(text)
    for figure in ("torques-fit-plot", "torques-validation-plot"):
        for name in ("measured", "predicted", "residual"):
            for trace in thinned.traces(figure, name):
                assert len(values(trace["x"])) == len(values(trace["y"])) <= 1.01 * POINTS_PER_TRACE
        shown = values(thinned.traces(figure, "measured")[1]["y"])
        assert np.nanmax(shown) == 99.0
        assert np.nanmin(shown) == -77.0
    assert thinned.words.count("keeps all peaks") == 2
    assert len(text.encode()) < 2.5e6


def test_short_series_are_shown_as_they_are(usual: Page) -> None:
    np.testing.assert_array_equal(
        values(usual.traces("torques-validation-plot", "measured")[0]["y"]),
        series(seed=1).measured[0].astype(np.float32),
    )
    assert "keeps all peaks" not in usual.words


def test_no_line_across_a_gap(usual: Page) -> None:
    for name in ("measured", "predicted", "residual"):
        trace = usual.traces("torques-fit-plot", name)[0]
        time, torque = values(trace["x"]), values(trace["y"])
        assert np.flatnonzero(np.isnan(torque)).tolist() == [300]
        np.testing.assert_allclose(time[[299, 301]], [2.99, 3.5], rtol=1e-6)
    assert "2 gap-free segments" in usual.words


def test_no_residual_where_samples_do_not_count() -> None:
    still = series()
    still.used[100:150] = False
    shown = page(fit=(still,))
    residual = values(shown.traces("torques-fit-plot", "residual")[0]["y"])
    assert np.isnan(residual[100:150]).all()
    assert np.isfinite(residual).sum() == 250
    assert "Samples not used" in shown.words


def test_truth_section() -> None:
    truth = TruthTable(("ZZ1R", "XX2R", "unknown"), np.array([1.24, 0.5, 1.0]))
    told = page(truth=truth)
    assert "truth" in told.ids()
    assert "1 of 1" in told.words  # XX2R has no estimate, Fv1 no truth
    assert "without a base parameter in this result: unknown" in told.words
    assert told.figures["truth-plot"]["data"][0]["x"] == [pytest.approx(1.0)]
    far = page(truth=TruthTable(("ZZ1R",), np.array([1.5])))
    assert "0 of 1" in far.words
    assert "truth" not in page().ids()


def test_written_as_utf8(tmp_path: Path) -> None:
    IdentificationResult(result(robot="Größe ✓"), (series(),)).save(tmp_path)
    text = (tmp_path / "report.html").read_bytes().decode("utf-8")
    assert '<meta charset="utf-8">' in text
    assert "Größe ✓" in text


def test_unwritable_place_is_told(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(UsageError, match="is a folder; a file is needed"):
        IdentificationResult(result(), (series(),)).save(tmp_path)
    assert not (tmp_path / "result.json").exists()


@each(
    "make",
    [
        lambda: TruthTable(("a", "b"), np.zeros(1)),
        lambda: TruthTable(("a", "a"), np.zeros(2)),
        lambda: ReportData(result(joints=["one"]), (series(),), ()),
    ],
)
def test_mistakes_of_the_caller(make: Callable[[], object]) -> None:
    with pytest.raises(ValueError):
        make()
