"""ROS 2 bags that cannot be taken over as they are: each with its message, none with a traceback."""

from __future__ import annotations

import functools
import shutil
import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_state_bag import write_bag
from three_links import NAMES, accept_or_refuse, make_robot, samples

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from drivers.core.errors import ImportFileError, UsageError

ROBOT = make_robot()


def bag_of(folder: Path, count: int = 50, **more: Any) -> Path:
    return write_bag(folder, samples(count), start=1_000_000_000, **more)


def rename(*names: str) -> Callable[[int, dict[str, Any]], None]:
    def edit(_: int, fields: dict[str, Any]) -> None:
        fields.update(
            name=list(names), position=np.zeros(len(names)), velocity=np.zeros(0), effort=np.zeros(len(names))
        )

    return edit


def shorten(name: str, at: int) -> Callable[[int, dict[str, Any]], None]:
    def edit(index: int, fields: dict[str, Any]) -> None:
        if index == at:
            fields[name] = fields[name][:-1]

    return edit


def vanish(index: int, fields: dict[str, Any]) -> None:
    if index > 10:
        fields["velocity"] = np.zeros(0)


def lose_a_joint(index: int, fields: dict[str, Any]) -> None:
    if index > 10:
        for name in fields:
            fields[name] = fields[name][:2]


def alternate(index: int, fields: dict[str, Any]) -> None:
    fields["name"] = ["a", "b", "c"] if index % 2 else ["c", "b", "a"]


TORQUE = ImportChoices(effort="torque")
BOTH_ARMS = tuple(f"{side}_{name}" for side in ("left", "right") for name in NAMES)


@pytest.mark.parametrize(
    ("options", "choices", "message"),
    [
        ({}, ImportChoices(), "--effort torque or --effort current"),
        ({"topics": ()}, TORQUE, r"no topic with sensor_msgs/msg/JointState; it has: /chatter \(std_msgs/msg/String\)"),
        ({"topics": ("/a", "/b")}, TORQUE, "several topics: /a, /b .choose one with --topic"),
        ({}, ImportChoices(topic="/joint_stats"), "/joint_stats is not in the bag.*did you mean '/joint_states'"),
        ({}, ImportChoices(topic="/chatter"), "/chatter carries std_msgs/msg/String, not sensor_msgs/msg/JointState"),
        ({"count": 0}, TORQUE, "/joint_states: holds no message"),
        ({"count": 1}, TORQUE, r"holds 1 sample;"),
        (
            {"edit": rename("shoulder", "elbow", "hand")},
            TORQUE,
            "no joint wrist; it has: shoulder, elbow, hand.*--by-order",
        ),
        (
            {"edit": rename("a", "b")},
            ImportChoices(effort="torque", by_order=True),
            "by order needs 3 joints, the file has 2",
        ),
        ({"edit": rename()}, TORQUE, "has no joint shoulder, elbow, wrist; it has: none"),
        ({"edit": rename(*BOTH_ARMS)}, TORQUE, "several prefixes: left_, right_"),
        (
            {"edit": alternate},
            ImportChoices(effort="torque", by_order=True),
            "joint names change from message to message",
        ),
        ({"edit": shorten("position", 7)}, TORQUE, "message 7: names 3 joints, but has 2 values of position"),
        ({"edit": shorten("name", 7)}, TORQUE, "message 7: has no joint wrist"),
        ({"edit": lose_a_joint}, TORQUE, "message 11: has no joint wrist"),
        ({"edit": vanish}, TORQUE, r"message 11: names 3 joints, but has 0 values of velocity \(message 0 has them\)"),
        ({}, ImportChoices(rate=100.0), "has 'effort'"),
        ({}, ImportChoices(effort="torque", rate=100.0), "--rate 100 would discard them"),
    ],
)
@pytest.mark.parametrize("mcap", [False, True])
def test_bags_refused_with_their_message(
    tmp_path: Path, mcap: bool, options: dict[str, Any], choices: ImportChoices, message: str
) -> None:
    with pytest.raises(ImportFileError, match=message):
        import_file(bag_of(tmp_path, mcap=mcap, **options), ROBOT, choices)


def test_one_of_several_topics_can_be_chosen(tmp_path: Path) -> None:
    path = bag_of(tmp_path, topics=("/a", "/b"))
    recording = import_file(path, ROBOT, ImportChoices(effort="torque", topic="/b"))
    assert any("topic /b, 50 messages" in event.message for event in recording.events)


def test_columns_make_no_sense_for_a_bag(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="a bag has no columns to map"):
        import_file(bag_of(tmp_path), ROBOT, ImportChoices(columns={"t": "stamp"}))


@functools.cache
def bag_content(mcap: bool) -> bytes:
    with tempfile.TemporaryDirectory() as name:
        bag = bag_of(Path(name), mcap=mcap)
        return next(file for file in bag.iterdir() if file.suffix in (".db3", ".mcap")).read_bytes()


@pytest.mark.parametrize("mcap", [False, True])
@settings(max_examples=10, deadline=None)
@given(share=st.floats(0.0, 0.999), position=st.floats(0, 1), noise=st.binary(min_size=1, max_size=30))
def test_cut_and_spoilt_bags_never_give_a_traceback(mcap: bool, share: float, position: float, noise: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        content, bare = bag_content(mcap), Path(name) / ("bare.mcap" if mcap else "bare.db3")
        bare.write_bytes(content[: int(share * len(content))])
        accept_or_refuse(bare, TORQUE)
        start = int(position * (len(content) - len(noise)))
        bare.write_bytes(content[:start] + noise + content[start + len(noise) :])
        accept_or_refuse(bare, TORQUE)


def test_a_cut_bag_says_so(tmp_path: Path) -> None:
    for mcap, expected in ((False, "cannot be read as a ROS 2 bag"), (True, "cannot be read as a ROS 2 bag")):
        bag = bag_of(tmp_path, mcap=mcap)
        storage = next(file for file in bag.iterdir() if file.suffix in (".db3", ".mcap"))
        storage.write_bytes(storage.read_bytes()[: storage.stat().st_size // 2])
        for path in (storage, bag):
            with pytest.raises(ImportFileError, match=expected):
                import_file(path, ROBOT, TORQUE)
        shutil.rmtree(bag)


def test_unmerged_journals_and_split_bags_are_mentioned(tmp_path: Path) -> None:
    bag = bag_of(tmp_path)
    storage = bag / "bag.db3"
    (bag / "bag.db3-wal").write_bytes(b"pending")
    shutil.copy(storage, bag / "bag_1.db3")
    text = " ".join(event.message for event in import_file(storage, ROBOT, TORQUE).events)
    assert "bag.db3-wal beside the file was not read" in text
    assert "one file of a split bag was read; beside it: bag_1.db3" in text


def test_a_foreign_database_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "run.db3") as connection:
        connection.execute("CREATE TABLE notes (text TEXT)")
    with pytest.raises(ImportFileError, match="database missing tables"):
        import_file(tmp_path / "run.db3", ROBOT, TORQUE)
