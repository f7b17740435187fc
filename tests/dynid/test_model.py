"""What an identified model answers, against Pinocchio, the simulated plant, and its own definitions."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from each import each
from loop_arms import FOUR_BAR, four_bar_arm
from true_results import true_result

import dynid
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.dynamics.rigid_arm import rigid_arm
from ident.model.parameters import INERTIAL, link_parameters
from ident.model.true_parameters import truth_vector

TREES = ("ur5e", "ur10e", "panda", "rocr6", "up6", "aubo_i5")
MANY = 450
"""Samples, so many that the vectorised regressor is used."""


@functools.cache
def arm(name: str) -> RobotFile:
    if name == "four_bar":
        return four_bar_arm()
    if name == "coupled_four_bar":
        coupled = FOUR_BAR.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1)
        return parse_robot(coupled, where="arm.yaml", folder=None)
    return load_robot(name)


@functools.cache
def true_model(name: str) -> dynid.Model:
    return dynid.Model(true_result(arm(name)), "full")


def states(name: str, count: int, seed: int = 3) -> list[np.ndarray]:
    return [np.ascontiguousarray(part.T) for part in random_states(build_model(arm(name)), count, seed)]


ARMS = (*TREES, "sr400", "four_bar", "coupled_four_bar")


@pytest.mark.parametrize("name", TREES)
def test_torque_is_that_of_pinocchio_with_friction_and_motor_inertia(name):
    import pinocchio as pin

    robot_file = arm(name)
    model, truth = build_model(robot_file), truth_vector(robot_file)
    reference = pinocchio_model(model, truth[: 10 * model.dof])
    data = reference.createData()
    joints = [robot_file.robot.truth.joints.get(joint) for joint in model.joint_names]
    q, dq, ddq = states(name, 20)
    expected = np.array([pin.rnea(reference, data, *sample) for sample in zip(q, dq, ddq, strict=True)])
    for j, true in enumerate(joints):
        if true is None:
            continue
        expected[:, j] += model.motor_inertia[j] * true.motor_inertia * ddq[:, j]
        expected[:, j] += model.viscous[j] * true.viscous * dq[:, j]
        expected[:, j] += model.coulomb[j] * true.coulomb * model.coulomb_direction(dq[:, j])
        expected[:, j] += model.offset[j] * true.offset
    np.testing.assert_allclose(
        true_model(name).torque(q, dq, ddq), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.parametrize("name", ["sr400", "four_bar", "coupled_four_bar"])
def test_torque_is_that_of_the_plant_with_loops_and_coupled_motors(name):
    robot_file = arm(name)
    model, truth = build_model(robot_file), truth_vector(robot_file)
    values = dict(zip((parameter.name for parameter in model.parameters), truth, strict=True))
    of_motors = {joint: f"Ia{number + 1}" for joint, number in enumerate(model.active)}
    armature = np.array([values.get(of_motors[joint], 0.0) for joint in range(model.dof)])
    pair = np.array([values.get(f"Iac{number + 1}", 0.0) for number in model.active])
    plant = rigid_arm(model, truth[: 10 * len(model.joints)], armature, pair)
    identified = true_model(name)
    to_motors = identified.coupling
    q, dq, ddq = states(name, 20)
    expected = [
        plant.inverse(*(to_motors @ part for part in sample)) @ to_motors for sample in zip(q, dq, ddq, strict=True)
    ]
    without_friction = identified.torque(q, dq, ddq) - identified.friction(dq)
    np.testing.assert_allclose(without_friction, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@each("name", ARMS)
@each("count", [1, 30, MANY])
def test_the_regressor_times_the_parameters_is_the_torque(name, count):
    model = true_model(name)
    q, dq, ddq = states(name, count)
    torque = model.torque(q, dq, ddq)
    regressor = model.regressor(q, dq, ddq)
    assert regressor.shape == (count, model.dof, len(model.parameters))
    np.testing.assert_allclose(regressor @ model.parameters["value"], torque, rtol=0, atol=1e-9 * np.abs(torque).max())


@pytest.mark.parametrize("name", ARMS)
def test_the_torque_is_the_sum_of_its_terms_and_forward_dynamics_inverts_it(name):
    model = true_model(name)
    q, dq, ddq = states(name, MANY)
    torque, mass = model.torque(q, dq, ddq), model.mass_matrix(q)
    inertial = np.einsum("Nij,Nj->Ni", mass, ddq)
    total = inertial + model.coriolis(q, dq) + model.gravity(q) + model.friction(dq)
    np.testing.assert_allclose(total, torque, rtol=0, atol=1e-9 * np.abs(torque).max())
    np.testing.assert_allclose(mass, mass.transpose(0, 2, 1), rtol=0, atol=1e-12 * np.abs(mass).max())
    np.testing.assert_allclose(model.forward_dynamics(q, dq, torque), ddq, rtol=0, atol=1e-6 * np.abs(ddq).max())


@pytest.mark.parametrize("name", ["ur5e", "sr400", "four_bar"])
def test_a_single_sample_has_the_shape_that_was_given(name):
    model = true_model(name)
    q, dq, ddq = states(name, 3)
    for whole, one in (
        (model.torque(q, dq, ddq), model.torque(q[1], dq[1], ddq[1])),
        (model.gravity(q), model.gravity(q[1])),
        (model.friction(dq), model.friction(dq[1])),
        (model.coriolis(q, dq), model.coriolis(q[1], dq[1])),
        (model.mass_matrix(q), model.mass_matrix(q[1])),
        (model.regressor(q, dq, ddq), model.regressor(q[1], dq[1], ddq[1])),
        (model.forward_dynamics(q, dq, ddq), model.forward_dynamics(q[1], dq[1], ddq[1])),
    ):
        assert one.shape == whole.shape[1:]
        np.testing.assert_allclose(one, whole[1], rtol=1e-9, atol=1e-9)


def test_no_samples_give_no_torques():
    model = true_model("ur5e")
    nothing = np.empty((0, 6))
    assert model.torque(nothing, nothing, nothing).shape == (0, 6)
    assert model.mass_matrix(nothing).shape == (0, 6, 6)


@pytest.mark.parametrize("kind", ["full", "essential"])
def test_an_identified_model_has_the_values_of_its_result(result, kind):
    model = dynid.Model(result.result, kind)
    stored = {parameter.name: parameter for parameter in result.result.base_parameters}
    for row in model.parameters:
        entry = stored[str(row["name"])]
        value = entry.value if kind == "full" else entry.essential_value or 0.0
        assert row["value"] == value
    assert model.joint_names == tuple(result.result.joints)


def test_full_and_essential_models_differ_by_less_than_their_errors(result):
    full, essential = dynid.Model(result.result, "full"), dynid.Model(result.result, "essential")
    q, dq, ddq = states("ur5e", 50)
    difference = np.sqrt(np.mean((full.torque(q, dq, ddq) - essential.torque(q, dq, ddq)) ** 2, axis=0))
    truth = true_model("ur5e").torque(q, dq, ddq)
    assert np.all(difference < 0.1 * np.sqrt(np.mean(truth**2, axis=0)))
    assert (essential.parameters["value"] == 0).sum() == len(full.parameters) - result.result.essential.count


def test_torque_std_is_the_spread_of_the_parameters(result):
    model = dynid.Model(result.result, "full")
    estimate = result.result.estimate
    assert estimate is not None
    covariance = np.array(estimate.covariance, dtype=float)
    draws = np.random.default_rng(5).multivariate_normal(np.zeros(len(covariance)), covariance, 4000, method="eigh")
    q, dq, ddq = states("ur5e", 8)
    columns = [model.parameters.names.index(name) for name in estimate.parameters]
    spread = np.std(model.regressor(q, dq, ddq)[..., columns] @ draws.T, axis=-1)
    np.testing.assert_allclose(model.torque_std(q, dq, ddq), spread, rtol=0.06)


def test_the_essential_model_is_as_sure_as_the_full_one_but_for_what_the_pruning_changed(result):
    q, dq, ddq = states("ur5e", 40)
    full, essential = (dynid.Model(result.result, kind) for kind in ("full", "essential"))
    difference = essential.torque(q, dq, ddq) - full.torque(q, dq, ddq)
    expected = np.hypot(full.torque_std(q, dq, ddq), difference)
    np.testing.assert_allclose(essential.torque_std(q, dq, ddq), expected, rtol=1e-9)
    stored = {p.name: p.essential_std for p in result.result.base_parameters if p.essential_std is not None}
    assert 0 < len(stored) == result.result.essential.count < len(full.parameters)
    active, covariance = essential._covariance()
    own = {full.parameters.names[i]: np.sqrt(variance) for i, variance in zip(active, np.diag(covariance), strict=True)}
    assert {name: own[name] for name in stored} == pytest.approx(stored, rel=1e-9)
    of_full = {p.name: p.std for p in result.result.base_parameters}
    assert all(stored[name] >= of_full[name] for name in stored)


def test_torque_std_of_the_essential_model_is_infinite_where_an_unexcited_parameter_acts():
    robot_file = arm("ur5e")
    count = base_parameters(build_model(robot_file)).count - 1
    model = dynid.Model(true_result(robot_file, {"Fv3": None}, covariance=1e-4 * np.eye(count)), "essential")
    q, dq, ddq = states("ur5e", 3)
    dq[0, 2] = 0.0
    deviations = model.torque_std(q, dq, ddq)
    assert np.all(np.isinf(deviations[1:, 2]))
    assert np.all(np.isfinite(deviations[0]))
    assert np.all(np.isfinite(np.delete(deviations, 2, axis=1)))


@pytest.mark.usefixtures("estimate_alone")
def test_torque_std_covers_the_error_of_repeated_identifications():
    q, dq, ddq = states("rocr6", 30)
    truth = true_model("rocr6").torque(q, dq, ddq)
    normalised = []
    for seed in range(4):
        run = dynid.simulate("rocr6", duration=10.0, seed=seed, rate=100.0)
        model = dynid.identify(run, friction="coulomb-viscous", presliding=False).model
        deviations = model.torque_std(q, dq, ddq)
        normalised.append((model.torque(q, dq, ddq) - truth) / deviations)
    assert 0.6 < np.sqrt(np.median(np.square(normalised))) / 0.6745 < 1.5


def test_a_parameter_without_a_value_is_refused_only_where_it_acts():
    model = dynid.Model(true_result(arm("ur5e"), {"Fv3": None}), "full")
    q, dq, ddq = states("ur5e", 2)
    still = dq.copy()
    still[:, 2] = 0.0
    assert np.all(np.isfinite(model.torque(q, still, ddq)))
    assert np.all(np.isfinite(model.gravity(q)))
    assert np.all(np.isfinite(model.coriolis(q, dq)))
    assert np.all(np.isfinite(model.mass_matrix(q)))
    for refused in (
        lambda: model.torque(q, dq, ddq),
        lambda: model.friction(dq),
        lambda: model.forward_dynamics(q, dq, ddq),
    ):
        with pytest.raises(dynid.ModelError, match="Fv3 acts on this motion and has no value"):
            refused()


def test_a_gravity_parameter_without_a_value_is_refused_by_gravity():
    model = dynid.Model(true_result(arm("ur5e"), {"MXR2": None}), "full")
    q, dq, _ = states("ur5e", 2)
    with pytest.raises(dynid.ModelError, match="MXR2"):
        model.gravity(q)
    assert np.all(np.isfinite(model.friction(dq)))


def test_a_matrix_that_is_not_positive_definite_has_no_forward_dynamics():
    model = dynid.Model(true_result(arm("ur5e"), {"Ia6": -3.0}), "full")
    q, dq, ddq = states("ur5e", 5)
    assert model.mass_matrix(q).shape == (5, 6, 6)
    with pytest.raises(dynid.ModelError, match="not positive definite"):
        model.forward_dynamics(q, dq, ddq)


def test_the_consistent_model_is_the_default_and_can_be_simulated(result):
    model = result.model
    assert model.kind == "consistent"
    q, dq, ddq = states("ur5e", 200)
    assert np.all(np.linalg.eigvalsh(model.mass_matrix(q)) > 0)
    torque = model.torque(q, dq, ddq)
    np.testing.assert_allclose(model.forward_dynamics(q, dq, torque), ddq, rtol=1e-6, atol=1e-6)
    full = dynid.Model(result.result, "full").torque(q, dq, ddq)
    assert np.all(np.sqrt(np.mean((torque - full) ** 2, axis=0)) < 0.1 * np.sqrt(np.mean(full**2, axis=0)))
    deviations = model.torque_std(q, dq, ddq)
    assert np.all(deviations > 0)
    assert np.median(deviations) < 2.0 * np.median(dynid.Model(result.result, "full").torque_std(q, dq, ddq))


def test_links_of_the_result_give_its_consistent_torques(result):
    """The bodies in result.json are those of the model, up to their rounding."""
    robot_file = arm("ur5e")
    links = result.result.standard_parameters
    assert [link.link for link in links] == list(robot_file.robot.joint_names)
    model = build_model(robot_file)
    values = {entry.name: entry.value for entry in result.result.consistent.parameters}
    for index, link in enumerate(links):
        inertia = link.inertia
        own = link_parameters(link.mass, link.com, [inertia[key] for key in ("xx", "xy", "xz", "yy", "yz", "zz")])
        names = [f"{symbol}{index + 1}" for symbol in INERTIAL]
        np.testing.assert_allclose(own, [values[name] for name in names], rtol=1e-9, atol=1e-12)
    base = base_parameters(model)
    standard = np.array([values[parameter.name] for parameter in model.parameters])
    expected = [result.result.consistent.base_values[name] for name in base.names]
    np.testing.assert_allclose(base.projection @ standard, expected, rtol=1e-9, atol=1e-12)


def test_an_unknown_variance_makes_the_torque_unsure_where_it_acts():
    base = base_parameters(build_model(arm("up6")))
    stored = true_result(arm("up6"), covariance=np.eye(base.count) * 1e-4)
    assert stored.estimate is not None
    open_variance = [list(row) for row in stored.estimate.covariance]
    number = stored.estimate.parameters.index("Fv1")
    open_variance[number] = [None] * base.count
    for row in open_variance:
        row[number] = None
    unsure = stored.model_copy(update={"estimate": stored.estimate.model_copy(update={"covariance": open_variance})})
    q, dq, ddq = states("up6", 2)
    for kind in ("full", "essential"):
        deviations = dynid.Model(unsure, kind).torque_std(q, dq, ddq)
        assert np.all(np.isinf(deviations[:, 0]))
        assert np.all(np.isfinite(deviations[:, 1:]))


def test_without_a_covariance_there_is_no_torque_std():
    q, dq, ddq = states("up6", 2)
    with pytest.raises(dynid.ResultFileError, match="no covariance"):
        true_model("up6").torque_std(q, dq, ddq)


@each(
    ("arguments", "message"),
    [
        (([0.0] * 5, [0.0] * 5, [0.0] * 5), r"q: has shape \(5,\); \(6,\) or \(N, 6\) is needed"),
        ((np.zeros((6, 50)), np.zeros((6, 50)), np.zeros((6, 50))), r"q: has shape \(6, 50\)"),
        ((np.zeros((3, 6)), np.zeros((2, 6)), np.zeros(6)), r"dq: has shape \(2, 6\), q has \(3, 6\)"),
        ((np.zeros((2, 3, 6)),) * 3, "q: has shape"),
        ((np.full((2, 6), np.nan),) * 3, "q: is not finite at sample 0, joint shoulder_pan_joint"),
        ((["a"] * 6, [0.0] * 6, [0.0] * 6), "q: does not consist of numbers"),
        ((0.0, 0.0, 0.0), "q: has shape"),
    ],
)
def test_hostile_arrays_are_refused_in_one_line(arguments, message):
    with pytest.raises(dynid.DataError, match=message) as refused:
        true_model("ur5e").torque(*arguments)
    assert "\n" not in str(refused.value)


def test_inputs_are_left_alone():
    q, dq, ddq = states("ur5e", 4)
    before = [part.copy() for part in (q, dq, ddq)]
    true_model("ur5e").torque(q, dq, ddq)
    true_model("ur5e").mass_matrix(q)[:] = 0
    assert all(np.array_equal(part, old) for part, old in zip((q, dq, ddq), before, strict=True))


def test_a_model_of_a_part_of_the_arm_is_refused():
    robot_file = arm("up6")
    run = dynid.simulate(robot_file, duration=6.0, seed=1, rate=100.0)
    stream = run.streams["joints"]
    position = stream.channels["position"].values.copy()
    position[:, 1] = 0.3
    locked = dynid.Recording.from_arrays(
        robot_file, time=stream.time, position=position, torque=stream.channels["torque"].values
    )
    result = dynid.identify(locked)
    with pytest.raises(dynid.ModelError, match="only some of the base parameters"):
        _ = result.model
