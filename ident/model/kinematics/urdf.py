"""Kinematics from a URDF: parsed by Pinocchio, meshes never opened, joints locked as in the robot file."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import numpy as np

from daq.robot.loader import RobotFile
from daq.robot.urdf_check import checked_urdf
from drivers.core.errors import RobotFileError
from drivers.core.text import did_you_mean
from ident.model.kinematics.joints import BASE_INDEX, Joint

UNIVERSE = 0
_ONE_AT_A_TIME = threading.Lock()
"""Standard error belongs to the whole process."""

_LIMITS = {"effort", "velocity"}

_LINK = "\n"
"""End of a link's name while joints are locked: no name holds one."""

RIGHT_ANGLE_TOLERANCE = 1e-5  # [rad]; many URDFs write π/2 as `1.5708`


def urdf_joints(xml: str, names: Sequence[str], locked: Mapping[str, float], where: str) -> tuple[Joint, ...]:
    """Joints of a URDF in the order of `names`, with the joints of `locked` (name → position [rad or m]) frozen.

    Raises:
        RobotFileError: not a URDF; a joint is missing, neither named nor locked, has more than one degree of freedom,
            or is listed before its parent.
    """
    model = urdf_model(xml, names, locked, where)
    joint_index = {name: index for index, name in enumerate(names)}
    joints = []
    for name in names:
        identifier = model.getJointId(name)
        parent_identifier = model.parents[identifier]
        parent = BASE_INDEX if parent_identifier == UNIVERSE else joint_index[model.names[parent_identifier]]
        if parent >= joint_index[name]:
            raise RobotFileError(
                f"joint '{name}' is listed before its parent '{names[parent]}'",
                where=f"{where}: joints",
                hint="reorder 'joints'",
            )
        subspace = _motion_subspace(model.joints[identifier], name, where)
        prismatic = bool(np.any(subspace[:3]))
        placement = model.jointPlacements[identifier]
        joints.append(
            Joint(
                name=name,
                parent=parent,
                prismatic=prismatic,
                rotation=_without_rounding(placement.rotation),
                translation=_without_rounding(placement.translation),
                axis=_without_rounding(subspace[:3] if prismatic else subspace[3:]),
            )
        )
    return tuple(joints)


def urdf_order(xml: str, names: Sequence[str], locked: Mapping[str, float], where: str) -> tuple[str, ...]:
    """The same joints in an order in which each follows its parent.

    Raises:
        RobotFileError: not a URDF; a joint is missing, or neither named nor locked.
    """
    return tuple(name for name in urdf_model(xml, names, locked, where).names if name in names)


def urdf_model(xml: str, names: Sequence[str], locked: Mapping[str, float], where: str) -> Any:
    """A URDF as a `pinocchio.Model` in which just the joints of `names` move, in its own order.

    Raises:
        RobotFileError: not a URDF; a joint is missing, or neither named nor locked.
    """
    import pinocchio as pin

    root = checked_urdf(xml, where)
    said: list[str] = []
    try:
        with _standard_error(said):
            full = pin.buildModelFromXML(_with_limits(root) or xml)
    except Exception as error:  # Pinocchio raises several kinds, none of them public
        # The parser's own lines say more than the exception that follows them.
        reason = [line.removeprefix("Error:").strip() for line in (*said, *str(error).splitlines())]
        first = next((line for line in reason if line and not line.startswith("at line")), "it contains no robot")
        raise RobotFileError(f"not a URDF: {first}", where=where) from error
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and joint.get("name") in locked and mimic.get("joint") in names:
            raise RobotFileError(
                f"joint '{joint.get('name')}' follows '{mimic.get('joint')}' (<mimic>), which moves, so it is not "
                "locked",
                where=f"{where}: model.locked",
                hint="let it follow by an equation of model.loops (docs/loops.md); dynid robot new writes it",
            )
    return _lock(full, names, locked, where)


def _with_limits(root: ElementTree.Element) -> str | None:
    """The XML with a limit at each joint where the parser asks for one, which the robot file states; None if it has."""
    lacking = [
        joint
        for joint in root.findall("joint")
        if joint.get("type") in ("revolute", "prismatic") and not _limit_of(joint).keys() >= _LIMITS
    ]
    if not lacking:
        return None
    names = {id(joint) for joint in lacking}
    copy = deepcopy(root)
    for joint, own in zip(root.findall("joint"), copy.findall("joint"), strict=True):
        if id(joint) in names:
            stated = _limit_of(joint)
            for limit in own.findall("limit"):
                own.remove(limit)
            ElementTree.SubElement(own, "limit", dict.fromkeys(_LIMITS, "0") | stated)
    return ElementTree.tostring(copy, encoding="unicode")


def _limit_of(joint: ElementTree.Element) -> dict[str, str]:
    limit = joint.find("limit")
    return {} if limit is None else dict(limit.attrib)


@contextmanager
def _standard_error(lines: list[str]) -> Iterator[None]:
    """Take what a library writes to the process's standard error: its parser prints there what it also raises."""
    with tempfile.TemporaryFile() as taken, _ONE_AT_A_TIME:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(taken.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            taken.seek(0)
            lines += taken.read().decode("utf-8", "replace").splitlines()


UrdfBody = tuple[float, np.ndarray, np.ndarray]
"""Mass [kg], centre of mass (3,) [m] and inertia (3, 3) about it [kg·m²]."""


def urdf_inertias(robot_file: RobotFile, names: Sequence[str]) -> tuple[UrdfBody | None, ...]:
    """The body that each joint of `names` moves.

    In the joint's frame; None for a body without mass, and for all where the robot has no URDF.

    Raises:
        RobotFileError: not a URDF; a joint is missing, or neither named nor locked.
    """
    if not robot_file.urdf_text:
        return (None,) * len(names)
    robot = robot_file.robot
    model = urdf_model(robot_file.urdf_text, names, robot.model.locked, robot.name)
    bodies = (model.inertias[model.getJointId(name)] for name in names)
    return tuple(
        (float(body.mass), np.array(body.lever), np.array(body.inertia)) if body.mass > 0 else None for body in bodies
    )


def _lock(full: Any, names: Sequence[str], locked: Mapping[str, float], where: str) -> Any:
    import pinocchio as pin

    movable = [name for name in full.names if name != "universe"]
    for name in names:
        if name not in movable:
            hint = did_you_mean(name, movable) or f"movable joints of the URDF: {', '.join(movable) or 'none'}"
            raise RobotFileError(
                f"'joints' names '{name}', which is not a movable joint of the URDF", where=where, hint=hint
            )
    for name in locked:
        if name not in movable:
            hint = did_you_mean(name, movable) or f"movable joints of the URDF: {', '.join(movable) or 'none'}"
            raise RobotFileError(
                f"'{name}' is not a movable joint of the URDF", where=f"{where}: model.locked", hint=hint
            )
        if name in names:
            raise RobotFileError(
                f"joint '{name}' is both locked and listed in 'joints'", where=f"{where}: model.locked"
            )
    loose = [name for name in movable if name not in names and name not in locked]
    if loose:
        raise RobotFileError(
            f"the URDF moves joints that 'joints' does not name: {', '.join(loose)}",
            where=where,
            hint=f"add them to 'joints', or lock them: model: {{locked: {{{loose[0]}: 0}}}}",
        )
    if not locked:
        return full
    reference = pin.neutral(full)
    for name, position in locked.items():
        joint = full.joints[full.getJointId(name)]
        if joint.nq == 1:
            reference[joint.idx_q] = position
        elif joint.nq == 2 and joint.nv == 1:  # a continuous joint keeps cosine and sine
            reference[joint.idx_q : joint.idx_q + 2] = np.cos(position), np.sin(position)
        else:
            raise RobotFileError(f"joint '{name}' has more than one degree of freedom", where=f"{where}: model.locked")
    return _reduced(full, locked, reference)


def _reduced(full: Any, locked: Iterable[str], reference: Any) -> Any:
    """The model without the locked joints; Pinocchio confuses a link with a joint of its name (SO-100: gripper)."""
    import pinocchio as pin

    links = [frame for frame in full.frames if frame.type == pin.FrameType.BODY]
    for frame in links:
        frame.name += _LINK
    reduced = pin.buildReducedModel(full, [full.getJointId(name) for name in locked], reference)
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(_LINK)
    return reduced


def _motion_subspace(joint: Any, name: str, where: str) -> Any:
    """(6,) direction of motion, translation first."""
    if joint.nv != 1:
        raise RobotFileError(
            f"joint '{name}' has {joint.nv} degrees of freedom; only revolute, continuous and prismatic joints work",
            where=where,
        )
    data = joint.createData()
    position = np.array([1.0, 0.0])[: joint.nq] if joint.nq == 2 else np.zeros(1)
    joint.calc(data, position)
    return np.asarray(data.S).reshape(6)


def _without_rounding(values: Any) -> Any:
    """Entries within 1e-11 of 0 or ±1 made exact, and a matrix of right angles that was written `1.5708` too.

    Such rounding residue would make unidentifiable parameters look identifiable, and it costs products in the kernel.
    """
    exact = np.array(values, dtype=np.float64)
    nearest = np.clip(np.round(exact), -1, 1)
    tolerance = RIGHT_ANGLE_TOLERANCE if exact.ndim == 2 and _is_signed_permutation(nearest) else 1e-11
    close = np.abs(exact - nearest) < tolerance
    exact[close] = nearest[close]
    return exact


def _is_signed_permutation(matrix: Any) -> bool:
    return bool(np.all(np.abs(matrix).sum(axis=0) == 1) and np.all(np.abs(matrix).sum(axis=1) == 1))
