"""Convex hulls of meshes: distances along a path, between its samples, and the motions that they allow or refuse."""

from __future__ import annotations

import itertools
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from loop_arms import four_bar_arm
from scipy.spatial import ConvexHull

from daq.motion.trajectories import PointToPoint
from daq.robot.loader import parse_robot
from drivers.core.errors import MotionRefusedError
from ident.checks.robot_check import check_robot
from ident.excite.constraints.collision_geometry import ArmGeometry, arm_geometry
from ident.excite.constraints.constraints import unchecked_pairs
from ident.excite.constraints.hull_distance import (
    DISTANCE_TOLERANCE,
    Hull,
    HullDistances,
    coal_shape,
    hull_of_capsule,
    hull_of_points,
)
from ident.excite.constraints.placements import Capsule
from ident.excite.constraints.self_collision import SelfCollision, link_pairs
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.path import JointPath
from ident.model.dynamic_model import build_model
from ident.model.kinematics.joints import BASE_INDEX

URDF = """<robot name="folding">
  <link name="plate"><collision><geometry><mesh filename="plate.stl"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="plate"/><child link="post"/><origin xyz="0 0 0.02"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="99" velocity="1"/></joint>
  <link name="post"/>
  <joint name="lift" type="revolute"><parent link="post"/><child link="fore"/><origin xyz="0 0 0.25"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="99" velocity="1"/></joint>
  <link name="fore"><collision><geometry><mesh filename="fore.stl"/></geometry></collision></link>
</robot>"""
ROBOT = """
name: folding
model: {urdf: folding.urdf, mounting: free}
joints: [{name: turn, position: [-3, 3], velocity: 1}, {name: lift, position: [-3, 3], velocity: 1}]
"""
LENGTH = 0.6


def write_box(path, low, high):
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    triangles = [corners[list(chosen)] for chosen in itertools.combinations(range(8), 3)]
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *np.ravel(triangle), 0) for triangle in triangles)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + body)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A wide, thin plate, which no capsule fits, and a forearm that folds down onto it."""
    folder = tmp_path_factory.mktemp("folding")
    write_box(folder / "plate.stl", (-0.5, -0.5, -0.02), (0.5, 0.5, 0.0))
    write_box(folder / "fore.stl", (0.0, -0.03, -0.03), (LENGTH, 0.03, 0.03))
    return folder


@pytest.fixture(scope="module")
def robot_file(folder):
    return parse_robot(ROBOT, where="folding", folder=folder, urdf_text=URDF)


def move(*lifts):
    points = np.array([[0.3 * number, lift] for number, lift in enumerate(lifts)])
    return PointToPoint(points, np.full(len(lifts) - 1, 2.0))


def test_a_motion_over_a_plate_is_free_and_one_into_it_is_refused(robot_file):
    model = build_model(robot_file)
    geometry = arm_geometry(robot_file, model)
    assert len(geometry.hulls) == 3  # the post has no shape: its tube
    pairs = link_pairs(model, geometry)
    assert (pairs.by_hull, pairs.checked, pairs.close) == (((BASE_INDEX, 1),), (), ())
    assert unchecked_pairs(robot_file, model) == ()
    assert any("does not check base and lift, " in said for said in check_robot(robot_file).assumed)
    check = ArmMotionCheck(robot_file)
    # The lower edge of the end is 0.27 - 0.6 sin(q) - 0.03 cos(q) above the plate.
    figures = check.trajectory(move(-1.0, 0.3, -0.5), "motion")
    (nearest,) = (one for one in figures.clearances if one.what == "link base")
    least = 0.27 - LENGTH * np.sin(0.3) - 0.03 * np.cos(0.3)
    assert 0.4 * least < nearest.distance <= least
    with pytest.raises(MotionRefusedError, match="link lift enters link base"):
        check.trajectory(move(-1.0, 0.5, -0.5), "motion")


def test_the_same_arm_without_its_meshes_has_tubes_and_says_so(tmp_path):
    robot_file = parse_robot(ROBOT, where="folding", folder=tmp_path, urdf_text=URDF)
    geometry = arm_geometry(robot_file, build_model(robot_file))
    assert (geometry.hulls, geometry.from_shapes) == ((), ())
    assert geometry.unread == ("base: no such file: plate.stl", "lift: no such file: fore.stl")
    assert any("shape of link base: no such file: plate.stl" in said for said in check_robot(robot_file).assumed)


def test_flat_points_have_no_hull():
    flat = np.array([[x, y, 0.0] for x in (0, 1) for y in (0, 1)], dtype=float)
    assert hull_of_points(0, flat) is None
    assert hull_of_points(0, flat[:2]) is None
    cube = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    inside = np.vstack([cube, [[0.5, 0.5, 0.5]]])
    hull = hull_of_points(0, inside)
    assert hull is not None
    assert len(hull.points) == 8


@pytest.mark.parametrize("shape", ["disc", "cone"])
def test_a_shape_too_finely_drawn_for_coal_gets_a_hull_around_it(shape):
    angle = np.linspace(0.0, 2.0 * np.pi, 700, endpoint=False)
    rim = np.column_stack([0.3 * np.cos(angle), 0.2 * np.sin(angle), np.zeros(angle.size)])
    over = rim + [0.0, 0.0, 1e-3] if shape == "disc" else np.array([[0.0, 0.0, 0.5]])
    points = np.vstack([rim, over])
    hull = hull_of_points(0, points)
    assert hull is not None
    coal_shape(hull)  # raised from inside Coal before
    planes = ConvexHull(hull.points).equations
    assert (planes[:, :3] @ points.T + planes[:, 3:]).max() < 1e-12
    assert hull.reach < 1.002 * np.linalg.norm(points, axis=1).max()


def random_hulls(model, seed):
    """A capsule or some points for every link."""
    draw = np.random.default_rng(seed)
    for link in (BASE_INDEX, *range(len(model.joints))):
        if draw.random() < 0.5:
            yield hull_of_capsule(Capsule(link, draw.normal(size=3) * 0.1, draw.normal(size=3) * 0.1, 0.05))
        else:
            hull = hull_of_points(link, 0.1 * draw.normal(size=(12, 3)))
            assert hull is not None
            yield hull


@settings(max_examples=8)
@given(seed=st.integers(0, 10**6), loop=st.booleans())
@example(seed=848, loop=True)  # links overlap at the end of the path
def test_bounds_along_a_path_hold_between_its_samples(random_tree, seed, loop):
    model = build_model(four_bar_arm()) if loop else random_tree(seed % 50, dof=3 + seed % 3)
    hulls: list[Hull] = list(random_hulls(model, seed))
    distances = HullDistances(model, hulls)
    draw = np.random.default_rng(seed)
    low, high = np.array([limits.position for limits in model.limits]).T
    ends = draw.uniform(0.8 * low, 0.8 * high, (2, model.dof))
    time = np.linspace(0.0, 1.0, 161)
    bend = draw.normal(size=model.dof) * 0.1 * (high - low)
    share = 0.5 - 0.5 * np.cos(np.pi * time)
    path = ends[0] + np.outer(share, ends[1] - ends[0]) + np.outer(np.sin(np.pi * time) ** 2, bend)
    path = np.clip(path, low, high).T
    links = [BASE_INDEX, *range(len(model.joints))]
    pair = tuple(sorted(draw.choice(links, 2, replace=False).tolist()))
    fine = distances.between(pair, path)
    coarse = distances.along(pair, path[:, ::4], np.ones(41, dtype=bool))
    least = np.array([fine[4 * k : 4 * k + 5].min() for k in range(41)])
    assert np.all(coarse <= least + 2 * DISTANCE_TOLERANCE)
    if not loop:  # where links come no nearer than they may, bounds are of use
        clear = least > 0.05
        still = distances.ways(pair, path[:, ::4]) < 0.01
        assert np.all(coarse[clear & still] > 0.2 * least[clear & still])


def test_hulls_are_never_nearer_than_capsules_around_them(robot_file):
    model = build_model(robot_file)
    geometry = arm_geometry(robot_file, model)
    position = np.random.default_rng(0).uniform(-3, 3, (2, 60))
    pair = (BASE_INDEX, 1)
    capsules = SelfCollision(model, ArmGeometry(geometry.capsules, ()), link_pairs(model, geometry))
    capsules = SelfCollision(model, geometry, type(capsules.pairs)((pair,), (), (), ()))
    apart = capsules.distances(JointPath(np.arange(60.0), position, 0 * position, 0 * position))[0]
    tight = HullDistances(model, geometry.hulls).between(pair, position)
    assert np.all(tight >= apart - 1e-5)
    assert np.mean(tight - apart) > 0.1
