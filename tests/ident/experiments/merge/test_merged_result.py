"""Merging results as `dynid identify` writes them: two experiments, one model, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from true_results import truth_of

from daq.recording.reader import read_recording
from daq.recording.recording import JOINTS_STREAM
from daq.recording.writer import write_recording
from daq.robot.loader import parse_robot
from drivers.core.errors import DataError, ResultFileError, UsageError
from ident.experiments.merge.merged_result import merge_results
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.revalidate import revalidate
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.regression.options import ExperimentChoices
from ident.report.page import render_report
from ident.report.section import ReportData
from ident.result.result_file import read_result, result_json, stored_estimate, stored_model
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("mistakes_not_sought")

SECONDS = 20.0
STATED = ModelChoices(friction="coulomb-viscous")
"""The terms that the arm has; to look for others takes a quarter of the time."""


@pytest.fixture(scope="module")
def recorded(three_joint, tmp_path_factory):
    """Factory of recordings on disk; some joints may stand still somewhere, the arm may carry a load."""
    model = build_model(three_joint)
    folder = tmp_path_factory.mktemp("recordings")

    def make(seed, still=(), arm=three_joint, at=0.4):
        motion = random_fourier_motion(model, 10.0, seed, candidates=3)
        for joint in still:
            motion.sine[joint] = motion.cosine[joint] = 0.0
            motion.offset[joint] = at
        path = folder / f"{seed}{still}{at}{arm is three_joint}.h5"
        if not path.exists():
            write_recording(path, simulate_recording(arm, motion, SECONDS, seed))
        return read_recording(path)

    return make


def result_of(recording, *, locked=(), torques_of=(), robot_file=None, model=STATED):
    choices = IdentifyChoices(
        experiment=ExperimentChoices(locked=locked, torques_of=torques_of),
        search_delay=False,
        presliding=False,
        model=model,
    )
    return identify([recording], [], choices, robot_file=robot_file).result


@pytest.fixture(scope="module")
def results(recorded):
    """Joint 3 locked; joint 3's own torque in free motion."""
    arm = result_of(recorded(1, still=(2,)), locked=("j3",))
    wrist = result_of(recorded(2), torques_of=("j3",))
    return arm, wrist


@pytest.fixture(scope="module")
def merged(results, recorded):
    return merge_results([("arm", results[0]), ("wrist", results[1])], recorded(3))


def deviations(result, robot_file):
    """Errors (b,) in standard deviations."""
    values = np.array([parameter.value for parameter in result.base_parameters], dtype=float)
    std = np.array([parameter.std for parameter in result.base_parameters], dtype=float)
    return (values - truth_of(robot_file)) / std


def test_two_experiments_make_the_whole_model(merged, results, three_joint):
    result, validated = merged
    whole = base_parameters(build_model(three_joint))
    assert [parameter.name for parameter in result.base_parameters] == list(whole.names)
    assert max(len(part.base_parameters) for part in results) < whole.count
    assert np.max(np.abs(deviations(result, three_joint))) < 5.0
    assert validated is not None
    assert result.validation is not None
    assert result.validation.relative_error < 0.05
    assert all(value is not None for value in result.validation.rmse)
    assert result.verdict.purposes["torque_prediction"].grade == "good"


@pytest.mark.usefixtures("estimate_alone")
def test_merged_intervals_hold_the_truth(results, recorded, three_joint):
    arms = [result_of(recorded(seed, still=(2,)), locked=("j3",)) for seed in range(5, 8)]
    merged = [merge_results([("arm", arm), ("wrist", results[1])])[0] for arm in arms]
    inside = np.abs([deviations(result, three_joint) for result in merged]) < 1.96
    assert np.mean(inside) > 0.9


def test_the_merged_model_is_simulated_on_held_out_data(merged, results):
    result, _ = merged
    consistent = result.consistent
    assert consistent.validation.relative_error == pytest.approx(result.validation.relative_error, rel=0.2)
    assert consistent.not_simulated == ""
    assert max(consistent.simulation.position_rmse) < 0.02
    alone, _ = merge_results([("arm", results[0]), ("wrist", results[1])])
    assert alone.consistent.simulation is None
    assert alone.consistent.not_simulated == "nothing was held out"
    assert results[0].consistent.not_simulated == "not all joints moved, or not all torques were used"
    assert "Not simulated on the held-out motion: nothing was held out" in render_report(ReportData(alone, (), ()))


def test_the_merged_model_is_a_result_like_others(merged, recorded, tmp_path):
    result, validated = merged
    (tmp_path / "result.json").write_text(result_json(result))
    again = read_result(tmp_path / "result.json")
    assert again == result
    assert revalidate(again, recorded(3)).full.relative_error == validated.full.relative_error
    assert result.fit is None
    assert [use.role for use in result.recordings] == ["identification"] * 2
    assert result.residuals.joint_std[2] is not None
    page = render_report(ReportData(result, (), validated.series))
    assert "Merged models" in page
    assert "arm" in page


def test_merging_with_what_was_known_before_changes_nothing_but_the_error_bars(merged, recorded, three_joint):
    """The merged estimate is the prior of a third experiment; in one step or in two, the result is the same."""
    more = result_of(recorded(4))
    in_steps, _ = merge_results([("before", merged[0]), ("more", more)])
    assert in_steps.merge.consistency is not None
    assert in_steps.merge.consistency.agree
    assert "agree" in in_steps.verdict.basis
    assert len(in_steps.experiments) == 3
    before = np.array([parameter.std for parameter in merged[0].base_parameters])
    after = np.array([parameter.std for parameter in in_steps.base_parameters])
    alone = np.array([parameter.std for parameter in more.base_parameters])
    assert np.median(after / np.minimum(before, alone)) < 1.0
    assert np.mean(np.abs(deviations(in_steps, three_joint)) < 1.96) > 0.8


@pytest.fixture(scope="module")
def more(recorded):
    """All joints free, on another motion."""
    return result_of(recorded(4))


def test_friction_that_differs_between_models_is_in_its_interval(results, more):
    """Three models, of one of which friction is 20 % larger."""

    def larger(factor, number):
        values = [
            p.model_copy(update={"value": p.value * (factor if p.kind in ("coulomb", "viscous") else 1.0)})
            for p in more.base_parameters
        ]
        uses = [use.model_copy(update={"sha256": f"{number:064d}", "sample_hashes": []}) for use in more.recordings]
        return more.model_copy(update={"base_parameters": values, "recordings": uses})

    alike, _ = merge_results([("a", larger(1.0, 1)), ("b", larger(1.0, 2)), ("c", larger(1.0, 3))])
    changed, _ = merge_results([("a", larger(1.0, 1)), ("b", larger(1.2, 2)), ("c", larger(1.0, 3))])
    for one, other, before in zip(changed.base_parameters, alike.base_parameters, more.base_parameters, strict=True):
        if one.kind in ("coulomb", "viscous"):
            assert one.repeatability == pytest.approx(0.2 / np.sqrt(3.0) * before.value, rel=0.2)
            assert one.std > 0.5 * one.repeatability
            assert other.repeatability == 0.0
    assert "3 runs" in changed.friction_note


def test_merging_in_steps_is_merging_at_once(merged, results, more):
    at_once, _ = merge_results([("arm", results[0]), ("wrist", results[1]), ("more", more)])
    in_steps, _ = merge_results([("before", merged[0]), ("more", more)])
    for one, other in zip(at_once.base_parameters, in_steps.base_parameters, strict=True):
        assert other.value == pytest.approx(one.value, abs=1e-6 * one.std)
        assert other.std == pytest.approx(one.std, rel=1e-6)


def test_another_load_shows(results, recorded, three_joint):
    """0.3 kg more on the last link between the experiments."""
    loaded = with_load(three_joint, 0.3, (0.3, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    other = result_of(recorded(4, arm=loaded))
    result, _ = merge_results([("wrist", results[1]), ("loaded", other)])
    assert not result.merge.consistency.agree
    assert result.merge.consistency.contradictions
    assert "contradict each other" in result.verdict.headline
    assert any("Furthest" in warning for warning in result.warnings)
    names = {one.parameter for one in result.merge.consistency.contradictions}
    assert names & {"MX3", "ZZ3", "XXR3", "MXR3", "ZZR3"}


def test_parts_of_an_arm_stay_parts(results, recorded):
    """The same joint locked twice in the same place tells no more of the arm, and the model says what it holds for."""
    again = result_of(recorded(5, still=(2,)))
    result, _ = merge_results([("a", results[0]), ("b", again)])
    assert [p.name for p in result.base_parameters] == [p.name for p in results[0].base_parameters]
    assert any("can show" in warning for warning in result.warnings)
    assert result.merge.consistency.freedom == len(result.base_parameters)
    assert revalidate(result, recorded(6, still=(2,))).full.relative_error < 0.05
    with pytest.raises(DataError, match=r"j3 is at 0\.9 rad"):
        revalidate(result, recorded(6, still=(2,), at=0.9))
    elsewhere, _ = merge_results([("a", results[0]), ("c", result_of(recorded(6, still=(2,), at=0.9)))])
    assert len(elsewhere.base_parameters) > len(result.base_parameters)


def test_parts_are_not_simulated(results, recorded):
    part = result_of(recorded(5, still=(2,)), locked=("j3",))
    merged, _ = merge_results([("arm", results[0]), ("again", part)], recorded(6, still=(2,)))
    assert merged.consistent.simulation is None
    assert merged.consistent.not_simulated == "not all joints moved, or not all torques were used"


def test_a_parameter_that_was_not_excited_comes_from_the_other_experiment(recorded, three_joint):
    model = build_model(three_joint)
    motion = random_fourier_motion(model, 10.0, 7)
    motion.sine[1] *= 3e-3  # too slow to rub
    motion.cosine[1] *= 3e-3
    slow = simulate_recording(three_joint, motion, SECONDS, 7)
    part = result_of(slow, torques_of=("j1", "j3"))
    whole = result_of(recorded(8))
    result, _ = merge_results([("slow", part), ("whole", whole)])
    assert all(parameter.value is not None for parameter in result.base_parameters)
    assert np.max(np.abs(deviations(result, three_joint))) < 5.0


def test_a_recording_counts_once(recorded):
    run = recorded(2)
    one, other = result_of(run, torques_of=("j2", "j3")), result_of(run, torques_of=("j1", "j3"))
    with pytest.raises(UsageError, match=r"torques of j3 in .*h5, which would count twice"):
        merge_results([("a", one), ("b", other)])
    apart = result_of(run, torques_of=("j1",))
    result, _ = merge_results([("a", one), ("b", apart)])
    assert len(result.base_parameters) == base_parameters(build_model(run.robot())).count


def test_models_of_different_arms_are_refused(results, recorded, three_joint):
    doubled = parse_robot(three_joint.text.replace("gain: 10,", "gain: 20,"), where="doubled", folder=None)
    other = result_of(recorded(4), robot_file=doubled)
    with pytest.raises(UsageError, match=r"differ at line \d+: '- \{joint: j1, gain: 10,.*gain: 20") as caught:
        merge_results([("a", results[0]), ("b", other)])
    assert "--robot" in (caught.value.hint or "")
    other = result_of(recorded(4), model=replace(STATED, offset=False))
    with pytest.raises(UsageError, match="different columns: offset"):
        merge_results([("a", results[0]), ("b", other)])


def test_one_model_is_no_merge(results):
    with pytest.raises(UsageError, match="at least two models"):
        merge_results([("a", results[0])])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.update(estimate=None), "earlier dynid"),
        (lambda content: content["estimate"].update(absorbed={"XX9": [1.0]}), "absorbed.XX9"),
        (lambda content: content["estimate"]["parameters"].__setitem__(0, "XX9"), "estimate.parameters"),
        (lambda content: content["base_parameters"][0].update(value=None), "estimate.parameters"),
        (lambda content: content["experiments"][0].update(torques_of=["j9"]), "experiments.0"),
        (lambda content: content["experiments"][0].update(torques_of=[]), "experiments.0"),
        (lambda content: content["experiments"][0].update(locked={"j3": [0.1], "j2": [0.1, 0.2]}), "experiments.0"),
        (lambda content: content["experiments"][0].update(locked={}), "do not belong"),
    ],
)
def test_what_does_not_fit_together_is_refused_by_name(results, change, message):
    content = json.loads(result_json(results[0]))
    change(content)
    spoilt = type(results[0]).model_validate(content)
    with pytest.raises(ResultFileError) as caught:
        merge_results([("arm/result.json", spoilt), ("wrist", results[1])])
    assert message in str(caught.value)
    assert "arm/result.json" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda content: content["estimate"]["covariance"].pop(), "estimate.covariance"),
        (lambda content: content["estimate"]["root"][0].pop(), "estimate.root"),
        (lambda content: content["estimate"]["root"][2].__setitem__(2, 0.0), "estimate.root"),
        (lambda content: content["estimate"]["covariance"][1].__setitem__(0, 1e3), "estimate.covariance"),
        (lambda content: content["estimate"]["covariance"][1].__setitem__(1, -1.0), "estimate.covariance"),
        (lambda content: content["estimate"].update(within=[[1.0]]), "estimate.within"),
    ],
)
def test_a_broken_covariance_is_refused_when_the_file_is_read(results, tmp_path, change, key):
    content = json.loads(result_json(results[0]))
    change(content)
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content))
    with pytest.raises(ResultFileError) as caught:
        read_result(path)
    assert caught.value.where == f"{path}: {key}"


def test_what_changes_between_runs_is_apart_after_reading(results, tmp_path):
    whole = results[0].estimate
    apart = whole.model_copy(update={"within": (0.25 * np.array(whole.covariance)).tolist()})
    path = tmp_path / "result.json"
    path.write_text(result_json(results[0].model_copy(update={"estimate": apart})))
    stored = stored_model(results[0])
    assert stored_estimate(results[0], stored).within is None
    read = stored_estimate(read_result(path), stored)
    np.testing.assert_allclose(read.within, 0.25 * read.covariance)


def test_noise_free_estimates_can_be_merged(three_joint):
    clean = parse_robot(three_joint.text[: three_joint.text.index("  noise:")], where="noise-free", folder=None)
    model = build_model(clean)
    runs = [
        simulate_recording(clean, random_fourier_motion(model, 10.0, seed), 15.0, seed, rate=200.0) for seed in (1, 2)
    ]
    assert JOINTS_STREAM in runs[0].streams
    result, _ = merge_results([(str(i), result_of(run)) for i, run in enumerate(runs)])
    truth = truth_of(clean)
    values = np.array([parameter.value for parameter in result.base_parameters])
    assert np.max(np.abs(values - truth) / np.maximum(np.abs(truth), 0.01 * np.max(np.abs(truth)))) < 2e-3
