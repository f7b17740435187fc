"""Workspace limits: distances in closed form, derivatives on random arms, what counts and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from path_derivatives import assert_derivatives, assert_upper_bound, random_path

from daq.robot.loader import load_robot, parse_robot
from daq.robot.obstacles import obstacles_of
from daq.robot.workspace import Box, Workspace
from drivers.core.errors import RobotFileError
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry, tube_capsules
from ident.excite.constraints.workspace import WorkspaceLimits, box_distances
from ident.excite.path import JointPath
from ident.model.dynamic_model import build_model

# Shoulder at 0.3 m; upper arm and forearm of 0.4 m each in the vertical plane through the first axis.
ARM = """
name: arm
model:
  mdh:
    - {joint: j1, alpha: 0, d: 0, r: 0.3}
    - {joint: j2, antecedent: j1, alpha: pi/2, d: 0, r: 0}
    - {joint: j3, antecedent: j2, alpha: 0, d: 0.4, r: 0}
joints:
  - {name: j1, position: [-3, 3], velocity: 1}
  - {name: j2, position: [-3, 3], velocity: 1}
  - {name: j3, position: [-3, 3], velocity: 1}
workspace:
  tool: [0.4, 0, 0]
  clearance: 0
"""
FREE = ARM.replace("model:", "model:\n  mounting: free")

EVERYTHING = {
    "tool": [0.1, -0.2, 0.15],
    "radius": [0.2, 0.6],
    "height": [-0.2, 0.7],
    "floor": -0.3,
    "clearance": 0.03,
    "keep_out": [
        {"half_space": {"normal": [1, 2, -1], "offset": -0.4}, "clearance": 0.01},
        {"box": {"lower": [0.1, -0.5, 0.0], "upper": [0.6, 0.3, 0.4]}},
    ],
}


def limits_of(more="", arm=FREE):
    robot_file = parse_robot(arm + more, where="arm", folder=None)
    model = build_model(robot_file)
    return WorkspaceLimits(
        model, arm_geometry(robot_file, model), robot_file.robot.workspace, obstacles_of(robot_file.robot)
    )


def obstacles(workspace):
    return obstacles_of(load_robot("ur5e").robot.model_copy(update={"workspace": workspace}))


def poses(*positions):
    position = np.array(positions, dtype=float).T
    return JointPath(np.arange(position.shape[1], dtype=float), position, 0 * position, 0 * position)


def use_of(constraint, *positions):
    return dict(zip(constraint.names, constraint.use(poses(*positions)), strict=True))


def test_radius_and_height_are_those_of_the_papers_end_effector():
    constraint = limits_of("  radius: [0.1, 0.7]\n  height: [0.2, 1.0]\n")
    stretched = use_of(constraint, [0.5, 0, 0])  # tool point 0.8 m from the axis, 0.3 m high
    assert stretched["largest radius of the arm"] == pytest.approx(1 + 0.1 / 0.1)
    assert stretched["smallest radius of the tool point"] == pytest.approx(1 - 0.7 / 0.1)
    assert stretched["smallest height of the arm"] == pytest.approx(1 - 0.1 / 0.1)
    assert stretched["largest height of the arm"] == pytest.approx(1 - 0.7 / 0.1)
    upright = use_of(constraint, [0, np.pi / 2, 0])
    assert upright["largest height of the arm"] == pytest.approx(1 + 0.1 / 0.1)
    assert upright["smallest radius of the tool point"] == pytest.approx(1 + 0.1 / 0.1)


def test_points_along_the_links_count_too():
    constraint = limits_of("  radius: [0, 0.35]\n")
    folded = use_of(constraint, [0, 0, np.pi * 0.99])  # the tool is back at the axis, the elbow sticks out
    assert constraint.names == ("largest radius of the arm",)
    assert folded["largest radius of the arm"] == pytest.approx(1 + 0.05 / 0.1)


def test_the_arm_stays_where_the_normal_points():
    constraint = limits_of("  keep_out: [{half_space: {normal: [0, 0, 5], offset: 0.1}}]\n  link_radius: 0.04\n")
    level, down = use_of(constraint, [0, 0, 0]), use_of(constraint, [0, -0.5, 0])
    name = "clearance to half-space keep_out[0]"
    assert level[name] == pytest.approx(1 - (0.3 - 0.1 - 0.04) / 0.1)
    assert down[name] == pytest.approx(1 - (0.3 - 0.8 * np.sin(0.5) - 0.1 - 0.04) / 0.1)
    assert down[name] > 1


def test_a_box_that_the_arm_passes_through_is_noticed():
    # The box stands between elbow and tool: neither end of the forearm is in it.
    more = "  keep_out: [{box: {lower: [0.55, -0.05, 0.2], upper: [0.65, 0.05, 0.4]}}]\n"
    constraint = limits_of(more + "  link_radius: 0.03\n")
    # Through the middle: 0.05 m from axis to the nearest faces, plus the radius.
    through = use_of(constraint, [0, 0, 0])["clearance to box keep_out[0]"]
    assert through == pytest.approx(1 + (0.05 + 0.03) / 0.1)
    beside = use_of(constraint, [np.pi / 2, 0, 0])["clearance to box keep_out[0]"]
    assert beside < 1
    swing = np.linspace(-1.5, 1.5, 401)
    passing = use_of(constraint, *np.column_stack([swing, 0 * swing, 0 * swing]))
    assert passing["clearance to box keep_out[0]"] == pytest.approx(through, abs=1e-3)


def test_distance_of_segments_to_a_box_is_the_smallest_of_their_points():
    generator = np.random.default_rng(0)
    box = Box(lower=(-0.3, -0.2, -0.5), upper=(0.4, 0.6, 0.1))
    start, end = generator.uniform(-1.2, 1.2, (2, 300, 3, 1))
    found = box_distances(start, end, box)
    shares = np.linspace(0, 1, 4001)
    points = start + (end - start) * shares
    lower, upper = np.array(box.lower)[:, None], np.array(box.upper)[:, None]
    beyond = np.maximum(lower - points, points - upper)
    signed = np.where((beyond > 0).any(axis=1), np.linalg.norm(np.maximum(beyond, 0), axis=1), beyond.max(axis=1))
    assert np.allclose(found.value[:, 0], signed.min(axis=1), atol=5e-4)
    assert np.all(found.value[:, 0] <= signed.min(axis=1) + 1e-9)
    assert 30 < np.count_nonzero(found.value < 0) < 270


@pytest.mark.parametrize("seed", range(8))
def test_derivatives_and_bound_on_random_arms(random_tree, seed):
    model = random_tree(seed, dof=2 + seed % 5)
    workspace = Workspace.model_validate(EVERYTHING | {"keep_out": EVERYTHING["keep_out"][:2]})
    capsules = tube_capsules(model, None, workspace)
    try:
        constraint = WorkspaceLimits(model, ArmGeometry(capsules, ()), workspace, obstacles(workspace))
    except RobotFileError:
        # A random arm's first joint may stand in the box, or below the floor; then without them.
        workspace = Workspace.model_validate(EVERYTHING | {"keep_out": [], "floor": None})
        constraint = WorkspaceLimits(model, ArmGeometry(capsules, ()), workspace, obstacles(workspace))
    path = random_path(model, seed, size=1.0)
    assert_derivatives(constraint, path, 2.0)
    assert_derivatives(constraint, path, 30.0)
    assert_upper_bound(constraint, path)


def test_derivatives_of_a_box_that_links_go_through():
    more = "  keep_out: [{box: {lower: [0.2, -0.3, 0.2], upper: [0.5, 0.35, 0.45]}}]\n"
    constraint = limits_of(more)
    robot_file = parse_robot(ARM, where="arm", folder=None)
    path = random_path(build_model(robot_file), 3, count=40, size=0.6)
    assert constraint.use(path)[0] > 1.5
    assert_derivatives(constraint, path, 4.0)


def test_a_long_path_gives_the_same_as_its_parts(monkeypatch):
    from ident.excite.constraints import workspace

    constraint = limits_of("  radius: [0.1, 0.7]\n  height: [0.2, 1.0]\n")
    path = random_path(build_model(parse_robot(ARM, where="arm", folder=None)), 1, count=50)
    whole = constraint.use(path)
    monkeypatch.setattr(workspace, "SAMPLES_AT_ONCE", 7)
    assert np.array_equal(whole, constraint.use(path))


def test_without_a_workspace_there_is_nothing_to_keep():
    constraint = limits_of()
    assert constraint.names == ()
    assert constraint.use(poses([0, 0, 0])).shape == (0,)
    assert constraint.smooth_use(poses([0, 0, 0]), 5.0)[1].shape == (0, 3, 3, 1)


@pytest.mark.parametrize(
    "keep_out",
    ["{half_space: {normal: [0, 0, 1], offset: 0.28}}", "{box: {lower: [-0.1, -0.1, 0], upper: [0.1, 0.1, 0.28]}}"],
)
def test_a_limit_that_holds_the_shoulder_is_refused(keep_out):
    with pytest.raises(RobotFileError, match="begins at a point that no joint moves") as caught:
        limits_of(f"  keep_out: [{keep_out}]\n")
    assert caught.value.where == "arm: workspace.keep_out[0]"


def test_the_table_keeps_links_up_by_their_thickness_and_the_clearance():
    constraint = limits_of("  link_radius: 0.04\n", ARM.replace("clearance: 0", "clearance: 0.05"))
    assert constraint.names == ("clearance to the table",)
    for lift in (0.0, -0.2, -0.5):  # the tool is the lowest point
        expected = 0.3 - 0.8 * np.sin(-lift) - 0.04
        assert use_of(constraint, [1, lift, 0])["clearance to the table"] == pytest.approx(1 - (expected - 0.05) / 0.1)
        (clearance,) = constraint.clearances(poses([1, lift, 0]))
        assert clearance.distance[0] == pytest.approx(expected)


@pytest.mark.parametrize("shoulder", [0.0, 0.04])
def test_links_that_touch_the_base_plane_by_construction_keep_their_other_end_clear(shoulder):
    constraint = limits_of("", ARM.replace("r: 0.3", f"r: {shoulder}"))
    raised = use_of(constraint, [0, 0.5, 0])["clearance to the table"]
    assert raised == pytest.approx(1 - (shoulder + 0.4 * np.sin(0.5) - 0.05) / 0.1)  # the elbow
    assert use_of(constraint, [0, 0.5, -1.5])["clearance to the table"] > 1  # the tool under the table


def test_an_arm_that_begins_below_the_table_is_refused():
    below = ARM.replace("r: 0.3", "r: -0.3").replace("[0.4, 0, 0]", "[0.1, 0, 0]")
    with pytest.raises(RobotFileError, match=r"the link of joint 'j2' reaches 0\.3 m below the table") as caught:
        limits_of("", below.replace("d: 0.4", "d: 0.1"))
    assert caught.value.where == "arm: model.mounting"
    assert limits_of("  floor: -0.6\n", below).names == ("clearance to the table",)


@each("seed", range(4))
def test_clearances_name_the_link_and_are_what_the_use_is_made_of(seed):
    more = f"  keep_out: [{{box: {{lower: [0.3, -0.3, 0.2], upper: [0.5, 0.3, {0.3 + 0.1 * seed}]}}, name: crate}}]\n"
    constraint = limits_of(more, ARM)
    path = random_path(build_model(parse_robot(ARM, where="arm", folder=None)), seed, count=30)
    used = dict(zip(constraint.names, constraint.use(path), strict=True))
    clearances = constraint.clearances(path)
    assert [clearance.name for clearance in clearances] == ["the table", "crate"]
    for clearance in clearances:
        assert used[f"clearance to {clearance.name}"] == pytest.approx(1 - clearance.distance.min() / 0.1)
        assert set(clearance.link) <= {0, 1, 2}
