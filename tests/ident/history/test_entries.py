"""What a history takes from a result, and which results it refuses."""

from __future__ import annotations

import functools
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from each import each
from servo_result import true_servo_result
from true_results import true_result

import dynid
from daq.robot.loader import load_robot
from drivers.core.errors import ResultFileError, UsageError
from ident.history.entry import read_entry
from ident.result.graded import UsedRecording
from ident.result.result_file import result_json
from ident.result.schema import RecordingUse

PATH = Path("model/result.json")


def recording(started: str = "2026-05-01T10:00:00+00:00", serial: str = "7", sha256: str = "a") -> dict:
    shared = UsedRecording(
        file="run.h5", sha256=sha256, role="identification", started=started, serial=serial, temperature=[30, 31, None]
    )
    return RecordingUse(**shared.model_dump(), window=(0.0, 1.0), samples=1, rate_hz=1.0, events=[]).model_dump()


@functools.cache
def stored_text() -> str:
    return result_json(true_result(load_robot("up6")))


def content(*recordings: dict, std: float | None = 0.1, wear: float = 0.0) -> dict:
    stored = json.loads(stored_text())
    for parameter in stored["base_parameters"]:
        parameter["std"] = std
        parameter["value"] *= 1.0 + wear
    return stored | {"recordings": list(recordings)}


def test_a_result_gives_its_arm_its_time_and_its_parameters():
    entry = read_entry(content(recording(), recording("2026-05-01T14:00:00+02:00", sha256="b")), PATH)
    assert entry.arm == "up6 7"
    assert datetime.fromtimestamp(entry.time, UTC) == datetime(2026, 5, 1, 11, 0, tzinfo=UTC)
    values = {value.name: value for value in entry.values}
    assert (values["Fs2"].kind, values["Fs2"].joint, values["Fs2"].unit) == ("Coulomb friction", "L", "N·m")
    assert values["Fs2"].basis == "viscous, coulomb"
    assert [values[f"Fv{k}"].temperature for k in (1, 2, 3)] == [30.0, 31.0, None]
    again = read_entry({**content(recording(), recording("2026-05-01T14:00:00+02:00", sha256="b")), "files": {}}, PATH)
    assert again.digest == entry.digest
    assert read_entry(content(recording(), wear=0.1), PATH).data != entry.data


def test_servo_models_have_values_and_those_of_no_recording_need_a_time():
    file = load_robot("so101")
    stored = json.loads(result_json(true_servo_result(file)))
    with pytest.raises(ResultFileError, match="names no recording"):
        read_entry(stored, PATH)
    entry = read_entry(stored, PATH, datetime(2026, 5, 1, tzinfo=UTC))
    assert entry.kind == "servo"
    assert "armature" in {value.kind for value in entry.values}


@each(
    ("recordings", "std", "words"),
    [
        ([recording("")], 0.1, "does not state when"),
        ([recording("yesterday")], 0.1, "does not state when"),
        ([recording((datetime.now(UTC) + timedelta(days=2)).isoformat())], 0.1, "in the future"),
        ([recording("1970-01-01T00:01:00+00:00")], 0.1, "clock that was not set.*dynid history add .* --time"),
        ([recording(serial="7"), recording(serial="8")], 0.1, "several arms"),
        ([], 0.1, "names no recording"),
        ([recording()], None, "no parameter with a standard deviation"),
        ([recording()], 0.0, "no parameter with a standard deviation"),
    ],
)
def test_results_that_cannot_be_placed_are_refused(recordings, std, words):
    with pytest.raises(ResultFileError, match=words):
        read_entry(content(*recordings, std=std), PATH)


def test_the_command_adds_shows_and_refuses(run_dynid, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = []
    rng = np.random.default_rng(1)
    for month in range(1, 9):
        names.append(f"r{month}.json")
        stored = content(recording(f"2026-0{month}-01T00:00:00", sha256=str(month)), wear=0.02 * month)
        for parameter in stored["base_parameters"]:
            parameter["std"] = 0.001 * abs(parameter["value"]) if parameter["kind"] != "inertial" else None
            parameter["value"] *= 1 + 0.001 * rng.normal()
        Path(names[-1]).write_text(json.dumps(stored))
    run = lambda *arguments: run_dynid("history", *arguments)  # noqa: E731
    assert run("add", *names, "--history", "arm.db")[1].startswith("arm.db: 8 results added\n")
    assert "0 results added, 8 there already" in run("add", *names, "--history", "arm.db")[1]
    status, out, _ = run("arm.db", "--page", "arm.html", "--csv", "arm.csv")
    assert status == 0
    assert len(out.splitlines()) <= 20
    assert "friction rose by" in out
    assert "</html>" in Path("arm.html").read_text()
    assert len(Path("arm.csv").read_text().splitlines()) == 1 + 8 * len(
        [one for one in content()["base_parameters"] if one["kind"] != "inertial"]
    )
    told = json.loads(run("show", "arm.db", "--json")[1])
    assert told["arm"] == "up6 7"
    assert told["trends"][0]["significant"]
    Path("other.json").write_text(json.dumps(content(recording(serial="8"))))
    assert run("add", "other.json", "--history", "arm.db")[0] == 0
    assert "up6 8" in run("--arm", "up6 8", "arm.db")[1]
    said = {
        (): "Missing command",
        ("arm.db",): "holds 2 arms",
        ("arm.db", "--arm", "up6 9"): "no arm 'up6 9'",
        ("none.db",): "no such file",
        ("r1.json",): "is not a history",
        ("add", "arm.db", "--history", "arm.db"): "cannot be read",
        ("add", *names, "--history", "arm.db", "--time", "2026-05-01"): "needs a single result",
        ("add", "r1.json", "--history", "arm.db", "--time", "May"): "is not a time",
    }
    for arguments, words in said.items():
        status, out, err = run(*arguments)
        assert (status, out) == (2, "")
        assert words in err
        assert err.count("\n") == 1
    assert dynid.History("arm.db").arms == ("up6 7", "up6 8")
    with pytest.raises(UsageError, match="is not a time"):
        dynid.History("arm.db").add("r1.json", time=float("nan"))
