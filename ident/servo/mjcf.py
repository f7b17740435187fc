"""A servo arm as MJCF with position actuators, and its replay on recorded commands in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.export.arm import ExportedArm
from ident.export.mjcf import TIME_STEP, mjcf
from ident.export.mujoco_reading import loaded
from ident.export.xml_text import comment_text, number, numbers
from ident.friction.terms import NO_TERMS
from ident.model.base_parameters import base_parameters
from ident.model.inverse_dynamics import InverseDynamics
from ident.servo.actuator_law import (
    ServoReplay,
    actuator_law,
    left_out,
    replay_of,
    shaped_commands,
    some_motions,
)
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion
from ident.servo.terms import INDEX, TERMS

MISSING = ("acceleration_limit", "load_friction", "breakaway", "load_breakaway", "dead_band")
"""Terms that an MJCF has no place for; friction that follows the load stands in it as that of the mean load."""


def servo_mjcf(robot_file: RobotFile, links: ServoLinks, values: FloatArray) -> str:
    """The text of an MJCF: bodies of the robot file, joints and position actuators as identified.

    Args:
        robot_file: shapes and limits.
        links: bodies.
        values: (n, terms) parameters.

    Raises:
        ModelError: the arm has loops or coupled motors.
    """
    model = links.model
    if not model.transmission.direct:
        raise ModelError("closed loops and coupled motors are not exported as servos", where=model.name)
    count = model.dof
    plain = replace(
        model,
        motor_inertia=(True,) * count,
        viscous=(True,) * count,
        coulomb=(True,) * count,
        offset=(False,) * count,
        terms=NO_TERMS,
    )
    law = actuator_law(values, links, 0.0)
    kinds = {"motor_inertia": law.armature, "viscous": law.damping + law.viscous, "coulomb": law.dynamic}
    own = {(kind, model.active[joint]): float(kinds[kind][joint]) for kind in kinds for joint in range(count)}
    standard = np.concatenate(
        [
            links.inertial,
            [own[parameter.kind, parameter.joint] for parameter in plain.parameters[len(links.inertial) :]],
        ]
    )
    base = base_parameters(plain)
    dynamics = InverseDynamics(plain, base, base.projection @ standard, standard)
    root = ElementTree.fromstring(mjcf(ExportedArm(robot_file, plain, standard, dynamics)))
    lines = [
        f"Servo model of {model.name}, identified with dynid; ctrl is the commanded position.",
        "Not in this file:",
        *(f"- {word}" for word in left_out(values, MISSING) or ("nothing",)),
        "A delay needs a MuJoCo whose actuators have one.",
    ]
    root.insert(0, ElementTree.Comment("\n" + comment_text(lines)))
    actuators = root.find("actuator")
    assert actuators is not None
    for actuator in list(actuators):
        actuators.remove(actuator)
    for joint, name in enumerate(model.joint_names):
        element = next(found for found in root.iter("joint") if found.get("name") == name)
        zero = values[joint, INDEX["zero"]]
        if zero:
            # The file's pose is that of a joint at `ref`.
            element.set("ref", number(-zero))
        ElementTree.SubElement(actuators, "general", _actuator(name, values[joint], model.limits[joint].position))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _actuator(name: str, values: FloatArray, limits: tuple[float, float]) -> dict[str, str]:
    stiffness, bias, delay, limit = (
        float(values[INDEX[term]]) for term in ("stiffness", "bias", "delay", "torque_limit")
    )
    attributes = {
        "name": name,
        "joint": name,
        "gainprm": number(stiffness),
        "biastype": "affine",
        "biasprm": numbers((-stiffness * bias, -stiffness, 0.0)),
        "ctrlrange": numbers(limits),
    }
    if limit < TERMS[INDEX["torque_limit"]].absent:
        attributes["forcerange"] = numbers((-limit, limit))
    if delay > TIME_STEP:
        attributes |= {"delay": number(delay), "nsample": str(int(np.ceil(delay / TIME_STEP)) + 1)}
    return attributes


def replay(
    text: str, links: ServoLinks, values: FloatArray, motions: Sequence[ServoMotion], model_paths: Sequence[FloatArray]
) -> ServoReplay:
    """Roll an MJCF's text out on recorded commands in MuJoCo.

    Raises:
        ModelError: MuJoCo cannot read it.
    """
    import mujoco

    model = loaded(text, links.model.name)
    chosen = some_motions(motions)
    raw = [_replayed(model, links, motion, motion.command[motion.history :], values) for motion in chosen]
    shaped = [
        _replayed(model, links, motion, shaped_commands(links, motion, values)[motion.history :], values)
        for motion in chosen
    ]
    own = model_paths[: len(chosen)]
    program = f"MuJoCo {mujoco.__version__}"
    return replay_of("MJCF", program, chosen, (raw, shaped, own), left_out(values, MISSING))


def _replayed(
    model: object, links: ServoLinks, motion: ServoMotion, command: FloatArray, values: FloatArray
) -> FloatArray:
    """Positions (N, n) at the motion's samples."""
    import mujoco

    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in links.model.joint_names]  # type: ignore[attr-defined]
    order = [int(joint.qposadr[0]) for joint in joints]
    actuators = [int(model.actuator(name).id) for name in links.model.joint_names]  # type: ignore[attr-defined]
    data.qpos[order] = motion.position[0]
    step = float(model.opt.timestep)  # type: ignore[attr-defined]
    count = int(np.ceil(motion.time[-1] / step)) + 1
    times = np.arange(count) * step
    grid = np.arange(len(command)) * motion.step
    controls = np.stack([np.interp(times, grid, column) for column in command.T], axis=1)
    path = np.empty((count, len(order)))
    data.ctrl[actuators] = controls[0]
    mujoco.mj_forward(model, data)
    for index in range(count):
        path[index] = data.qpos[order]
        data.ctrl[actuators] = controls[index]
        mujoco.mj_step(model, data)
    return np.stack([np.interp(motion.time, times, column) for column in path.T], axis=1)
