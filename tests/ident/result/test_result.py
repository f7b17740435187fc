"""result.json: strict, complete, and refused in words where it is not a result."""

from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.recording.reader import read_recording
from daq.recording.recording import Event
from daq.recording.writer import write_recording
from drivers.core.errors import ResultFileError
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.result.models.model import Model
from ident.result.result_file import file_sha256, read_result, result_json
from ident.result.schema import Result
from ident.result.units import UNITS
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording


@pytest.fixture(scope="module")
def identified(three_joint, tmp_path_factory):
    """A recording on disk in which joint j2 moves too slowly to rub, its identification and its result."""
    motion = random_fourier_motion(build_model(three_joint), 10.0, seed=1)
    motion.sine[1] *= 3e-3
    motion.cosine[1] *= 3e-3
    recording = simulate_recording(three_joint, motion, 14.0, seed=1)
    path = tmp_path_factory.mktemp("result") / "run.h5"
    write_recording(path, recording)
    recording = read_recording(path)
    found = identify([recording], [], IdentifyChoices())
    return recording, found, found.result


@pytest.fixture(scope="module")
def content(identified):
    return json.loads(result_json(identified[2]))


def no_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


def test_a_result_comes_back_as_it_was(identified, tmp_path):
    _, _, result = identified
    (tmp_path / "result.json").write_text(result_json(result))
    text = (tmp_path / "result.json").read_text(encoding="utf-8")
    json.loads(text, parse_constant=no_constant)  # no NaN, no Infinity
    assert read_result(tmp_path / "result.json") == result
    (tmp_path / "again.json").write_text(result_json(read_result(tmp_path / "result.json")))
    assert (tmp_path / "again.json").read_text(encoding="utf-8") == text


@pytest.mark.usefixtures("estimate_alone")
def test_free_exponents_leave_the_torque_as_certain_as_it_is(three_joint):
    """They move viscous and Coulomb friction against each other, and the torque at medium speed hardly."""
    motion = random_fourier_motion(build_model(three_joint), 5.0, 1, candidates=1)
    recording = simulate_recording(three_joint, motion, 5.0, seed=1)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    deviations = {}
    for term in ("", "+power"):
        model = ModelChoices(friction=f"coulomb-viscous{term}")
        found = identify([recording], [], IdentifyChoices(search_delay=False, presliding=False, model=model))
        result = found.result
        for kind in ("full", "consistent"):
            deviations[term, kind] = np.mean(Model(result, kind).torque_std(q, 0.3 + 0.0 * q, 0.0 * q), axis=0)
    for kind in ("full", "consistent"):
        assert np.median(deviations["+power", kind] / deviations["", kind]) < 1.2


def test_the_names_of_the_design_are_there(content):
    assert {
        "robot", "method", "options", "base_parameters", "friction", "standard_parameters", "drive_gains", "fit",
        "validation", "condition", "residuals", "recordings", "versions", "warnings", "dynid_schema",
    } <= set(content)  # fmt: skip
    for parameter in content["base_parameters"]:
        assert {"name", "expression", "kind", "value", "std", "rsd_percent", "significant"} <= set(parameter)
    for part in ("fit", "validation"):
        assert {"relative_error", "rmse", "low_speed_rmse", "high_speed_rmse"} <= set(content[part])
        assert len(content[part]["rmse"]) == len(content["joints"]) == 3
    assert {"python", "numpy", "dynid"} <= set(content["versions"])
    assert [gain["gain"] for gain in content["drive_gains"]] == [10.0, -8.0, 4.0]


def test_gains_that_are_not_used_are_not_listed(identified):
    _, found, _ = identified
    signals = replace(found.runs[0].signals, gains_used=("j1", "j3"))
    without = replace(found, runs=tuple(replace(run, signals=signals, torques=(0, 1)) for run in found.runs))
    assert [gain.joint for gain in without.result.drive_gains] == ["j1"]


def test_numbers_are_those_of_the_identification(identified, content):
    _, found, _ = identified
    assert [parameter["name"] for parameter in content["base_parameters"]] == list(found.base.names)
    assert [parameter["expression"] for parameter in content["base_parameters"]] == list(found.base.expressions)
    for i, parameter in enumerate(content["base_parameters"]):
        if i in found.solution.active:
            assert parameter["value"] == found.solution.parameters[i]
            assert parameter["std"] == found.std[i]
            assert parameter["rsd_percent"] == pytest.approx(100 * found.std[i] / abs(found.solution.parameters[i]))
            assert parameter["significant"] == (parameter["rsd_percent"] < 15.0)
            assert parameter["f_value"] == pytest.approx((100 / parameter["rsd_percent"]) ** 2)  # AUBO Table II
            assert parameter["classical_std"] == found.solution.std[i]
        assert parameter["unit"] in UNITS.values()
    assert content["fit"]["relative_error"] == found.fit.relative_error
    assert content["validation"]["rmse"] == found.validation.rmse
    assert content["options"]["torque_cutoff"] == found.choices.preprocess.torque_cutoff


def test_what_is_not_excited_is_null_and_not_significant(content):
    parameters = {parameter["name"]: parameter for parameter in content["base_parameters"]}
    silent = parameters["Fs2"]
    assert [silent[key] for key in ("value", "std", "rsd_percent", "f_value", "essential_value", "essential_std")] == [
        None
    ] * 6
    assert silent["significant"] is False
    assert "Fs2" in content["excitation"]["unexcited"]
    friction = {joint["joint"]: joint for joint in content["friction"]}
    assert friction["j2"]["coulomb"] is None
    assert friction["j1"]["coulomb"] == parameters["Fs1"]["value"]


def test_essential_model_is_what_is_left(content):
    dropped = set(content["essential"]["dropped"]) | set(content["excitation"]["unexcited"])
    kept = {p["name"] for p in content["base_parameters"] if p["essential_value"] is not None}
    assert kept.isdisjoint(dropped)
    assert kept | dropped == {p["name"] for p in content["base_parameters"]}
    assert content["essential"]["count"] == len(kept)


def test_recordings_are_named_with_their_hashes_and_roles(identified, content):
    recording, _, _ = identified
    digest = sha256(recording.path.read_bytes()).hexdigest()
    assert file_sha256(recording.path) == digest
    assert [use["role"] for use in content["recordings"]] == ["identification", "validation"]
    assert {use["sha256"] for use in content["recordings"]} == {digest}
    first, second = (use["window"] for use in content["recordings"])
    assert first[1] == second[0]
    assert content["recordings"][0]["file"] == "run.h5"


def test_events_of_the_recording_are_handed_on(identified):
    from dataclasses import replace

    recording, found, _ = identified
    noted = replace(recording, events=(Event(1.0, "warning", "importer", "two samples were repaired"),))
    use = replace(found, recordings=(noted,)).result.recordings[0]
    assert use.events == ["warning: two samples were repaired"]


def test_verdict_says_where_the_error_was_measured(identified, content):
    verdict = content["verdict"]
    assert verdict["basis"].startswith("On the last 30 % of the recording")
    assert set(verdict) == {"headline", "purposes", "joints", "checks", "basis"}
    assert set(verdict["purposes"]["simulation"]) == {"grade", "because"}
    assert content["warnings"] == [check["text"] for check in verdict["checks"] if check["severity"] != "note"]


@pytest.mark.parametrize("section", ["fit", "validation", "residuals", "model_options"])
def test_a_list_that_does_not_fit_the_joints_is_refused(content, tmp_path, section):
    name = next(name for name, value in content[section].items() if isinstance(value, list))
    changed = {**content, section: {**content[section], name: [*content[section][name], content[section][name][0]]}}
    (tmp_path / "result.json").write_text(json.dumps(changed), encoding="utf-8")
    with pytest.raises(ResultFileError, match=f"'{name}' has .* entries for .* joints"):
        read_result(tmp_path / "result.json")


def test_no_such_file(tmp_path):
    with pytest.raises(ResultFileError, match="no such file"):
        read_result(tmp_path / "none.json")
    with pytest.raises(ResultFileError, match="a folder"):
        read_result(tmp_path)


@each("text", [b"", b"{", b"\xff\xfe\x00", b"not json", b"[" * 100_000, b"9" * 5000])
def test_what_is_not_json_is_refused(tmp_path, text):
    (tmp_path / "r.json").write_bytes(text)
    with pytest.raises(ResultFileError, match=r"is not (JSON|UTF-8)"):
        read_result(tmp_path / "r.json")


def test_files_of_another_kind_or_schema_are_refused(tmp_path, content):
    others = [[], 3, None, "text", {}, {"kind": "trajectory"}, {"dynid_schema": 1}]
    cases = [(other, "not a result of dynid identify") for other in others]
    cases += [(content | {"dynid_schema": schema}, "schema version") for schema in (2, 99, "1", None)]
    for value, message in cases:
        (tmp_path / "r.json").write_text(json.dumps(value))
        with pytest.raises(ResultFileError, match=message):
            read_result(tmp_path / "r.json")


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_missing_keys_and_wrong_types_are_named(tmp_path_factory, content, data):
    broken = json.loads(json.dumps(content))
    optional = {name for name, field in Result.model_fields.items() if not field.is_required()} | set(
        Result.model_computed_fields
    )
    key = data.draw(st.sampled_from(sorted(set(broken) - optional)))
    wrong = data.draw(st.sampled_from(["missing", "list", "object"]))
    if wrong == "missing":
        del broken[key]
    else:
        broken[key] = [{}] if wrong == "list" else {"x": {"y": 1}}
    path = tmp_path_factory.mktemp("broken") / "r.json"
    path.write_text(json.dumps(broken))
    with pytest.raises(ResultFileError) as caught:
        read_result(path)
    assert key in caught.value.where
    assert caught.value.hint


def test_unknown_keys_of_the_same_schema_are_let_through(tmp_path, content, identified):
    (tmp_path / "r.json").write_text(json.dumps(content | {"added_later": 1}))
    assert read_result(tmp_path / "r.json") == identified[2]


def test_no_number_becomes_null(identified):
    _, _, result = identified
    changed = result.model_copy(
        update={"fit": result.fit.model_copy(update={"relative_error": None, "rmse": [None, 1.0, 2.0]})}
    )
    assert json.loads(result_json(changed))["fit"]["rmse"] == [None, 1.0, 2.0]
    figures = type(result.fit).model_validate(result.fit.model_dump() | {"rmse": [np.nan, np.inf, 2.0]})
    assert figures.rmse == [None, None, 2.0]
