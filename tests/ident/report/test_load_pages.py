"""Pages of a load and of drive gains, from results of every kind."""

from __future__ import annotations

import math

import pytest
from html_page import Page

from ident.assessment.delay.delay import DelaySearch
from ident.experiments.gains.drive_gains import DriveGains, EstimatedValue, GainEstimate
from ident.experiments.gains.up_and_down import SlowGain, SlowGainsResult
from ident.experiments.load.load_estimate import LoadParameter
from ident.experiments.load.payload import BaseParameterChange, Payload, PayloadTests
from ident.model.load import KnownLoad
from ident.regression.hypothesis_tests import SignificanceTest
from ident.report.load_pages import gains_page, payload_page

HOSTILE = "<script>alert(1)</script>"
KNOWN = KnownLoad(2.8, (0.0, 0.1, 0.2))
TEST = SignificanceTest(3.0, 1, 1e-9)


def parameter(name: str, value: float | None, std: float | None) -> LoadParameter:
    return LoadParameter(
        name=name,
        expression=name,
        unit="kg",
        value=value,
        std=std,
        noise_std=std,
        gain_std=None if std is None else 0.0,
    )


def payload(**changes: object) -> Payload:
    content: dict[str, object] = {
        "robot": "arm",
        "runs": ["free.h5", HOSTILE],
        "frame": "tool frame",
        "load": [parameter("M_L", 2.75, 0.1)],
        "load_with_known": None,
        "consistent_load": None,
        "centre_of_mass": None,
        "not_identifiable": ["XX_L"],
        "unexcited": [],
        "known": None,
        "base_parameters": [],
        "tests": PayloadTests(mass=None, values=None, load=None, known_load=None, unchanged=None),
        "delay": DelaySearch(used=0.0, note="none"),
        "blocks": 9,
        "block_length": 8,
        "warnings": [HOSTILE],
    }
    return Payload(**(content | changes))


def gain(joint: str, value: float | None, file_gain: float | None) -> GainEstimate:
    return GainEstimate(
        joint=joint, gain=value, std=None if value is None else 1234.56 * value,
        file_gain=file_gain, angle_degrees=3.0, confused_with=HOSTILE, correlation=0.5, noise=0.1,
    )  # fmt: skip


def gains(*of: GainEstimate) -> DriveGains:
    return DriveGains(
        robot="arm", runs=["free.h5", "loaded.h5"], signal="current", unit="N·m/A", known=KNOWN, gains=list(of),
        covariance=[], base_parameters=[EstimatedValue(name="ZZ1", unit="kg·m²", value=1.0, std=None)], load=[],
        condition=5.0, gap=math.inf, delay=DelaySearch(used=0.0, note="none"), blocks=9, block_length=8,
        robot_file_text=f"drives: {HOSTILE}", warnings=[],
    )  # fmt: skip


def read(text: str) -> Page:
    assert HOSTILE not in text
    page = Page(text)
    links = [str(attributes["href"])[1:] for tag, attributes in page.elements if tag == "a"]
    assert set(links) <= set(page.ids())
    return page


def test_a_load_of_which_nothing_is_known() -> None:
    page = read(payload_page(payload()))
    assert list(page.figures) == ["load-plot"]
    assert "whether a load explains the change: too few blocks of data to decide" in page.words
    assert HOSTILE in page.words
    assert "too little data to decide" in page.words
    assert "Mass agrees" not in page.words


def test_a_load_that_is_known_and_what_it_changes() -> None:
    change = BaseParameterChange(
        name="MX3", unit="kg·m", free=1.0, free_std=0.3, predicted=3.0, loaded=3.5, loaded_std=0.4
    )
    unknown = change.model_copy(update={"name": "MY3", "loaded_std": math.nan})
    tests = PayloadTests(mass=TEST, values=None, load=TEST, known_load=None, unchanged=None)
    page = read(
        payload_page(
            payload(
                known=KNOWN,
                base_parameters=[change, unknown],
                tests=tests,
                load_with_known=[parameter("M_L", None, None)],
            )
        )
    )
    assert "Mass agrees" in page.words
    assert "p < 0.0001" in page.words
    changed, left = page.figures["changes-plot"]["data"]
    assert changed["x"] == [pytest.approx(5.0)]
    assert left["x"] == [pytest.approx(1.0)]


def test_gains_with_and_without_a_value() -> None:
    page = read(gains_page(gains(gain("j1", 11.0, 10.0), gain("j2", None, 10.0), gain("j3", 5.0, None))))
    absolute, file, change = page.figures["gains-plot"]["data"]
    assert absolute["y"] == ["j1", "j3"]
    assert file["y"] == ["j1", "j2"]
    assert change["x"] == [pytest.approx(10.0)]
    assert "123456" in page.words
    assert list(read(gains_page(gains(gain("j1", None, None)))).figures) == []


def test_gains_from_slow_runs() -> None:
    slow = SlowGain(
        joint="j1", gain=10.0, std=0.1, file_gain=None, sweeps=3, positions=20, speed=0.05,
        friction_free=2.0, friction_loaded=None, reason=None,
    )  # fmt: skip
    result = SlowGainsResult(
        robot="arm", runs=["free.h5", "loaded.h5"], signal="voltage", unit="N·m/V", known=KNOWN, gains=[slow], load=[],
        gap=4.0, robot_file_text="drives:", warnings=[],
    )  # fmt: skip
    page = read(gains_page(result))
    assert "slow runs up and down" in page.words
    assert "N·m/V" in page.words
    assert "Confounded with" not in page.words
