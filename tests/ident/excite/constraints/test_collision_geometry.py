"""Capsules of an arm: along its axes, around the shapes and meshes of a URDF, and what cannot be used."""

from __future__ import annotations

import itertools
import struct

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot, parse_robot
from ident.excite.constraints.collision_geometry import arm_geometry
from ident.excite.constraints.placements import box_capsules, enclosing_capsule
from ident.model.dynamic_model import build_model

ARM = """
name: arm
model:
  mdh:
    - {joint: j1, alpha: 0, d: 0, r: 0.3}
    - {joint: j2, antecedent: j1, alpha: pi/2, d: 0.1, r: 0}
    - {joint: j3, antecedent: j2, alpha: 0, d: 0.5, r: 0.2}
    - {joint: j4, antecedent: j3, type: prismatic, alpha: pi/2, d: 0, r: 0.1}
joints:
  - {name: j1, position: [-3, 3], velocity: 1}
  - {name: j2, position: [-3, 3], velocity: 1}
  - {name: j3, position: [-3, 3], velocity: 1}
  - {name: j4, position: [0.0, 0.4], velocity: 1}
"""

URDF = """<robot name="two">
  <link name="ground"><collision><origin xyz="0 0 0.05"/>
    <geometry><box size="0.4 0.1 0.1"/></geometry></collision></link>
  <joint name="j1" type="revolute"><parent link="ground"/><child link="upper"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="upper">
    <collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>
      <geometry><cylinder radius="0.04" length="0.3"/></geometry></collision>
    <collision><origin xyz="0.4 0 0"/><geometry><sphere radius="0.06"/></geometry></collision></link>
  <joint name="stuck" type="fixed"><parent link="upper"/><child link="bracket"/><origin xyz="0.4 0 0.1"/></joint>
  <link name="bracket"><collision><geometry><capsule radius="0.02" length="0.1"/></geometry></collision></link>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="fore"><collision><geometry>{fore}</geometry></collision></link>
</robot>"""

URDF_ROBOT = """
name: two
model: {urdf: two.urdf}
joints:
  - {name: j1, position: [-3, 3], velocity: 1}
  - {name: j2, position: [-3, 3], velocity: 1}
"""


def geometry_of(text, **more):
    robot_file = parse_robot(text, where="arm", **({"folder": None} | more))
    return arm_geometry(robot_file, build_model(robot_file))


def of_link(geometry, link):
    return [capsule for capsule in geometry.capsules if capsule.link == link]


def contains(capsule, points):
    way = capsule.end - capsule.start
    share = np.clip((points - capsule.start) @ way / max(way @ way, 1e-30), 0.0, 1.0)
    return np.linalg.norm(points - capsule.start - share[:, None] * way, axis=1) <= capsule.radius + 1e-9


def test_tubes_follow_the_rows_with_a_corner():
    geometry = geometry_of(ARM + "workspace: {link_radius: {j2: 0.07, base: 0.09}, tool: [0, 0, 0.15]}\n")
    assert geometry.from_shapes == ()
    (base,) = of_link(geometry, -1)
    assert np.allclose([base.start, base.end], [[0, 0, 0], [0, 0, 0.3]])
    assert base.radius == 0.09
    first, second = of_link(geometry, 1)
    assert np.allclose([first.start, first.end], [[0, 0, 0], [0.5, 0, 0]])
    assert np.allclose([second.start, second.end], [[0.5, 0, 0], [0.5, 0, 0.2]])
    assert first.radius == second.radius == 0.07
    (shoulder,) = of_link(geometry, 0)
    assert np.allclose([shoulder.start, shoulder.end], [[0, 0, 0], [0.1, 0, 0]])
    assert shoulder.radius == 0.05


def test_a_prismatic_joint_is_covered_over_its_travel():
    geometry = geometry_of(ARM + "workspace: {tool: [0, 0, 0.15]}\n")
    (tube,) = of_link(geometry, 2)
    assert np.allclose([tube.start, tube.end], [[0, 0, 0], [0, -0.1, 0]], atol=1e-12)  # where the travel begins
    inner, tool = of_link(geometry, 3)
    assert np.allclose([inner.start, inner.end], [[0, 0, 0], [0, 0, -0.4]])
    assert np.allclose([tool.start, tool.end], [[0, 0, 0], [0, 0, 0.15]])


def test_a_link_without_length_is_a_sphere():
    geometry = geometry_of(ARM.replace("d: 0.1, r: 0}", "d: 0, r: 0}"))
    (shoulder,) = of_link(geometry, 0)
    assert np.array_equal(shoulder.start, shoulder.end)


@each("robot", ["ur5e", "ur10", "panda", "up6"])
def test_every_link_of_a_builtin_arm_has_a_capsule(robot):
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    geometry = arm_geometry(robot_file, model)
    assert set(geometry.links) == set(range(-1, model.dof))
    assert np.all(geometry.radii > 0)


def test_primitives_are_enclosed():
    geometry = geometry_of(URDF_ROBOT, urdf_text=URDF.format(fore='<box size="0.1 0.3 0.2"/>'))
    assert geometry.from_shapes == ("base", "j1", "j2")
    tube, ball, bracket = of_link(geometry, 0)
    assert np.allclose([tube.start, tube.end], [[0.05, 0, 0], [0.35, 0, 0]])
    assert (tube.radius, ball.radius, bracket.radius) == (0.04, 0.06, 0.02)
    assert np.allclose([ball.start, ball.end], [[0.4, 0, 0], [0.4, 0, 0]])
    assert np.allclose([bracket.start, bracket.end], [[0.4, 0, 0.05], [0.4, 0, 0.15]])
    grid = np.array(list(itertools.product(np.linspace(-1, 1, 9), repeat=3)))
    for link, sides, centre in ((-1, [0.4, 0.1, 0.1], [0, 0, 0.05]), (1, [0.1, 0.3, 0.2], [0, 0, 0])):
        inside = np.any([contains(capsule, grid * 0.5 * sides + centre) for capsule in of_link(geometry, link)], axis=0)
        assert np.all(inside)


@each("sides", [(1.0, 1.0, 1.0), (2.0, 0.5, 0.1), (0.1, 1.0, 1.0), (0.3, 0.2, 1e-12)])
def test_a_box_is_inside_its_capsules_and_they_are_not_huge(sides):
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    capsules = box_capsules(0, rotation, np.array([0.1, 0.2, 0.3]), sides)
    grid = np.array(list(itertools.product(np.linspace(-0.5, 0.5, 13), repeat=3)))
    points = (grid * sides) @ rotation.T + [0.1, 0.2, 0.3]
    assert np.all(np.any([contains(capsule, points) for capsule in capsules], axis=0))
    assert max(capsule.radius for capsule in capsules) <= 0.5 * np.linalg.norm(sides) + 1e-9


def test_points_are_inside_their_capsule_and_a_long_cloud_gets_a_slim_one():
    generator = np.random.default_rng(1)
    points = generator.uniform(-0.5, 0.5, (400, 3)) * [2.0, 0.2, 0.2]
    capsule = enclosing_capsule(0, points)
    assert np.all(contains(capsule, points))
    assert capsule.radius < 0.2
    single = enclosing_capsule(0, np.array([[1.0, 2.0, 3.0]]))
    assert np.allclose(single.start, [1, 2, 3])
    assert single.radius == 0.0


def write_stl(path, triangles):
    path.parent.mkdir(parents=True, exist_ok=True)
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *np.ravel(triangle), 0) for triangle in triangles)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + body)


@pytest.mark.parametrize("kind", ["package above", "package path", "relative", "absolute"])
def test_a_mesh_that_is_found_is_enclosed(tmp_path, monkeypatch, kind):
    corners = np.array([[0, 0, 0], [600, 0, 0], [0, 80, 0], [0, 0, 80]], dtype=float)
    triangles = [corners[list(chosen)] for chosen in itertools.combinations(range(4), 3)]
    place = {"package path": tmp_path / "elsewhere" / "my_arm"}.get(kind, tmp_path / "my_arm") / "meshes" / "fore.stl"
    write_stl(place, triangles)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "elsewhere") if kind == "package path" else "")
    name = {"relative": "../meshes/fore.stl", "absolute": f"file://{place}"}.get(
        kind, "package://my_arm/meshes/fore.stl"
    )
    folder = tmp_path / "my_arm" / "urdf"
    folder.mkdir(parents=True)
    xml = URDF.format(fore=f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>')
    geometry = geometry_of(URDF_ROBOT, urdf_text=xml, folder=folder)
    assert "j2" in geometry.from_shapes
    (capsule,) = of_link(geometry, 1)
    assert np.all(contains(capsule, 0.001 * corners))
    assert capsule.radius < 0.1


@each(
    "shape",
    [
        '<mesh filename="package://nowhere/fore.stl"/>',
        '<mesh filename="nowhere.stl"/>',
        "<mesh/>",
        '<box size="0.1 0.1"/>',
        '<box size="0.1 0.1 -0.1"/>',
        '<sphere radius="nan"/>',
        '<sphere radius="thick"/>',
        "<blob/>",
        "",
    ],
)
def test_a_shape_that_cannot_be_used_leaves_the_tube(shape, monkeypatch):
    # Pinocchio refuses such a URDF in part; here only the reading of the shape is looked at.
    from ident.model.kinematics import urdf_shapes

    good = URDF.format(fore='<sphere radius="0.1"/>')
    robot_file = parse_robot(URDF_ROBOT, where="arm", folder=None, urdf_text=good)
    model = build_model(robot_file)
    pin_model = urdf_shapes.urdf_model(good, ("j1", "j2"), {}, "two")
    monkeypatch.setattr(urdf_shapes, "urdf_model", lambda *_: pin_model)
    broken = robot_file.model_copy(update={"urdf_text": URDF.format(fore=shape)})
    geometry = arm_geometry(broken, model)
    assert geometry.from_shapes == ("base", "j1")
    (ball,) = of_link(geometry, 1)
    assert np.array_equal(ball.start, ball.end)
    assert ball.radius == 0.05


def test_a_file_that_is_no_mesh_leaves_the_tube(tmp_path):
    (tmp_path / "fore.stl").write_bytes(b"not a mesh")
    xml = URDF.format(fore='<mesh filename="fore.stl"/>')
    assert "j2" not in geometry_of(URDF_ROBOT, urdf_text=xml, folder=tmp_path).from_shapes


def test_a_tool_is_added_to_the_shapes_of_the_last_link():
    text = URDF_ROBOT + "workspace: {tool: [0.3, 0, 0]}\n"
    geometry = geometry_of(text, urdf_text=URDF.format(fore='<sphere radius="0.1"/>'))
    _, tool = of_link(geometry, 1)
    assert np.allclose(tool.end, [0.3, 0, 0])
