"""The file of a history: added once, by several writers, never lost, and refused in a line where it is none."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sqlite3
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_histories import entry, worn_arm
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import DynidError, ResultFileError, UsageError
from ident.history import database
from ident.history.database import add_entries, check_history, read_entries


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("history") / "arm.db"
    add_entries(path, worn_arm(1, 6, {"Fs1": 0.0, "Fs2": 0.1}))
    return path.read_bytes()


def test_what_is_added_is_read_and_added_once(tmp_path):
    path = tmp_path / "arm.db"
    entries = worn_arm(1, 5, {"Fs2": 0.1, "Fs1": 0.0})
    assert add_entries(path, entries[:3]) == 3
    assert add_entries(path, entries) == 2
    assert add_entries(path, entries) == 0
    ordered = [replace(one, values=tuple(sorted(one.values, key=lambda value: value.name))) for one in entries]
    assert read_entries(path) == ordered
    check_history(path)
    assert list(tmp_path.iterdir()) == [path]


def add_one(path: Path, number: int) -> None:
    add_entries(path, [entry(number, number, {"Fs1": (1.0, 0.1)})])


@pytest.mark.realtime
def test_twenty_writers_at_once_and_one_that_is_killed_lose_nothing(tmp_path):
    path = tmp_path / "arm.db"
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=add_one, args=(path, number)) for number in range(20)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60.0)
    assert [writer.exitcode for writer in writers] == [0] * 20
    assert len(read_entries(path)) == 20

    # A writer that dies with half of its rows in the file: its journal takes them back.
    child = os.fork()
    if child == 0:
        connection = sqlite3.connect(path, isolation_level=None)
        connection.execute("PRAGMA cache_size=1")
        connection.execute("BEGIN IMMEDIATE")
        for number in range(3000):
            connection.execute("INSERT INTO result VALUES (?,'','','','','',0,'','','')", (f"{number:0100}",))
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert Path(f"{path}-journal").stat().st_size > 0
    assert path.stat().st_size > 100_000
    assert len(read_entries(path)) == 20
    add_one(path, 20)
    assert len(read_entries(path)) == 21


def test_a_file_that_is_held_is_refused_in_a_line(tmp_path, kept, monkeypatch):
    path = tmp_path / "arm.db"
    path.write_bytes(kept)
    monkeypatch.setattr(database, "PATIENCE", 0.0)
    holder = sqlite3.connect(path, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    with pytest.raises(UsageError, match="locked by another program"):
        add_one(path, 30)
    with pytest.raises(UsageError, match="locked by another program"):
        read_entries(path)
    holder.close()
    assert len(read_entries(path)) == 6


def test_what_is_no_history_is_refused_in_a_line(tmp_path, kept):
    foreign = tmp_path / "foreign.db"
    with sqlite3.connect(foreign) as connection:
        connection.execute("CREATE TABLE mine (x)")
    before = foreign.read_bytes()
    newer = tmp_path / "newer.db"
    newer.write_bytes(kept[:60] + b"\0\0\0\x02" + kept[64:])
    text = tmp_path / "text.db"
    text.write_text("a history " * 100)
    empty = tmp_path / "empty.db"
    empty.touch()
    trigger = tmp_path / "trigger.db"
    trigger.write_bytes(kept)
    with sqlite3.connect(trigger) as connection:
        connection.execute("CREATE TRIGGER t AFTER INSERT ON result BEGIN DELETE FROM value; END")
    link = tmp_path / "link.db"
    link.symlink_to("nowhere")
    said = {
        foreign: "another program", newer: "schema version 2", text: "is not a history", empty: "no results yet",
        trigger: "its tables", link: "no such file", tmp_path: "a folder", tmp_path / "none.db": "no such file",
    }  # fmt: skip
    for path, words in said.items():
        with pytest.raises(ResultFileError, match=words):
            read_entries(path)
        if path.name not in ("empty.db", "none.db"):
            with pytest.raises(DynidError):
                add_one(path, 1)
    assert foreign.read_bytes() == before
    with pytest.raises(UsageError, match="no such folder"):
        add_one(tmp_path / "no" / "arm.db", 1)
    add_one(empty, 1)
    assert len(read_entries(empty)) == 1


@given(cut=st.integers(0, 40_000), at=st.integers(0, 40_000), garbage=st.binary(min_size=1, max_size=60))
def test_damaged_files_are_read_or_refused_in_a_line(kept, tmp_path_factory, cut, at, garbage):
    path = tmp_path_factory.getbasetemp() / "damaged.db"
    damaged = bytearray(kept)
    at %= len(damaged)
    damaged[at : at + len(garbage)] = garbage
    for content in (bytes(damaged), kept[: cut % len(kept)], garbage):
        path.write_bytes(content)
        with suppress(DynidError):  # nothing else is raised
            assert np.isfinite([value.std for one in read_entries(path) for value in one.values]).all()
