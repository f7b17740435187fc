"""ROS 2 bags (sqlite3 and MCAP storage) through `rosbags`: the JointState messages of one topic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.formats.bag_commands import TYPES, command_topic, read_commands
from daq.importers.matching import JointMatch, match_joints, shares_joints
from daq.importers.table import ForeignTable, Note, QuantityColumns, check_count, listed, parsing, printable
from drivers.core.arrays import FloatArray
from drivers.core.errors import ImportFileError
from drivers.core.files import BAG_FILE, BAG_METADATA, check_input
from drivers.core.reading_process import Progress
from drivers.core.text import counted, did_you_mean

JOINT_STATE = "sensor_msgs/msg/JointState"
METADATA = "metadata.yaml"
STORAGE_SUFFIXES = (".db3", ".mcap")
PROGRESS_STEP = 10_000
"""Messages between two reports of progress."""
SECOND = 1e9
"""[ns]"""
_FIELDS = ("position", "velocity", "effort")


@dataclass(frozen=True)
class _Messages:
    """All JointState messages of a topic: log and header stamps (N,) [ns], joint names and raw fields per message."""

    topic: str
    logged: npt.NDArray[np.int64]
    stamped: npt.NDArray[np.int64]
    names: list[tuple[str, ...]]
    fields: dict[str, list[FloatArray]]
    others: tuple[str, ...]  # topics that were not read and may hold commands


def bag_files(path: Path) -> tuple[Path, ...]:
    """The storage files of a bag, given as a folder, its metadata.yaml or a single storage file, in their order.

    Raises:
        ImportFileError: a folder without any.
    """
    if path.name == METADATA:
        path = path.parent
    if not path.is_dir():
        return (path,)
    files = tuple(sorted(file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES or file.suffix == ".zstd"))
    if not files:
        raise ImportFileError("the folder holds no bag: no .db3 and no .mcap file", where=str(path))
    return files


def read_rosbag(
    path: Path, joints: Sequence[str], choices: ImportChoices, progress: Progress = lambda step: None
) -> ForeignTable:
    """Read the sensor_msgs/JointState messages of one topic; time is relative to the first one.

    Args:
        path: a bag's folder, its metadata.yaml, or a bare .db3 or .mcap file.
        joints: the robot's joint names; they are matched message by message, others are left out.
        choices: `topic` where several carry JointState; `columns` name the topic of the commands; `by_order` where the
            names differ.
        progress: called with how many messages were read.

    Raises:
        UsageError: `columns` are something else than commands; a bag has none.
        ImportFileError: damaged, no such topic, a joint missing, a message whose fields differ in length.
    """
    command_source = command_topic(choices.columns, joints)
    if path.name == METADATA:
        path = path.parent
    where = str(path)
    notes: list[Note] = []
    for file in bag_files(path):
        check_input(file, BAG_FILE, ImportFileError)
    if path.is_dir() and (path / METADATA).exists():
        check_input(path / METADATA, BAG_METADATA, ImportFileError)
    files = _openable(path, notes)
    beside = "" if command_source is None else command_source[0]
    read = [_read_messages(file, choices.topic, beside, where, progress) for file in files]
    topics = sorted({messages.topic for messages in read})
    if len(topics) > 1:
        raise _several(topics, where)
    messages = read[0] if len(read) == 1 else _joined(read)
    notes.append(Note("info", f"topic {printable(messages.topic)}, {counted(len(messages.names), 'message')}"))
    if messages.others:
        text = f"not imported, may hold commanded positions (--column target_position=TOPIC): {listed(messages.others)}"
        notes.append(Note("info", text))
    place = f"{where}: {printable(messages.topic)}"
    matches = _matches(messages.names, joints, choices.by_order, place, notes)
    selected = [index for index, names in enumerate(messages.names) if names in matches]
    if len(selected) < len(messages.names):
        notes.append(Note("info", f"{len(messages.names) - len(selected)} messages about other joints were dropped"))
    for match in matches.values():
        notes.extend(note for note in match.notes if note not in notes)
    stamps = _stamps(messages, selected, notes)
    seconds = (stamps - stamps[0]) / SECOND
    notes.append(Note("info", f"time is counted from the first message, stamped {stamps[0] / SECOND:.9f} s"))
    labels = tuple(joints)
    quantities = {}
    for field in _FIELDS:
        values = _gather(messages, field, selected, matches, place)
        if values is not None:
            quantities[field] = QuantityColumns(values, labels, ("",) * len(joints), labels)
    table = ForeignTable("ROS 2 bag", seconds, "s", quantities, tuple(notes))
    if command_source is None:
        return table
    commands = read_commands(files, *command_source, joints, by_order=choices.by_order, where=where)
    return replace(
        table,
        quantities={**quantities, **commands.quantities},
        notes=(*notes, *commands.notes),
        target_time=(commands.stamps - stamps[0]) / SECOND,
        target_time_unit="s",
    )


def _openable(path: Path, notes: list[Note]) -> tuple[Path, ...]:
    """Paths for the reader: the folder where it is complete, else the storage files in it."""
    if path.is_dir():
        if (path / METADATA).exists():
            return (path,)
        files = tuple(file for file in bag_files(path) if file.suffix in STORAGE_SUFFIXES)
        if not files:
            raise ImportFileError(
                f"the folder has compressed files but no {METADATA}",
                where=str(path),
                hint="decompress them with zstd -d",
            )
        notes.append(Note("info", f"no {METADATA}; read {listed(file.name for file in files)}"))
        return files
    if path.with_name(path.name + "-wal").exists():
        notes.append(
            Note("warning", f"{printable(path.name)}-wal beside the file was not read; its messages are missing")
        )
    siblings = [file.name for file in path.parent.glob(f"*{path.suffix}") if file != path]
    if siblings and (path.parent / METADATA).exists():
        notes.append(Note("warning", f"one file of a split bag was read; beside it: {listed(sorted(siblings))}"))
    return (path,)


def _read_messages(path: Path, topic: str | None, beside: str, where: str, progress: Progress) -> _Messages:
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    logged: list[int] = []
    stamped: list[int] = []
    names: list[tuple[str, ...]] = []
    values_read = 0
    fields: dict[str, list[FloatArray]] = {field: [] for field in _FIELDS}
    with parsing(path, "a ROS 2 bag"), Reader(path) as reader:
        connections = _chosen(
            [connection for connection in reader.connections if connection.topic != beside], topic, where
        )
        for _, stamp, raw in reader.messages(connections):
            message: Any = typestore.deserialize_cdr(raw, JOINT_STATE)
            values_read += sum(len(getattr(message, field)) for field in _FIELDS)
            check_count(values_read, path)
            logged.append(stamp)
            stamped.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
            names.append(tuple(message.name))
            for field, values in fields.items():
                values.append(getattr(message, field))
            if len(names) % PROGRESS_STEP == 0:
                progress(f"reading {printable(path.name)}: {len(names):,} messages")
        name = connections[0].topic
        others = {one.topic for one in reader.connections if one.msgtype in TYPES and one.topic not in (name, beside)}
    if not names:
        raise ImportFileError("holds no message", where=f"{where}: {printable(name)}")
    with parsing(path, "a ROS 2 bag"):
        clocks = np.array(logged, dtype=np.int64), np.array(stamped, dtype=np.int64)
    return _Messages(name, *clocks, names, fields, tuple(sorted(others)))


def _chosen(connections: Sequence[Any], topic: str | None, where: str) -> list[Any]:
    """The connections of the one JointState topic that is meant."""
    carrying = [connection for connection in connections if connection.msgtype == JOINT_STATE]
    topics = sorted({connection.topic for connection in carrying})
    if topic is not None:
        if topic not in topics:
            others = {connection.topic: connection.msgtype for connection in connections}
            problem = (
                f"carries {printable(others[topic])}, not {JOINT_STATE}" if topic in others else "is not in the bag"
            )
            raise ImportFileError(
                f"topic {printable(topic)} {problem}; with JointState: {listed(topics) or 'none'}",
                where=where,
                hint=did_you_mean(topic, topics),
            )
        topics = [topic]
    if not topics:
        present = listed(sorted({f"{connection.topic} ({connection.msgtype})" for connection in connections}))
        raise ImportFileError(f"has no topic with {JOINT_STATE}; it has: {present or 'nothing'}", where=where)
    if len(topics) > 1:
        raise _several(topics, where)
    chosen = [connection for connection in carrying if connection.topic == topics[0]]
    formats = {connection.ext.serialization_format for connection in chosen} - {"cdr"}
    if formats:
        raise ImportFileError(f"messages are serialized as {listed(formats)}; only cdr is read", where=where)
    return chosen


def _several(topics: Sequence[str], where: str) -> ImportFileError:
    message = f"JointState is on several topics: {listed(topics)}"
    return ImportFileError(message, where=where, hint="choose one with --topic")


def _joined(bags: Sequence[_Messages]) -> _Messages:
    return _Messages(
        bags[0].topic,
        np.concatenate([bag.logged for bag in bags]),
        np.concatenate([bag.stamped for bag in bags]),
        [names for bag in bags for names in bag.names],
        {field: [values for bag in bags for values in bag.fields[field]] for field in _FIELDS},
        tuple(sorted({topic for bag in bags for topic in bag.others})),
    )


def _matches(
    names: Sequence[tuple[str, ...]], joints: Sequence[str], by_order: bool, where: str, notes: list[Note]
) -> dict[tuple[str, ...], JointMatch]:
    """Distinct name lists of the messages that hold the robot's joints → where they are in them."""
    distinct = list(dict.fromkeys(names))
    related = [given for given in distinct if shares_joints(given, joints)]
    if not related:
        # Nothing fits by name; by order only one list of names can be meant.
        if len(distinct) > 1 and by_order:
            raise ImportFileError(
                f"joint names change from message to message: {' | '.join(listed(given) for given in distinct[:4])}",
                where=where,
                hint="joints cannot be matched by order then; rename the robot file's joints",
            )
        related = distinct[:1]
    matches = {}
    for given in related:
        first = names.index(given)
        matches[given] = match_joints(given, joints, by_order=by_order, where=f"{where}, message {first}")
    if len({match.columns for match in matches.values()}) > 1:
        notes.append(Note("info", "the order of the joints changes between messages; each was matched by its names"))
    return matches


def _stamps(messages: _Messages, selected: Sequence[int], notes: list[Note]) -> npt.NDArray[np.int64]:
    stamps: npt.NDArray[np.int64] = messages.stamped[selected]
    if stamps.any():
        return stamps
    notes.append(Note("warning", "all header stamps are zero; receive times, with their jitter, were used"))
    logged: npt.NDArray[np.int64] = messages.logged[selected]
    return logged


def _gather(
    messages: _Messages, field: str, selected: Sequence[int], matches: dict[tuple[str, ...], JointMatch], where: str
) -> FloatArray | None:
    """(N, n) in the robot's order; None where every message leaves the field empty."""
    raw = messages.fields[field]
    first_filled = next((index for index in selected if len(raw[index])), None)
    if first_filled is None:
        return None
    rows = []
    for index in selected:
        given = messages.names[index]
        if len(raw[index]) != len(given):
            raise ImportFileError(
                f"names {counted(len(given), 'joint')}, but has {counted(len(raw[index]), 'value')} of {field}"
                + (f" (message {first_filled} has them)" if not len(raw[index]) else ""),
                where=f"{where}, message {index}",
            )
        rows.append(raw[index][list(matches[given].columns)])
    return np.array(rows, dtype=np.float64)
