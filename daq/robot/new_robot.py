"""A commented robot file to complete (`dynid robot new`), which can be simulated as it stands where it is of a URDF."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import yaml

from daq.robot.schema import ASSUMED_ACCELERATION, TruthLink
from daq.robot.urdf_robot import UrdfArm, UrdfJoint
from daq.robot.validation import TODO
from drivers.core.ranges import POSITION_LIMIT, VELOCITY_LIMIT

ASSUMED_VELOCITY = {"rad": 1.0, "m": 0.1}
"""Velocity limit where the URDF states none [rad/s, m/s]: slow for an arm, so that it is on the safe side."""

FRAMES_PER_SECOND = 2000.0
"""Frames of samples per second on the simulated bus of 1 Mbit/s, which they fill to 80 % at worst."""

MOST_SYNC = 125.0
"""[Hz], which a computer keeps that simulates the arm and records it at once."""

_DRIVES = """\
# {todo} (identify): drives, unless the arm gives joint torque. Joint torque = gain · signal, joint side, sign included;
# gain [N·m/A or N·m/V]: torque constant times gear ratio; gain_std: its standard deviation. signal: magnitude where the
# current has no sign. inertia: false where torque is sensed behind the gearbox, without the motor's inertia.
# drives:
{drives}

# model: auto (coulomb-viscous, and what else the recordings show), or what you know it to be: none, viscous, coulomb or
# coulomb-viscous; offset: a constant torque per joint
friction: {{model: auto, offset: true}}
"""

_WORKSPACE = """
workspace:   # m, in the frame of the last joint; height of the floor, obstacles: docs/robot-file.md
  tool: {tool}   # the flange or the tool's tip{note}
  tool_rotation: {rotation}   # rad, its axes there as a rotation vector
  # link_radius: 0.06   # {todo} (move): half the thickness of links without a mesh; 0.05 is assumed
"""


@dataclass(frozen=True)
class JointTruth:
    """Assumptions on a simulated joint."""

    viscous: float  # [N·m·s/rad or N·s/m]
    coulomb: float  # [N·m or N]
    motor_inertia: float  # [kg·m² or kg]
    noise: float  # standard deviation of its torque [N·m or N]
    gravity: float  # torque that holds it in the worst pose [N·m or N]


@dataclass(frozen=True)
class ArmGuess:
    """What a URDF lets guess of an arm beyond its kinematics and limits."""

    # joint → body of the link that it moves, and where it is from, in words
    links: Mapping[str, tuple[TruthLink, str]] = field(default_factory=dict)
    # joint → friction, motor inertia and noise; of those with a motor
    joints: Mapping[str, JointTruth] = field(default_factory=dict)
    # name → positions of all joints [rad or m], and what they are, in words
    poses: Mapping[str, tuple[Sequence[float], str]] = field(default_factory=dict)
    # whether parts of the arm are below its base in every pose, so that no mounting surface is assumed
    free: bool = False


def unknown_positions(arm: UrdfArm) -> tuple[str, ...]:
    """Names of the joints whose position limits the URDF does not state, or not in rad or m."""
    return tuple(joint.name for joint in arm.joints if _position(joint) is None)


def new_robot_of_urdf(arm: UrdfArm, urdf: str, guess: ArmGuess | None = None) -> str:
    """The text of a robot file for a URDF, whose path is relative to where the robot file will be, or absolute."""
    guess = ArmGuess() if guess is None else guess
    note = f"; here: link {arm.tool_link} of the URDF".replace("\n", " ")
    rounded = [[round(value, 9) for value in values] for values in (arm.tool, arm.tool_rotation)]
    parts = [
        _head(quoted(arm.name), unknown_positions(arm), guess),
        _urdf_model(arm, urdf, free=guess.free),
        "joints:   # limits, in the order of all arrays: motions are planned and supervised within them",
        _acceleration_note(),
        *(_joint(joint, guess.joints.get(joint.name)) for joint in arm.joints),
        "",
        _DRIVES.format(todo=TODO, drives=_drives(arm.joints)).rstrip("\n"),
        _WORKSPACE.format(tool=rounded[0], rotation=rounded[1], note=note, todo=TODO).rstrip("\n"),
    ]
    if guess.poses:
        parts += ["", "poses:   # positions of all joints [rad or m]; the simulated arm stands at `start`"]
        parts += [f"  {name}: {_list(pose)}   # {meaning}" for name, (pose, meaning) in guess.poses.items()]
    if guess.links:
        parts += ["", _truth(guess)]
    parts += ["", _connection(arm.joints)]
    return "\n".join(parts) + "\n"


def new_robot_of_joints(count: int) -> str:
    """The text of a robot file for an arm of `count` revolute joints, each carried by the one before."""
    joints = tuple(UrdfJoint(f"j{number}", "revolute", None, None, None) for number in range(1, count + 1))
    rows = [
        f"    - {{joint: j{number}, antecedent: {f'j{number - 1}' if number > 1 else 'base'}, "
        f"alpha: {TODO}, d: {TODO}, theta0: {TODO}, r: {TODO}}}"
        for number in range(1, count + 1)
    ]
    model = "\n".join(
        (
            "# Modified Denavit-Hartenberg rows of Khalil and Kleinfinger: frame j follows from the frame before it by",
            "# Rot(x, alpha) Trans(x, d) Rot(z, theta0 + q) Trans(z, r): Craig's convention, d for a and r for d.",
            "# From the standard convention (theta, d, a, alpha): alpha and d are the alpha and a of the row before.",
            "model:",
            "  mdh:   # alpha, theta0 [rad]; d, r [m]; a sliding joint: type: prismatic, q adds to r",
            *rows,
            _GRAVITY,
        )
    )
    limits = [
        f"  - {{name: {joint.name}, position: [{TODO}, {TODO}], velocity: {TODO}}}   # rad, rad/s; torque: N·m"
        for joint in joints
    ]
    parts = [
        _head("my_arm", None, ArmGuess()),
        model,
        "",
        "joints:   # limits, in the order of all arrays: motions are planned and supervised within them",
        _acceleration_note(),
        *limits,
        "",
        _DRIVES.format(todo=TODO, drives=_drives(joints)).rstrip("\n"),
        _WORKSPACE.format(tool=[0, 0, 0], rotation=[0, 0, 0], note="", todo=TODO).rstrip("\n"),
        "",
        "# poses: {home: [" + ", ".join("0" for _ in joints) + "]}   # rad, to compare `dynid check` with the pendant",
        f"# connections:   # {TODO} (record): where the arm answers, docs/recording-ur.md or docs/can.md",
        "#   rtde: {driver: rtde, host: 192.168.0.10, rate: 500}",
        "#   canopen: {driver: canopen402, interface: socketcan, channel: can0, bitrate: 1000000, sync_rate: 250,",
        "#     nodes: {" + ", ".join(f"{joint.name}: {{id: {node}}}" for node, joint in enumerate(joints, 1)) + "}}",
    ]
    return "\n".join(parts) + "\n"


def to_fill_in(unknown: Sequence[str] | None) -> dict[str, str]:
    """Return what is still to be filled in, by what needs it.

    `unknown` are joints whose position limits the URDF does not state; None where there is no URDF.
    """
    needed = {}
    if unknown is None:
        needed["run"] = "geometry (model.mdh), position and velocity limits"
    elif unknown:
        needed["run"] = f"position limits of {', '.join(unknown)}: the URDF states none in rad or m"
    return needed | {
        "record": "where the arm answers (connections)",
        "move": f"limits of acceleration ({ASSUMED_ACCELERATION:g} rad/s² is assumed) and torque, what is around it",
        "identify": "drive gains (drives), unless the arm gives joint torque",
    }


_GRAVITY = "  gravity: [0, 0, -9.81]   # m/s², in the base frame; turn it for an arm on a wall or a ceiling"


def _head(name: str, unknown: Sequence[str] | None, guess: ArmGuess) -> str:
    lines = ["# Robot file of dynid (docs/robot-file.md). Units: m, rad (pi/2 may be written), s, kg, N·m, A, °C."]
    if guess.links and not unknown:
        lines.append(
            "# It is complete for the simulated arm: dynid sim THIS_FILE. A real one needs what is marked TODO, to"
        )
    else:
        lines.append("# Replace each value TODO; what is marked TODO in a comment is needed to")
    lines += [f"#   {purpose + ':':9} {what}" for purpose, what in to_fill_in(unknown).items()]
    return "\n".join((*lines, "# Then ask: dynid check THIS_FILE", "", f"name: {name}", ""))


def _urdf_model(arm: UrdfArm, urdf: str, *, free: bool) -> str:
    lines = ["model:", f"  urdf: {quoted(urdf)}   # kinematics; its inertias are the prior of an identification"]
    if arm.locked:
        lines.append("  locked:   # joints beside the arm, or a gripper's; to move one, name it under joints")
        lines += [f"    {quoted(name)}: {_number(position, 9)}" for name, position in arm.locked]
    if arm.mimics:
        lines.append("  loops:   # joints that follow others (<mimic> of the URDF)")
    for mimic in arm.mimics:
        equation = f"{{{quoted(mimic.follows)}: {mimic.multiplier!r}}}"
        lines.append(f"    - {{joint: {quoted(mimic.name)}, equation: {equation}, offset: {mimic.offset!r}}}")
    lines.append(_GRAVITY)
    if free:
        lines.append("  mounting: free   # parts of the arm are always below z = 0; or give workspace.floor")
    return "\n".join((*lines, ""))


def _acceleration_note() -> str:
    return (
        f"  # {TODO} (move): acceleration of each joint [rad/s², m/s²]; {ASSUMED_ACCELERATION:g} is assumed. Torques "
        "that are not stated are not supervised."
    )


def _unit(joint: UrdfJoint) -> str:
    return "m" if joint.kind == "prismatic" else "rad"


def _position(joint: UrdfJoint) -> tuple[float, float] | None:
    stated = joint.position
    if stated is None or not all(map(POSITION_LIMIT.holds, stated)) or not float(f"{stated[0]:.9g}") < stated[1]:
        return None
    return stated


def _joint(joint: UrdfJoint, truth: JointTruth | None) -> str:
    unit, notes = _unit(joint), []
    position = _position(joint)
    if joint.kind == "continuous":
        notes.append("continuous: limited to one turn either way")
    if position is None and joint.position is not None:
        notes.append(f"the URDF says {list(joint.position)}, which cannot be limits in {unit}")
    velocity = joint.velocity if joint.velocity is None or VELOCITY_LIMIT.holds(joint.velocity) else None
    if velocity is None:
        stated = "states no velocity" if joint.velocity is None else f"says {joint.velocity:g} {unit}/s"
        notes.append(f"{TODO} (move): the URDF {stated}, this one is assumed")
        velocity = ASSUMED_VELOCITY[unit]
    limits = f"[{TODO}, {TODO}]" if position is None else f"[{_number(position[0], 9)}, {_number(position[1], 9)}]"
    torque = joint.torque
    force = "N" if unit == "m" else "N·m"
    if torque is None:
        notes.append(f"{TODO} (move): the URDF states no torque [{force}]")
    elif truth is not None and torque < truth.gravity:
        notes.append(
            f"{TODO} (move): torque; the URDF says {torque:g} {force}, gravity alone needs {truth.gravity:.3g}"
        )
        torque = None
    entry = f"  - {{name: {quoted(joint.name)}, position: {limits}, velocity: {_number(velocity, 9)}"
    entry += "}" if torque is None else f", torque: {_number(torque, 9)}}}"
    return entry + (f"   # {'; '.join(notes)}" if notes else "")


def _drives(joints: Iterable[UrdfJoint]) -> str:
    return "\n".join(
        f"#   - {{joint: {quoted(joint.name)}, gain: {TODO}, gain_std: {TODO}, signal: current}}" for joint in joints
    )


def _truth(guess: ArmGuess) -> str:
    lines = [
        "truth:   # of the simulated arm, and the prior of a motion's design; change it to see what is identified",
        "  links:   # mass [kg], com [m], inertia about com: xx, xy, xz, yy, yz, zz [kg·m²]; joints' frames",
    ]
    for name, (link, origin) in guess.links.items():
        lines.append(
            f"    {quoted(name)}: {{mass: {_number(link.mass)}, com: {_list(link.com)}, "
            f"inertia: {_list(link.inertia)}}}   # {origin}"
        )
    lines.append("  joints:   # assumptions: friction and motor inertia of arms of this strength")
    for name, joint in guess.joints.items():
        lines.append(
            f"    {quoted(name)}: {{viscous: {_number(joint.viscous)}, coulomb: {_number(joint.coulomb)}, "
            f"motor_inertia: {_number(joint.motor_inertia)}}}"
        )
    noise = ", ".join(f"{quoted(name)}: {_number(joint.noise)}" for name, joint in guess.joints.items())
    lines += ["  noise:   # assumptions", "    encoder_resolution: 1.2e-05", f"    torque_std: {{{noise}}}"]
    return "\n".join(lines)


def _connection(joints: Sequence[UrdfJoint]) -> str:
    rate = min(MOST_SYNC, FRAMES_PER_SECOND / len(joints))
    nodes = [
        f"      {quoted(joint.name)}: {{id: {number}, counts_per_turn: 524288}}"
        for number, joint in enumerate(joints, start=1)
    ]
    return "\n".join(
        (
            f"connections:   # {TODO} (record): where your arm answers, docs/recording-ur.md or docs/can.md",
            "  simulated:   # CiA 402 drives of `dynid sim THIS_FILE`",
            "    driver: canopen402",
            "    interface: udp_multicast",
            "    channel: 239.74.163.2",
            "    options: {hop_limit: 0}",
            "    timeout: 30   # s; with the next line, for a busy computer",
            "    sdo_timeout: 2",
            f"    sync_rate: {max(1, round(rate))}",
            "    nodes:",
            *nodes,
        )
    )


def _number(value: float, digits: int = 6) -> str:
    """A number that YAML 1.1 reads as one: with a point before an exponent."""
    text = f"{value:.{digits}g}"
    return text if "." in text else text.replace("e", ".0e")


def _list(values: Sequence[float]) -> str:
    return f"[{', '.join(_number(value) for value in values)}]"


def quoted(text: str) -> str:
    """A text as YAML reads it back; in quotes where it is no plain word."""
    if PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return yaml.safe_dump(text, default_style='"', allow_unicode=True, width=math.inf).strip()


PLAIN = re.compile(r"(?:\.\./)*[A-Za-z][\w./-]*", re.ASCII)
"""A word or a path that YAML reads as a text without quotes, `_WORDS` aside."""
_WORDS = frozenset({"yes", "no", "on", "off", "true", "false", "null", "y", "n"})
"""Characters that YAML 1.1 does not read as plain text."""
