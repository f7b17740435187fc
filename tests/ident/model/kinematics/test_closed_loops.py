"""General closed loops: positions, G and Ġ, against finite differences and against the linear description."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from each import each
from loop_arms import four_bar_arm, spatial_arm, spherical_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import DataError
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.kinematics.linkages.closed_loops import ClosedLoops
from ident.model.kinematics.loops import loop_ends, place_tree
from ident.model.regressor import regressor

ARMS: tuple[Callable[[], RobotFile], ...] = (four_bar_arm, spatial_arm, spherical_arm)


def loops_of(model: DynamicModel) -> ClosedLoops:
    assert isinstance(model.transmission, ClosedLoops)
    return model.transmission


def sr400_by_closing() -> RobotFile:
    """The SR400, its parallelogram given by the closing frames alone."""
    text = load_robot("sr400").text
    general = "passive: {j3: 0.5, j8: 1.3}\n      at: {j2: -1.6, j7: pi}"
    assert text.count("parallelogram: [j2, j3, j7, j8]") == 1
    return parse_robot(text.replace("parallelogram: [j2, j3, j7, j8]", general), where="sr400", folder=None)


@pytest.mark.parametrize("make", [*ARMS, sr400_by_closing])
def test_the_closing_frames_meet_along_paths(make: Callable[[], RobotFile]) -> None:
    """Placed by the tree's kinematics alone, which the solver does not use."""
    robot_file = make()
    model = build_model(robot_file)
    low, high = (np.array(limit)[:, None] for limit in zip(*(joint.position for joint in model.limits), strict=True))
    time = np.linspace(0.0, 1.0, 200)
    waves = 0.5 + 0.5 * np.sin(2 * np.pi * np.outer(1 + np.arange(model.dof), time))
    loop = robot_file.robot.model.loops[0]
    numbers = {name: number for number, name in enumerate(model.link_names)}
    tree = model.tree_position(low + (high - low) * waves)
    following = [numbers[name] for name in robot_file.robot.passive_names]
    assert np.abs(np.diff(tree[following], axis=1)).max() < 0.3  # on one branch
    for position in tree.T:
        frames = place_tree(model.joints, position)
        one, other = (
            (frames[number][0] @ end[0], frames[number][1] + frames[number][0] @ end[1])
            for number, end in loop_ends(loop, numbers)
        )
        np.testing.assert_allclose(one[1], other[1], atol=1e-10)
        if loop.opened != "spherical":
            np.testing.assert_allclose(np.cross(one[0][:, 2], other[0][:, 2]), 0.0, atol=1e-10)


@each("make", ARMS)
def test_velocities_and_accelerations_are_the_positions_derivatives(make: Callable[[], RobotFile]) -> None:
    model = build_model(make())
    position, velocity, acceleration = random_states(model, 20, seed=3)
    position *= 0.9  # finite differences stay within the limits
    motion = model.tree_motion(position, velocity, acceleration)
    step = 1e-5

    def moved(time: float) -> tuple[np.ndarray, np.ndarray]:
        return model.tree_velocity(
            position + time * velocity + 0.5 * time**2 * acceleration, velocity + time * acceleration
        )

    (before, rate_before), (after, rate_after) = moved(-step), moved(step)
    scale = np.abs(motion.acceleration).max()
    np.testing.assert_allclose(motion.velocity, (after - before) / (2 * step), atol=1e-6 * scale)
    np.testing.assert_allclose(motion.acceleration, (rate_after - rate_before) / (2 * step), atol=1e-6 * scale)


@pytest.mark.parametrize("make", ARMS)
def test_g_and_its_rate_are_derivatives(make: Callable[[], RobotFile]) -> None:
    model = build_model(make())
    position, velocity, acceleration = random_states(model, 10, seed=4)
    position *= 0.9
    motion = model.tree_motion(position, velocity, acceleration)
    step = 1e-6
    for joint in range(model.dof):
        ends = [position.copy() for _ in range(2)]
        ends[0][joint] -= step
        ends[1][joint] += step
        difference = (model.tree_position(ends[1]) - model.tree_position(ends[0])) / (2 * step)
        np.testing.assert_allclose(motion.follow[:, joint], difference, atol=1e-8)
    before, after = (model.tree_motion(position + t * velocity, velocity, velocity).follow for t in (-step, step))
    rate = (after - before) / (2 * step)
    expected = np.einsum("naN,aN->nN", motion.follow, acceleration) + np.einsum("naN,aN->nN", rate, velocity)
    np.testing.assert_allclose(motion.acceleration, expected, atol=1e-6 * (1.0 + np.abs(expected).max()))


def test_a_parallelogram_by_its_closing_frames_is_the_linear_one() -> None:
    general, linear = build_model(sr400_by_closing()), build_model(load_robot("sr400"))
    motion = random_states(linear, 600, seed=2)
    found, expected = general.tree_motion(*motion), linear.tree_motion(*motion)
    turns = (found.position - expected.position) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.broadcast_to(np.round(turns[:, :1]), turns.shape), atol=1e-12)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-10)
    np.testing.assert_allclose(found.acceleration, expected.acceleration, atol=1e-9)
    np.testing.assert_allclose(
        found.follow, np.broadcast_to(expected.follow[..., None], found.follow.shape), atol=1e-11
    )
    assert not loops_of(general).varies.any()
    of_linear = regressor(linear, *motion)
    np.testing.assert_allclose(regressor(general, *motion), of_linear, atol=1e-9 * np.abs(of_linear).max())
    one, other = base_parameters(general), base_parameters(linear)
    assert one.names == other.names
    assert one.expressions == other.expressions
    assert one.no_effect == other.no_effect


def test_the_loop_of_the_docs_is_the_example_s() -> None:
    page = (Path(__file__).parents[4] / "docs" / "loops.md").read_text(encoding="utf-8")
    block = page.split("## Any other linkage", 1)[1].split("```yaml\n", 1)[1].split("```", 1)[0]
    assert yaml.safe_load(block)["loops"] == yaml.safe_load(four_bar_arm().text)["model"]["loops"]


def test_the_tool_is_behind_the_wrist() -> None:
    """Coupler and wrist are as many joints away from the base; only the wrist has a motor."""
    model = build_model(four_bar_arm())
    assert model.link_names[model.tool_link] == "wrist"


def test_the_start_chooses_the_assembly() -> None:
    up = build_model(four_bar_arm())
    down = build_model(four_bar_arm(**{"{coupler: 1.0, rocker: -1.3}": "{coupler: 2.7, rocker: 2.5}"}))
    position = random_states(up, 50)[0]
    one, other = up.tree_position(position), down.tree_position(position)
    assert np.all(np.sign(one[3]) != np.sign(other[3]))
    assert one[3].max() < 0.0


def test_a_loop_may_close_on_the_base() -> None:
    """A slider-crank: the rod's end slides on the base."""
    text = (
        "name: slider\nmodel:\n  gravity: [0, -9.81, 0]\n  mdh:\n    - {joint: crank, alpha: 0, d: 0, r: 0}\n"
        "    - {joint: rod, antecedent: crank, alpha: 0, d: 0.1, r: 0}\n"
        "    - {joint: slide, type: prismatic, gamma: pi/2, alpha: pi/2, d: 0, r: 0}\n"
        "  loops:\n    - passive: {rod: 0.1, slide: 0.4}\n      closing:\n"
        "        - {antecedent: rod, d: 0.3}\n        - {antecedent: slide, alpha: -pi/2, d: 0}\n"
        "joints:\n  - {name: crank, position: [-3, 3], velocity: 5}\n"
    )
    model = build_model(parse_robot(text, where="slider", folder=None))
    angle = np.linspace(-3, 3, 30)
    tree = model.tree_position(angle[None])
    expected = 0.1 * np.cos(angle) + np.sqrt(0.3**2 - (0.1 * np.sin(angle)) ** 2)
    np.testing.assert_allclose(tree[2], expected, atol=1e-12)


CHAINED = """\
name: chained
model:
  mdh:
    - {joint: crank, alpha: 0, d: 0, r: 0}
    - {joint: coupler, antecedent: crank, alpha: 0, d: 0.25, r: 0}
    - {joint: rocker, alpha: 0, d: 0.5, r: 0}
    - {joint: second, antecedent: rocker, alpha: 0, d: 0.3, r: 0}
    - {joint: last, gamma: 0.4, alpha: 0, d: 0.9, r: 0}
    - {joint: pointer, antecedent: last, alpha: pi/2, d: 0.2, r: 0}
  loops:
    - passive: {coupler: -0.8, rocker: 1.3}
      closing: [{antecedent: coupler, d: 0.5}, {antecedent: rocker, d: 0.4}]
    - passive: {second: -0.5, last: 1.6}
      closing: [{antecedent: second, d: 0.45}, {antecedent: last, d: 0.35}]
    - {joint: pointer, equation: {last: -1, crank: 0.5}, offset: 0.1}
joints:
  - {name: crank, position: [0.8, 1.9], velocity: 2}
"""
"""A four-bar linkage whose rocker drives another, and a joint that follows both by an equation."""


def test_loops_and_equations_may_share_joints() -> None:
    robot_file = parse_robot(CHAINED, where="chained", folder=None)
    model = build_model(robot_file)
    numbers = {name: number for number, name in enumerate(model.link_names)}
    crank = np.linspace(0.81, 1.89, 40)
    motion = model.tree_motion(crank[None], np.ones((1, 40)), np.zeros((1, 40)))
    for position in motion.position.T:
        frames = place_tree(model.joints, position)
        for loop in robot_file.robot.model.loops[:2]:
            one, other = (frames[number][1] + frames[number][0] @ end[1] for number, end in loop_ends(loop, numbers))
            np.testing.assert_allclose(one, other, atol=1e-10)
    np.testing.assert_allclose(motion.position[5], 0.1 - motion.position[4] + 0.5 * crank, atol=1e-12)
    before, after = (model.tree_velocity(crank[None] + step, np.ones((1, 40))) for step in (-1e-6, 1e-6))
    np.testing.assert_allclose(motion.velocity, (after[0] - before[0]) / 2e-6, atol=1e-8)
    np.testing.assert_allclose(motion.acceleration, (after[1] - before[1]) / 2e-6, atol=1e-6)
    assert np.abs(motion.acceleration).max() > 0.1


def test_a_position_that_cannot_be_closed_is_refused_with_its_numbers() -> None:
    model = build_model(four_bar_arm(**{"d: 0.25, r: 0}": "d: 0.45, r: 0}", "[-2.4, -0.4]": "[-1.6, -0.8]"}))
    position = np.array([[0.0, 0.0], [-1.2, 2.5], [0.0, 0.0]])
    with pytest.raises(DataError, match=r"loop of coupler, rocker does not close at crank = 2.5 \(") as caught:
        model.tree_position(position)
    assert caught.value.exit_status == 2


def test_a_position_beyond_all_ways_is_refused_at_once() -> None:
    with pytest.raises(DataError, match=r"does not close at crank = 1e\+12"):
        build_model(four_bar_arm()).tree_position(np.array([0.0, 1e12, 0.0]))


def test_a_crank_may_turn_many_times() -> None:
    """Known positions are then far apart; what lies between them is followed from the nearest."""
    start = "{coupler: 1.0, rocker: -1.3}"
    changes = {"[-2.4, -0.4]": "[-10*pi, 10*pi]", start: start + "\n      at: {crank: -1.4}"}
    model = build_model(four_bar_arm(**changes))
    crank = np.linspace(-28, 28, 250)
    position = np.stack([np.zeros(250), crank, np.zeros(250)])
    tree = model.tree_position(position)
    turned = model.tree_position(position + np.array([[0.0], [2 * np.pi], [0.0]])[:, :1] * (crank < 22))
    np.testing.assert_allclose(turned[3], tree[3], atol=1e-10)


def test_positions_do_not_depend_on_what_else_is_asked_for() -> None:
    model = build_model(spatial_arm())
    position = random_states(model, 100, seed=9)[0]
    whole = model.tree_position(position)
    for sample in (0, 50, 99):
        np.testing.assert_allclose(model.tree_position(position[:, sample]), whole[:, sample], atol=1e-12)
        np.testing.assert_allclose(model.tree_position(position[:, [sample]])[:, 0], whole[:, sample], atol=1e-12)
