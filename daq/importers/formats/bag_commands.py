"""Commands in a ROS 2 bag: the messages of the topic that command a controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.matching import match_joints
from daq.importers.naming import parse_name
from daq.importers.table import Note, QuantityColumns, check_count, listed, parsing, printable
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError, UsageError
from drivers.core.text import counted
from drivers.streams import COMMANDS

SECOND = 10**9
"""[ns]"""
Fields = tuple[tuple[str, ...], Mapping[str, FloatArray], Any]
"""Joint names, where the message has them; quantity → values; its header or None."""


def _of_joint_state(message: Any) -> Fields:
    fields = {"target_position": message.position, "target_velocity": message.velocity, "target_torque": message.effort}
    return tuple(message.name), fields, message.header


def _of_trajectory(message: Any) -> Fields:
    if len(message.points) != 1:
        return tuple(message.joint_names), {}, message.header
    point = message.points[0]
    fields = {"target_position": point.positions, "target_velocity": point.velocities, "target_torque": point.effort}
    return tuple(message.joint_names), fields, message.header


def _of_array(message: Any) -> Fields:
    return (), dict.fromkeys(COMMANDS, message.data), None


TYPES: Mapping[str, Callable[[Any], Fields]] = {
    "sensor_msgs/msg/JointState": _of_joint_state,
    "trajectory_msgs/msg/JointTrajectory": _of_trajectory,
    "std_msgs/msg/Float64MultiArray": _of_array,
}
"""Type of a message → what it tells; a trajectory of one point is a command, a longer one a plan."""


@dataclass(frozen=True)
class BagCommands:
    """Commands of one topic: `stamps` (M,) [ns] and `quantities`, (M, n) in the robot's order."""

    stamps: npt.NDArray[np.int64]
    quantities: Mapping[str, QuantityColumns]
    notes: tuple[Note, ...]


def command_topic(columns: Mapping[str, str], joints: Sequence[str]) -> tuple[str, tuple[str, ...]] | None:
    """The topic that `--column target_position=TOPIC` names, and what it holds; None where nothing is named.

    Raises:
        UsageError: something else than a command is mapped, or several topics are named.
    """
    if not columns:
        return None
    meant = {key: parse_name(key, joints) for key in columns}
    wrong = [
        key for key, role in meant.items() if role is None or role.quantity not in COMMANDS or role.number or role.joint
    ]
    if wrong:
        raise UsageError(
            f"a bag has no columns to map, such as '{printable(wrong[0])}'",
            where="--column",
            hint="choose the measured topic with --topic, the commands' with --column target_position=TOPIC",
        )
    topics = set(columns.values())
    if len(topics) > 1:
        raise UsageError(f"commands can be read from one topic, not from {listed(sorted(topics))}", where="--column")
    return topics.pop(), tuple(role.quantity for role in meant.values() if role is not None)


def read_commands(
    files: Sequence[Path], topic: str, wanted: Sequence[str], joints: Sequence[str], *, by_order: bool, where: str
) -> BagCommands:
    """Read the commands of a topic.

    Raises:
        ImportFileError: no such topic, one of another type, a message without the wanted values or with others' joints.
    """
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    place = f"{where}: {printable(topic)}"
    logged: list[int] = []
    stamped: list[int] = []
    rows: dict[str, list[FloatArray]] = {quantity: [] for quantity in wanted}
    columns: dict[tuple[str, ...], tuple[int, ...]] = {}
    notes: list[Note] = []
    types: dict[str, str] = {}
    for path in files:
        with parsing(path, "a ROS 2 bag"), Reader(path) as reader:
            types |= {connection.topic: connection.msgtype for connection in reader.connections}
            chosen = [entry for entry in reader.connections if entry.topic == topic and entry.msgtype in TYPES]
            for connection, stamp, raw in reader.messages(chosen) if chosen else ():
                message: Any = store.deserialize_cdr(raw, connection.msgtype)
                names, fields, header = TYPES[connection.msgtype](message)
                if names not in columns:
                    columns[names] = _columns(names, joints, by_order, f"{place}, message {len(logged)}", notes)
                for quantity, values in rows.items():
                    given = np.asarray(fields.get(quantity, ()), dtype=np.float64)
                    if len(given) != len(names or joints):
                        raise ImportFileError(
                            f"has {counted(len(given), 'value')} of {quantity} for {len(names or joints)} joints",
                            where=f"{place}, message {len(logged)}",
                        )
                    values.append(given[list(columns[names])])
                logged.append(stamp)
                stamped.append(0 if header is None else header.stamp.sec * SECOND + header.stamp.nanosec)
                check_count(len(logged) * len(joints) * len(rows), path)
    if len(logged) < 2:
        said = f"carries {printable(types[topic])}" if topic in types else "is not in the bag"
        shortage = f"holds {counted(len(logged), 'command')}; at least 2 are needed" if logged else said
        allowed = listed(sorted(name for name, kind in types.items() if kind in TYPES))
        raise ImportFileError(f"{shortage}; topics that may hold commands: {allowed or 'none'}", where=place)
    if not any(stamped):
        notes.append(Note("info", "commands have no stamps of their own; those of their arrival were used"))
    stamps = np.array(stamped if any(stamped) else logged, dtype=np.int64)
    labels = tuple(joints)
    quantities = {
        name: QuantityColumns(np.array(values), labels, ("",) * len(joints), labels) for name, values in rows.items()
    }
    return BagCommands(stamps, quantities, (Note("info", f"commands of {printable(topic)}, {len(logged)}"), *notes))


def _columns(
    names: tuple[str, ...], joints: Sequence[str], by_order: bool, where: str, notes: list[Note]
) -> tuple[int, ...]:
    """Return where the robot's joints are in a message; those of a message without names are in the robot's order."""
    if not names:
        notes.append(Note("info", f"commands matched by order (their messages have no names): {', '.join(joints)}"))
        return tuple(range(len(joints)))
    match = match_joints(names, joints, by_order=by_order, where=where)
    notes.extend(note for note in match.notes if note not in notes)
    return match.columns
