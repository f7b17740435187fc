"""An exported MJCF or URDF read again by MuJoCo, where it is installed, compared and simulated."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any
from xml.etree import ElementTree

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.export.arm import ExportedArm
from ident.export.reading import (
    DURATION,
    STATES,
    ReadBack,
    Simulation,
    energy_gain,
    largest_share,
    random_states,
    released,
    tracked_motion,
    tracking_error,
    tracking_gains,
    tree_torque_error,
)


def mujoco_installed() -> bool:
    """Return whether there is a MuJoCo to read with."""
    return find_spec("mujoco") is not None


def read_mjcf(arm: ExportedArm, text: str) -> ReadBack:
    """Read an MJCF's text, compare the motor torques of the constrained model with the arm's, and simulate it.

    Raises:
        ModelError: MuJoCo cannot read it.
    """
    model = loaded(text, arm.model.name)
    error = torque_error(arm, model, STATES)
    with _without_log_file():
        simulations = _fall(arm, model), _track(arm, model)
    return ReadBack(_name(), error, STATES, simulations)


def torque_error(arm: ExportedArm, model: Any, states: int) -> float:
    """Largest difference of an MJCF's motor torques from the arm's at random states, over the largest torque."""
    q, dq, ddq = random_states(arm, states)
    motors = inverse_dynamics(arm, model, q, dq, ddq)
    expected = np.asarray(np.linalg.solve(arm.coupling.T, arm.dynamics.torque(q, dq, ddq)), dtype=np.float64)
    return largest_share(motors - expected, expected)


def read_urdf(arm: ExportedArm, text: str) -> ReadBack:
    """Read a URDF's text without its meshes, and compare its torques with the model's; what it cannot hold is added.

    Raises:
        ModelError: MuJoCo cannot read it.
    """
    root = ElementTree.fromstring(text)
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    model = loaded(ElementTree.tostring(root, encoding="unicode"), arm.model.name)
    model.opt.gravity[:] = arm.model.gravity
    active = random_states(arm)
    motion = arm.model.tree_motion(*active)
    torque = _bare_inverse(arm, model, motion.position, motion.velocity, motion.acceleration)
    friction = model.dof_frictionloss[_order(arm, model)]
    torque += friction[:, None] * arm.model.coulomb_direction(motion.velocity)
    return ReadBack(_name(), tree_torque_error(arm, torque, active), STATES)


def inverse_dynamics(arm: ExportedArm, model: Any, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Controls (a, N) that an MJCF's model needs for a motion (a, N) of the joints with a motor.

    `mj_inverse` of the tree, friction loss by its sign, minus what closed loops carry: the rows of MuJoCo's equality
    constraints and the directions of the actuators together make up the torque.
    """
    import mujoco

    motion = arm.model.tree_motion(q, dq, ddq)
    order = _order(arm, model)
    torque = np.zeros((model.nv, q.shape[1]))
    torque[order] = _bare_inverse(arm, model, motion.position, motion.velocity, motion.acceleration)
    rates = np.zeros((model.nv, q.shape[1]))
    rates[order] = motion.velocity
    torque += model.dof_frictionloss[:, None] * arm.model.coulomb_direction(rates)
    tendons = _tendon_shares(model)
    torque += tendons.T @ (model.tendon_frictionloss[:, None] * arm.model.coulomb_direction(tendons @ rates))
    pull, bias = _actuators(model)
    controls = np.empty_like(q)
    data = mujoco.MjData(model)
    kept = int(model.opt.disableflags), int(model.opt.jacobian)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags = kept[0] | int(flags.mjDSBL_FRICTIONLOSS) | int(flags.mjDSBL_LIMIT)
    model.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
    for sample in range(q.shape[1]):
        data.qpos[order], data.qvel[:] = motion.position[:, sample], 0.0
        mujoco.mj_forward(model, data)
        # Rows without effect are left out, and what is behind the last row is not cleared.
        carried = np.array(data.efc_J)[: data.nefc * model.nv].reshape(data.nefc, model.nv)
        solved = np.linalg.lstsq(np.vstack([pull, carried]).T, torque[:, sample] - bias, rcond=1e-8)[0]
        controls[:, sample] = solved[: model.nu]
    model.opt.disableflags, model.opt.jacobian = kept
    return controls


def _name() -> str:
    import mujoco

    return f"MuJoCo {mujoco.__version__}"


def loaded(text: str, where: str) -> Any:
    """The `mujoco.MjModel` of an MJCF's or a URDF's text.

    Raises:
        ModelError: MuJoCo cannot read it.
    """
    import mujoco

    try:
        return mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise ModelError(f"MuJoCo does not read the file: {error}", where=where) from error


def _order(arm: ExportedArm, model: Any) -> list[int]:
    """Return where the arm's joints stand among MuJoCo's."""
    return [int(model.jnt_dofadr[model.joint(name).id]) for name in arm.model.link_names]


def _bare_inverse(
    arm: ExportedArm, model: Any, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """`mj_inverse` (n, N) of the tree alone: no constraints, which are friction loss, limits and loops in MuJoCo."""
    import mujoco

    order, data = _order(arm, model), mujoco.MjData(model)
    kept = int(model.opt.disableflags)
    model.opt.disableflags = kept | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    torque = np.empty_like(position)
    for sample in range(position.shape[1]):
        data.qpos[order], data.qvel[order] = position[:, sample], velocity[:, sample]
        data.qacc[order] = acceleration[:, sample]
        mujoco.mj_inverse(model, data)
        torque[:, sample] = data.qfrc_inverse[order]
    model.opt.disableflags = kept
    return torque


def _tendon_shares(model: Any) -> FloatArray:
    """(t, nv) rates of the fixed tendons' lengths by those of the joints."""
    shares = np.zeros((model.ntendon, model.nv))
    for tendon in range(model.ntendon):
        first = int(model.tendon_adr[tendon])
        for wrap in range(first, first + int(model.tendon_num[tendon])):
            shares[tendon, model.jnt_dofadr[model.wrap_objid[wrap]]] = model.wrap_prm[wrap]
    return shares


def _actuators(model: Any) -> tuple[FloatArray, FloatArray]:
    """(u, nv) joint torques of one unit of each control, and (nv,) of none: the same at every position."""
    import mujoco

    data = mujoco.MjData(model)
    kept = int(model.opt.disableflags)
    model.opt.disableflags = kept | int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    mujoco.mj_forward(model, data)
    bias, pull = np.array(data.qfrc_actuator), np.empty((model.nu, model.nv))
    for actuator in range(model.nu):
        data.ctrl[:] = 0.0
        data.ctrl[actuator] = 1.0
        mujoco.mj_forward(model, data)
        pull[actuator] = data.qfrc_actuator - bias
    model.opt.disableflags = kept
    return pull, bias


def _fall(arm: ExportedArm, model: Any) -> Simulation:
    """Unpowered; the controls compensate the offsets, which would do work."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[_order(arm, model)] = arm.model.tree_position(released(arm)[:, None])[:, 0]
    data.ctrl[:] = arm.motors.offset
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    energies = np.empty((round(DURATION / model.opt.timestep), 2))
    for sample in range(len(energies)):
        mujoco.mj_step(model, data)
        energies[sample] = data.energy
    if not _finite(data):
        return Simulation("unpowered", finite=False)
    potential, kinetic = energies.T
    return Simulation("unpowered", finite=True, energy_gain=energy_gain(potential + kinetic, kinetic))


def _track(arm: ExportedArm, model: Any) -> Simulation:
    """Track the motion with the model's torque and a controller, within the control limits."""
    import mujoco

    data, active = mujoco.MjData(model), [_order(arm, model)[index] for index in arm.model.active]
    mujoco.mj_resetDataKeyframe(model, data, 0)
    time = model.opt.timestep * np.arange(round(DURATION / model.opt.timestep))
    q, dq, ddq = tracked_motion(arm, time)
    torque = arm.dynamics.torque(q, dq, ddq)
    friction = arm.at_joints.coulomb + np.abs(arm.coupling.T) @ np.where(arm.coupled, arm.motors.coulomb, 0.0)
    stiffness, damping = tracking_gains(arm.dynamics.inertia(q[:, :1])[0], friction, np.ptp(q, axis=1))
    to_motors = np.linalg.inv(arm.coupling.T)
    positions = np.empty_like(q)
    for sample in range(len(time)):
        positions[:, sample] = data.qpos[active]
        away, slower = q[:, sample] - positions[:, sample], dq[:, sample] - data.qvel[active]
        data.ctrl[:] = to_motors @ (torque[:, sample] + stiffness @ away + damping @ slower)
        mujoco.mj_step(model, data)
    if not _finite(data):
        return Simulation("tracking", finite=False)
    return Simulation("tracking", finite=True, tracking_error=tracking_error(positions, q))


@contextmanager
def _without_log_file() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to a file MUJOCO_LOG.TXT wherever the user is."""
    import mujoco

    kept = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(kept)


def _finite(data: Any) -> bool:
    """Return whether all states were finite so far; MuJoCo starts anew, and counts a warning, where one is not."""
    import mujoco

    bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
    counted = any(data.warning[int(kind)].number for kind in bad)
    return not counted and bool(np.all(np.isfinite(data.qpos)) and np.all(np.isfinite(data.qvel)))
