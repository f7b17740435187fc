"""The command `dynid excite` as a user calls it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from daq.motion.limits import motion_extremes
from daq.motion.trajectory_file import load_trajectory
from daq.robot.loader import load_robot
from dynid.command import build_app
from ident.excite import design as design_module
from ident.excite.search.search import SearchResult

QUICK = ("--starts", "1", "--harmonics", "1", "--period", "5")
LARGEST = (*QUICK, "--criterion", "motion-size", "--joints", "j1")
"""Quicker still, for what has nothing to do with the design's quality."""


@pytest.fixture
def folder(tmp_path, monkeypatch, three_joint) -> Path:
    (tmp_path / "arm.yaml").write_text(three_joint.text)
    (tmp_path / "high.yaml").write_text(three_joint.text + "workspace:\n  height: [5, 6]\n")
    inside = "{box: {lower: [-0.2, -0.2, 0], upper: [0.2, 0.2, 0.4]}}"
    (tmp_path / "boxed.yaml").write_text(three_joint.text + f"workspace:\n  keep_out: [{inside}]\n")
    (tmp_path / "there.yaml").write_text("a file of the user")
    (tmp_path / "bad.json").write_text("{")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def usual(three_joint, tmp_path_factory) -> tuple[Path, dict[str, Any], SearchResult]:
    """The file of the quick design, what the command says of it as JSON, and what its search found."""
    folder = tmp_path_factory.mktemp("usual")
    (folder / "arm.yaml").write_text(three_joint.text)
    search, found = design_module.search, []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(design_module, "search", lambda *given: found.append(search(*given)) or found[0])
        told = CliRunner().invoke(build_app(), ["excite", "arm.yaml", "-o", "t.yaml", "--json", *QUICK])
    assert told.exit_code == 0, told.output
    return folder / "t.yaml", json.loads(told.stdout), found[0]


@pytest.fixture
def searched(usual, monkeypatch) -> SearchResult:
    """Search as `usual` did, which takes most of a design: for what is done before and after."""
    monkeypatch.setattr(design_module, "search", lambda *_: usual[2])
    return usual[2]


def test_it_designs_writes_and_prints(run_dynid, folder, searched):
    status, out, _ = run_dynid("excite", "arm.yaml", "-o", "t.yaml", "--page", "t.html", "--periods", "2", *QUICK)
    assert status == 0
    assert "Limit utilisation" in out
    assert "as played: condition" in out
    robot = load_robot(folder / "arm.yaml").robot
    written = load_trajectory(folder / "t.yaml", robot)  # checks limits and rest
    assert written.motion.duration == pytest.approx(14.0)
    comment = written.trajectory.comment
    assert comment.startswith("designed by dynid excite: fourier of 14 s, d-optimal")
    assert len(comment.splitlines()) == 1
    assert comment.split(": ", 1)[1] in out.replace("\n", "")
    extremes = motion_extremes(written.motion)
    share = max(np.max(extremes.velocity) / 3.0, np.max(extremes.highest) / 3.0, -np.min(extremes.lowest) / 3.0)
    assert 0.5 < share <= 1.0
    assert (folder / "t.html").stat().st_size > 1e6


def test_json_is_one_object_with_the_figures_and_an_earlier_design_is_improved_or_kept(run_dynid, folder, usual):
    path, told, _ = usual
    assert told["file"] == "t.yaml"
    assert told["page"] is None
    assert told["search"]["interrupted"] is False
    assert told["search"]["finished_starts"] == 1
    assert max(told["limits"].values()) <= 1.0
    assert len(told["figures"]["forecast"]["parameters"]) == 25
    assert [joint["joint"] for joint in told["figures"]["joints"]] == ["j1", "j2", "j3"]
    assert (
        told["figures"]["forecast"]["scaled_condition"] < 50
    )  # which optimum a start ends in differs between processors
    more = ("--starts", "1", "--harmonics", "1", "--period", "5", "--from", str(path), "--json")
    again = json.loads(run_dynid("excite", "arm.yaml", "-o", "b.yaml", *more)[1])
    assert again["cost"] <= 1.02 * told["cost"]


def test_the_same_seed_gives_the_same_file_and_another_one_another(run_dynid, folder):
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert run_dynid("excite", "arm.yaml", "-o", f"{name}.yaml", "--seed", seed, *LARGEST)[0] == 0
    texts = [(folder / f"{name}.yaml").read_text() for name in "abc"]
    assert texts[0] == texts[1] != texts[2]


def test_a_payload_and_single_joints(run_dynid, folder, usual):
    arguments = ("excite", "arm.yaml", "--json", "--force", "-o", "t.yaml", *QUICK)
    loaded = json.loads(run_dynid(*arguments, "--loaded")[1])
    assert loaded["choices"]["loaded"] is True
    assert loaded["cost"] < usual[1]["cost"]  # ten parameters of one link are fewer than all
    status, out, _ = run_dynid(*arguments, "--joints", "j2, j3")
    joints = {joint["joint"]: joint for joint in json.loads(out)["figures"]["joints"]}
    assert status == 0
    assert joints["j1"]["lowest"] == joints["j1"]["highest"] == 0.0
    assert joints["j2"]["velocity"] > 0.1
    assert {"Fv1", "Fs1"} <= set(json.loads(out)["figures"]["forecast"]["unexcited"])


def test_ctrl_c_writes_the_best_so_far(run_dynid, monkeypatch, folder, searched):
    monkeypatch.setattr(design_module, "search", lambda *_: replace(searched, interrupted=True))
    status, out, _ = run_dynid("excite", "arm.yaml", "-o", "t.yaml", *QUICK)
    assert status == 0
    assert "Ctrl-C ended the search" in out
    load_trajectory(folder / "t.yaml", load_robot(folder / "arm.yaml").robot)


def test_ctrl_c_before_anything_was_found_writes_nothing(run_dynid, monkeypatch, folder, searched):
    monkeypatch.setattr(design_module, "search", lambda *_: replace(searched, interrupted=True, best=None))
    status, out, err = run_dynid("excite", "arm.yaml", "-o", "t.yaml", *QUICK)
    assert (status, out) == (130, "")
    assert "interrupted" in err
    assert not (folder / "t.yaml").exists()


def test_an_existing_file_stays_unless_forced(run_dynid, folder, searched):
    assert run_dynid("excite", "arm.yaml", "-o", "there.yaml", *QUICK)[0] == 2
    assert (folder / "there.yaml").read_text() == "a file of the user"
    assert run_dynid("excite", "arm.yaml", "-o", "there.yaml", "--force", *QUICK)[0] == 0
    assert yaml.safe_load((folder / "there.yaml").read_text())["kind"] == "fourier"


REFUSED = [
    (["arm.yaml", "-o", "there.yaml"], ["there.yaml", "exists already", "--force"]),
    (["arm.yaml", "--page", "there.yaml"], ["there.yaml", "exists already"]),
    (["arm.yaml", "-o", "none/t.yaml"], ["none: there is no such folder"]),
    (["arm.yaml", "-o", "."], ["is a folder"]),
    (["arm.yaml", "--page", "t.yaml"], ["t.yaml", "same file"]),
    (["missing.yaml"], ["missing.yaml", "no such file"]),
    (["arm.yaml", "--kind", "foo"], ["'foo'", "fourier-quintic"]),
    (["arm.yaml", "--criterion", "foo"], ["'foo'", "d-optimal"]),
    (["arm.yaml", "--solver", "foo"], ["'foo'", "slsqp"]),
    (["arm.yaml", "--period", "0"], ["--period 0"]),
    (["arm.yaml", "--period", "nan"], ["--period nan"]),
    (["arm.yaml", "--ramp=-1"], ["--ramp -1"]),
    (["arm.yaml", "--ramp", "0.001"], ["--ramp 0.001", "at least 0.1 s"]),
    (["arm.yaml", "--periods", "0"], ["--periods 0"]),
    (["arm.yaml", "--harmonics", "0"], ["--harmonics 0"]),
    (["arm.yaml", "--margin", "1"], ["--margin 1"]),
    (["arm.yaml", "--time", "0"], ["--time 0"]),
    (["arm.yaml", "--time", "inf"], ["--time inf"]),
    (["arm.yaml", "--time", "3", "--starts", "3"], ["exclude each other"]),
    (["arm.yaml", "--starts", "0"], ["--starts 0"]),
    (["arm.yaml", "--seed=-1"], ["--seed -1"]),
    (["arm.yaml", "--joints", "j9"], ["'j9'"]),
    (["arm.yaml", "--joints", ","], ["contains no name"]),
    (["arm.yaml", "--from", "missing.yaml"], ["missing.yaml"]),
    (["arm.yaml", "--from", "there.yaml"], ["there.yaml"]),
    (["arm.yaml", "--prior", "bad.json"], ["bad.json", "not JSON"]),
    (["high.yaml", *QUICK], ["no feasible motion", "poses tried", "smallest height of the arm", "workspace"]),
    (["boxed.yaml", *QUICK], ["keep_out"]),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED)
def test_what_is_refused_is_told_in_one_line(run_dynid, folder, arguments, words):
    out_option = [] if "-o" in arguments else ["-o", "t.yaml"]
    status, out, err = run_dynid("excite", *arguments, *out_option)
    assert status == 2, err
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err
    assert not (folder / "t.yaml").exists()
    assert (folder / "there.yaml").read_text() == "a file of the user"


def test_a_refusal_with_json_is_an_object(run_dynid, folder):
    status, out, err = run_dynid("excite", "arm.yaml", "-o", "t.yaml", "--period", "0", "--json")
    assert (status, err) == (2, "")
    assert "--period 0" in json.loads(out)["error"]
