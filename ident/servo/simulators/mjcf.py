"""A servo arm as MJCF with position actuators, and the replay of MJCFs on recorded commands in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError, UsageError
from ident.export.arm import ExportedArm
from ident.export.mjcf import TIME_STEP, mjcf
from ident.export.mujoco_reading import loaded, mujoco_installed
from ident.export.xml_text import comment_text, number, numbers
from ident.friction.terms import NO_TERMS
from ident.model.base_parameters import base_parameters
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.servo.contact import ServoContact
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion
from ident.servo.simulators.actuator_law import FileFormat, actuator_law
from ident.servo.terms import INDEX, TERMS

MISSING = ("acceleration_limit", "load_friction", "breakaway", "load_breakaway", "dead_band", "backlash")
"""Terms that an MJCF has no place for."""

FORMAT = FileFormat("MJCF", "MuJoCo", MISSING)

BALL = 0.002
"""[m] Radius of the ball that stands for a point that touches."""


def servo_mjcf(
    robot_file: RobotFile,
    links: ServoLinks,
    values: FloatArray,
    missing: Sequence[str] = (),
    contact: ServoContact | None = None,
) -> str:
    """The text of an MJCF: bodies of the robot file, joints, position actuators, and what the arm touches.

    Args:
        robot_file: shapes and limits.
        links: bodies.
        values: (n, terms) parameters that an MJCF has a place for.
        missing: what it has none for, in words.
        contact: a surface and the point that touches it.

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
        *(f"- {word}" for word in missing or ("nothing",)),
        "A delay needs a MuJoCo whose actuators have one; mj_initCtrlHistory, or it begins with controls of 0.",
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
    if contact is not None:
        _add_surface(root, links, contact)
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


def _add_surface(root: ElementTree.Element, links: ServoLinks, contact: ServoContact) -> None:
    """A plane, and a small ball at the point that touches it; they collide with nothing else."""
    world = root.find("worldbody")
    body = next(
        body for body in root.iter("body") if any(own.get("name") == contact.link for own in body.findall("joint"))
    )
    assert world is not None
    up = -links.model.gravity / np.linalg.norm(links.model.gravity)
    plane = {
        "name": "surface",
        "type": "plane",
        "size": "1 1 0.1",
        "zaxis": numbers(up),
        "pos": numbers(up * contact.height),
    }
    ball = {"name": "touching", "type": "sphere", "size": number(BALL), "pos": numbers(contact.point), "mass": "0"}
    # The ball's lowest point is the model's, so that its centre stands higher by the radius where it touches.
    plane["pos"] = numbers(up * (contact.height - BALL))
    ElementTree.SubElement(world, "geom", plane | {"contype": "2", "conaffinity": "0", "friction": "0.001 0 0"})
    ElementTree.SubElement(body, "geom", ball | {"contype": "0", "conaffinity": "2", "friction": "0.001 0 0"})


def played_paths(text: str, links: ServoLinks, motions: Sequence[ServoMotion]) -> list[FloatArray]:
    """Positions (N, n) of motions, as an MJCF's text moves on their commands in MuJoCo.

    Raises:
        ModelError: MuJoCo cannot read it.
    """
    return model_paths(loaded(text, links.model.name), links, motions)


def read_model_file(path: Path, joints: Sequence[str]) -> Any:
    """The MuJoCo model of an MJCF that came with the arm.

    Raises:
        UsageError: no MJCF with a position actuator for each joint, or MuJoCo is not installed.
        ModelError: MuJoCo does not read it.
    """
    if not mujoco_installed():
        raise UsageError(
            "rolling out a model file needs MuJoCo, which is not installed", where=str(path), hint="pip install mujoco"
        )
    model = _model_file(path)
    for name in joints:
        _position_actuator(model, name, str(path))
    return model


def model_paths(model: Any, links: ServoLinks, motions: Sequence[ServoMotion]) -> list[FloatArray]:
    """Positions (N, n) of motions, as a MuJoCo model moves on their commands."""
    return [_replayed(model, links, motion) for motion in motions]


def _model_file(path: Path) -> Any:
    """An MJCF as it came; without its shapes where their meshes are missing.

    Raises:
        UsageError: it is none.
        ModelError: MuJoCo does not read it.
    """
    import mujoco

    try:
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ElementTree.ParseError) as error:
        raise UsageError(f"is not a readable MJCF: {error}", where=str(path)) from error
    if root.tag != "mujoco":
        hint = "a URDF has no gains: give an MJCF" if root.tag == "robot" else "give an MJCF"
        raise UsageError(f"is not an MJCF, but a <{root.tag}>", where=str(path), hint=hint)
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        for parent in root.iter():
            parent.attrib.pop("material", None)
            for child in [child for child in parent if child.tag in {"geom", "mesh", "texture", "material"}]:
                parent.remove(child)
        return loaded(ElementTree.tostring(root, encoding="unicode"), str(path))


def _position_actuator(model: Any, joint: str, where: str) -> int:
    """The index of the actuator that holds a joint at its control.

    Raises:
        UsageError: there is no such joint, or nothing holds it.
    """
    import mujoco

    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    if number < 0:
        raise UsageError(f"has no joint {joint}", where=where, hint="joints of both files must have the same names")
    for actuator in range(model.nu):
        gain, bias = float(model.actuator_gainprm[actuator, 0]), float(model.actuator_biasprm[actuator, 1])
        turns = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        if turns and model.actuator_trnid[actuator, 0] == number and gain > 0 and bias < 0:
            return actuator
    raise UsageError(f"has no position actuator for {joint}", where=where, hint="its ctrl must be a position")


def _replayed(model: Any, links: ServoLinks, motion: ServoMotion) -> FloatArray:
    """Positions (N, n) at the motion's samples."""
    import mujoco

    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in links.model.joint_names]
    order = [int(joint.qposadr[0]) for joint in joints]
    actuators = [_position_actuator(model, name, links.model.name) for name in links.model.joint_names]
    data.qpos[order] = motion.position[0]
    step = float(model.opt.timestep)
    count = int(np.ceil(motion.time[-1] / step)) + 1
    # A command of the grid is the mean of the step before; a control holds for the step that follows.
    middles = (np.arange(len(motion.command)) - motion.history - 0.5) * motion.step

    def controls(first: int, end: int) -> FloatArray:
        times = (np.arange(first, end) + 0.5) * step
        return np.stack([np.interp(times, middles, column) for column in motion.command.T], axis=1)

    for joint, actuator in enumerate(actuators):
        # a delay would begin with controls of 0, which throws the arm
        if hasattr(model, "actuator_history") and (delayed := int(model.actuator_history[actuator, 0])):
            times, values = np.arange(-delayed, 0) * step, controls(-delayed, 0)[:, joint : joint + 1]
            mujoco.mj_initCtrlHistory(model, data, actuator, times, values)
    path, commanded = np.empty((count, len(order))), controls(0, count)
    for index in range(count):
        path[index] = data.qpos[order]
        data.ctrl[actuators] = commanded[index]
        mujoco.mj_step(model, data)
    return np.stack([np.interp(motion.time, np.arange(count) * step, column) for column in path.T], axis=1)
