"""The commands as a user calls them: the main job end to end, and bad input one by one."""

from __future__ import annotations

import html
import json
from dataclasses import asdict, replace
from pathlib import Path

import command_line
import h5py
import numpy as np
import pytest
from each import each

import dynid
from daq.recording.reader import read_recording
from daq.recording.recording import Event
from daq.recording.writer import write_recording
from daq.robot.loader import load_robot
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("stated_friction", "mistakes_not_sought")

RATE = 125.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with recordings, a result, and files that are not what they should be."""
    folder = tmp_path_factory.mktemp("work")
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    for name, seed, duration in (("run", 1, 14.0), ("val", 2, 8.0), ("short", 3, 0.05)):
        motion = random_fourier_motion(model, 10.0, seed=seed, candidates=3)
        write_recording(folder / f"{name}.h5", simulate_recording(robot_file, motion, duration, seed=seed, rate=RATE))
    content = (folder / "run.h5").read_bytes()
    (folder / "cut.h5").write_bytes(content[: len(content) // 3])
    (folder / "text.h5").write_text("not hdf5")
    (folder / "old").mkdir()
    (folder / "old" / "result.json").write_text("{}")
    (folder / "empty.h5").write_bytes(b"")
    for name, change in (
        ("newer", {"dynid_schema": 99}),
        ("foreign", {"dynid_schema": None}),
        ("norobot", {"robot": ""}),
    ):
        (folder / f"{name}.h5").write_bytes(content)
        with h5py.File(folder / f"{name}.h5", "a") as file:
            for key, value in change.items():
                if value is None:
                    del file.attrs[key]
                else:
                    file.attrs[key] = value
    for name, row, column, value in (("nan", 5, 2, np.nan), ("inf", 7, 1, np.inf)):
        (folder / f"{name}.h5").write_bytes(content)
        with h5py.File(folder / f"{name}.h5", "a") as file:
            file["streams/joints/position"][row, column] = value
    (folder / "backward.h5").write_bytes(content)
    with h5py.File(folder / "backward.h5", "a") as file:
        file["streams/joints/time"][100] = 0.1
    (folder / "still.h5").write_bytes(content)
    with h5py.File(folder / "still.h5", "a") as file:
        file["streams/joints/position"][:] = 0.5
    (folder / "nocurrent.h5").write_bytes(content)
    with h5py.File(folder / "nocurrent.h5", "a") as file:
        del file["streams/joints/current"]
    (folder / "onejoint.h5").write_bytes(content)
    with h5py.File(folder / "onejoint.h5", "a") as file:
        file["streams/joints/position"].attrs["joints"] = [f"a{i}" for i in range(6)]
    (folder / "bad.yaml").write_text("name: x\nmodel: {mdh: []}\njoints: [{name: a, position: [-1, 1], velocity: 1}]\n")
    (folder / "bad.json").write_text('{"kind": "result"')
    (folder / "other.json").write_text('{"kind": "trajectory"}')
    (folder / "bad.csv").write_text("t,q1\n0,1\n1,x\n")
    return folder


@pytest.fixture
def run_dynid(run_dynid, monkeypatch, folder):
    """Calls the command in the folder."""
    monkeypatch.chdir(folder)
    return run_dynid


def test_info_writes_a_page_once(run_dynid, folder):
    status, out, _ = run_dynid("info", "run.h5", "--page", "run-info")
    assert status == 0
    assert out.endswith("run-info/info.json\nrun-info/info.html\n")
    status, _, err = run_dynid("info", "run.h5", "--page", "run-info")
    assert status == 2
    assert "exists already" in err
    status, out, _ = run_dynid("info", "run.h5", "--page", "run-info", "--force", "--json")
    assert status == 0
    assert json.loads(out) == command_line.stored(folder / "run-info" / "info.json")


@pytest.mark.usefixtures("with_friction_search")
def test_identify_validates_writes_and_prints(run_dynid, folder):
    status, out, _ = run_dynid("identify", "run.h5", "--validate", "val.h5", "-o", "model", "-v")
    assert status == 0
    assert "\nNext:\n" in "\n".join(out.splitlines()[:MOST_LINES])
    assert_one_verdict(folder / "model", out)
    assert "val.h5" in out
    assert "differs from measured torque by" in out
    result = json.loads((folder / "model" / "result.json").read_text())
    assert result["robot"] == "ur5e"
    assert result["validation"]["relative_error"] < 0.05
    assert {use["role"] for use in result["recordings"]} == {"identification", "validation"}
    assert all(len(use["sha256"]) == 64 for use in result["recordings"])
    assert (folder / "model" / "report.html").stat().st_size > 1e6

    status, out, _ = run_dynid("validate", "model/result.json", "val.h5", "--json")
    assert status == 0
    again = json.loads(out)["full"]
    assert again["relative_error"] == pytest.approx(result["validation"]["relative_error"], rel=1e-6)

    status, out, _ = run_dynid("validate", "model", "val.h5", "run.h5", "--json")
    assert status == 0
    judged = json.loads(out)
    assert [one["recording"].rpartition("/")[2] for one in judged["recordings"]] == ["val.h5", "run.h5"]
    assert judged["recordings"][0]["full"] == again
    order = ("good", "usable", "poor")
    assert [one["delivered"]["overlap"] for one in judged["recordings"]] == [0.0, 1.0]
    for purpose, verdict in judged["verdict"]["purposes"].items():
        apart = [one["verdict"]["purposes"][purpose] for one in judged["recordings"]]
        assert verdict == result["verdict"]["purposes"][purpose] == apart[0]  # data of the identification do not count
        assert order.index(apart[1]["grade"]) >= order.index("usable")
    called = dynid.validate(folder / "model", [folder / "val.h5", folder / "run.h5"])
    assert {purpose: asdict(one) for purpose, one in called.verdict.purposes.items()} == judged["verdict"]["purposes"]
    status, _, err = run_dynid("identify", "run.h5", "--validate", "run.h5", "-o", "refused")
    assert status == 2
    assert "nothing is held out" in err
    assert not (folder / "refused").exists()
    status, out, _ = run_dynid("validate", "model", "val.h5", "run.h5")
    assert (status, len(out.splitlines()) <= MOST_LINES) == (0, True)
    status, out, _ = run_dynid("validate", "model", "val.h5", "run.h5", "--verbose")
    assert status == 0
    assert "run.h5 (NOT held out: 100 % of its samples were used in the identification)" in out
    assert judged["verdict"]["headline"] in out


MOST_LINES = 20
"""Most lines that a command prints without --verbose."""


def assert_one_verdict(model: Path, out: str) -> None:
    """The same verdict stands in JSON, on the terminal and in the report."""
    verdict = json.loads((model / "result.json").read_text())["verdict"]
    report = html.unescape((model / "report.html").read_text(encoding="utf-8"))
    assert verdict["headline"] in out
    assert verdict["headline"] in report
    for check in verdict["checks"]:
        assert f"{check['severity']}: {check['text']} [{check['name']}]" in out
        assert check["text"] in report


def test_info_begins_with_its_verdict_and_remembers_the_import(run_dynid, folder):
    recording = read_recording(folder / "run.h5")
    noted = replace(recording, events=(Event(0.0, "warning", "import", "sort: time went backward 3 times"),))
    write_recording(folder / "noted.h5", noted)
    _, out, _ = run_dynid("info", "noted.h5")
    assert "Judging by the recording alone: Good for" in out.splitlines()[1]
    assert len(out.splitlines()) <= 25
    assert "note: import: sort: time went backward 3 times [import-warning]" in out
    _, out, _ = run_dynid("info", "noted.h5", "--json")
    assert [check["name"] for check in json.loads(out)["verdict"]["checks"]] == ["import-warning"]


def test_identify_json_is_the_result_and_nothing_else(run_dynid, folder):
    status, out, _ = run_dynid("identify", "run.h5", "--json", "-o", "asjson", "--method", "ols")
    assert status == 0
    printed = json.loads(out)
    written = json.loads((folder / "asjson" / "result.json").read_text())
    assert written["files"].keys() == {"report.html"}
    assert printed == written
    assert printed["method"] == "ols"
    assert "last 30 %" in printed["validation_source"]


def test_robot_show_json(run_dynid):
    status, out, _ = run_dynid("robot", "show", "panda", "--json")
    shown = json.loads(out)
    assert status == 0
    assert (shown["name"], shown["dof"], shown["inertial_base_count"], shown["base_count"]) == ("panda", 7, 43, 64)
    kinds = {"inertial", "motor_inertia", "viscous", "coulomb", "offset"}
    assert {parameter["kind"] for parameter in shown["base_parameters"]} <= kinds
    assert {"name", "expression", "kind"} == set(shown["base_parameters"][0])
    assert "XX1" in shown["no_effect"]


def test_robot_show_yaml_is_the_file(run_dynid):
    _, out, _ = run_dynid("robot", "show", "ur5e", "--yaml")
    assert out == load_robot("ur5e").text


def test_info_json(run_dynid):
    status, out, _ = run_dynid("info", "run.h5", "--json")
    shown = json.loads(out)
    assert status == 0
    stream = shown["streams"]["joints"]
    assert stream["samples"] == 1750
    assert stream["rate_hz"] == pytest.approx(RATE)
    assert (stream["lost"], stream["duplicates"], stream["gaps"]) == (0, 0, [])
    assert shown["complete"] is True
    assert shown["excitation"]["scaled_condition"] < 100


def test_info_of_a_motionless_recording(run_dynid):
    status, out, _ = run_dynid("info", "still.h5")
    assert status == 0
    assert "joints" in out


def test_check(run_dynid):
    status, out, _ = run_dynid("check", "ur5e")
    assert status == 0
    assert "the file is valid" in out


def test_import_refuses_to_overwrite(run_dynid, folder):
    np.savez(folder / "a.npz", t=np.arange(100) / 100, q=np.zeros((100, 6)), torque=np.zeros((100, 6)))
    arguments = ("import", "a.npz", "--robot", "ur5e", "-o", "imported.h5")
    assert run_dynid(*arguments)[0] == 0
    status, _, err = run_dynid(*arguments)
    assert status == 2
    assert "exists already" in err
    assert run_dynid(*arguments, "--force")[0] == 0


BAD = [
    # recordings
    (["info", "missing.h5"], ["missing.h5", "no such file"]),
    (["info", "."], ["is a folder, not a file"]),
    (["recover", "."], ["is a folder, not a file (name a recording in it)"]),
    (["info", "text.h5"], ["is not an HDF5 file", "dynid import"]),
    (["info", "empty.h5"], ["empty.h5"]),
    (["info", "cut.h5"], ["cut.h5", "truncated"]),
    (["info", "newer.h5"], ["schema version 99", "update dynid"]),
    (["info", "foreign.h5"], ["not a dynid recording"]),
    (["identify", "norobot.h5"], ["carries no robot file", "--robot"]),
    (["identify", "nan.h5"], ["not a number", "position of elbow_joint", "sample 5"]),
    (["identify", "inf.h5"], ["not a number", "position of shoulder_lift_joint", "sample 7"]),
    (["identify", "backward.h5"], ["backward.h5", "backwards", "sample 100"]),
    (["identify", "still.h5"], ["still.h5", "nothing moves"]),
    (["identify", "short.h5"], ["short.h5"]),
    (["identify", "nocurrent.h5"], ["neither torque nor current", "position"]),
    (["identify", "onejoint.h5"], ["no column for joint", "another: --robot"]),
    (["identify", "run.h5", "--robot", "panda"], ["no column for joint", "panda_joint1"]),
    # options
    (["identify", "run.h5", "--method", "magic"], ["'magic'", "irls", "wls"]),
    (["identify", "run.h5", "--method", "wls:window=0.1"], ["wls has no option 'window'", "has no options"]),
    (["identify", "run.h5", "--method", "energy:windows=0.1"], ["no option 'windows'", "its options: window"]),
    (["identify", "run.h5", "--method", "energy:window"], ["'window' has no value", "energy:window=VALUE"]),
    (["identify", "run.h5", "--method", "energy:window=1:window=2"], ["'window' is given twice"]),
    (["identify", "run.h5", "--method", "energy:window=long"], ["--method energy", "window=long", "mean duration"]),
    (["identify", "run.h5", "--method", "energy:window=nan"], ["--method energy", "nan is not within"]),
    (["identify", "run.h5", "--method", "energy:window=50"], ["energy:window", "50 s do not fit"]),
    (["identify", "run.h5", "--friction", "sticky"], ["'sticky'", "coulomb-viscous"]),
    (["identify", "run.h5", "--delay", "soon"], ["--delay soon", "auto"]),
    (["identify", "run.h5", "--delay", "nan"], ["--delay nan"]),
    (["identify", "run.h5", "--delay", "1000"], ["delay", "not within"]),
    (["identify", "run.h5", "--split", "99"], ["--split 99", "outside the data"]),
    (["identify", "run.h5", "--split", "5", "--validate", "val.h5"], ["exclude each other"]),
    (["identify", "run.h5", "--torque-cutoff", "500"], ["500 Hz", "half the sampling rate"]),
    (["identify", "run.h5", "--position-cutoff", "0"], ["cut-off of 0 Hz"]),
    (["identify", "run.h5", "--decimate", "0"], ["--decimate 0 is not within 1 to 10000", "1 keeps every sample"]),
    (["identify", "run.h5", "--filter", "boxcar"], ["'boxcar'", "butterworth or chebyshev"]),
    (["identify", "run.h5", "--differentiation", "spline"], ["'spline'", "five-point or savitzky-golay"]),
    (["identify", "run.h5", "--start", "9", "--stop", "3"], ["window", "empty"]),
    (["identify", "run.h5", "--start", "100"], ["run.h5", "no samples", "lasts 13.992 s"]),
    (["identify", "run.h5", "--smoothing=-1"], ["--smoothing -1"]),
    (["identify", "run.h5", "--significance", "0"], ["significance 0 is not within", "15"]),
    (["identify", "run.h5", "--measured-velocity"], ["holds no velocity"]),
    (["identify", "run.h5", "-o", "run.h5"], ["is a file; a folder is needed"]),
    (["identify", "run.h5", "--validate", "missing.h5"], ["missing.h5", "no such file"]),
    # robots
    (["robot", "show", "ur5"], ["'ur5'", "did you mean 'ur5e'"]),
    (["robot", "show", "missing.yaml"], ["missing.yaml", "no such file"]),
    (["check", "bad.yaml"], ["bad.yaml"]),
    # results
    (["validate", "missing.json", "run.h5"], ["missing.json"]),
    (["validate", "bad.json", "run.h5"], ["is not JSON"]),
    (["validate", "other.json", "run.h5"], ["not a result"]),
    # imports
    (["import", "bad.csv", "--robot", "ur5e", "-o", "x.h5"], ["bad.csv", "line 3"]),
    (["import", "missing.csv", "--robot", "ur5e", "-o", "x.h5"], ["missing.csv"]),
    (["import", "bad.csv", "--robot", "ur5e", "-o", "x.h5", "--column", "q1"], ["not NAME=COLUMN"]),
    (["import", "bad.csv", "--robot", "ur5e", "-o", "x.h5", "--repair", "magic"], ["'magic'", "drop-nan"]),
    (["import", "bad.csv", "--robot", "ur5e", "-o", "x.h5", "--rate", "-5"], ["-5"]),
    (["demo", "--robot", "bad.yaml"], ["bad.yaml"]),
    (["demo", "--duration", "0"], ["--duration 0"]),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=[" ".join(arguments) for arguments, _ in BAD])
def test_bad_input_is_told_in_one_line(run_dynid, arguments, words):
    status, out, err = run_dynid(*arguments)
    assert status == 2, err
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert err.startswith("dynid: ")
    for word in words:
        assert word in err


def test_bad_input_with_json_is_an_object(run_dynid):
    status, out, err = run_dynid("identify", "nan.h5", "--json")
    assert (status, err) == (2, "")
    told = json.loads(out)
    assert "not a number" in told["error"]
    assert "elbow_joint" in told["where"]
    assert told["hint"]


def test_nothing_is_written_where_the_input_is_bad(run_dynid, folder):
    assert run_dynid("identify", "nan.h5", "-o", "untouched")[0] == 2
    assert not (folder / "untouched").exists()


@pytest.fixture(scope="module")
def parts(folder) -> Path:
    """Two models of the UR5e: its last joint locked, and that joint's own torque in free motion."""
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), 10.0, seed=4, candidates=3)
    motion.sine[5] = motion.cosine[5] = 0.0
    write_recording(folder / "locked.h5", simulate_recording(robot_file, motion, 14.0, seed=4, rate=RATE))
    return folder


def test_two_experiments_are_identified_and_merged(run_dynid, monkeypatch, parts):
    monkeypatch.chdir(parts)
    joint = load_robot("ur5e").robot.joint_names[5]
    status, out, _ = run_dynid("identify", "locked.h5", "--locked", joint, "-o", "arm", "--delay", "0", "-v")
    assert status == 0
    assert f"experiment: locked: {joint} at" in out
    status, out, _ = run_dynid("identify", "run.h5", "--torques-of", f" {joint}, ", "-o", "wrist", "--delay", "0", "-v")
    assert status == 0
    assert f"torques of {joint}" in out
    status, out, _ = run_dynid("merge", "arm", "wrist/result.json", "--validate", "val.h5", "-o", "whole", "-v")
    assert status == 0
    assert "Models that were merged" in out
    assert "val.h5" in out
    result = json.loads((parts / "whole" / "result.json").read_text())
    assert len(result["base_parameters"]) == 58
    assert result["validation"]["relative_error"] < 0.1
    assert [model["file"] for model in result["merge"]["models"]] == ["arm/result.json", "wrist/result.json"]
    assert (parts / "whole" / "report.html").stat().st_size > 1e6

    status, out, _ = run_dynid("merge", "arm", "wrist", "--json", "-o", "again")
    assert status == 0
    assert json.loads(out)["validation"] is None

    status, _, err = run_dynid("validate", "arm/result.json", "val.h5")
    assert status == 2
    assert f"{joint} was locked" in err


@each(
    ("arguments", "words"),
    [
        (["identify", "run.h5", "--locked", "wrist_3_joint"], "declared locked but moves over"),
        (["identify", "run.h5", "--locked", "elbow"], "no joint of ur5e is called 'elbow'"),
        (["identify", "run.h5", "--torques-of", "elbow"], "no joint of ur5e is called 'elbow'"),
        (["identify", "run.h5", "--torques-of", "elbow_joint", "--method", "power"], "--torques-of has no meaning"),
        (["merge", "missing.json", "other.json"], "no such file"),
        (["merge", "other.json", "bad.json"], "is not a result"),
        (["merge", "other.json", "bad.json", "--significance", "0"], "not within"),
        (["merge", "other.json", "bad.json", "-o", "other.json"], "is a file"),
        (["merge", "old/result.json", "bad.json", "-o", "old"], "old/result.json: is an input of this command"),
    ],
)
def test_wrong_experiments_and_merges_are_refused_in_one_line(run_dynid, arguments, words):
    status, _, err = run_dynid(*arguments)
    assert status == 2
    assert words in err
    assert len(err.strip().splitlines()) == 1
