"""The expressions of every function equal the model's own answers, on any arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_arms import FOUR_BAR, four_bar_arm, spatial_arm
from random_arms import random_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import ModelError
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import arm_functions, left_out
from ident.export.c_code.reference import check_expressions, deviation, reference
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector

COUPLED_PARALLELOGRAM = load_robot("sr400").text.replace("j6: {j6: 1, j5: 1}", "j6: {j6: 1.5, j5: 0.7, j4: -0.2}")
"""The SR400 with a coupling of no integers."""

FOLLOWING = """
name: following
model:
  mdh:
    - {joint: lift, type: prismatic, alpha: 0.3, d: 0.1, r: 0.2}
    - {joint: arm, antecedent: lift, alpha: 0.4, d: 0.1, r: 0}
    - {joint: hand, antecedent: arm, alpha: pi/2, d: 0.15, r: 0.02}
    - {joint: slide, antecedent: arm, type: prismatic, alpha: 0.2, d: 0.1, r: 0.3}
  loops:
    - {joint: hand, equation: {arm: -0.6, lift: 2}, offset: 0.3}
    - {joint: slide, equation: {arm: 0.05}, offset: 0.1}
joints:
  - {name: lift, position: [-0.3, 0.3], velocity: 0.5}
  - {name: arm, position: [-1.2, 1.2], velocity: 2}
"""
"""Joints, prismatic ones too, that follow by equations with offsets."""


def random_dynamics(model: DynamicModel, seed: int = 0) -> InverseDynamics:
    """An arm with random base parameters."""
    base = base_parameters(model)
    return InverseDynamics(model, base, np.random.default_rng(seed).normal(size=base.count))


def assert_equal(dynamics: InverseDynamics) -> None:
    graph = Graph()
    functions = arm_functions(graph, dynamics)
    check_expressions(graph, functions, dynamics)
    expected = reference(dynamics, "double", count=30, seed=5)
    for function in functions:
        assert deviation(graph, function, expected) < 1e-12, function.name


@pytest.mark.parametrize("name", ["ur5e", "panda", "rocr6", "aubo_i5", "sr400"])
def test_built_in_robots(name):
    assert_equal(random_dynamics(build_model(load_robot(name))))


def true_dynamics(robot_file: RobotFile) -> InverseDynamics:
    """An arm of its true bodies."""
    model, truth = build_model(robot_file), truth_vector(robot_file)
    base = base_parameters(model)
    return InverseDynamics(model, base, base.projection @ truth, truth)


@pytest.mark.parametrize("name", ["ur5e", "panda", "sr400"])
def test_bodies_have_every_function(name):
    dynamics = true_dynamics(load_robot(name))
    assert_equal(dynamics)
    names = {function.name for function in arm_functions(Graph(), dynamics)}
    assert {"torque", "coriolis", "gravity", "friction", "mass_matrix", "forward_dynamics", "payload_torque"} <= names
    assert not left_out(dynamics)


@pytest.mark.parametrize("seed", range(6))
def test_random_bodies_have_every_function(seed):
    dynamics = true_dynamics(random_arm(seed, joints=2 + seed, sliding=0.5))
    assert not left_out(dynamics)
    assert_equal(dynamics)


def test_what_the_parameters_do_not_allow_is_left_out_and_said():
    for seed in range(20):
        dynamics = true_dynamics(random_arm(seed, joints=2, sliding=1.0))
        confounded = InverseDynamics(dynamics.model, dynamics.base, dynamics.parameters)
        if confounded.confounded:
            break
    assert set(left_out(confounded)) == {"gravity", "friction"}
    assert {"gravity", "friction"}.isdisjoint(function.name for function in arm_functions(Graph(), confounded))
    assert_equal(confounded)
    assert not left_out(dynamics)
    negative = InverseDynamics(dynamics.model, dynamics.base, -dynamics.parameters)
    assert "not positive definite" in left_out(negative)["forward_dynamics"]


@pytest.mark.parametrize("aligned", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_random_trees(random_tree, seed, aligned):
    model = random_tree(seed, dof=5, aligned=aligned)
    assert_equal(random_dynamics(model, seed))


@pytest.mark.parametrize("text", [COUPLED_PARALLELOGRAM, FOLLOWING])
def test_joints_that_follow_and_coupled_motors(text):
    assert_equal(random_dynamics(build_model(parse_robot(text, where="arm.yaml", folder=None))))


def test_axes_against_the_coordinates():
    model = build_model(load_robot("sr400"))
    flipped = tuple(replace(joint, axis=joint.axis * (-1.0) ** number) for number, joint in enumerate(model.joints))
    assert_equal(random_dynamics(replace(model, joints=flipped)))


def test_a_link_that_stays_level_turns_as_its_grandparent_does():
    level = FOLLOWING.replace("alpha: pi/2, d: 0.15", "alpha: 0, d: 0.15").replace("{arm: -0.6, lift: 2}", "{arm: -1}")
    dynamics = random_dynamics(build_model(parse_robot(level, where="arm.yaml", folder=None)))
    assert_equal(dynamics)
    graph = Graph()
    torque = arm_functions(graph, dynamics)[0]
    assert graph.operations(torque.outputs).sines == 2


def test_essential_parameters_take_fewer_operations():
    model = build_model(load_robot("ur5e"))
    base = base_parameters(model)
    values = np.random.default_rng(0).normal(size=base.count)
    few = np.where(np.arange(base.count) % 2, values, 0.0)
    counts = []
    for parameters in (values, few):
        graph = Graph()
        torque = arm_functions(graph, InverseDynamics(model, base, parameters))[0]
        counts.append(graph.operations(torque.outputs).multiplications)
    assert counts[1] < counts[0]
    assert_equal(InverseDynamics(model, base, few))


def test_parameters_that_are_all_zero_leave_no_operation():
    model = build_model(load_robot("up6"))
    base = base_parameters(model)
    graph = Graph()
    functions = arm_functions(graph, InverseDynamics(model, base, np.zeros(base.count)))
    operations = {function.name: graph.operations(function.outputs) for function in functions}
    assert operations["torque"].multiplications == operations["torque"].additions == 0
    assert operations["regressor"].multiplications > 0


def test_code_that_deviates_is_refused():
    model = build_model(load_robot("up6"))
    dynamics = random_dynamics(model)
    graph = Graph()
    functions = arm_functions(graph, dynamics)
    row = functions[0].rows[0]
    wrong = replace(functions[0], rows=((row[0] * (1.0 + 1e-9), *row[1:]),))
    with pytest.raises(ModelError, match="torque would deviate"):
        check_expressions(graph, (wrong, *functions[1:]), dynamics)


@pytest.mark.parametrize("robot", [four_bar_arm, spatial_arm])
def test_loops_that_are_solved_numerically_are_refused(robot):
    assert "passive" in FOUR_BAR
    with pytest.raises(ModelError, match="solved numerically"):
        arm_functions(Graph(), random_dynamics(build_model(robot())))
