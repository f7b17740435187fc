"""`dynid friction` and `dynid identify --friction-from` as a user calls them."""

from __future__ import annotations

import json

import pytest
from command_line import stored
from friction_experiment_arm import GIVEN, sweeps
from html_page import Page

from daq.recording.writer import write_recording

pytestmark = pytest.mark.usefixtures("estimates_alone")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweeps")
    for index, recording in enumerate(sweeps()):
        write_recording(path / f"sweep{index}.h5", recording)
    return path


def test_friction_in_words_as_json_and_as_a_page(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    names = [f"sweep{index}.h5" for index in range(4)]
    options = ["--friction", GIVEN, "--delay", "0"]
    status, out, err = run_dynid("friction", names[0], names[3], *options)
    assert (status, err) == (0, "")
    assert out.endswith("\nsweep0-friction/friction.json\nsweep0-friction/report.html\n")
    assert "j2" in out
    status, as_json, _ = run_dynid("friction", *names, *options, "--json", "--force")
    content = json.loads(as_json)
    assert content == stored(folder / "sweep0-friction" / "friction.json")
    assert [joint["joint"] for joint in content["joints"]] == ["j1", "j2"]
    page = Page((folder / "sweep0-friction" / "report.html").read_text(encoding="utf-8"))
    assert set(page.figures) == {"speed-plot", "temperature-plot", "load-plot"}
    assert "What the recordings cover" in page.words
    line = ["identify", "sweep0.h5", "--friction-from", "sweep0-friction", "--delay", "0", "-o", "model", "--json"]
    status, as_json, _ = run_dynid(*line)
    origins = {entry["name"]: entry["origin"] for entry in json.loads(as_json)["base_parameters"]}
    assert status == 0
    assert origins["Fts1"] == "friction experiment"
    assert origins["Fs1"] == ""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("friction sweep0.h5 --friction sticky", "no friction model is called 'sticky'"),
        ("friction missing.h5", "missing.h5: no such file"),
        ("identify sweep0.h5 --friction-from missing.json", "missing.json: no such file"),
        ("identify sweep0.h5 --friction-from sweep1.h5", "sweep1.h5"),
    ],
)
def test_bad_input_is_refused_in_one_line(folder, run_dynid, monkeypatch, line, message):
    monkeypatch.chdir(folder)
    status, out, err = run_dynid(*line.split(), "-o", "elsewhere")
    assert (status, out) == (2, "")
    assert message in err
