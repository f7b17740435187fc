"""The page of a recording: every signal and gap of it, the cut-offs that identification chooses, nothing that runs."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from html_page import Page

from daq.recording.recording import Channel, Event, Recording, Stream
from drivers.core.errors import UsageError
from ident.checks.page.page import MOST_COLUMNS, MOST_GAPS, render_page
from ident.checks.recording_check import info_object, recording_info
from ident.model.dynamic_model import build_model
from ident.tasks.recording_quality import RecordingQuality
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_rows, with_values


def values(packed: Mapping[str, str]) -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype="<f4")


@pytest.fixture(scope="module")
def run(three_joint) -> Recording:
    """A recording with a gap of 100 samples and a slow thermometer that began 0.5 s later."""
    motion = random_fourier_motion(build_model(three_joint), 6.0, seed=2, candidates=2)
    whole = simulate_recording(three_joint, motion, 8.0, seed=2, rate=200.0)
    joints = whole.streams["joints"]
    kept = np.delete(np.arange(len(joints.time)), np.arange(600, 700))
    channels = {name: replace(one, values=one.values[kept]) for name, one in joints.channels.items()}
    joints = Stream("joints", joints.time[kept], joints.time[kept] + 100.0, channels)
    time = np.arange(0.0, 7.0, 0.5)
    warm = Channel("temperature", 30.0 + time[:, None], "degC", ("base",))
    thermometer = Stream("thermometer", time, time + 100.5 + joints.time[0], {"temperature": warm})
    return replace(whole, streams={"joints": joints, "thermometer": thermometer})


@pytest.fixture(scope="module")
def page(run) -> Page:
    return Page(render_page(recording_info(run, run.robot()), "run.h5"))


def panels(page: Page, figure: str) -> list[dict[str, Any]]:
    return list(page.figures[figure]["data"])


def test_every_signal_is_drawn_as_recorded_and_breaks_at_the_gap(page: Page, run: Recording):
    drawn = {(trace["meta"]["panel"], trace["name"]): trace for trace in panels(page, "signals-plot")}
    for stream in run.streams.values():
        for channel in stream.channels.values():
            for column, recorded in zip(channel.columns, channel.values.T, strict=True):
                y = values(drawn[f"{stream.name}/{channel.quantity}", column]["y"])
                np.testing.assert_array_equal(y[~np.isnan(y)], recorded.astype(np.float32))
                assert np.isnan(y).sum() == (stream.name == "joints")
    assert len(drawn) == sum(len(c.columns) for s in run.streams.values() for c in s.channels.values())


def test_streams_stand_beside_each_other_by_the_hosts_clock(page: Page):
    (warm,) = page.traces("signals-plot", "base")
    assert values(warm["x"])[0] == pytest.approx(0.5)


def test_intervals_show_the_gap(page: Page):
    (joints,) = page.traces("intervals-plot", "joints")
    intervals = values(joints["y"])
    assert intervals.max() == pytest.approx(505.0, rel=1e-3)
    assert np.median(intervals) == pytest.approx(5.0, rel=1e-3)
    assert "100 lost in 1 gap" in json.dumps(page.figures["intervals-plot"]["layout"])
    assert "Samples lost" in page.words


def test_spectra_hold_the_cutoffs_that_identification_chooses(page: Page, run: Recording):
    cutoffs = recording_info(run, run.robot()).motion.prepared.cutoffs
    lines = {(shape["xref"], shape["x0"]) for shape in page.figures["spectra-plot"]["layout"]["shapes"]}
    assert lines == {("x", cutoffs.band), ("x", cutoffs.position), ("x2", cutoffs.band), ("x2", cutoffs.torque)}
    assert "--torque-cutoff" in page.words


def test_a_sine_stands_at_its_frequency(run: Recording):
    time = np.arange(0, 40.0, 0.01)
    position = np.stack([np.sin(2 * np.pi * frequency * time) for frequency in (0.5, 1.0, 2.0)], axis=1)
    sine = Recording.from_arrays(run.robot(), time=time, position=position, current=position)
    page = Page(render_page(recording_info(sine, sine.robot()), "sine.h5"))
    for trace, frequency in zip(panels(page, "spectra-plot")[:3], (0.5, 1.0, 2.0), strict=True):
        assert values(trace["x"])[np.nanargmax(values(trace["y"]))] == pytest.approx(frequency, abs=0.13)


def test_headline_checks_and_events_are_those_of_the_terminal(run: Recording):
    noted = replace(run, events=(Event(1.0, "warning", "import", "columns were renamed"),))
    info = recording_info(noted, noted.robot())
    words = Page(render_page(info, "run.h5")).words
    assert info.verdict.headline in words
    assert all(check.text in words for check in info.verdict.checks)
    assert "columns were renamed" in words


def test_a_recording_without_samples_or_motion_has_a_page(run: Recording):
    joints = run.streams["joints"]
    empty = replace(run, streams={"joints": with_rows(run, slice(0)).streams["joints"]})
    page = Page(render_page(recording_info(empty, empty.robot()), "empty.h5"))
    assert page.figures == {}
    assert "holds no samples" in page.words
    resting = with_values(run, **{name: np.zeros_like(one.values) for name, one in joints.channels.items()})
    assert "spectra-plot" not in Page(render_page(recording_info(resting, resting.robot()), "still.h5")).figures


def test_many_gaps_and_columns_are_cut_and_said(run: Recording):
    time = np.repeat(np.arange(200) * 0.15, 10) + np.tile(np.arange(10) * 0.01, 200)
    wide = Channel("voltage", np.ones((len(time), 100)), "V", tuple(f"c{k}" for k in range(100)))
    ragged = replace(run, streams={"bus": Stream("bus", time, time, {"voltage": wide})})
    page = Page(render_page(recording_info(ragged, ragged.robot()), "ragged.h5"))
    assert f"The first {MOST_GAPS} of 199" in page.words
    assert len(panels(page, "signals-plot")) == MOST_COLUMNS
    assert f"{MOST_COLUMNS} of 100 columns" in json.dumps(page.figures["signals-plot"]["layout"])


def test_names_stay_text(run: Recording):
    evil = "</script><script>alert(1)</script><b>x"
    joints = run.streams["thermometer"]
    channel = replace(joints.channels["temperature"], columns=(evil,), unit=evil)
    hostile = replace(
        run,
        streams={"joints": run.streams["joints"], evil: Stream(evil, joints.time, joints.host_time, {evil: channel})},
        events=(Event(0.0, "info", evil, evil),),
    )
    text = render_page(recording_info(hostile, hostile.robot()), evil)
    assert "<script>alert(1)" not in text
    assert "<b>x" not in text
    assert evil in Page(text).words


def test_nothing_is_fetched(page: Page):
    for tag, attributes in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "form")
        assert "src" not in attributes
        assert (attributes.get("href") or "#").startswith("#")
    links = [str(attributes["href"])[1:] for tag, attributes in page.elements if tag == "a"]
    assert set(links) <= set(page.ids())


def test_json_and_page_lie_in_one_folder(run: Recording, tmp_path: Path):
    info = recording_info(run, run.robot())
    folder = tmp_path / "new" / "info"
    quality = RecordingQuality("run.h5", info)
    quality.save(folder)
    assert sorted(path.name for path in folder.iterdir()) == ["info.html", "info.json"]
    written = json.loads((folder / "info.json").read_text(encoding="utf-8"))
    assert written["streams"]["joints"]["lost"] == info_object(info, "run.h5")["streams"]["joints"]["lost"] == 100
    with pytest.raises(UsageError, match="a folder is needed"):
        quality.save(folder / "info.html")
