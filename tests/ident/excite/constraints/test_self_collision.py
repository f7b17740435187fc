"""Self-collision: closed forms, Coal as the reference, derivatives, which pairs are checked."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from arm_kinds import ARM_KINDS
from each import each
from path_derivatives import assert_derivatives, assert_upper_bound, random_path

from daq.commands.confirmation import unchecked_lines
from daq.motion.trajectories import PointToPoint
from daq.robot.loader import load_robot, parse_robot
from daq.robot.workspace import Workspace
from drivers.core.errors import RobotFileError
from ident.checks.robot_check import check_robot
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry, tube_capsules
from ident.excite.constraints.constraints import checked_pairs, unchecked_pairs
from ident.excite.constraints.placements import Capsule
from ident.excite.constraints.self_collision import SelfCollision, link_pairs
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.path import JointPath
from ident.model.base_parameters import random_states
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model

URDF = """<robot name="crab">
  <link name="body"><collision><geometry><box size="0.1 0.1 0.4"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="body"/><child link="arm"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="1"/></joint>
  <link name="arm"><collision><origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/>
    <geometry><cylinder radius="0.04" length="0.4"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="claw"/><origin xyz="0.6 0 0.1"/>
    <axis xyz="0 0 -1"/><limit lower="0" upper="0.5" effort="9" velocity="1"/></joint>
  <link name="claw"><collision><origin xyz="-0.1 0.02 -0.1"/>
    <geometry><capsule radius="0.03" length="0.3"/></geometry></collision></link>
</robot>"""
CRAB = """
name: crab
model: {urdf: crab.urdf}
joints: [{name: turn, position: [-3, 3], velocity: 1}, {name: slide, position: [0, 0.5], velocity: 1}]
"""


def built_in(name):
    robot_file = load_robot(name)
    model = build_model(robot_file)
    return model, arm_geometry(robot_file, model), robot_file.robot.workspace


def builtin_text(name):
    return load_robot(name).text


def pose(position):
    position = np.array(position, dtype=float)[:, None]
    return JointPath(np.zeros(1), position, 0 * position, 0 * position)


def uses(constraint, position):
    return dict(zip(constraint.names, constraint.use(pose(position)), strict=True))


@each("robot", ["ur10", "ur10e", "ur5e"])
def test_an_arm_folded_onto_itself_collides_and_its_home_pose_does_not(robot):
    model, geometry, workspace = built_in(robot)
    constraint = SelfCollision(model, geometry, link_pairs(model, geometry, workspace.ignore_pairs))
    home = uses(constraint, [0, -np.pi / 2, 0, -np.pi / 2, 0, 0])
    assert max(home.values()) < 1
    folded = uses(constraint, [0, -np.pi / 2, np.pi, 0, 0, 0])
    assert folded["distance of link elbow_joint from base"] > 1


def test_two_capsules_in_closed_form(random_tree):
    text = """
name: two_arms
model:
  mdh:
    - {joint: left, alpha: 0, d: 0, r: 0.2}
    - {joint: right, antecedent: base, gamma: 0, b: 0.5, alpha: 0, d: 0, r: 0}
joints: [{name: left, position: [-3, 3], velocity: 1}, {name: right, position: [-3, 3], velocity: 1}]
"""
    model = build_model(parse_robot(text, where="two", folder=None))
    x = np.array([1.0, 0.0, 0.0])
    capsules = (
        Capsule(-1, np.zeros(3) - [0, 0, 9.0], np.zeros(3) - [0, 0, 9.0], 0.1),
        Capsule(0, np.zeros(3), x, 0.05),
        Capsule(1, 0.2 * x, x, 0.03),
    )
    geometry = ArmGeometry(capsules, ())
    pairs = link_pairs(model, geometry)
    assert pairs.checked == ((0, 1),)
    assert pairs.neighbours == ((-1, 0), (-1, 1))
    constraint = SelfCollision(model, geometry, pairs)
    # The arms turn in planes 0.3 m apart; at an angle φ the nearest points are the axis and the inner end of the other.
    for angle in (0.0, 0.4, np.pi / 2, 2.0):
        apart = np.hypot(0.3, 0.2 * np.sin(angle) if angle < np.pi / 2 else 0.2)
        expected = 1 - (apart - 0.08) / 0.1
        assert constraint.use(pose([0.7, 0.7 + angle]))[0] == pytest.approx(expected, abs=1e-9)


def test_same_distances_as_pinocchio_with_coal():
    import coal
    import pinocchio as pin

    model, geometry, _ = built_in("ur10")
    pairs = link_pairs(model, geometry)
    arm = pinocchio_model(model)
    shapes = pin.GeometryModel()
    numbers = []
    for number, capsule in enumerate(geometry.capsules):
        way = capsule.end - capsule.start
        length = float(np.linalg.norm(way))
        rotation = np.eye(3)
        if length > 0:
            z = way / length
            x = np.linalg.svd(z[None, :])[2][1]
            rotation = np.column_stack([x, np.cross(z, x), z])
        placement = pin.SE3(rotation, 0.5 * (capsule.start + capsule.end))
        shape = coal.Capsule(capsule.radius, length) if length > 0 else coal.Sphere(capsule.radius)
        numbers.append(shapes.addGeometryObject(pin.GeometryObject(f"c{number}", capsule.link + 1, placement, shape)))
    of_pair = []
    for first, second in pairs.checked:
        indices = []
        for one in np.flatnonzero(geometry.links == first):
            for other in np.flatnonzero(geometry.links == second):
                shapes.addCollisionPair(pin.CollisionPair(numbers[one], numbers[other]))
                indices.append(len(shapes.collisionPairs) - 1)
        of_pair.append(indices)
    data, shape_data = arm.createData(), shapes.createData()
    constraint = SelfCollision(model, geometry, pairs)
    path = random_path(model, 1, count=60, size=3.0)
    for sample in range(60):
        q = path.position[:, sample]
        pin.computeDistances(arm, data, shapes, shape_data, q)
        reference = np.array([min(shape_data.distanceResults[i].min_distance for i in pair) for pair in of_pair])
        ours = 0.1 * (1 - constraint.use(pose(q)))
        # Coal's depth is less exact where the axes themselves nearly cross.
        clear = reference > -0.5 * geometry.radii.min()
        assert np.allclose(ours[clear], reference[clear], atol=2e-6)
        assert np.all(ours[~clear] < 0)


@each("seed", range(8))
def test_derivatives_and_bound_on_random_trees(random_tree, seed):
    model = random_tree(seed, dof=3 + seed % 4)
    geometry = ArmGeometry(tube_capsules(model, None, Workspace()), ())
    constraint = SelfCollision(model, geometry, link_pairs(model, geometry))
    path = random_path(model, seed)
    assert_derivatives(constraint, path, 2.0)
    assert_derivatives(constraint, path, 30.0)
    if constraint.names:
        assert_upper_bound(constraint, path)


@pytest.mark.parametrize("robot", ["ur10", "panda"])
def test_derivatives_on_builtin_arms(robot):
    model, geometry, workspace = built_in(robot)
    constraint = SelfCollision(model, geometry, link_pairs(model, geometry, workspace.ignore_pairs))
    assert len(constraint.names) > 5
    assert_derivatives(constraint, random_path(model, 2, count=20, size=2.5), 10.0)


def test_a_urdf_arm_with_a_prismatic_joint():
    robot_file = parse_robot(CRAB, where="crab", folder=None, urdf_text=URDF)
    model = build_model(robot_file)
    geometry = arm_geometry(robot_file, model)
    assert geometry.from_shapes == ("base", "turn", "slide")
    pairs = link_pairs(model, geometry)
    assert pairs.checked == ((-1, 1),)
    constraint = SelfCollision(model, geometry, pairs)
    assert constraint.names == ("distance of link slide from base",)
    path = random_path(model, 0, count=25, size=1.5)
    assert_derivatives(constraint, path, 5.0)
    assert_upper_bound(constraint, path)
    assert constraint.use(pose([0.0, 0.0]))[0] < 1
    assert constraint.use(pose([1.4, 0.2]))[0] > 1


def test_pairs_that_are_close_by_construction_and_those_that_are_ignored_are_left_out():
    model, geometry, _ = built_in("ur10")
    pairs = link_pairs(model, geometry, [("wrist_3_joint", "base"), ("shoulder_pan_joint", "elbow_joint")])
    assert set(pairs.ignored) == {(-1, 5), (0, 2)}
    assert (-1, 1) in pairs.close  # the upper arm begins where the base's tube ends
    assert pairs.neighbours == ((-1, 0), (0, 1), (1, 2), (2, 3), (3, 4), (4, 5))
    every = pairs.checked + pairs.neighbours + pairs.close + pairs.ignored
    assert len(every) == len(set(every)) == 21


@pytest.mark.parametrize("robot", ARM_KINDS)
def test_every_checked_pair_of_a_builtin_arm_can_be_kept_apart(robot):
    # A pair that is within the margin of a limit in every configuration would make every design fail.
    model, geometry, workspace = built_in(robot)
    constraint = SelfCollision(model, geometry, link_pairs(model, geometry, workspace.ignore_pairs))
    positions = random_states(model, 300, seed=5)[0].T
    uses_found = np.array([constraint.use(pose(position)) for position in positions])
    assert np.all(uses_found.min(axis=0, initial=np.inf) < 0.8)
    assert np.any(np.all(uses_found < 0.95, axis=1))


def test_nothing_to_check_is_no_constraint(random_tree):
    model = random_tree(0, dof=1)
    geometry = ArmGeometry(tube_capsules(model, None, Workspace()), ())
    constraint = SelfCollision(model, geometry, link_pairs(model, geometry))
    assert constraint.names == ()
    path = random_path(model, 0)
    assert constraint.use(path).shape == (0,)
    assert constraint.smooth_use(path, 3.0)[1].shape == (0, 3, 1, 7)


@pytest.mark.parametrize("robot", ["ur5e", "panda", "rocr6", "sr400"])
@pytest.mark.parametrize("pose", ["folded", "random"])
def test_narrow_limits_hide_no_pair_of_links(robot, pose):
    """Within them links may always touch, or never come near each other; what the arm is has not changed."""
    text = builtin_text(robot)
    wide = parse_robot(text, where=robot, folder=None)
    content = yaml.safe_load(text)
    generator = np.random.default_rng(5)
    loops = {"sr400": ("j2", "j7")}.get(robot, ())  # beyond the limits of these, bars would go through each other
    for number, joint in enumerate(content["joints"]):
        if joint["name"] in loops:
            continue
        low, high = wide.robot.joints[number].position
        middle = (low, high)[number % 2] if pose == "folded" else generator.uniform(low, high)
        joint["position"] = [float(max(low, middle - 0.02)), float(min(high, middle + 0.02))]
    narrow = parse_robot(yaml.safe_dump(content), where=robot, folder=None)
    sorted_pairs = [
        checked_pairs(file, model := build_model(file), arm_geometry(file, model)) for file in (wide, narrow)
    ]
    assert sorted_pairs[0] == sorted_pairs[1]
    assert unchecked_pairs(narrow, build_model(narrow)) == unchecked_pairs(wide, build_model(wide))


def test_a_link_radius_that_leaves_no_pair_is_refused_by_its_key():
    content = yaml.safe_load(builtin_text("ur5e"))
    for radius in (0.95, {joint["name"]: 0.95 for joint in content["joints"]}):
        content["workspace"] = {**content.get("workspace", {}), "link_radius": radius}
        file = parse_robot(yaml.safe_dump(content), where="arm.yaml", folder=None)
        model = build_model(file)
        with pytest.raises(RobotFileError, match="every pair touches in nearly every pose") as caught:
            checked_pairs(file, model, arm_geometry(file, model))
        assert caught.value.where == "arm.yaml: workspace.link_radius"
        assert [str(problem) for problem in check_robot(file).problems] == [str(caught.value)]


def test_pairs_that_are_left_out_are_named():
    robot_file = load_robot("ur5e")
    left_out = "elbow_joint and wrist_2_joint"
    assert left_out in unchecked_pairs(robot_file, build_model(robot_file))
    assert any(left_out in assumed for assumed in check_robot(robot_file).assumed)
    motion = PointToPoint(np.array([[0, -1.5, 0.5, -1.5, 0, 0], [0.1, -1.5, 0.5, -1.5, 0, 0]]), np.array([2.0]))
    figures = ArmMotionCheck(robot_file).trajectory(motion, "motion")
    assert left_out in figures.unchecked
    assert any(left_out in line for line in unchecked_lines(figures))
