"""MJCFs in MuJoCo: motor torques, constrained accelerations, energy, and simulations that fail when they should."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from each import each
from exported_arms import exported_arm, random_parameters
from loop_arms import FOUR_BAR, SPHERICAL, four_bar_arm, spatial_arm, spherical_arm

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import ModelError
from ident.export import mujoco_reading
from ident.export.arm import ExportedArm
from ident.export.mjcf import mjcf
from ident.export.reading import check_same_torque, random_states, simulation_checks
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector

mujoco = pytest.importorskip("mujoco")

COUPLED = """\
name: coupled
model:
  mdh:
    - {joint: a, alpha: 0.3, d: 0.1, r: 0.2}
    - {joint: b, antecedent: a, alpha: pi/2, d: 0.3, r: 0}
    - {joint: c, antecedent: b, type: prismatic, alpha: 0.2, d: 0.1, r: 0.1}
    - {joint: d, antecedent: a, alpha: 1.1, d: 0.2, r: 0.1}
  coupling: {b: {b: -1.5}, c: {c: 1, b: 0.4}, d: {d: 2, a: -1}}
  gravity: [3, 0, -9]
joints:
  - {name: a, position: [-2, 2], velocity: 2, torque: 90}
  - {name: b, position: [0.2, 2], velocity: 2, torque: 90}
  - {name: c, position: [-0.3, 0.3], velocity: 1}
  - {name: d, position: [-2, -1], velocity: 2, torque: 50}
drives:
  - {joint: c, pair_inertia: true}
  - {joint: d, inertia: false}
friction: {joints: {a: {offset: false}}}
"""
COUPLED_LOOP = FOUR_BAR.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1)
TEXTS = {
    "coupled": COUPLED,
    "coupled_loop": COUPLED_LOOP,
    # Opened in the point where all axes meet: meeting there closes nothing, the axes have to be held.
    "spherical_centre": SPHERICAL.replace("d: 0, r: 0.3}", "d: 0, r: 0}"),
}
ARMS = ("ur5e", "panda", "sr400", "four_bar", "spatial", "spherical", "spherical_centre", "coupled")


@functools.cache
def robot(name: str) -> RobotFile:
    if name in TEXTS:
        return parse_robot(TEXTS[name], where=name, folder=None)
    arms = {"four_bar": four_bar_arm, "spatial": spatial_arm, "spherical": spherical_arm}
    return arms[name]() if name in arms else load_robot(name)


@functools.cache
def arm_of(name: str) -> ExportedArm:
    robot_file = robot(name)
    return exported_arm(robot_file, truth_vector(robot_file) if robot_file.robot.truth.links else None)


def model_of(arm: ExportedArm) -> Any:
    return mujoco_reading.loaded(mjcf(arm), "test")


def smooth(name: str) -> ExportedArm:
    """The arm without friction and offsets."""
    model = build_model(robot(name))
    values = arm_of(name).values.copy()
    for index, parameter in enumerate(model.parameters):
        if parameter.kind in ("viscous", "coulomb", "offset") or parameter.symbol in ("Fv", "Fs"):
            values[index] = 0.0
    return exported_arm(robot(name), values)


@pytest.mark.parametrize("name", ARMS)
def test_motor_torques_are_those_of_the_model(name):
    arm = arm_of(name)
    assert mujoco_reading.torque_error(arm, model_of(arm), 1000 if name in ("ur5e", "sr400") else 100) < 1e-9


@pytest.mark.parametrize("field", ["dof_armature", "dof_damping", "dof_frictionloss", "actuator_biasprm", "body_mass"])
def test_every_part_of_the_file_is_seen_in_the_torques(field):
    arm, model = arm_of("ur5e"), model_of(arm_of("ur5e"))
    values = getattr(model, field)
    assert np.any(values)
    values *= 1.1
    if field == "actuator_biasprm" and not np.any(arm.motors.offset):
        pytest.skip("no offsets")
    assert mujoco_reading.torque_error(arm, model, 20) > 1e-6


@each("name", ["sr400", "four_bar", "spatial", "spherical", "spherical_centre"])
def test_loops_close_where_the_model_closes_them_and_the_second_point_only_where_it_is_needed(name):
    arm = arm_of(name)
    model = model_of(arm)
    data = mujoco.MjData(model)
    order = [int(model.jnt_qposadr[model.joint(joint).id]) for joint in arm.model.link_names]
    for position in arm.model.tree_position(random_states(arm, 20)[0]).T:
        data.qpos[order] = position
        mujoco.mj_forward(model, data)
        assert data.ne
        assert np.abs(data.efc_pos[: data.ne]).max() < 1e-9
    connects = int(np.sum(model.eq_type == mujoco.mjtEq.mjEQ_CONNECT))
    assert connects == {"sr400": 0, "four_bar": 1, "spatial": 1, "spherical": 1, "spherical_centre": 2}[name]


@pytest.mark.parametrize("name", ["ur5e", "sr400", "four_bar", "spherical_centre", "coupled"])
def test_accelerations_are_those_of_the_model(name):
    """Loops are springs in MuJoCo: constrained accelerations agree as far as these are stiff."""
    arm = smooth(name)
    model = model_of(arm)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT) | int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    q, dq, ddq = random_states(arm, 20)
    motors = np.linalg.solve(arm.coupling.T, arm.dynamics.torque(q, dq, ddq))
    motion = arm.model.tree_motion(q, dq, ddq)
    order = [int(model.jnt_dofadr[model.joint(joint).id]) for joint in arm.model.link_names]
    data = mujoco.MjData(model)
    found = np.empty_like(ddq)
    for sample in range(q.shape[1]):
        data.qpos[order], data.qvel[order] = motion.position[:, sample], motion.velocity[:, sample]
        data.ctrl[:] = motors[:, sample]
        mujoco.mj_forward(model, data)
        found[:, sample] = data.qacc[[order[index] for index in arm.model.active]]
    np.testing.assert_allclose(found, ddq, rtol=0, atol=(1e-9 if not arm.closed else 2e-3) * np.abs(ddq).max())


@pytest.mark.parametrize("name", ["ur5e", "sr400", "coupled"])
def test_energy_is_conserved_without_friction(name):
    arm = smooth(name)
    model = model_of(arm)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 1e-3
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = 0.0
    energies = []
    for _ in range(5000):
        mujoco.mj_step(model, data)
        energies.append(np.array(data.energy))
    potential, kinetic = np.array(energies).T
    assert kinetic.max() > 1.0
    assert np.ptp(potential + kinetic) < 1e-5 * kinetic.max()


@pytest.mark.parametrize("name", ARMS)
def test_simulations_of_five_seconds_stay_sane(name):
    reading = mujoco_reading.read_mjcf(arm_of(name), mjcf(arm_of(name)))
    check_same_torque(reading, "arm.xml")
    assert [simulation.motion for simulation in reading.simulations] == ["unpowered", "tracking"]
    assert simulation_checks(reading) == []


def test_a_motor_that_couples_branches_is_refused():
    with pytest.raises(ModelError, match="motor of wrist turns with joints of different branches, crank, wrist"):
        mjcf(arm_of("coupled_loop"))


def test_the_keyframe_holds_the_arm_within_its_limits():
    arm = exported_arm(robot("coupled"), random_parameters(build_model(robot("coupled"))))
    model = model_of(arm)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert np.all(data.qpos >= model.jnt_range[:, 0])
    assert np.all(data.qpos <= model.jnt_range[:, 1])
    assert np.abs(data.qacc).max() < 1e-9


def test_negative_damping_is_found_in_simulation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arm = arm_of("ur5e")
    text = mjcf(arm)
    for damping in sorted({f'damping="{value!r}"' for value in arm.at_joints.viscous.tolist()}, key=len, reverse=True):
        text = text.replace(damping, 'damping="-40"')
    found = {check.name for check in simulation_checks(mujoco_reading.read_mjcf(arm, text))}
    assert found & {"export-diverges", "export-gains-energy"}
    assert list(tmp_path.iterdir()) == []
