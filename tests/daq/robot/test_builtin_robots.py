"""The robot files that ship with dynid: complete, sourced, and physically possible."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from each import each

from daq.robot.loader import RobotFile, builtin_robots, load_robot, parse_robot
from daq.robot.schema import TruthLink
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.true_parameters import truth_vector

UR_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
JOINTS = {
    **dict.fromkeys(("ur3e", "ur5e", "ur10", "ur10e", "ur16e", "ur20"), UR_JOINTS),
    "panda": tuple(f"panda_joint{number}" for number in range(1, 8)),
    "aubo_i5": ("shoulder_joint", "upperArm_joint", "foreArm_joint", "wrist1_joint", "wrist2_joint", "wrist3_joint"),
    "rocr6": tuple(f"joint{number}" for number in range(1, 7)),
    "up6": ("S", "L", "U"),
}
# Mass of the moving links, and of the whole arm on the maker's data sheet [kg].
MOVING_MASS = {
    "ur3e": (8.7985, 11.2),
    "ur5e": (17.7, 20.6),
    "ur10": (28.435, 28.9),
    "ur10e": (29.104, 33.5),
    "ur16e": (27.26, 33.1),
    "ur20": (60.96, 64.0),
    "aubo_i5": (21.988, 24.0),
}


@pytest.fixture(params=sorted(JOINTS))
def builtin(request: pytest.FixtureRequest) -> RobotFile:
    return load_robot(request.param)


def test_the_list_of_built_in_robots_is_complete() -> None:
    assert set(JOINTS) <= set(builtin_robots())


@each("name", builtin_robots())
def test_every_built_in_robot_loads_under_its_own_name_without_a_folder(name: str) -> None:
    robot_file = load_robot(name)
    assert robot_file.robot.name == name
    assert robot_file.robot.description
    assert robot_file.folder is None


def test_joints_bear_the_maker_s_names(builtin: RobotFile) -> None:
    assert builtin.robot.joint_names == JOINTS[builtin.robot.name]
    assert builtin.robot.dof == len(JOINTS[builtin.robot.name])
    assert tuple(drive.joint for drive in builtin.robot.drives) == builtin.robot.joint_names


def test_every_section_says_where_its_numbers_come_from(builtin: RobotFile) -> None:
    optional = {"workspace"} if "workspace" in builtin.robot.model_fields_set else set()
    assert set(builtin.robot.sources) == {"model", "joints", "drives", "truth"} | optional
    for section, source in builtin.robot.sources.items():
        assert len(source) > 40, f"{section}: {source!r} names no source"


def test_every_link_of_the_truth_is_a_possible_rigid_body(builtin: RobotFile) -> None:
    truth = builtin.robot.truth
    assert tuple(truth.links) == builtin.robot.joint_names
    for name, link in truth.links.items():
        moments = np.linalg.eigvalsh(inertia_matrix(link))
        assert moments[0] > 0, name
        # Triangle inequality: no axis may have more inertia than the other two together.
        assert moments[2] <= moments[0] + moments[1], name
        assert np.linalg.norm(link.com) < 1, f"{name}: centre of mass farther than 1 m from its joint"


def test_truth_is_complete_for_every_column_of_the_model(builtin: RobotFile) -> None:
    robot = builtin.robot
    vector = dict(zip((p.name for p in build_model(builtin).parameters), truth_vector(builtin), strict=True))
    for number, name in enumerate(robot.joint_names, start=1):
        joint = robot.truth.joints[name]
        assert joint.viscous > 0, name
        assert joint.coulomb > 0, name
        # A joint has motor inertia exactly where the measured torque carries it.
        assert (joint.motor_inertia > 0) == robot.drive(name).inertia, name
        assert (f"Ia{number}" in vector) == robot.drive(name).inertia, name
        assert (joint.offset != 0) == robot.friction.offset, name


@each("name", sorted(set(JOINTS) - {"up6"}))  # UP6's paper simulates without noise
def test_noise_of_the_simulated_sensors_is_of_a_real_size(name: str) -> None:
    robot = load_robot(name).robot
    noise = robot.truth.noise
    assert noise.rate == {"ur10": 125, "aubo_i5": 200, "panda": 1000, "rocr6": 1000}.get(name, 500)
    bits = math.log2(2 * math.pi / noise.encoder_resolution)
    assert 18.9 < bits < 20.1
    assert tuple(noise.torque_std) == tuple(noise.ripple_amplitude) == robot.joint_names
    for joint in robot.joints:
        if joint.torque is not None:
            assert 0.002 <= noise.torque_std[joint.name] / joint.torque <= 0.01, joint.name
            assert 0.0025 <= noise.ripple_amplitude[joint.name] / joint.torque <= 0.005, joint.name


@each("name", sorted(MOVING_MASS))
def test_moving_masses_are_the_maker_s_and_leave_some_for_the_base(name: str) -> None:
    moving, whole = MOVING_MASS[name]
    links = load_robot(name).robot.truth.links.values()
    assert sum(link.mass for link in links) == pytest.approx(moving, abs=1e-3)
    assert moving < whole


@each("name", ["ur3e", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "aubo_i5"])
def test_assumed_acceleration_limits_stay_below_the_torque_limits(name: str) -> None:
    """What the files' sources claim: inertial, gravity and Coulomb torque together, in random poses."""
    import pinocchio as pin

    robot_file = load_robot(name)
    robot = robot_file.robot
    arm = pinocchio_model(build_model(robot_file), truth_vector(robot_file)[: 10 * robot.dof])
    data = arm.createData()
    lower, upper = np.array([joint.position for joint in robot.joints]).T
    limit = np.array([joint.torque for joint in robot.joints], dtype=np.float64)
    acceleration = np.array([joint.acceleration for joint in robot.joints])
    joints = [robot.truth.joints[joint] for joint in robot.joint_names]
    coulomb = np.array([joint.coulomb for joint in joints])
    rotor = np.array([joint.motor_inertia for joint in joints])
    generator = np.random.default_rng(1)
    for _ in range(300):
        signs = generator.choice([-1.0, 1.0], robot.dof)
        position = generator.uniform(lower, upper)
        torque = pin.rnea(arm, data, position, np.zeros(robot.dof), signs * acceleration) + rotor * signs * acceleration
        assert np.all(np.abs(torque) + coulomb < limit)


@each(
    ("name", "dh_a", "dh_alpha", "dh_com"),
    [
        (
            "ur5e",
            (0, -0.425, -0.3922, 0, 0, 0),
            (1, 0, 0, 1, -1, 0),
            (
                (0, -0.02561, 0.00193),
                (0.2125, 0, 0.11336),
                (0.15, 0, 0.0265),
                (0, -0.0018, 0.01634),
                (0, 0.0018, 0.01634),
                (0, 0, -0.001159),
            ),
        ),
        (
            "ur10",
            (0, -0.612, -0.5723, 0, 0, 0),
            (1, 0, 0, 1, -1, 0),
            (
                (0.021, 0, 0.027),
                (0.38, 0, 0.158),
                (0.24, 0, 0.068),
                (0, 0.007, 0.018),
                (0, 0.007, 0.018),
                (0, 0, -0.026),
            ),
        ),
        (
            "ur3e",
            (0, -0.24355, -0.2132, 0, 0, 0),
            (1, 0, 0, 1, -1, 0),
            ((0, -0.02, 0), (0.13, 0, 0.1157), (0.05, 0, 0.0238), (0, 0, 0.01), (0, 0, 0.01), (0, 0, -0.02)),
        ),
    ],
)
def test_centres_of_mass_agree_with_the_maker_s_dh_frames(
    name: str, dh_a: tuple[float, ...], dh_alpha: tuple[int, ...], dh_com: tuple[tuple[float, float, float], ...]
) -> None:
    """The maker's DH table and centres of mass give the same points in space as our frames (alpha in quarter turns)."""
    import pinocchio as pin

    robot_file = load_robot(name)
    robot = robot_file.robot
    arm = pinocchio_model(build_model(robot_file))
    data = arm.createData()
    rows = robot.model.mdh
    assert rows is not None
    generator = np.random.default_rng(2)
    for _ in range(5):
        position = generator.uniform(-np.pi, np.pi, robot.dof)
        pin.forwardKinematics(arm, data, position)
        frame = pin.SE3.Identity()
        for number, row in enumerate(rows):
            turn = pin.SE3(pin.utils.rotate("z", position[number]), np.array([0, 0, row.r]))
            tilt = pin.SE3(pin.utils.rotate("x", dh_alpha[number] * np.pi / 2), np.array([dh_a[number], 0, 0]))
            frame = frame * turn * tilt
            ours = data.oMi[number + 1].act(np.array(robot.truth.links[row.joint].com))
            np.testing.assert_allclose(ours, frame.act(np.array(dh_com[number], dtype=np.float64)), atol=1e-7)


def test_aubo_frames_are_those_of_its_maker_s_urdf() -> None:
    """Joint origins of AuboRobot/aubo_description, urdf/aubo_i5.urdf: xyz [m], rpy [rad]."""
    import pinocchio as pin

    half = np.pi / 2
    origins = [
        ((0, 0, 0.122), (0, 0, np.pi)),
        ((0, 0.1215, 0), (-half, -half, 0)),
        ((0.408, 0, 0), (-np.pi, 0, 0)),
        ((0.376, 0, 0), (np.pi, 0, half)),
        ((0, 0.1025, 0), (-half, 0, 0)),
        ((0, -0.094, 0), (half, 0, 0)),
    ]
    for joint, (xyz, rpy) in zip(build_model(load_robot("aubo_i5")).joints, origins, strict=True):
        np.testing.assert_allclose(joint.translation, xyz, atol=1e-12)
        np.testing.assert_allclose(joint.rotation, pin.rpy.rpyToMatrix(*rpy), atol=1e-12)


def test_up6_carries_table_3_of_its_paper() -> None:
    truth = load_robot("up6").robot.truth
    assert [link.mass for link in truth.links.values()] == [60, 35, 35]
    assert [link.inertia[5] for link in truth.links.values()] == [1.2, 0.7, 0.7]
    assert [joint.coulomb for joint in truth.joints.values()] == [15, 5, 12]
    assert [joint.viscous for joint in truth.joints.values()] == [29, 10, 15]


def test_up6_limits_are_the_paper_s_degrees() -> None:
    joints = load_robot("up6").robot.joints
    assert np.rad2deg([joint.position for joint in joints]) == pytest.approx(
        np.array([[-170, 170], [-90, 155], [-170, 190]]), abs=1e-3
    )
    assert np.rad2deg([joint.velocity for joint in joints]) == pytest.approx(np.array([140, 160, 170]), abs=1e-3)


def test_openarm_is_the_public_model_with_its_hand() -> None:
    robot_file = load_robot("openarm")
    names = robot_file.robot.joint_names
    for name, body in zip(names, urdf_inertias(robot_file, names), strict=True):
        link = robot_file.robot.truth.links[name]
        assert body is not None
        np.testing.assert_allclose([body[0], *body[1]], [link.mass, *link.com], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(body[2], inertia_matrix(link), rtol=1e-7, atol=1e-11)
    # joints 1 to 7 of enactic/openarm_mujoco, v1/openarm.xml, and hand and fingers
    masses = [1.14166846, 0.27750927, 1.07386334, 0.63485346, 0.6156588, 0.47520277, 0.46597713]
    total = sum(link.mass for link in robot_file.robot.truth.links.values())
    assert total == pytest.approx(sum(masses) + 0.35 + 2 * 0.03602545, rel=1e-6)


def test_so101_moves_the_links_of_its_urdf() -> None:
    robot_file = load_robot("so101")
    names = robot_file.robot.joint_names
    bodies = dict(zip(names, urdf_inertias(robot_file, names), strict=True))
    assert tuple(robot_file.robot.truth.links) == names
    assert parse_robot(robot_file.text, where="a copy of it", folder=Path("/")).urdf_text == robot_file.urdf_text
    with pytest.raises(RobotFileError, match=r"no built-in URDF is called 'so100\.urdf'"):
        parse_robot(robot_file.text.replace("so101.urdf", "so100.urdf"), where="of another arm", folder=None)
    for name, link in robot_file.robot.truth.links.items():
        mass, centre, inertia = bodies[name] or (0.0, np.zeros(3), np.zeros((3, 3)))
        assert mass == link.mass
        np.testing.assert_allclose(centre, link.com, atol=1e-15)
        np.testing.assert_allclose(inertia, inertia_matrix(link), atol=1e-15)


def test_rocr6_regrouped_first_moments_have_the_size_of_table_2() -> None:
    # MX_jR = MX_j + d_(j+1) times the mass behind joint j+1 (Khalil and Kleinfinger's regrouping).
    links = list(load_robot("rocr6").robot.truth.links.values())
    moment_2 = links[1].mass * links[1].com[0] - 0.257 * sum(link.mass for link in links[2:])
    moment_3 = links[2].mass * links[2].com[0] - 0.215 * sum(link.mass for link in links[3:])
    assert abs(moment_2) == pytest.approx(4.4642, abs=1e-3)
    assert abs(moment_3) == pytest.approx(1.9305, abs=1e-3)


def inertia_matrix(link: TruthLink) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = link.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_a_port_or_folder_of_a_robot_s_name_hides_no_robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("so101")
    (tmp_path / "koch").mkdir()
    assert [load_robot(name).robot.name for name in ("so101", "koch")] == ["so101", "koch"]
