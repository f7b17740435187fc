"""`dynid export --c` as a user calls it."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest
from compiled_arm import self_test
from each import each
from loop_arms import four_bar_arm
from true_results import true_result

import dynid
from daq.robot.loader import load_robot
from drivers.core.errors import ModelError
from drivers.core.text import percent_text
from ident.result.result_file import result_json


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """A folder that identify wrote."""
    folder = tmp_path_factory.mktemp("identified")
    dynid.identify(dynid.simulate("up6", duration=10.0, seed=1)).save(folder)
    return folder


@pytest.fixture
def export(run_dynid):
    """Calls `dynid export`."""
    return partial(run_dynid, "export")


@pytest.mark.realtime
@pytest.mark.parametrize("kind", ["consistent", "full", "essential"])
def test_code_of_all_three_models_passes_its_test(model, kind, tmp_path, export):
    status, out, _ = export(model, "--c", tmp_path / "arm", "--parameters", kind)
    assert status == 0
    assert "multiplications" in out
    assert self_test(tmp_path / "arm.c", "up6").returncode == 0


@pytest.mark.parametrize("kind", ["consistent", "full"])
def test_the_header_says_where_the_parameters_come_from(model, kind, tmp_path):
    loaded = dynid.load_model(model, kind)
    loaded.export_c(tmp_path / "arm")
    header, source = ((tmp_path / name).read_text() for name in ("arm.h", "arm.c"))
    result = loaded.result
    flowing = " ".join(header.replace("\n *", " ").split())
    assert f"Identified {result.created} by dynid {result.versions['dynid']}, method wls" in flowing
    assert all(use.sha256 in flowing for use in result.recordings)
    fit = result.consistent.validation if kind == "consistent" else result.validation
    assert f"Held-out error of the torque: {percent_text(fit.relative_error)}" in flowing
    assert f"Verdict: {result.verdict.headline}" in flowing
    std = dict(zip(loaded.parameters["name"], loaded.parameters["std"], strict=True))
    for name, value in std.items():
        (line,) = (text for text in source.splitlines() if f" {name} [" in text)
        assert f"std {value:.3g}" in line


def test_json(model, tmp_path, export):
    status, out, _ = export(model, "--c", tmp_path / "arm.c", "--c-float", "--json")
    assert status == 0
    assert [file["path"] for file in json.loads(out)["files"]] == [str(tmp_path / "arm.c")]
    assert "typedef float up6_real;" in (tmp_path / "arm.h").read_text()


@each(
    ("arguments", "message"),
    [
        (["--c-float", "--urdf", "OUT/arm.urdf"], "--c-float needs --c"),
        (["--c", "OUT/arm", "--parameters", "some"], "there are no 'some' parameters"),
        (["--c", 'OUT/a"b'], "is not a valid name for C files"),
        (["--c", "OUT/no/arm"], "there is no such folder"),
        (["--c", "OUT/arm", "--urdf", "OUT/arm.c"], "same file"),
        ([], "no file to write is named"),
    ],
)
def test_bad_input_is_one_line_and_status_2(model, arguments, message, tmp_path, export):
    given = [argument.replace("OUT", str(tmp_path)) for argument in arguments]
    status, _, error = export(model, *given)
    assert (status, error.count("\n")) == (2, 1)
    assert message in error
    assert not list(tmp_path.iterdir())


def test_a_file_that_exists_needs_force(model, tmp_path, export):
    (tmp_path / "arm.h").write_text("mine")
    status, _, error = export(model, "--c", tmp_path / "arm")
    assert (status, error.count("\n")) == (2, 1)
    assert (tmp_path / "arm.h").read_text() == "mine"
    assert export(model, "--c", tmp_path / "arm", "--force")[0] == 0


def test_loops_solved_numerically_are_refused_in_a_sentence(tmp_path, export):
    (tmp_path / "result.json").write_text(result_json(true_result(four_bar_arm())))
    status, _, error = export(tmp_path / "result.json", "--c", tmp_path / "arm", "--parameters", "full")
    assert (status, error.count("\n")) == (1, 1)
    assert "solved numerically" in error


def test_a_model_with_an_unidentified_parameter_is_refused(tmp_path):
    robot_file = load_robot("up6")
    unknown = dynid.Model(true_result(robot_file, {"Fv2": None}), "full")
    with pytest.raises(ModelError, match="Fv2 has no value"):
        unknown.export_c(tmp_path / "arm")
    assert not list(tmp_path.iterdir())
