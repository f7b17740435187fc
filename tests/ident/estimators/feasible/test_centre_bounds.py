"""Bounds of a link's centre of mass: boxes, points, shapes of a URDF."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import RobotFileError
from ident.checks.robot_check import check_robot
from ident.estimators.feasible.centre_bounds import HULL_TOLERANCE, centre_bounds, half_spaces
from ident.estimators.feasible.consistent import consistent_parameters
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.regressor import regressor
from ident.regression.estimate import Estimate

URDF = """<robot name="two">
  <link name="ground"/>
  <joint name="j1" type="revolute"><parent link="ground"/><child link="upper"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="100" velocity="3"/></joint>
  <link name="upper"><collision><origin xyz="0.2 0 0" rpy="0 1.5707963267948966 0"/>
    <geometry><cylinder radius="0.04" length="0.3"/></geometry></collision></link>
  <joint name="j2" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="100" velocity="3"/></joint>
  <link name="fore"><visual><origin xyz="0 0 0.1"/><geometry>{shape}</geometry></visual></link>
  <joint name="stuck" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0 0 0.3"/></joint>
  <link name="tip"><visual><geometry><sphere radius="0.05"/></geometry></visual></link>
</robot>"""

ROBOT = """
name: two
model: {{urdf: two.urdf, mounting: free}}
joints:
  - {{name: j1, position: [-3, 3], velocity: 3, torque: 100}}
  - {{name: j2, position: [-3, 3], velocity: 3, torque: 100}}
prior: {{links: {{j2: {{{prior}}}}}}}
"""

CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4)]
FACES += [(1, 5, 7), (1, 7, 3)]


def robot(prior: str = "com_hull: urdf", shape: str = '<box size="0.1 0.1 0.2"/>', folder=None) -> RobotFile:
    text = ROBOT.format(prior=prior)
    return parse_robot(text, where="two", folder=folder, urdf_text=URDF.format(shape=shape))


def bounds_of(file: RobotFile):
    return list(centre_bounds(build_model(file), file))


def inside(bound, points) -> np.ndarray:
    return np.all(np.atleast_2d(points) @ bound.normals.T <= bound.offsets + 1e-9, axis=1)


def cloud(kind: str) -> np.ndarray:
    generator = np.random.default_rng(0)
    if kind == "box":
        return generator.uniform(-1, 1, (2000, 3)) * [1.0, 0.5, 0.01]
    ball = generator.standard_normal((2000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    return ball * [0.1, 0.1, 1.0] if kind == "rod" else ball


@pytest.mark.parametrize("kind", ["box", "rod", "ball"])
def test_a_hull_is_enclosed_closely(kind):
    """Every point is inside, and along random directions the half-spaces reach little farther than the points."""
    from scipy.optimize import linprog

    points = cloud(kind)
    normals, offsets = half_spaces(points, "here")
    assert len(offsets) <= 40
    assert np.all(points @ normals.T <= offsets + 1e-12)
    extent = np.linalg.norm(np.ptp(points, axis=0))
    for direction in np.random.default_rng(1).standard_normal((10, 3)):
        direction /= np.linalg.norm(direction)
        reach = -linprog(-direction, A_ub=normals, b_ub=offsets, bounds=[(None, None)] * 3).fun
        assert reach <= np.max(points @ direction) + 4 * HULL_TOLERANCE * extent


def test_points_in_a_plane_enclose_nothing():
    with pytest.raises(RobotFileError, match="lie in a plane"):
        half_spaces(np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float), "here")
    with pytest.raises(RobotFileError, match="lie in a plane"):
        half_spaces(np.ones((5, 3)), "here")


@each(
    ("shape", "within", "without"),
    [
        ('<box size="0.1 0.1 0.2"/>', (0.049, 0.049, 0.199), (0.08, 0.0, 0.1)),
        ('<cylinder radius="0.05" length="0.2"/>', (0.049, 0.0, 0.001), (0.045, 0.045, 0.1)),
        ('<sphere radius="0.1"/>', (0.0, 0.099, 0.1), (0.09, 0.09, 0.1)),
        ('<capsule radius="0.05" length="0.1"/>', (0.0, 0.0, 0.001), (0.0, 0.08, 0.1)),
    ],
)
def test_shapes_fixed_to_a_link_count_as_its_own(shape, within, without):
    (bound,) = bounds_of(robot(shape=shape))
    assert bound.name == "prior.links.j2.com_hull"
    assert bound.link == 1
    assert inside(bound, within)
    assert inside(bound, (0.0, 0.0, 0.34))  # in the ball at the tip
    assert not inside(bound, without)
    assert not inside(bound, (0.0, 0.0, 0.37))


@pytest.mark.parametrize("format", ["stl", "ascii stl", "obj", "dae"])
def test_meshes_of_every_format(format, tmp_path):
    corners = np.array(CUBE, dtype=float) * 100
    triangles = [[corners[i] for i in face] for face in FACES]
    if format == "stl":
        import struct

        body = b"".join(struct.pack("<12fH", 0, 0, 1, *np.ravel(one), 0) for one in triangles)
        content = b"\0" * 80 + struct.pack("<I", len(triangles)) + body
    elif format == "ascii stl":
        lines = ["solid fore"]
        for one in triangles:
            vertices = "\n".join("vertex {} {} {}".format(*corner) for corner in one)
            lines.append(f"facet normal 0 0 1\nouter loop\n{vertices}\nendloop\nendfacet")
        content = "\n".join([*lines, "endsolid fore\n"]).encode()
    elif format == "obj":
        rows = ["v {} {} {}".format(*corner) for corner in corners]
        rows += ["f {} {} {}".format(*(i + 1 for i in face)) for face in FACES]
        content = ("\n".join(rows) + "\n").encode()
    else:
        numbers = " ".join(str(value) for value in corners.ravel())
        indices = " ".join(str(i) for face in FACES for i in face)
        content = (
            '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
            '<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>'
            f'<source id="p"><float_array id="a" count="24">{numbers}</float_array><technique_common>'
            '<accessor source="#a" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
            '<param name="Z" type="float"/></accessor></technique_common></source>'
            '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
            f'<triangles count="{len(FACES)}"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p>'
            "</triangles></mesh></geometry></library_geometries><library_visual_scenes>"
            '<visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>'
            '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
        ).encode()
    name = f"fore.{format.split()[-1]}"
    (tmp_path / name).write_bytes(content)
    file = robot(shape=f'<mesh filename="{name}" scale="0.001 0.001 0.001"/>', folder=tmp_path)
    (bound,) = bounds_of(file)
    assert inside(bound, 1e-3 * corners + (0, 0, 0.1)).all()
    assert not inside(bound, (0.11, 0.05, 0.1))


def test_what_cannot_be_used_is_refused(tmp_path):
    mesh = '<mesh filename="package://nowhere/fore.stl"/>'
    with pytest.raises(RobotFileError, match="no such file: package:") as refused:
        bounds_of(robot(shape=mesh))
    assert "ROS_PACKAGE_PATH" in refused.value.hint
    (tmp_path / "fore.stl").write_bytes(b"not a mesh")
    with pytest.raises(RobotFileError, match="not a mesh"):
        bounds_of(robot(shape='<mesh filename="fore.stl"/>', folder=tmp_path))
    bare = robot().model_copy(update={"urdf_text": URDF.replace("visual", "nothing").format(shape="<x/>")})
    with pytest.raises(RobotFileError, match="no shape of this link"):
        bounds_of(bare)


@each(
    ("prior", "message"),
    [
        ("com_hull: mesh", "write 'urdf', or a list of points"),
        ("com_hull: [[0, 0, 0], [1, 0, 0], [0, 1, 0]]", "3 points enclose no volume"),
        ("com_hull: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0]]", "com_hull"),
        ("com_hull: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, .nan]]", "com_hull"),
    ],
)
def test_no_hull_in_the_file(prior, message):
    with pytest.raises(RobotFileError) as refused:
        robot(prior)
    assert message in str(refused.value)


def test_urdf_without_one_is_refused(three_joint):
    known = three_joint.text + "prior: {links: {j2: {com_hull: urdf}}}\n"
    file = parse_robot(known, where="three_joint", folder=None)
    with pytest.raises(RobotFileError, match="'urdf', but the model is none"):
        bounds_of(file)


def test_the_centre_of_mass_stays_within_the_hull():
    """Data of a body whose centre lies outside: the bound holds, and is named."""
    file, free = robot(), robot("com_box: [[-1, -1, -1], [1, 1, 1]]")
    model = build_model(file)
    base = base_parameters(model)
    truth = np.zeros(len(model.parameters))
    truth[10:20] = [1.0, 0, 0, 1.0, 0, 1.0, 0.6, 0.1, 0.2, 2.0]  # centre at 0.3, 0.05, 0.1
    truth[:10] = [0.1, 0, 0, 0.1, 0, 0.1, 0.4, 0, 0, 3.0]
    rows = np.concatenate([joint.T for joint in regressor(model, *random_states(model, 200, seed=1), base.columns)])
    values = base.projection @ truth
    root = np.linalg.qr(100 * rows, mode="r")
    estimate = Estimate(
        tuple(range(base.count)), values, root, np.linalg.inv(root.T @ root), np.zeros((base.count, 0)), 20
    )
    held = consistent_parameters(model, base, estimate, file)
    loose = consistent_parameters(model, base, estimate, free)
    (bound,) = bounds_of(file)
    centre, outside = (one.values[16:19] / one.values[19] for one in (held, loose))
    assert inside(bound, centre)
    assert not inside(bound, outside)
    assert held.limits_hit == ("prior.links.j2.com_hull",)
    assert held.misfit > loose.misfit


def test_check_reads_the_shapes():
    found = check_robot(robot(shape='<mesh filename="nowhere.stl"/>'))
    assert any("no such file: nowhere.stl" in problem.message for problem in found.problems)
    large = check_robot(robot("com_hull: [[0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 300]]"))
    assert any("300 m long: are its points in mm" in warning for warning in large.warnings)
    assert not any("com_hull" in warning for warning in check_robot(robot()).warnings)
