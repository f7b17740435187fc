"""The file of a history: SQLite with a rollback journal, so that a killed writer leaves what was there before it.

A writer holds the file for the milliseconds of its transaction; others wait for it. The journal is synchronised before
the file (`synchronous=EXTRA`). There is no write-ahead log: its shared memory does not work on network file systems,
and its side files would have to be copied along.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import astuple, fields
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from drivers.core.errors import DiskError, DynidError, ResultFileError, UsageError
from drivers.core.files import HISTORY_FILE, check_input
from ident.history.entry import HistoryEntry, KeptValue

APPLICATION = 0x64796E68
"""`application_id` of the file: "dynh"."""

SCHEMA = 1

TABLES = {
    "result": "CREATE TABLE result (digest TEXT PRIMARY KEY, arm TEXT NOT NULL, data TEXT NOT NULL, "
    "robot TEXT NOT NULL, serial TEXT NOT NULL, kind TEXT NOT NULL, time REAL NOT NULL, created TEXT NOT NULL, "
    "source TEXT NOT NULL, added TEXT NOT NULL) STRICT, WITHOUT ROWID",
    "value": "CREATE TABLE value (digest TEXT NOT NULL REFERENCES result, name TEXT NOT NULL, joint TEXT NOT NULL, "
    "kind TEXT NOT NULL, unit TEXT NOT NULL, basis TEXT NOT NULL, value REAL NOT NULL, std REAL NOT NULL, "
    "temperature REAL, PRIMARY KEY (digest, name)) STRICT, WITHOUT ROWID",
}

PATIENCE = 30.0
"""Time [s] that a writer waits for others."""


def check_history(path: Path) -> None:
    """Check that results can be added to a history, before they are computed; it need not exist.

    Raises:
        UsageError: its folder does not exist; or as `add_entries`.
    """
    if path.exists() or path.is_symlink():
        with _opened(path, write=True):
            return
    if not path.parent.is_dir():
        raise UsageError("there is no such folder", where=str(path.parent), hint="create it, or choose another one")


def add_entries(path: Path, entries: Sequence[HistoryEntry]) -> int:
    """Add what is not in a history yet, all of it or nothing; the file is made where it does not exist.

    Returns:
        How many were new.

    Raises:
        UsageError: the file may not be written, or another program has held it for long.
        ResultFileError: it is not a history, is damaged, or of a newer dynid.
        DiskError: the disk is full or fails.
    """
    check_history(path)
    added = datetime.now(UTC).isoformat(timespec="seconds")
    new = 0
    with _opened(path, write=True) as database:
        for entry in entries:
            row = (
                entry.digest, entry.arm, entry.data, entry.robot, entry.serial, entry.kind, entry.time, entry.created,
                entry.source, added,
            )  # fmt: skip
            cursor = database.execute(f"INSERT OR IGNORE INTO result VALUES ({_marks(row)})", row)
            if cursor.rowcount != 1:
                continue
            new += 1
            rows = [(entry.digest, *astuple(value)) for value in entry.values]
            database.executemany(f"INSERT OR IGNORE INTO value VALUES ({_marks(rows[0])})", rows)
    return new


def read_entries(path: Path) -> list[HistoryEntry]:
    """All results of a history, in the order of their times.

    Raises:
        ResultFileError: no such file, no history, or damaged.
        UsageError: another program has held it for long.
    """
    names = [of.name for of in fields(KeptValue)]
    columns = [of.name for of in fields(HistoryEntry) if of.name != "values"]
    with _opened(path, write=False) as database:
        values: dict[str, list[KeptValue]] = {}
        for digest, *row in database.execute(f"SELECT digest, {', '.join(names)} FROM value ORDER BY digest, name"):
            values.setdefault(digest, []).append(KeptValue(*row))
        rows = database.execute(f"SELECT {', '.join(columns)} FROM result ORDER BY time, created, digest")
        entries = [
            HistoryEntry(**dict(zip(columns, row, strict=True)), values=tuple(values.get(row[0], ()))) for row in rows
        ]
    numbers = [number for entry in entries for value in entry.values for number in (value.value, value.std)]
    if not all(map(math.isfinite, [*numbers, *(entry.time for entry in entries)])):
        raise _damaged(path, "a number is not finite")
    return entries


def _marks(row: Sequence[object]) -> str:
    return ", ".join("?" * len(row))


@contextmanager
def _opened(path: Path, *, write: bool) -> Iterator[sqlite3.Connection]:
    """The database in a transaction, checked; on an error nothing is written."""
    exists = path.exists() or path.is_symlink()
    if exists or not write:
        check_input(path, HISTORY_FILE, ResultFileError, "dynid history add RESULT --history FILE makes one")
    try:
        # Reading, too, may have to take back what a killed writer left, and so needs the right to write.
        mode = "rwc" if write else "rw" if _writable(path) else "ro"
        address = f"file:{quote(str(path.absolute()), errors='surrogateescape')}?mode={mode}"
        with closing(sqlite3.connect(address, uri=True, timeout=PATIENCE, isolation_level=None)) as database:
            database.execute("PRAGMA trusted_schema=OFF")
            database.execute("PRAGMA synchronous=EXTRA")
            database.execute("BEGIN IMMEDIATE" if write else "BEGIN")
            try:
                _check(database, path, write=write)
                yield database
                database.execute("COMMIT")
            finally:
                if database.in_transaction:
                    database.execute("ROLLBACK")
    except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        raise _refused(error, path) from error


def _writable(path: Path) -> bool:
    import os

    return os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)


def _check(database: sqlite3.Connection, path: Path, *, write: bool) -> None:
    """Make the tables in an empty file; else whether they are those of a history."""
    tables = dict(database.execute("SELECT name, sql FROM sqlite_schema WHERE name NOT LIKE 'sqlite_autoindex_%'"))
    application = database.execute("PRAGMA application_id").fetchone()[0]
    version = database.execute("PRAGMA user_version").fetchone()[0]
    if not tables and application == 0:
        if not write:
            raise ResultFileError("holds no results yet", where=str(path), hint="dynid history add RESULT --history …")
        for text in TABLES.values():
            database.execute(text)
        database.execute(f"PRAGMA application_id={APPLICATION}")
        database.execute(f"PRAGMA user_version={SCHEMA}")
        return
    if application != APPLICATION:
        raise ResultFileError("is a database of another program", where=str(path), hint="choose another file")
    if version > SCHEMA:
        raise ResultFileError(
            f"has schema version {version}, this version of dynid reads up to {SCHEMA}",
            where=str(path),
            hint="update dynid",
        )
    if tables != TABLES:
        raise _damaged(path, "its tables are not those of a history")
    said = database.execute("PRAGMA quick_check(1)").fetchone()[0]
    if said != "ok":
        raise _damaged(path, said)


def _damaged(path: Path, said: str) -> ResultFileError:
    return ResultFileError(
        f"is damaged: {said}", where=str(path), hint="use a copy of it, or add the results to a new file"
    )


def _refused(error: Exception, path: Path) -> DynidError:
    """Return what SQLite's error means to a person."""
    code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
    where = str(path)
    if code == sqlite3.SQLITE_NOTADB:
        return ResultFileError("is not a history", where=where, hint="choose another file")
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return UsageError(
            f"has been locked by another program for {PATIENCE:.0f} s", where=where, hint="try again when it has ended"
        )
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM):
        return DiskError(f"cannot be written: {error}", where=where, hint="nothing was added; make room")
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_AUTH):
        return UsageError(
            f"cannot be opened: {error}", where=where, hint="choose a file and a folder that you may write to"
        )
    return _damaged(path, str(error))
