"""The file's joints against the robot's, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daq.importers.table import Note, listed, printable
from daq.robot.schema import Robot
from drivers.core.errors import ImportFileError
from drivers.core.text import counted, did_you_mean

_SEPARATORS = "_/.:-"


@dataclass(frozen=True)
class JointMatch:
    """Columns of a file in the order of the robot's joints."""

    columns: tuple[int, ...]  # for each of the robot's joints, the index of its column in the file
    notes: tuple[Note, ...] = ()  # for the recording: a prefix, an order, joints that were left out
    by_order: bool = False  # whether names were of no use


def with_own_names(names: Sequence[str], robot: Robot) -> tuple[tuple[str, ...], tuple[Note, ...]]:
    """A file's joint names, those in the robot file's `aliases` replaced by the robot's own; and what was replaced."""
    own = {alias: joint.name for joint in robot.joints for alias in joint.aliases}
    called = tuple(own.get(name, name) for name in names)
    if called == tuple(names) or set(robot.joint_names) <= set(names):
        return tuple(names), ()
    pairs = ", ".join(f"{printable(name)} → {own[name]}" for name in names if name in own)
    return called, (Note("info", f"joints matched by the robot file's aliases: {pairs}"),)


def match_joints(names: Sequence[str], joints: Sequence[str], *, by_order: bool, where: str) -> JointMatch:
    """Find the robot's joints among a file's joint names.

    Equal names match; failing that, names that differ by one prefix that all joints share, on either side
    (`robot1_elbow_joint` and `elbow_joint`); failing that the order, where the user asked for it.

    Args:
        names: (m) the file's joint names, m ≥ n.
        joints: (n) the robot's joint names.
        by_order: take the file's order where names don't match.
        where: the file, for messages.

    Raises:
        ImportFileError: a joint is missing, appears twice, or could be several.
    """
    for name in names:
        if list(names).count(name) > 1:
            raise ImportFileError(f"names the joint '{printable(name)}' twice", where=where)
    index = {name: column for column, name in enumerate(names)}
    if all(joint in index for joint in joints):
        return _matched(names, [index[joint] for joint in joints], ())
    prefixed = [name[: -len(joints[0])] for name in names if _ends_in(name, joints[0])]
    fitting = [prefix for prefix in prefixed if all(f"{prefix}{joint}" in index for joint in joints)]
    if len(fitting) == 1:
        note = Note("info", f"the file's joint names carry the prefix '{printable(fitting[0])}', the robot's don't")
        return _matched(names, [index[f"{fitting[0]}{joint}"] for joint in joints], (note,))
    if len(fitting) > 1:
        raise ImportFileError(
            f"holds the robot's joints under several prefixes: {listed(fitting)}",
            where=where,
            hint="add the prefix of the intended arm to the robot file's joint names",
        )
    stripped = [prefix for prefix in _own_prefixes(joints) if all(joint[len(prefix) :] in index for joint in joints)]
    if stripped:
        note = Note("info", f"the robot's joint names carry the prefix '{stripped[0]}', the file's don't")
        return _matched(names, [index[joint[len(stripped[0]) :]] for joint in joints], (note,))
    if by_order and len(names) == len(joints):
        pairs = ", ".join(f"{printable(name)} → {joint}" for name, joint in zip(names, joints, strict=True))
        return JointMatch(tuple(range(len(joints))), (Note("warning", f"joints matched by order: {pairs}"),), True)
    missing = [joint for joint in joints if joint not in index]
    if by_order:
        hint = f"by order needs {counted(len(joints), 'joint')}, the file has {len(names)}"
    elif len(names) == len(joints):
        hint = "rename the robot file's joints, or use the file's order with --by-order"
    else:
        hint = did_you_mean(missing[0], names) or "is it another robot's file? see --robot"
    raise ImportFileError(f"has no joint {listed(missing)}; it has: {listed(names) or 'none'}", where=where, hint=hint)


def shares_joints(names: Sequence[str], joints: Sequence[str]) -> bool:
    """Return whether any of the file's names could be one of the robot's joints."""
    return any(name == joint or _ends_in(name, joint) or _ends_in(joint, name) for name in names for joint in joints)


def _ends_in(name: str, tail: str) -> bool:
    return 0 < len(tail) < len(name) and name.endswith(tail) and name[-len(tail) - 1] in _SEPARATORS


def _matched(names: Sequence[str], columns: list[int], notes: tuple[Note, ...]) -> JointMatch:
    matched = set(columns)
    ignored = [name for column, name in enumerate(names) if column not in matched]
    if ignored:
        notes = (*notes, Note("info", f"joints that the robot does not have were dropped: {listed(ignored)}"))
    return JointMatch(tuple(columns), notes)


def _own_prefixes(joints: Sequence[str]) -> list[str]:
    """Prefixes up to a separator that all the robot's joint names share, shortest first."""
    first = joints[0]
    ends = [position + 1 for position, character in enumerate(first) if character in _SEPARATORS]
    return [first[:end] for end in ends if all(joint.startswith(first[:end]) and len(joint) > end for joint in joints)]
