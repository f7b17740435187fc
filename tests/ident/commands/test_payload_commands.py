"""`dynid payload` and `dynid gains` as a user calls them."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import pytest
from command_line import stored
from html_page import Page
from loaded_arm import runs

from daq.recording.writer import write_recording
from ident.model.parameters import INERTIAL


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for name, recording in zip(("free", "loaded"), runs(0, hidden=True), strict=True):
        write_recording(folder / f"{name}.h5", recording)
    content = (folder / "loaded.h5").read_bytes()
    (folder / "nocurrent.h5").write_bytes(content)
    with h5py.File(folder / "nocurrent.h5", "a") as file:
        del file["streams/joints/current"]
    return folder


def test_payload_in_words_and_as_a_page(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    status, out, err = run_dynid("payload", "free.h5", "loaded.h5", "--mass", "2.8", "-v")
    assert out.endswith("\nloaded-payload/payload.json\nloaded-payload/report.html\n")
    content = json.loads((folder / "loaded-payload" / "payload.json").read_text(encoding="utf-8"))
    page = Page((folder / "loaded-payload" / "report.html").read_text(encoding="utf-8"))
    outcome = run_dynid("payload", "free.h5", "loaded.h5", "--mass", "2.8", "--force")[1]
    assert outcome.count("\n") <= 20
    assert all(f"warning: {warning}" in outcome for warning in content["warnings"])
    for sentence in content["sentences"]:
        assert sentence in out
        assert sentence in page.words
    assert set(page.figures) == {"load-plot", "changes-plot"}
    assert "Physically consistent load" in page.words
    assert content["consistent_load"]["mass"] == pytest.approx(2.8)
    assert (status, err) == (0, "")
    for expected in (
        "M_L",
        "Centre of mass",
        "tool frame",
        "free plus load",
        "the known 2.8 kg",
        "Load with the",
        "Physically consistent load",
    ):
        assert expected in out


def test_payload_as_json(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    status, out, _ = run_dynid("payload", "free.h5", "loaded.h5", "--json", "-o", "load")
    content = json.loads(out)
    assert content == stored(folder / "load" / "payload.json")
    assert status == 0
    assert [row["name"] for row in content["load"]] == [f"{symbol}_L" for symbol in INERTIAL]
    assert content["known"] is None
    assert content["load_with_known"] is None
    assert content["tests"]["mass"] is None


def test_gains_in_words_and_as_a_page(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    status, out, err = run_dynid("gains", "free.h5", "loaded.h5", "--mass", "2.8")
    assert out.endswith("\nloaded-gains/gains.json\nloaded-gains/report.html\n")
    content = json.loads((folder / "loaded-gains" / "gains.json").read_text(encoding="utf-8"))
    page = Page((folder / "loaded-gains" / "report.html").read_text(encoding="utf-8"))
    assert set(page.figures) == {"gains-plot"}
    assert out.count("\n") <= 20
    assert content["robot_file_text"].splitlines()[1].strip() in page.words
    assert (status, err) == (0, "")
    for expected in ("shoulder_pan_joint", "robot file", "RSD", "for the robot file:\ndrives:\n  - {joint:"):
        assert expected in out


def test_gains_as_json(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    arguments = ["gains", "free.h5", "loaded.h5", "--mass", "2.8", "--json", "-o", "gains"]
    status, out, _ = run_dynid(*arguments, "--com", "0.03,-0.02,0.08", "--inertia", "0.01,0.001,0,0.012,0,0.009")
    content = json.loads(out)
    assert status == 0
    assert content["kind"] == "gains"
    assert content["unit"] == "N·m/A"
    assert content["gains"][2]["gain"] == pytest.approx(1.05 * 11.13, rel=0.03)
    assert content["known"]["com"] == [0.03, -0.02, 0.08]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["gains", "free.h5", "loaded.h5"], "without the load's mass"),
        (["gains", "free.h5", "nocurrent.h5", "--mass", "2.8"], "records no motor current"),
        (["gains", "free.h5", "free.h5", "--mass", "2.8"], "same file"),
        (["gains", "free.h5", "loaded.h5", "--mass", "-1"], "not possible"),
        (["gains", "free.h5", "missing.h5", "--mass", "2.8"], "missing.h5"),
        (["payload", "free.h5", "loaded.h5", "--mass", "nan"], "not a finite number"),
        (["payload", "free.h5", "loaded.h5", "--com", "0,0,0.1"], "whose mass is missing"),
        (["payload", "free.h5", "loaded.h5", "--mass", "2.8", "--com", "0;0;0"], "separated by commas"),
        (["payload", "free.h5", "loaded.h5", "--mass", "2.8", "--com", "0,0"], "3 finite numbers"),
        (["payload", "free.h5", "loaded.h5", "--delay", "soon"], "--delay soon"),
        (["payload", "free.h5", "loaded.h5", "--delay", "50"], "longer than the recording"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, said, folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    status, out, err = run_dynid(*arguments, "-o", "untouched")
    assert not Path("untouched").exists()
    assert status == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1
    assert out == ""
