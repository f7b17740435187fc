"""URDF arms: same torque as Pinocchio's own reading, locked joints, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import parse_robot
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.regressor import regressor

URDF = """<robot name="two_fingers">
  <link name="base"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="column"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.5" effort="100" velocity="1"/></joint>
  <link name="column"><inertial><mass value="3"/><origin xyz="0.1 0 0.2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.05" ixy="0.01" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/column.stl"/></geometry></visual>
    <collision><geometry><mesh filename="package://nowhere/column.stl"/></geometry></collision></link>
  <joint name="turn" type="continuous"><parent link="column"/><child link="arm"/>
    <origin xyz="0 0.1 0.3" rpy="1.5708 0 0"/><axis xyz="0 1 0"/><limit effort="50" velocity="2"/></joint>
  <link name="arm"><inertial><mass value="2"/><origin xyz="0.2 0 0"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="finger" type="prismatic"><parent link="arm"/><child link="tip"/><origin xyz="0.4 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="10" velocity="0.1"/></joint>
  <link name="tip"><inertial><mass value="0.5"/><origin xyz="0.02 0 0"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""

ROBOT = """
name: two_fingers
model: {{urdf: arm.urdf, locked: {locked}}}
joints:
  - {{name: lift, position: [0, 0.5], velocity: 1}}
  - {{name: turn, position: [-3, 3], velocity: 2}}
{more}
"""


def robot(locked: str = "{finger: 0.02}", more: str = "", xml: str = URDF):
    return parse_robot(ROBOT.format(locked=locked, more=more), where="two.yaml", folder=None, urdf_text=xml)


def test_locked_finger_gives_pinocchio_torque():
    import pinocchio as pin

    model = build_model(robot(xml=URDF.replace("1.5708", "1.5707963267948966")))
    full = pin.buildModelFromXML(URDF.replace("1.5708", "1.5707963267948966"))
    reference = pin.buildReducedModel(full, [full.getJointId("finger")], np.array([0.0, 1.0, 0.0, 0.02]))
    inertial = np.concatenate([reference.inertias[i].toDynamicParameters() for i in (1, 2)])
    order = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]  # from Pinocchio's M MX MY MZ XX XY YY XZ YZ ZZ to ours
    ours = np.concatenate([inertial[10 * link : 10 * link + 10][order] for link in (0, 1)])
    generator = np.random.default_rng(0)
    q, dq, ddq = (generator.uniform(-1, 1, (2, 600)) for _ in range(3))
    columns = [i for i, p in enumerate(model.parameters) if p.kind == "inertial"]
    torque = np.einsum("npN,p->nN", regressor(model, q, dq, ddq, columns), ours)
    data = reference.createData()
    for sample in range(0, 600, 100):
        angles = np.array([q[0, sample], np.cos(q[1, sample]), np.sin(q[1, sample])])
        expected = pin.rnea(reference, data, angles, dq[:, sample], ddq[:, sample])
        assert np.allclose(torque[:, sample], expected, atol=1e-10)


def test_a_rounded_right_angle_adds_no_base_parameters():
    from ident.model.base_parameters import base_parameters

    exact = base_parameters(build_model(robot(xml=URDF.replace("1.5708", "1.5707963267948966"))))
    rounded = base_parameters(build_model(robot()))
    assert rounded.names == exact.names
    assert rounded.margin > 1e6


@each(
    ("locked", "more", "xml", "words"),
    [
        ("{}", "", URDF, ["does not name: finger", "locked: {finger: 0}"]),
        ("{fingr: 0}", "", URDF, ["'fingr' is not a movable joint", "did you mean 'finger'"]),
        ("{turn: 0, finger: 0}", "", URDF, ["'turn' is both locked and listed"]),
        (
            "{finger: 0}",
            "  - {name: elbow, position: [0, 1], velocity: 1}",
            URDF,
            ["'elbow'", "not a movable joint of the URDF"],
        ),
        ("{}", "", "<robot", ["not a URDF"]),
        ("{}", "", "", ["not a URDF"]),
        ("{finger: 0}", "", URDF.replace('type="continuous"', 'type="floating"'), ["degrees of freedom"]),
    ],
)
def test_bad_urdf_robots_are_refused(locked, more, xml, words):
    with pytest.raises(RobotFileError) as caught:
        build_model(robot(locked, more, xml))
    for word in words:
        assert word in str(caught.value)


def test_order_must_follow_the_tree():
    text = """
name: two_fingers
model: {urdf: arm.urdf, locked: {finger: 0}}
joints:
  - {name: turn, position: [-3, 3], velocity: 2}
  - {name: lift, position: [0, 0.5], velocity: 1}
"""
    with pytest.raises(RobotFileError, match="'turn' is listed before its parent 'lift'"):
        build_model(parse_robot(text, where="two.yaml", folder=None, urdf_text=URDF))
