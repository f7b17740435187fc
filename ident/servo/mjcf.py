"""A servo arm as MJCF with position actuators, and its replay on recorded commands in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from ident.servo.arm_rollout import rollout_errors
from ident.servo.links import ServoLinks
from ident.servo.motion import ServoMotion, lanes_of, motion_load
from ident.servo.rollout import profile_goals
from ident.servo.terms import INDEX, TERMS

REPLAYED = 120.0
"""[s] of motion at most in a replay."""

FAITHFUL = 1.2
"""Ratio of a replay's error to that of the model's own roll-out up to which the file stands for the model."""

_KINDS = {"motor_inertia": "armature", "viscous": "damping", "coulomb": "coulomb"}


@dataclass(frozen=True)
class ServoReplay:
    """A file rolled out on recorded commands; mean absolute errors over all joints [rad or m].

    Attributes:
        program: that read the file.
        error: with the commands as recorded.
        shaped_error: with the commands as the servos' profiles shape them.
        model_error: of the model's own roll-out of the same motions.
        seconds: of motion.
        left_out: terms that the format has no place for, in words.
    """

    program: str
    error: float
    shaped_error: float
    model_error: float
    seconds: float
    left_out: tuple[str, ...]

    def __str__(self) -> str:
        text = (
            f"{self.program} on {self.seconds:.0f} s of recorded commands: {1e3 * self.error:.3g} mrad, with commands "
            f"that the servos' profiles shaped {1e3 * self.shaped_error:.3g}; dynid {1e3 * self.model_error:.3g} mrad"
        )
        if self.error <= FAITHFUL * self.model_error or not self.left_out:
            return text
        return f"{text}. MJCF has no place for {', '.join(self.left_out)}"


def left_out(values: FloatArray) -> tuple[str, ...]:
    """Terms of some joint that an MJCF has no place for."""
    words = {
        "acceleration_limit": "the servos' profile",
        "load_friction": "friction that follows the load",
        "breakaway": "breakaway friction",
        "load_breakaway": "breakaway friction",
        "dead_band": "the dead band",
    }
    absent = {term.name: term.absent for term in TERMS}
    return tuple(dict.fromkeys(word for name, word in words.items() if np.any(values[:, INDEX[name]] != absent[name])))


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
    own = {
        (kind, model.active[joint]): float(values[joint, INDEX[name]])
        for kind, name in _KINDS.items()
        for joint in range(count)
    }
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
        *(f"- {word}" for word in left_out(values) or ("nothing",)),
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
    chosen, seconds = [], 0.0
    for motion, path in zip(motions, model_paths, strict=True):
        if seconds < REPLAYED:
            chosen.append((motion, path))
            seconds += float(motion.time[-1])
    raw = [_replayed(model, links, motion, motion.command[motion.history :], values) for motion, _ in chosen]
    shaped = [_replayed(model, links, motion, _shaped(links, motion, values), values) for motion, _ in chosen]
    weights = [motion.time[-1] for motion, _ in chosen]
    errors = [
        float(np.average(rollout_errors([motion for motion, _ in chosen], paths).mean(axis=1), weights=weights))
        for paths in (raw, shaped, [path for _, path in chosen])
    ]
    return ServoReplay(f"MuJoCo {mujoco.__version__}", errors[0], errors[1], errors[2], seconds, left_out(values))


def _shaped(links: ServoLinks, motion: ServoMotion, values: FloatArray) -> FloatArray:
    """Commands (K, n) as the servos' profiles shape them, before their delay."""
    zero = np.zeros(len(values))
    lanes = lanes_of([motion], [motion_load(links, motion, motion.time, motion.position, zero)], None)
    return profile_goals(lanes, np.zeros(len(values)), values[:, INDEX["acceleration_limit"]])


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
