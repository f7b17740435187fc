"""A commented robot file to complete (`dynid robot new`): a URDF's content is filled in, the rest is marked TODO."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path

import yaml

from daq.output_files import check_outputs, replace_files
from daq.robot.loader import read_robot_text
from daq.robot.schema import ASSUMED_ACCELERATION
from daq.robot.urdf_robot import UrdfArm, UrdfJoint, read_urdf_arm
from daq.robot.validation import TODO
from drivers.core.errors import UsageError
from drivers.core.ranges import JOINTS, POSITION_LIMIT, VELOCITY_LIMIT

_HEAD = """\
# Robot file of dynid (docs/robot-file.md). Replace every TODO, or delete its line where the comment says so;
# then ask:  dynid check THIS_FILE
# It lists what is still to be filled in, and shows where the tool is at position zero and at your poses.
# Units: m, rad (pi/2 may be written), s, kg, N·m, A, °C.

name: {name}
description: {todo}, what a reader should know of this arm; or delete the line
"""

_URDF_MODEL = """\
model:
  urdf: {urdf}   # kinematics, relative to this file; its inertias are not used
{loops}\
  gravity: [0, 0, -9.81]   # m/s², in the base frame; turn it for an arm on a wall or a ceiling
"""

_MDH_MODEL = """\
# Modified Denavit-Hartenberg rows of Khalil and Kleinfinger: frame j follows from the frame before it by
# Rot(x, alpha) Trans(x, d) Rot(z, theta0 + q) Trans(z, r). This is Craig's convention with d for his a, r for his d.
# From the standard convention (theta, d, a, alpha): alpha and d are the standard alpha and a of the row before.
model:
  mdh:   # alpha, theta0 [rad]; d, r [m]; a sliding joint: type: prismatic, q adds to r
{rows}
  gravity: [0, 0, -9.81]   # m/s², in the base frame; turn it for an arm on a wall or a ceiling
"""

_JOINTS = """\
joints:   # limits, in the order of all arrays: motions are planned and supervised within them
{joints}
"""

_REST = """\
drives:   # joint torque = gain · signal, joint side, sign included
  # gain [N·m/A or N·m/V]: torque constant times gear ratio; gain_std: its standard deviation in the same unit.
  # Where the arm gives joint torque, write instead: {{joint: {first}, signal: torque}}; where its current has no sign,
  # {{joint: {first}, signal: magnitude}}.
  # inertia: false where torque is sensed behind the gearbox, so that the motor's inertia is not in it.
{drives}

# model: auto (coulomb-viscous, and what else the recordings show), or what you know it to be: none, viscous, coulomb or
# coulomb-viscous; offset: a constant torque per joint
friction: {{model: auto, offset: true}}

workspace:
  tool: {tool}   # m, the flange or the tool's tip in the frame of the last joint{tool_note}
  tool_rotation: {tool_rotation}   # rad, its axes there as a rotation vector
  link_radius: {todo}   # m, half the thickness of the links, such as 0.06; one number, or joint: number

poses:   # positions of all joints [rad or m] at which to compare `dynid check` with the pendant
  home: {home}   # a pose that you can drive to; or delete the section

# connections:   # how to reach the arm (docs/recording-ur.md, docs/can.md); not needed for importing recordings
#   rtde: {{driver: rtde, host: 192.168.0.10, rate: 500}}
"""


def new_robot_file(urdf: Path | None, joints: int | None, out: Path, *, overwrite: bool = False) -> str:
    """Write a robot file to complete, and return its text.

    Args:
        urdf: source of kinematics and limits; None for modified DH rows of `joints` joints.
        joints: number of joints, where there is no URDF.
        out: the file to write.
        overwrite: whether it may exist already.

    Raises:
        UsageError: neither or both of `urdf` and `joints`, or `out` exists, cannot be written or is no YAML
            file's name.
        RobotFileError: the URDF cannot be read.
    """
    if (urdf is None) == (joints is None):
        raise UsageError("give either a URDF or --joints", hint="dynid robot new arm.urdf -o arm.yaml")
    if out.suffix.lower() not in {".yaml", ".yml"}:
        raise UsageError(f"'{out}' is no name of a robot file", where="--out", hint="end it in .yaml")
    check_outputs([out], [urdf], overwrite=overwrite)
    if joints is not None and not 1 <= joints <= int(JOINTS.most):
        raise UsageError(f"--joints {joints} is not from 1 to {int(JOINTS.most)}")
    if urdf is None:
        text = new_robot_of_joints(joints or 0)
    else:
        arm = read_urdf_arm(read_robot_text(urdf), urdf.name, where=str(urdf))
        text = new_robot_of_urdf(arm, Path(os.path.relpath(urdf.resolve(), out.resolve().parent)).as_posix())
    replace_files({out: text})
    return text


def new_robot_of_urdf(arm: UrdfArm, urdf: str) -> str:
    """The text of a robot file for a URDF.

    Args:
        arm: content of the URDF.
        urdf: its path, relative to where the robot file will be.
    """
    loops = "  loops:   # joints that follow others (<mimic> of the URDF)\n" if arm.mimics else ""
    for mimic in arm.mimics:
        equation = f"{{{_quoted(mimic.follows)}: {mimic.multiplier!r}}}"
        loops += f"    - {{joint: {_quoted(mimic.name)}, equation: {equation}, offset: {mimic.offset!r}}}\n"
    model = _URDF_MODEL.format(urdf=_quoted(urdf), loops=loops)
    note = f" (here: link {arm.tool_link} of the URDF)".replace("\n", " ")
    rotation = [round(value, 9) for value in arm.tool_rotation]
    return _text(arm.name, model, arm.joints, [round(value, 9) for value in arm.tool], rotation, note)


def new_robot_of_joints(count: int) -> str:
    """The text of a robot file for an arm of `count` revolute joints, each carried by the one before."""
    rows = []
    for joint_number in range(1, count + 1):
        antecedent = f"j{joint_number - 1}" if joint_number > 1 else "base"
        rows.append(
            f"    - {{joint: j{joint_number}, antecedent: {antecedent}, "
            f"alpha: {TODO}, d: {TODO}, theta0: {TODO}, r: {TODO}}}"
        )
    joints = tuple(UrdfJoint(f"j{joint_number}", "revolute", None, None, None) for joint_number in range(1, count + 1))
    return _text(TODO, _MDH_MODEL.format(rows="\n".join(rows)), joints, [0, 0, 0], [0, 0, 0], "")


def _text(
    name: str, model: str, joints: tuple[UrdfJoint, ...], tool: list[float], tool_rotation: list[float], tool_note: str
) -> str:
    names = [_quoted(joint.name) for joint in joints]
    return "\n".join(
        (
            _HEAD.format(name=_quoted(name), todo=TODO),
            model,
            _JOINTS.format(joints="\n".join(map(_joint, joints))),
            _REST.format(
                first=names[0],
                drives="\n".join(
                    f"  - {{joint: {one}, gain: {TODO}, gain_std: {TODO}, signal: current}}" for one in names
                ),
                tool=tool,
                tool_rotation=tool_rotation,
                tool_note=tool_note,
                home=f"[{', '.join(TODO for _ in joints)}]",
                todo=TODO,
            ),
        )
    )


def _joint(joint: UrdfJoint) -> str:
    unit = "m" if joint.kind == "prismatic" else "rad"
    position, note = joint.position, ""
    if joint.kind == "continuous":
        note = "; position: the URDF's joint is continuous, a turn to either side was written"
    if position is not None and not all(map(POSITION_LIMIT.holds, position)):
        note = f"; position: the URDF says {list(position)}, which is no limit in {unit}"
        position = None
    velocity = joint.velocity if joint.velocity is None or VELOCITY_LIMIT.holds(joint.velocity) else None
    limits = f"[{TODO}, {TODO}]" if position is None else f"[{position[0]:.9g}, {position[1]:.9g}]"
    lines = [
        f"  - name: {_quoted(joint.name)}",
        f"    position: {limits}   # {unit}{note}",
        f"    velocity: {TODO if velocity is None else f'{velocity:.9g}'}   # {unit}/s",
        f"    acceleration: {TODO}   # {unit}/s²; {ASSUMED_ACCELERATION:g} is assumed where the line is deleted",
        f"    torque: {TODO if joint.torque is None else f'{joint.torque:.9g}'}   # {'N' if unit == 'm' else 'N·m'}; "
        "or delete the line: the torque is then not supervised",
    ]
    return "\n".join(lines)


def _quoted(text: str) -> str:
    """A text as YAML reads it back; in quotes where it is no plain word."""
    if PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return yaml.safe_dump(text, default_style='"', allow_unicode=True, width=math.inf).strip()


PLAIN = re.compile(r"(?:\.\./)*[A-Za-z][\w./-]*", re.ASCII)
"""A word or a path that YAML reads as a text without quotes, `_WORDS` aside."""
_WORDS = frozenset({"yes", "no", "on", "off", "true", "false", "null", "y", "n"})
"""Characters that YAML 1.1 does not read as plain text."""
