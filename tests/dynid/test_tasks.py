"""The tasks in one call each, beside the commands that do the same."""

from __future__ import annotations

import html
import inspect
import json

import numpy as np
import pytest
from command_line import stored
from each import each
from loaded_arm import LOAD, runs
from typer.main import get_command

import dynid
from dynid.command import build_app


def test_a_result_is_saved_and_read_back(result, tmp_path):
    folder = tmp_path / "model"
    result.save(folder)
    assert {path.name for path in folder.iterdir()} == {"result.json", "report.html"}
    assert json.loads(result.to_json()) == stored(folder / "result.json")
    again = dynid.load_result(folder / "result.json")
    assert again.verdict == result.verdict
    q = np.linspace(-1, 1, 6)
    for kind in ("full", "essential"):
        model = dynid.load_model(folder, parameters=kind)
        assert model.kind == kind
        np.testing.assert_array_equal(model.gravity(q), dynid.Model(result.result, kind).gravity(q))


def test_a_result_that_was_changed_is_refused_by_all_that_read_it(result, tmp_path):
    """Two joints, links or values exchanged by hand or by a script; another format of the same is none of it."""
    result.save(tmp_path)
    file = tmp_path / "result.json"
    text = file.read_text(encoding="utf-8")
    written = json.loads(text)
    short = json.loads(
        text, parse_float=lambda number: int(float(number)) if float(number).is_integer() else float(number)
    )
    for same in (json.dumps(written, indent=5, sort_keys=True), json.dumps(short)):
        assert same != text
        file.write_text(same, encoding="utf-8")
        assert dynid.load_result(tmp_path).verdict == result.verdict
    first, second = written["joints"][:2]
    swaps = [text.replace(f'"{first}"', "@").replace(f'"{second}"', f'"{first}"').replace("@", f'"{second}"')]
    for key in ("joints", "base_parameters", "standard_parameters", "friction"):
        changed = json.loads(text)
        changed[key][0], changed[key][1] = changed[key][1], changed[key][0]
        swaps.append(json.dumps(changed))
    run = dynid.simulate("ur5e", duration=1.0, seed=1, rate=100.0)
    readers = (dynid.load_model, dynid.load_result, lambda path: dynid.validate(path, run))
    for swapped in swaps:
        file.write_text(swapped, encoding="utf-8")
        for read in readers:
            with pytest.raises(dynid.ResultFileError, match="was changed after dynid wrote it"):
                read(tmp_path)
    of_script = result.result
    swapped = of_script.robot_file.replace(first, "@").replace(second, first).replace("@", second)
    names = [{first: second, second: first}.get(name, name) for name in of_script.joints]
    for changes, message in (
        ({"joints": of_script.joints[::-1]}, "are not those of the robot file"),
        ({"robot_file": swapped}, "are not those of the robot file"),
        ({"robot_file": swapped, "joints": names}, "the base parameters do not belong to the robot file"),
    ):
        with pytest.raises(dynid.ResultFileError, match=message):
            dynid.validate(dynid.IdentificationResult(of_script.model_copy(update=changes)), run)


def test_parameters_that_a_result_lacks_are_refused_in_one_sentence(result, tmp_path):
    older = dynid.IdentificationResult(result.result.model_copy(update={"consistent": None}))
    older.save(tmp_path)
    with pytest.raises(dynid.ModelError, match="this result holds no physically consistent parameters"):
        dynid.load_model(tmp_path, parameters="consistent")
    assert dynid.load_model(tmp_path).kind == older.model.kind == "full"
    with pytest.raises(dynid.UsageError, match="there are no 'best' parameters"):
        dynid.load_model(tmp_path, parameters="best")
    with pytest.raises(dynid.ResultFileError, match="no such file"):
        dynid.load_model(tmp_path / "nowhere")


def test_save_refuses_a_file(result, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(dynid.UsageError, match="is a file"):
        result.save(tmp_path / "file")


def test_a_result_shows_itself(result):
    text, html = str(result), result._repr_html_()
    assert str(result.verdict) in text
    assert result.verdict.headline in html
    assert "ZZR1" in text
    assert html.count("<table>") == 2
    assert "wrist_3_joint" in result.errors._repr_html_()
    assert result.friction.row("elbow_joint")["viscous"] > 0
    assert result.fit.relative_error < 0.1
    assert result.validation.relative_error < 0.1


def test_a_table_becomes_a_frame(result):
    pytest.importorskip("pandas")
    frame = result.friction.to_frame()
    assert frame.loc["elbow_joint", "viscous"] == result.friction.row("elbow_joint")["viscous"]
    assert frame.attrs["units"]["viscous"] == "N·m·s/rad"
    assert result.parameters.to_frame().shape == (len(result.parameters), 12)


def test_a_table_escapes_what_it_shows():
    from ident.result.tables import table_of_rows

    table = table_of_rows("<t>", [("name", ""), ("value", "m")], [("<b>", 1.0), ("c", None)])
    assert "<b>" not in table._repr_html_()
    assert str(table).splitlines() == ["<t>", "name  value [m]", "<b>           1", "c             –"]
    assert np.isnan(table["value"][1])
    assert [row["name"] for row in table] == ["<b>", "c"]
    with pytest.raises(dynid.UsageError, match="no column 'mass'"):
        table["mass"]
    with pytest.raises(dynid.UsageError, match="no row 'd'"):
        table.row("d")
    assert len(table_of_rows("empty", [("name", "")], [])) == 0


def test_validate_takes_results_models_and_folders(result, other, tmp_path):
    result.save(tmp_path)
    for identified in (result, result.model, tmp_path, tmp_path / "result.json"):
        validation = dynid.validate(identified, other)
        assert validation.full.relative_error == pytest.approx(result.validation.relative_error, rel=0.05)
    assert len(validation.errors) == 6


@pytest.mark.usefixtures("estimate_alone")
def test_merge_halves_the_variance(result, other, run):
    second = dynid.identify(other, validation=run)
    merged = dynid.merge([result, second.model], validation=run)
    assert merged.fit is None
    assert merged.validation.relative_error < 0.05
    known = merged.parameters["std"] / result.parameters["std"]
    assert np.nanmedian(known) < 1
    with pytest.raises(dynid.UsageError, match="count twice"):
        dynid.merge([result, result])


@each(
    ("options", "message"),
    [
        ({"method": "magic"}, "no method is called 'magic'"),
        ({"friction": "sticky"}, "no friction model is called"),
        ({"significance": 0}, "significance 0 is not within 0.001 to 100 %"),
        ({"locked": "elbow_joint"}, "a list of joint names is needed"),
        ({"locked": ["elbow"]}, "no joint of ur5e is called 'elbow'"),
        ({"delay": float("nan")}, "nan is not a finite number"),
        ({"start": 5.0, "stop": 4.0}, "is empty"),
        ({"robot": "ur5"}, "did you mean 'ur5e'"),
        ({"validation": "nowhere.h5"}, "nowhere.h5: no such file"),
    ],
)
def test_bad_options_are_refused_in_one_line(run, options, message):
    with pytest.raises(dynid.InputError, match=message) as refused:
        dynid.identify(run, **options)
    assert "\n" not in str(refused.value)


def test_no_run_is_refused():
    with pytest.raises(dynid.UsageError, match="no recording"):
        dynid.identify([])


LIMITS = dict.fromkeys(("max_error", "max_joint_error", "max_rmse"), "accept")

RENAMED = {
    "identify": {"validate": "validation", **LIMITS},
    "validate": LIMITS,
    "excite": {"from": "earlier"},
    "import": {"column": "columns"},
    "merge": {"validate": "validation"},
    "compare": {"validate": "validation"},
}
"""Options whose names would be odd in Python."""

OF_FILES = {"out", "json", "help", "force", "verbose", "page", "comment", "up_and_down", "csv"}
OTHER_FUNCTIONS = {
    "identify": {"gravity": dynid.identify_gravity, "model_file": dynid.identify_servo, "history": dynid.History.add},
    "validate": {"model_file": dynid.ServoModel.validate},
    "excite": dict.fromkeys(("for", "poses"), dynid.design_gravity_motion)
    | dict.fromkeys(("after", "wanted", "length"), dynid.design_servo_motion),
}
"""Options that are a function of their own in Python, or keywords of one."""


@pytest.mark.parametrize(
    ("command", "function"),
    [
        ("identify", dynid.identify),
        ("validate", dynid.validate),
        ("predict", dynid.predict),
        ("merge", dynid.merge),
        ("payload", dynid.payload),
        ("gains", dynid.drive_gains),
        ("friction", dynid.friction),
        ("info", dynid.info),
        ("excite", dynid.design_excitation),
        ("import", dynid.import_recording),
    ],
)
def test_keywords_are_the_options_of_the_command(command, function):
    parameters = get_command(build_app()).commands[command].params
    options = {
        option.removeprefix("--").replace("-", "_")
        for parameter in parameters
        for option in parameter.opts
        if option.startswith("--")
    }
    others = OTHER_FUNCTIONS.get(command, {})
    assert set(others) <= options
    wanted = {RENAMED.get(command, {}).get(option, option) for option in options - OF_FILES - set(others)}
    assert wanted <= set(inspect.signature(function).parameters)


def test_the_quality_of_a_recording_is_shown_and_saved(run, tmp_path):
    quality = dynid.info(run, wanted_rsd=5.0)
    assert quality.streams.row("joints")["samples"] == len(run.streams["joints"].time)
    assert quality.motion.names == run.robot().robot.joint_names
    assert max(quality.motion["limit_utilisation"]) < 110
    for text in (quality.streams.title, quality.verdict.headline):
        assert text in str(quality)
    quality.save(tmp_path / "info")
    assert stored(tmp_path / "info" / "info.json") == json.loads(quality.to_json())
    assert quality.verdict.headline in html.unescape((tmp_path / "info" / "info.html").read_text(encoding="utf-8"))
    with pytest.raises(dynid.UsageError, match=r"is not within 0\.001 to 100 %"):
        dynid.info(run, wanted_rsd=-1.0)


def test_a_designed_motion_is_saved_and_shown(tmp_path):
    motion = dynid.design_excitation("up6", starts=1, workers=1, harmonics=2, period=6.0)
    motion.save(tmp_path / "motion.yaml")
    motion.page(tmp_path / "motion.html")
    assert "<html" in (tmp_path / "motion.html").read_text(encoding="utf-8")
    read = dynid.load_trajectory(tmp_path / "motion.yaml", "up6")
    time = np.linspace(0, motion.duration, 50)
    for mine, theirs in zip(motion.evaluate(time), read.evaluate(time), strict=True):
        assert mine.shape == (50, 3)
        np.testing.assert_allclose(mine, theirs, atol=1e-9)
    assert max(motion.limits["position"]) <= 100
    assert read.figures.worst_use == pytest.approx(motion.figures.worst_use)
    assert "designed" not in read.summary
    assert motion.limits.title in str(motion)
    with pytest.raises(dynid.UsageError, match="'magic' does not exist"):
        dynid.design_excitation("up6", criterion="magic")
    with pytest.raises(dynid.UsageError, match="there is no such folder"):
        motion.save(tmp_path / "nowhere" / "motion.yaml")


def test_gains_need_numbers_of_a_load(run):
    with pytest.raises(dynid.UsageError, match="not a number"):
        dynid.drive_gains(run, run, mass="heavy")
    with pytest.raises(dynid.UsageError, match="whose mass is missing"):
        dynid.payload(run, run, com=[0, 0, 0.1])


def test_a_payload_and_the_gains_that_hide_behind_it(tmp_path):
    free, loaded = runs(seed=1)
    load = dynid.payload(free, loaded, mass=LOAD.mass)
    assert load.mass == pytest.approx(LOAD.mass, abs=4 * load.mass_std)
    assert load.com is not None
    assert load.com_std is not None
    np.testing.assert_array_less(np.abs(load.com - LOAD.com), 5 * load.com_std)
    assert load.sentences
    assert "free" in load.changes._repr_html_()
    assert json.loads(load.to_json())["kind"] == "payload"
    gains = dynid.drive_gains(free, loaded, mass=LOAD.mass, com=LOAD.com, inertia=np.array(LOAD.inertia))
    assert json.loads(gains.to_json())["kind"] == "gains"
    load.save(tmp_path)
    assert stored(tmp_path / "payload.json") == json.loads(load.to_json())
    gains.save(tmp_path, overwrite=True)
    assert "drive gains" in (tmp_path / "report.html").read_text(encoding="utf-8")
    np.testing.assert_allclose(gains.values, gains.gains["file_gain"], rtol=0.2)
    assert gains.robot_file_text.startswith("drives:")
    assert gains.gains.columns[2].unit == "N·m/A"
    assert "Drive gains" in str(gains)
