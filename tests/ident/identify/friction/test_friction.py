"""Friction with further terms: recovered from simulation, chosen automatically, predicted, stored and exported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from friction_experiment_arm import TWO_BODIES

from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import DataError, ModelError, UsageError
from ident.friction.choice import check_friction, chosen_friction
from ident.identify.friction.candidates import FOLDS, CandidateGrams, candidates_of
from ident.identify.friction.selection import FrictionSearch
from ident.identify.friction.shapes import with_curvature, with_free_shapes
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.predict import predict_recording
from ident.identify.revalidate import revalidate
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import true_model, truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import FilteredRun
from ident.regression.systematic_errors import with_systematic_errors
from ident.result.models.model import Model
from ident.result.result_file import result_json
from ident.result.schema import Result
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("estimates_alone")

DURATION = 15.0

ARM = (
    TWO_BODIES
    + """  joints:
    j1: {viscous: 5, coulomb: 4, offset: 0.3, motor_inertia: 0.6, alpha: 1.4, stribeck: 3.0, stribeck_velocity: 0.12,
         load: 0.01, temperature: [36, -0.11, 0]}
    j2: {viscous: 3, coulomb: 3, offset: -0.2, motor_inertia: 0.3, alpha: 1.3, stribeck: 2.0, stribeck_velocity: 0.15,
         load: 0.03, temperature: [30, -0.09, 0]}
  noise:
    rate: 200
    torque_std: {j1: 0.05, j2: 0.05}
"""
)


def arm(**friction: object) -> RobotFile:
    content = yaml.safe_load(ARM)
    content["friction"] = friction
    return parse_robot(yaml.safe_dump(content), where="arm", folder=None)


def recorded(robot_file: RobotFile, seed: int, warm: bool = True):
    motion = random_fourier_motion(true_model(arm()), DURATION, seed)
    heat = np.linspace(22.0, 42.0, round(DURATION * 200))[:, None] * [1.0, 0.9] if warm else None
    return simulate_recording(robot_file, motion, DURATION, seed, celsius=heat)


CURVED = "temperature_curvature"
FULL = {"exponent": "estimated", "stribeck": True, "load": "quadratic", "temperature": "linear"}


@pytest.fixture(scope="module")
def full() -> tuple[RobotFile, Identification, Result]:
    robot_file = arm(**FULL)
    runs = [recorded(robot_file, 1)], [recorded(robot_file, 2)]
    found = identify(*runs, IdentifyChoices(search_delay=False, reversals=0.0))
    return robot_file, found, found.result


@pytest.mark.parametrize(
    "friction",
    [
        {"exponent": "estimated"},
        {"stribeck": True, "exponent": 1.4, "joints": {"j2": {"exponent": 1.3}}},
        {"load": "quadratic", "stribeck": True},
        {"temperature": "linear"},
        FULL,
    ],
    ids=lambda friction: "+".join(friction),
)
def test_truth_lies_within_the_error_bars(friction):
    robot_file = arm(**friction)
    found = identify([recorded(robot_file, 1)], [], IdentifyChoices(search_delay=False, reversals=0.0))
    truth = found.base.projection @ truth_vector(robot_file, found.model)
    deviation = np.abs(found.solution.parameters - truth) / found.std
    named = dict(zip(found.base.names, deviation.round(1), strict=True))
    assert np.mean(deviation < WITHIN_95_PERCENT) > 0.8, named
    assert np.max(deviation) < 4.5, named
    joints = robot_file.robot.truth.joints
    for (kind, motor), deviation_of_shape in found.shape_std.items():
        name = found.model.joint_names[motor]
        estimated = found.model.terms.shape(kind, motor)
        true = joints[name].alpha if kind == "exponent" else joints[name].stribeck_velocity
        assert abs(estimated - true) < 4.0 * deviation_of_shape
    assert len(found.shape_std) == 2 * (friction.get("exponent") == "estimated") + 2 * ("stribeck" in friction)
    assert found.friction.settled


def test_error_bars_hold_what_is_not_linear_in_the_shapes_and_what_a_delay_does_to_them(full):
    _, found, _ = full
    runs = [run.prepared for run in found.runs]
    (run,) = runs
    filtered = [FilteredRun(run.segments, run.parallel_filter, found.fit_series)]
    kernel, weights = RegressorKernel(found.model, found.base.columns), found.solution.weights
    corrected, free = with_free_shapes(
        found.choices.estimator, found.estimation, [0, 1], filtered, runs, runs, found.corrected
    )
    alone, shape_std = free.split(corrected)
    assert shape_std.keys() == found.shape_std.keys()
    assert all(std > 0.0 for std in shape_std.values())

    def curvature(share: float):
        shapes = {name: share * std for name, std in shape_std.items()}
        return with_curvature(alone, shapes, free, kernel, runs, weights).curvature

    whole, tenth = curvature(1.0), curvature(0.1)
    kinds = np.array([found.base.kinds[column] for column in found.solution.active])
    assert np.all(whole[kinds == "inertial"] == 0.0)
    assert np.all(whole[kinds == "viscous"] > 0.0)
    assert np.all(tenth[kinds == "viscous"] < 0.03 * whole[kinds == "viscous"])  # of second order
    assert np.all(found.std[list(found.solution.active)] >= np.sqrt(np.diag(found.corrected.covariance)))
    late = with_systematic_errors(corrected, free.kernel, runs, free.reduction, weights, free.active, [0, 1], 0.01)
    _, later = free.split(late)
    assert all(later[name] > std for name, std in shape_std.items())


def test_terms_of_the_temperature_are_no_candidates_where_it_hardly_differs():
    model = true_model(arm())
    kinds = [
        {one.quantity for one in candidates_of(model, np.ones(2), warmed)[0] if one.quantity.startswith("temperature")}
        for warmed in (0.0, np.nan, 4.9, 5.0, 15.0)
    ]
    assert kinds[:3] == [set(), set(), set()]
    assert kinds[3:] == [{"temperature", "temperature_slope"}, {"temperature", "temperature_slope", CURVED}]


def test_runs_at_different_temperatures_are_no_friction_that_changes_between_runs():
    robot_file = arm(temperature="linear")
    runs = []
    for seed, celsius in enumerate((25.0, 32.0, 40.0)):
        motion = random_fourier_motion(true_model(arm()), 8.0, seed)
        heat = celsius + np.linspace(0.0, 0.3, 1600)[:, None] * [1.0, 0.9]
        runs.append(simulate_recording(robot_file, motion, 8.0, seed, celsius=heat))
    found = identify(runs, [recorded(robot_file, 5)], IdentifyChoices(search_delay=False))
    named = dict(zip(found.base.names, zip(found.repeatability, found.std, strict=True), strict=True))
    assert np.isnan(named["Fts1"][0])
    for name in ("Fs1", "Fs2", "Fv1", "Fv2", "Ft1", "Ft2"):
        assert named[name][0] < named[name][1], named
    assert named["Ft1"][1] < 1.0, named


def test_automatic_choice_finds_what_there_is():
    robot_file = arm(stribeck=True, stribeck_velocity=0.12, joints={"j2": {"stribeck": False}})
    runs = [recorded(robot_file, 1)], [recorded(robot_file, 2)]
    plain = identify(*runs, IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), search_delay=False))
    found = identify(*runs, IdentifyChoices(model=ModelChoices(friction="auto"), search_delay=False))
    assert [(step.joint, step.term) for step in found.friction.steps if step.accepted] == [("j1", "stribeck")]
    assert found.model.has("stribeck") == (True, False)
    assert found.validation.relative_error < 0.7 * plain.validation.relative_error


@pytest.mark.parametrize("only", [False, True])
def test_what_one_fold_alone_determines_is_no_ground_for_a_choice(only):
    candidates = candidates_of(true_model(arm()), np.full(2, 2.0))[:1]
    rows = np.random.default_rng(1).standard_normal((FOLDS, 99, 3 + len(candidates[0])))
    rows[1:, :, 1] *= not only
    grams = CandidateGrams(candidates, ((0, 1),), (rows.transpose(0, 2, 1) @ rows,), np.full((FOLDS, 1), 99.0), 2)
    steps = FrictionSearch(grams, (0, 1), (1,), (0,), (0,), np.ones(1)).choose(0, "j1")
    assert (not steps) == only
    assert all(np.isfinite([step.error_before, step.error_after]).all() for step in steps)


def test_prediction_and_storage_agree(full, tmp_path):
    robot_file, found, result = full
    again = Result.model_validate_json(result_json(result))
    model = Model(again, "full")
    recording = recorded(robot_file, 2)
    assert revalidate(again, recording).full.relative_error == pytest.approx(found.validation.relative_error, rel=1e-6)
    prediction = predict_recording(model, robot_file, recording).segments[0]
    assert np.std(prediction.residual) < 0.05
    assert np.all(np.isfinite(prediction.std))
    q, dq, ddq, heat = [0.4, 0.3], [0.5, -0.4], [0.1, 0.2], [30.0, 35.0]
    rest = model.torque(q, [0.0, 0.0], ddq, heat)
    torque = model.torque(q, dq, ddq, heat)
    values = np.array(model.parameters["value"], dtype=float)
    assert np.allclose(model.regressor(q, dq, ddq, heat) @ values, torque)
    parts = model.mass_matrix(q) @ ddq + model.gravity(q) + model.coriolis(q, dq) + model.friction(dq, q, heat)
    assert np.allclose(parts, torque)
    assert not np.allclose(rest, torque)
    assert np.allclose(model.forward_dynamics(q, dq, torque, heat), ddq)


def test_friction_section_of_the_result(full):
    robot_file, _, result = full
    for joint in result.friction:
        truth = robot_file.robot.truth.joints[joint.joint]
        beta = np.array(joint.temperature[:2])
        assert np.all(np.abs(beta - truth.temperature[:2]) < 4.0 * np.array(joint.temperature_std[:2]))
        assert abs(joint.load - truth.load) < 4.0 * joint.load_std
        assert joint.load_power == 2.0
        assert "Stribeck" in joint.terms_text
        assert "α" in joint.terms_text
    units = {p.name: p.unit for p in result.base_parameters}
    assert units["Fl1"] == "1/(N·m)"
    assert units["Fv1"].startswith("N·m·(s/rad)^1.")


def test_what_friction_depends_on_is_asked_for(full):
    robot_file, _, result = full
    model = Model(result, "full")
    with pytest.raises(DataError, match="temperature of j1, j2 is missing"):
        model.torque([0.0, 0.0], [0.1, 0.1], [0.0, 0.0])
    with pytest.raises(DataError, match="positions are missing"):
        model.friction([0.1, 0.1], temperature=30.0)
    cold = recorded(arm(), 1)
    with pytest.raises(DataError, match="temperature of j1, j2 is missing"):
        identify([replace(cold, robot_text=robot_file.text)], [], IdentifyChoices())
    with pytest.raises(DataError, match="temperature of j1, j2 is missing"):
        revalidate(result, cold)
    with pytest.raises(ModelError, match="C code has no temperature"):
        model.export_c("arm")


def test_simulated_arm_has_this_friction(full):
    _, _, result = full
    model = Model(result)
    heat = [30.0, 32.0]
    torque = model.gravity([0.3, 0.2])
    held = model.simulate([0.3, 0.2], [0.0, 0.0], torque, 0.2, temperature=heat)
    assert np.allclose(held.position, [0.3, 0.2])  # dry friction holds the arm, and load adds to it

    def controller(time, q, dq):
        return model.torque(q, [0.5, -0.4], [0.0, 0.0], heat)

    moved = model.simulate([0.3, 0.2], [0.5, -0.4], controller, 0.3, temperature=heat)
    assert np.allclose(moved.velocity[-1], [0.5, -0.4], atol=2e-3)


def test_texts_of_friction_models():
    for good in ("auto", "none", "coulomb-viscous+power+stribeck+load-linear+temperature"):
        check_friction(good)
    for bad, message in (
        ("sticky", "no friction model is called 'sticky'"),
        ("coulomb+sticky", "no friction term is called 'sticky'"),
        ("coulomb+load+load-linear", "names a term twice"),
        ("coulomb+power", "exponent of viscous friction"),
    ):
        with pytest.raises(UsageError, match=message):
            check_friction(bad)
    given = arm(exponent=0.5, stribeck_velocity=0.2, joints={"j1": {"stribeck": True, "exponent": 0.8}}).robot.friction
    chosen = chosen_friction(given, "coulomb-viscous+power")
    assert chosen.exponent == 0.5
    assert chosen.joints["j1"].exponent == 0.8
    assert not chosen.joints["j1"].stribeck
    assert chosen_friction(given, "coulomb-viscous").exponent == 1.0


def test_exports_say_what_they_cannot_hold(full, tmp_path):
    _, _, result = full
    model = Model(result)
    for export in (model.export_urdf(tmp_path / "arm.urdf"), model.export_mjcf(tmp_path / "arm.xml")):
        lacking = " ".join(export.left_out)
        for what in ("Stribeck friction of j1, j2", "load-dependent", "temperature-dependent", "|q̇|^α"):
            assert what in lacking
