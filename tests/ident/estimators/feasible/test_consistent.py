"""Consistent parameters against a reference solver, against the truth, and from hostile priors."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.estimators.feasible.consistent import ConsistentParameters, consistent_parameters
from ident.estimators.feasible.prior import link_priors
from ident.estimators.feasible.problem import INTERIOR, build_problem
from ident.estimators.feasible.pseudo_inertia import BASIS, pseudo_inertia
from ident.model.base_parameters import BaseParameters, base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.parameters import link_parameters
from ident.model.regressor import regressor
from ident.model.true_parameters import truth_vector
from ident.regression.estimate import Estimate

SAMPLES = 60


def true_parameters(model: DynamicModel, seed: int = 1) -> np.ndarray:
    """Links of plausible bodies, and friction that brakes."""
    generator = np.random.default_rng(seed)
    links = []
    for _ in model.joints:
        mass = generator.uniform(0.5, 5.0)
        a, b, c = generator.uniform(0.8, 1.2, 3) * mass * 0.02
        links.append(link_parameters(mass, tuple(generator.uniform(-0.1, 0.1, 3)), (a, 0.0, 0.0, b, 0.0, c)))
    values = np.concatenate([np.concatenate(links), np.zeros(len(model.parameters) - 10 * len(model.joints))])
    for index, parameter in enumerate(model.parameters[10 * len(model.joints) :], start=10 * len(model.joints)):
        sign = -1.0 if parameter.kind == "coupling" and parameter.symbol != "Iac" else 1.0
        values[index] = sign * generator.uniform(0.2, 2.0)
    return values


def estimated(model: DynamicModel, truth: np.ndarray, noise: float, seed: int = 0) -> tuple[BaseParameters, Estimate]:
    """An estimate from random states with white noise of `noise` times the torques' size."""
    base = base_parameters(model)
    rows = regressor(model, *random_states(model, SAMPLES, seed=seed + 5), base.columns)
    matrix = np.concatenate([joint.T for joint in rows])
    torque = matrix @ (base.projection @ truth)
    sigma = max(noise, 1e-9) * np.sqrt(np.mean(torque**2))
    measured = torque + noise / max(noise, 1e-9) * sigma * np.random.default_rng(seed).standard_normal(len(torque))
    root = np.linalg.qr(matrix / sigma, mode="r")
    values = np.linalg.lstsq(matrix, measured, rcond=None)[0]
    covariance = np.linalg.inv(root.T @ root)
    return base, Estimate(tuple(range(base.count)), values, root, covariance, np.zeros((base.count, 0)), 20)


def check_possible(model: DynamicModel, found: ConsistentParameters) -> None:
    count = len(model.joints)
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(found.values[: 10 * count].reshape(count, 10))) > 0)
    for value, parameter in zip(found.values, model.parameters, strict=True):
        if parameter.kind not in ("inertial", "offset"):
            assert value * (-1.0 if parameter.kind == "coupling" and parameter.symbol != "Iac" else 1.0) > 0


def with_prior(text: str, name: str = "ur5e") -> RobotFile:
    return parse_robot(load_robot(name).text + "\n" + text, where="test", folder=None)


def reference(model: DynamicModel, robot_file: RobotFile, base: BaseParameters, estimate: Estimate) -> np.ndarray:
    """Scaled parameters by cvxpy and Clarabel: the same objective, given to a general conic solver."""
    cvxpy = pytest.importorskip("cvxpy")
    system = estimate.root @ estimate.combinations(base.projection)
    target = estimate.root @ estimate.values
    problem = build_problem(model, robot_file, base, estimate, link_priors(model, robot_file, system, target))
    scaled, conditions = system * problem.scale, problem.conditions
    y = cvxpy.Variable(len(problem.scale))
    cost = 0.5 * cvxpy.sum_squares(scaled @ y - target)
    if len(problem.rows):
        cost += 0.5 * cvxpy.sum_squares(problem.rows @ y - problem.values)
    constraints = []
    entropic = robot_file.robot.prior.distance == "entropic"
    for link, variables in enumerate(conditions.variables):
        matrix = sum(problem.scale[v] * y[int(v)] * BASIS[j] for j, v in enumerate(variables)) - conditions.least[link]
        if entropic:
            cost += conditions.weights[link] * (cvxpy.trace(conditions.pull[link] @ matrix) - cvxpy.log_det(matrix))
        else:
            constraints.append(matrix >> 0)
    slacks = conditions.rows @ y - conditions.limits
    weights = conditions.weights[len(conditions.least) :]
    for row in range(len(conditions.rows)):
        if entropic:
            cost += weights[row] * (conditions.row_pull[row] * slacks[row] - cvxpy.log(slacks[row]))
        else:
            constraints.append(slacks[row] >= 0)
    cvxpy.Problem(cvxpy.Minimize(cost), constraints).solve(
        solver=cvxpy.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11
    )
    return np.asarray(base.projection @ (problem.scale * y.value))


@pytest.mark.parametrize("noise", [0.01, 0.2])
def test_the_reference_solver_finds_the_same_parameters(noise: float) -> None:
    """Also with noise that throws the unconstrained estimate far out of what can exist."""
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), noise)
    found = consistent_parameters(model, base, estimate, robot_file)
    expected = reference(model, robot_file, base, estimate)
    deviations = np.sqrt(np.diag(estimate.covariance))
    assert np.all(np.abs(found.base - expected) < 1e-4 * np.abs(expected) + 1e-3 * deviations)


def test_a_euclidean_distance_is_the_semidefinite_program_but_for_the_barrier() -> None:
    robot_file = with_prior("prior: {distance: euclidean, weight: 0.01}")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.05)
    found = consistent_parameters(model, base, estimate, robot_file)
    expected = reference(model, robot_file, base, estimate)
    deviations = np.sqrt(np.diag(estimate.covariance))
    assert np.all(np.abs(found.base - expected) < 0.02 * np.abs(expected) + 0.05 * deviations)


@pytest.mark.parametrize("seed", range(10))
def test_noise_free_data_give_the_truth_of_random_trees(random_tree: Callable[..., DynamicModel], seed: int) -> None:
    model = random_tree(seed, dof=2 + seed % 5, aligned=seed % 2 == 0)
    truth = true_parameters(model, seed)
    base, estimate = estimated(model, truth, 0.0)
    found = consistent_parameters(model, base, estimate, load_robot("ur5e"))
    check_possible(model, found)
    expected = base.projection @ truth
    np.testing.assert_allclose(found.base, expected, rtol=1e-5, atol=1e-5 * np.max(np.abs(expected)))


FINGER = """
name: finger
model:
  mdh:
    - {joint: yaw, antecedent: base, alpha: 0, d: 0, theta0: 0, r: 0}
    - {joint: pitch, antecedent: yaw, alpha: 1.5708, d: 0.02, theta0: 0, r: 0}
    - {joint: distal, antecedent: pitch, alpha: 0, d: 0.04, theta0: 0, r: 0}
joints:
  - {name: yaw, position: [-1.3, 0], velocity: 1}
  - {name: pitch, position: [0, 1.2], velocity: 1}
  - {name: distal, position: [0, 1.2], velocity: 1}
truth:
  links:
    yaw: {mass: 0.035, com: [0.011, -0.002, -0.001], inertia: [2e-6, 0, 0, 5e-6, 0, 5e-6]}
    pitch: {mass: 0.048, com: [0.022, -0.004, 0], inertia: [4e-6, 0, 0, 1.2e-5, 0, 1.3e-5]}
    distal: {mass: 0.022, com: [0.016, -0.003, 0], inertia: [1e-6, 0, 0, 4e-6, 0, 4e-6]}
  joints:
    yaw: {viscous: 1.6e-4, coulomb: 4.9e-4, motor_inertia: 7.6e-5}
    pitch: {viscous: 1.0e-3, coulomb: 3.1e-3, motor_inertia: 4.9e-4}
    distal: {viscous: 1.5e-4, coulomb: 4.6e-4, motor_inertia: 7.3e-5}
"""


def test_joints_without_torque_limits_are_as_weak_as_the_data_say() -> None:
    """Motor inertias of a finger's size, some of which the data hold in sums with the links' alone."""
    finger = parse_robot(FINGER, where="test", folder=None)
    model, truth = build_model(finger), truth_vector(finger)
    base, estimate = estimated(model, truth, 0.01)
    found = consistent_parameters(model, base, estimate, finger)
    check_possible(model, found)
    assert found.misfit < 2.0 * base.count


def test_friction_that_the_data_leave_open_is_no_greater_than_the_motor() -> None:
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.02)
    column = base.kinds.index("coulomb")
    limit = model.limits[0].torque
    assert limit is not None
    root, values, covariance = estimate.root.copy(), estimate.values.copy(), estimate.covariance.copy()
    root[:, column] *= 1e-9
    values[column] = 1e3 * limit
    covariance[column, column] = (1e3 * limit) ** 2
    found = consistent_parameters(
        model, base, replace(estimate, root=root, values=values, covariance=covariance), robot_file
    )
    assert found.values[base.columns[column]] < 2.0 * limit


@pytest.mark.parametrize("seed", range(10))
def test_noise_never_gives_what_cannot_exist(random_tree: Callable[..., DynamicModel], seed: int) -> None:
    model = random_tree(seed, dof=2 + seed % 5, aligned=seed % 2 == 0)
    truth = true_parameters(model, seed)
    base, estimate = estimated(model, truth, 0.5, seed)
    found = consistent_parameters(model, base, estimate, load_robot("ur5e"))
    check_possible(model, found)
    # The truth can exist and is off by base.count on average.
    assert found.misfit < 2.0 * base.count + 20.0


@pytest.mark.parametrize("name", ["sr400", "panda", "aubo_i5"])
def test_loops_coupling_and_redundant_arms(name: str) -> None:
    robot_file = load_robot(name)
    model = build_model(robot_file)
    truth = truth_vector(robot_file)
    base, estimate = estimated(model, truth, 0.02)
    found = consistent_parameters(model, base, estimate, robot_file)
    check_possible(model, found)
    assert found.misfit < 4.0 * base.count


def test_the_intervals_hold_the_truth_of_base_parameters() -> None:
    robot_file = load_robot("rocr6")
    model = build_model(robot_file)
    truth = truth_vector(robot_file)
    inside = []
    for seed in range(10):
        base, estimate = estimated(model, truth, 0.01, seed)
        found = consistent_parameters(model, base, estimate, robot_file)
        deviation = np.sqrt(np.diag(found.base_covariance))
        inside.append(np.abs(found.base - base.projection @ truth) < 1.96 * deviation)
    assert 0.85 < np.mean(inside) <= 1.0


def test_what_is_known_is_kept_and_ranges_hold() -> None:
    robot_file = with_prior("known: {M6: 0.365, Ia1: {min: 0.5, max: 0.6}, total_mass: 21, MX3: {max: 0.2}}")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.05)
    found = consistent_parameters(model, base, estimate, robot_file)
    check_possible(model, found)
    values = dict(zip([parameter.name for parameter in model.parameters], found.values, strict=True))
    known = dict(zip([parameter.name for parameter in model.parameters], found.known, strict=True))
    assert values["M6"] == pytest.approx(0.365, rel=1e-12)
    assert [name for name, flag in known.items() if flag] == ["M6"]
    assert 0.5 < values["Ia1"] < 0.6
    assert values["MX3"] < 0.2
    assert sum(values[f"M{k}"] for k in range(1, 7)) == pytest.approx(21.0, rel=1e-3)


def test_a_box_holds_the_centre_of_mass() -> None:
    box = "[[0.01, 0.02, 0.03], [0.02, 0.03, 0.04]]"
    robot_file = with_prior(f"prior: {{links: {{wrist_2_joint: {{mass: 2.5, com_box: {box}}}}}}}")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.05)
    found = consistent_parameters(model, base, estimate, robot_file)
    link = found.values[:60].reshape(6, 10)[model.link_names.index("wrist_2_joint")]
    assert np.all(link[6:9] / link[9] > [0.01, 0.02, 0.03])
    assert np.all(link[6:9] / link[9] < [0.02, 0.03, 0.04])


def test_undetermined_parameters_come_from_the_prior_and_say_so() -> None:
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.01)
    found = consistent_parameters(model, base, estimate, robot_file)
    names = [parameter.name for parameter in model.parameters]
    for name in ("XX1", "M1", "MX1"):  # links that only turn about the vertical
        assert found.determined[names.index(name)] < 0.01
        assert np.isnan(found.std[names.index(name)])
    assert found.determined[names.index("Fs3")] == pytest.approx(1.0)
    assert np.isfinite(found.std[names.index("Fs3")])
    system = estimate.root @ estimate.combinations(base.projection)
    prior = link_priors(model, robot_file, system, estimate.root @ estimate.values)
    assert found.values[names.index("M1")] == pytest.approx(prior.links[0, 9], rel=INTERIOR * 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("known: {M7: 1}", "is no parameter"),
        ("known: {M2: -1}", "known.M2: no body has a mass of -1 kg or less"),
        ("known: {Fv2: -1}", "not a possible value of a body"),
        ("known: {M6: {max: -1}}", "known.M6: no body has a mass of -1 kg or less"),
        ("known: {M4: 0.5, total_mass: 0.4}", "no body satisfies all of: known.M4, known.total_mass"),
        ("known: {XX2: 0.1, YY2: 0.1, ZZ2: {min: 0.3}}", "no body satisfies all of: known.ZZ2, known.XX2"),
        ("known: {M2: 1, MX2: -1, ZZ2: 0.5}", "no body satisfies all of: known.ZZ2, known.M2, known.MX2"),
        (
            "known: {M6: 1, MX6: 1}\nprior: {links: {wrist_3_joint: {com_box: [[0, -1, -1], [0.1, 1, 1]]}}}",
            "no body satisfies all of: prior.links.wrist_3_joint.com_box",
        ),
        ("known: {M6: {min: 5}, total_mass: {max: 3}}", "no body satisfies all of: known.M6, known.total_mass"),
        ("known: {total_mass: {min: 2, max: 1}}", "min 2 is not below max 1"),
        ("known: {total_mass: {}}", "or 'min', 'max' or both"),
        ("prior: {links: {wrist_1_joint: {mass: -2}}}", "greater than 0"),
        ("prior: {links: {wrist_1_joint: {com: [0, 0, 0]}}}", "'com' needs 'mass'"),
        ("prior: {links: {tool: {mass: 1}}}", "'prior.links' names 'tool', but there are only"),
        (
            "prior: {links: {wrist_1_joint: {mass: 1, com: [0, 0, 0], inertia: [1, 0, 0, 1, 0, 3]}}}",
            "no body has this inertia",
        ),
    ],
)
def test_what_cannot_hold_is_refused_by_name(text: str, message: str) -> None:
    plain = load_robot("ur5e")
    model = build_model(plain)
    base, estimate = estimated(model, truth_vector(plain), 0.05)
    with pytest.raises(RobotFileError, match=re.escape(message)):
        consistent_parameters(model, base, estimate, with_prior(text))


def test_partial_priors_keep_what_they_do_not_name() -> None:
    """A mass alone scales the assumed body; a centre moves it."""
    plain = load_robot("ur5e")
    model = build_model(plain)
    base, estimate = estimated(model, truth_vector(plain), 0.01)
    system = estimate.root @ estimate.combinations(base.projection)
    target = estimate.root @ estimate.values

    def links(text: str) -> np.ndarray:
        return link_priors(model, with_prior(text), system, target).links[3]

    assumed = links("prior: {weight: 0.1}")
    heavy = links("prior: {links: {wrist_1_joint: {mass: 7}}}")
    np.testing.assert_allclose(heavy, assumed * 7 / assumed[9])
    moved = links("prior: {links: {wrist_1_joint: {mass: 7, com: [0.1, 0.2, 0.3]}}}")
    np.testing.assert_allclose(moved[6:9] / moved[9], [0.1, 0.2, 0.3])
    central = [pseudo_inertia(link)[:3, :3] - np.outer(link[6:9], link[6:9]) / link[9] for link in (heavy, moved)]
    np.testing.assert_allclose(central[0], central[1], rtol=1e-9, atol=1e-12)


def test_neither_the_length_of_the_data_nor_what_one_part_shows_alone_matters() -> None:
    """The same factor from four times the rows of half the weight each, and with an unbounded jackknife variance."""
    robot_file = load_robot("up6")
    model = build_model(robot_file)
    base, estimate = estimated(model, truth_vector(robot_file), 0.02)
    again = replace(estimate, root=np.linalg.qr(np.vstack([0.5 * estimate.root] * 4), mode="r"))
    weakest = np.linalg.inv(estimate.root)[:, -1]
    alone = replace(estimate, covariance=estimate.covariance + 1e8 * np.outer(weakest, weakest))
    first, second, third = (consistent_parameters(model, base, e, robot_file) for e in (estimate, again, alone))
    np.testing.assert_allclose(first.base, second.base, rtol=1e-6, atol=1e-9)
    errors = [np.linalg.norm(estimate.root @ (of.base - estimate.values)) for of in (first, third)]
    assert errors[1] < 2.0 * errors[0]


def test_the_test_of_consistency_keeps_its_level_and_finds_what_cannot_exist() -> None:
    """It rejects about as many true bodies as its level says, and always links of negative inertia."""
    robot_file = load_robot("ur5e")
    model = build_model(robot_file)
    truth = truth_vector(robot_file)

    def p_values(values: np.ndarray, seeds: range) -> np.ndarray:
        found = []
        for seed in seeds:
            base, estimate = estimated(model, values, 0.05, seed)
            cost = consistent_parameters(model, base, estimate, robot_file).cost
            assert cost is not None
            found.append(cost.p_value)
        return np.array(found)

    of_bodies = p_values(truth, range(12))
    assert np.mean(of_bodies < 0.05) <= 0.2
    assert np.min(of_bodies) < 0.8  # it is no test that everything passes
    impossible = truth.copy()
    impossible[[20, 23, 25]] -= 2.0  # inertia of link 3 about its joint
    assert np.all(p_values(impossible, range(3)) < 1e-3)
