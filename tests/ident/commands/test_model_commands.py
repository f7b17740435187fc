"""The commands that use a model: predict, acceptance, diff; and bad input one by one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import dynid

pytestmark = pytest.mark.usefixtures("stated_friction", "mistakes_not_sought")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Recordings and a model of a small arm."""
    folder = tmp_path_factory.mktemp("work")
    for name, seed in (("run", 1), ("val", 2)):
        recording = dynid.simulate("up6", duration=10.0, seed=seed, rate=100.0)
        dynid.write_recording(folder / f"{name}.h5", recording)
    dynid.identify(folder / "run.h5", validation=folder / "val.h5").save(folder / "model")
    (folder / "limits.yaml").write_text("relative_error: 0.5\nconsistent: true\n")
    (folder / "elbow.yaml").write_text("rmse: {elbow: 1}\n")
    return folder


@pytest.fixture
def run_dynid(run_dynid, monkeypatch, folder):
    """Calls the command in the folder."""
    monkeypatch.chdir(folder)
    return run_dynid


def test_predict_writes_a_recording_that_info_reads_and_a_page(run_dynid, folder):
    status, out, _ = run_dynid("predict", "model", "val.h5", "-o", "out.h5", "--page", "out.html")
    assert status == 0
    assert "residual" in out
    assert "out.h5" in out
    assert (folder / "out.html").exists()
    status, out, _ = run_dynid("info", "out.h5", "--json")
    assert status == 0
    streams = json.loads(out)["streams"]
    assert set(streams) == {"joints", "prediction"}
    assert streams["prediction"]["channels"]["gravity_torque"]["unit"] == "N*m"


def test_predict_prints_one_object_and_overwrites_by_force_only(run_dynid):
    arguments = ("predict", "model", "val.h5", "-o", "again.h5", "--json")
    status, out, _ = run_dynid(*arguments)
    assert status == 0
    told = json.loads(out)
    assert told["file"] == "again.h5"
    assert [joint["joint"] for joint in told["joints"]] == list(dynid.load_robot("up6").robot.joint_names)
    assert told["samples"] > 500
    status, out, _ = run_dynid(*arguments)
    assert status == 2
    assert "exists already" in json.loads(out)["error"]
    assert run_dynid(*arguments, "--force")[0] == 0


@pytest.mark.usefixtures("with_friction_search")
def test_presliding_is_found_and_used_unless_told_not_to(run_dynid):
    status, out, _ = run_dynid("identify", "run.h5", "-o", "sliding", "-v")
    assert status == 0
    assert "presliding: travel [rad] by Coulomb parameter" in out
    status, out, _ = run_dynid("identify", "run.h5", "--no-presliding", "-o", "static", "-v")
    assert status == 0
    assert "travel [rad]" not in out
    status, out, _ = run_dynid("predict", "static", "val.h5", "-o", "static.h5", "--json")
    assert status == 0
    assert json.loads(out)["presliding"] is False


def test_identify_fails_where_a_limit_is_not_kept_and_writes_everything(run_dynid, folder):
    limited = ("identify", "run.h5", "--validate", "val.h5", "--max-error", "1e-6", "-o", "failed")
    arguments = (*limited, "--history", "arm.db")
    status, out, _ = run_dynid(*arguments)
    assert status == 1
    assert "Acceptance FAILED: 0 of 1 limits kept." in out
    assert dynid.History(folder / "arm.db").arms == ("up6",)
    assert "held-out error of the physically consistent model is" in out
    stored = json.loads((folder / "failed" / "result.json").read_text())
    assert stored["acceptance"]["passed"] is False
    assert "Acceptance failed" in (folder / "failed" / "report.html").read_text()
    assert dynid.load_result(folder / "failed").acceptance.passed is False


def test_identify_passes_with_a_file_and_prints_one_object(run_dynid):
    arguments = ("identify", "run.h5", "--validate", "val.h5", "--accept", "limits.yaml", "-o", "passed", "--json")
    status, out, _ = run_dynid(*arguments)
    assert status == 0
    assert json.loads(out)["acceptance"]["passed"] is True


def test_validate_fails_where_a_limit_is_not_kept(run_dynid):
    status, out, _ = run_dynid("validate", "model", "val.h5", "--max-rmse", "1e-9", "--json")
    assert status == 1
    criteria = json.loads(out)["acceptance"]["criteria"]
    assert len(criteria) == 3
    assert not any(criterion["passed"] for criterion in criteria)
    status, out, _ = run_dynid("validate", "model", "val.h5", "--accept", "limits.yaml")
    assert status == 0
    assert "Acceptance passed: 2 of 2 limits kept." in out


def test_an_option_goes_before_the_files_limit(run_dynid):
    arguments = ("validate", "model", "val.h5", "--accept", "limits.yaml", "--max-error", "1e-6", "--json")
    status, out, _ = run_dynid(*arguments)
    assert status == 1
    criteria = {criterion["name"]: criterion for criterion in json.loads(out)["acceptance"]["criteria"]}
    assert criteria["relative_error"]["limit"] == 1e-6
    assert criteria["consistent"]["passed"] is True


def test_monitor_watches_a_recording_and_writes_a_page(run_dynid, folder):
    (folder / "labels.csv").write_text("start,end\n2,2.5\n")
    quiet = ("--quiet", "run.h5", "--quiet", "val.h5", "--bandwidth", "45", "--false-alarms", "100")
    arguments = ("monitor", "--replay", "val.h5", "--model", "model", *quiet, "--contacts", "labels.csv")
    status, out, err = run_dynid(*arguments, "--page", "contacts.html")
    assert status == 0, err
    assert "Smallest force detected" in out
    assert "torque of the drives, one threshold per joint" in out
    assert "no safety function" in out
    assert "External torque" in (folder / "contacts.html").read_text(encoding="utf-8")
    status, out, _ = run_dynid(*arguments, "--json")
    assert status == 0
    told = json.loads(out)
    assert told["contacts"] == []
    assert told["observer"] == "direct"
    assert len(told["detectors"]["external torque, learnt thresholds"]["roc"]) == 60
    assert set(told["smallest_force"]) == set(dynid.load_model(folder / "model").joint_names)


def test_diff_prints_tables_and_one_object(run_dynid):
    status, out, _ = run_dynid("diff", "model", "model")
    assert status == 0
    assert "0 of" in out
    assert "Held-out errors" in out
    status, out, _ = run_dynid("diff", "model", "model/result.json", "--json")
    assert status == 0
    told = json.loads(out)
    assert told["agree"] is True
    assert {"name", "first", "first_std", "second", "z"} <= set(told["parameters"][0])
    assert len(told["errors"]) == 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["diff", "model", "nowhere"], "nowhere: no such file"),
        (["diff", "limits.yaml", "model"], "is not JSON"),
        (["monitor", "--model", "model", "--replay", "val.h5"], "9.94 s without contact is too short for 1 false"),
        (["monitor", "--model", "model", "--replay", "run.h5", "--quiet", "val.h5", "--false-alarms", "0"], "1/h"),
        (["monitor", "--model", "model"], "give either a robot"),
        (["monitor", "--model", "model", "--replay", "val.h5", "--yes"], "--yes is for live monitoring"),
        (["monitor", "ur5e", "--model", "model"], "the robot file is of ur5e with joints"),
        (["monitor", "ur5e", "--model", "model", "--stop-on-contact"], "ends only a motion that dynid plays"),
        (["monitor", "ur5e", "--model", "model", "--page", "contacts.html"], "--contacts and --page need --replay"),
        (["predict", "nowhere", "val.h5"], "nowhere: no such file"),
        (["predict", "model", "nowhere.h5"], "nowhere.h5: no such file"),
        (["predict", "model", "limits.yaml"], "limits.yaml: kind: this key is missing"),
        (["predict", "model", "val.h5", "-o", "val.h5", "--force"], "is an input of this command"),
        (["predict", "model", "val.h5", "-o", "nowhere/out.h5"], "there is no such folder"),
        (["predict", "model", "val.h5", "-o", "new.h5", "--parameters", "best"], "there are no 'best' parameters"),
        (["predict", "model", "val.h5", "-o", "new.h5", "--page", "limits.yaml"], "limits.yaml: exists already"),
        (["validate", "model", "val.h5", "--max-error", "8"], "8 is a ratio, not a percentage"),
        (["validate", "model", "val.h5", "--max-error", "-1"], "--max-error: relative_error"),
        (["validate", "model", "val.h5", "--max-rmse", "nan"], "--max-rmse: rmse: found nan"),
        (["validate", "model", "val.h5", "--accept", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["validate", "model", "val.h5", "--accept", "elbow.yaml"], "limits for elbow, which the robot does not have"),
        (
            ["identify", "run.h5", "--accept", "elbow.yaml", "-o", "new"],
            "limits for elbow, which the robot does not have",
        ),
        (["identify", "run.h5", "--accept", "model", "-o", "new"], "model: is a folder, not a file"),
    ],
)
def test_bad_input_is_told_in_one_line(run_dynid, folder, arguments, words):
    status, out, err = run_dynid(*arguments)
    assert (status, out) == (2, ""), err
    assert words in err
    assert len(err.strip().splitlines()) == 1
    assert not (folder / "new").exists()
    assert not (folder / "new.h5").exists()
