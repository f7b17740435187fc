"""Input files, only regular ones of a bounded size, so that no input makes a command wait or fill memory; and locks.

Every reader of a file goes through this module. A library that opens a file by its name gets it after `check_input`.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from drivers.core.errors import InputError, UsageError

KB, MB, GB = 10**3, 10**6, 10**9


@dataclass(frozen=True)
class InputKind:
    """A kind of input file."""

    name: str  # in words, with the article
    largest: int  # size [B] that is read; what is larger takes more than 20 s or 2 GB to read, or is no such file


HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file."""

ROBOT_FILE = InputKind("a robot file", 500 * KB)
URDF_FILE = InputKind("a URDF", 10 * MB)
MESH_FILE = InputKind("a mesh", 50 * MB)
FLEET_FILE = InputKind("a fleet file", 5 * MB)
LIMITS_FILE = InputKind("a file of limits", 500 * KB)
DATASET_FILE = InputKind("a data set of the benchmark", 500 * KB)
DBC_FILE = InputKind("a DBC file", 4 * MB)
TRAJECTORY_FILE = InputKind("a trajectory", MB)
TRAJECTORY_SAMPLES = InputKind("a trajectory's CSV file", 5 * MB)
RESULT_FILE = InputKind("a result", 50 * MB)
HISTORY_FILE = InputKind("a history", GB)
RECORDING_FILE = InputKind("a recording", 2 * GB)
LONG_RECORDING_FILE = InputKind("a recording", 1000 * GB)
TEXT_TABLE = InputKind("a text file of samples", 250 * MB)
ARRAY_FILE = InputKind("a file of samples", GB)
BAG_FILE = InputKind("a bag", 2 * GB)
DATASET_META = InputKind("a dataset's JSON file", MB)
BAG_METADATA = InputKind("a bag's metadata.yaml", MB)

MOST_VALUES = 64_000_000
"""Numbers of one foreign file, and those of any HDF5 file that it declares without holding them: 512 MB."""


def path_of(given: object, hint: str = "") -> Path:
    """The path that a caller of Python gave.

    Raises:
        UsageError: it is none.
    """
    if not isinstance(given, (str, PathLike)):
        raise UsageError(f"{given_kind(given)} is not a path", hint=hint or "give it as text, or as a pathlib.Path")
    return Path(given)


def given_kind(given: object) -> str:
    """Return what a caller of Python gave, with its article: `an int`, `a DataFrame`, `None`."""
    name = type(given).__name__
    return "None" if given is None else f"{'an' if name[0] in 'aeiouAEIOU' else 'a'} {name}"


def check_utf8(given: str, refusal: type[InputError]) -> None:
    """Check that a name or text can be written into a file: bytes that were not UTF-8 are halves of pairs in it.

    Raises:
        InputError: `refusal`, where it cannot.
    """
    try:
        given.encode()
    except UnicodeEncodeError as error:
        raise refusal("holds bytes that are not UTF-8", where=given, hint="rename the file, or type it anew") from error


def check_input(path: Path, kind: InputKind, refusal: type[InputError], hint: str = "") -> int:
    """Check that a file may be opened by its name; its size [B].

    `hint` is what to do where there is no such file.

    Raises:
        InputError: `refusal`, where it is missing, no regular file (a folder, FIFO or device), or too large, or its
            name is not UTF-8.
    """
    where = str(path)
    check_utf8(path.name, refusal)
    try:
        about = path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise refusal("no such file", where=where, hint=hint) from error
    except (OSError, ValueError) as error:  # no right to its folder, too long a name; a NUL in it
        raise _unreadable(error, path, refusal) from error
    if not stat.S_ISREG(about.st_mode):
        is_folder = stat.S_ISDIR(about.st_mode)
        raise refusal(
            "is a folder, not a file" if is_folder else f"is not a regular file, so it is not read as {kind.name}",
            where=where,
            hint=f"name {kind.name} in it" if is_folder else "",
        )
    if about.st_size > kind.largest:
        raise _too_large(kind, path, refusal)
    return about.st_size


@contextmanager
def open_input(path: Path, kind: InputKind, refusal: type[InputError], hint: str = "") -> Iterator[BinaryIO]:
    """A file that was checked by `check_input`, open for reading.

    Raises:
        InputError: as `check_input`, or it cannot be opened.
    """
    check_input(path, kind, refusal, hint)
    try:
        # Opening never waits, should the name lead to a FIFO by now.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise _unreadable(error, path, refusal) from error
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise refusal(f"is not a regular file, so it is not read as {kind.name}", where=str(path))
        try:
            yield file
        except OSError as error:  # its disk fails
            raise _unreadable(error, path, refusal) from error


def read_bytes(path: Path, kind: InputKind, refusal: type[InputError], hint: str = "") -> bytes:
    """All bytes of a file.

    Raises:
        InputError: as `open_input`, or it cannot be read.
    """
    with open_input(path, kind, refusal, hint) as file:
        content = file.read(kind.largest + 1)  # a file may say it is empty and go on for ever, as those of /proc
    if len(content) > kind.largest:
        raise _too_large(kind, path, refusal)
    return content


def read_text(path: Path, kind: InputKind, refusal: type[InputError], hint: str = "") -> str:
    """A file's text: UTF-8, with or without a byte order mark, line ends as in Unix.

    Raises:
        InputError: as `read_bytes`, or it is not UTF-8.
    """
    content = read_bytes(path, kind, refusal, hint)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if content.startswith(HDF5_SIGNATURE):
            raise refusal(f"is an HDF5 file, as recordings are, and not {kind.name}", where=str(path)) from error
        line = content[: error.start].count(b"\n") + 1
        raise refusal(
            f"cannot be read: is not UTF-8 text ({error.reason})", where=f"{path}, line {line}", hint="save it as UTF-8"
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def size_text(size: int) -> str:
    """A size [B] as people write it: `500 kB`, `2 GB`."""
    unit, name = next(((unit, name) for unit, name in ((GB, "GB"), (MB, "MB")) if size >= unit), (KB, "kB"))
    return f"{size / unit:.4g} {name}"


def _too_large(kind: InputKind, path: Path, refusal: type[InputError]) -> InputError:
    return refusal(f"is larger than {size_text(kind.largest)}, too large for {kind.name}", where=str(path))


def _unreadable(error: Exception, path: Path, refusal: type[InputError]) -> InputError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return refusal(f"cannot be read: {reason}", where=str(path))


@contextmanager
def held_lock(key: str) -> Iterator[bool]:
    """Hold the lock of a name; false where it is held already. Computers without `flock` have no locks.

    Programs with one folder for temporary files share it.

    Raises:
        OSError: there is no place for temporary files.
        InputError: files of that place cannot be locked.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield True
        return
    name = hashlib.sha256(key.encode(errors="surrogateescape")).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"dynid-{name}.lock"
    while True:
        descriptor = _opened(path)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            if not isinstance(error, BlockingIOError):  # a file system without locks
                raise InputError(
                    f"cannot be locked: {error.strerror}", where=str(path), hint="set TMPDIR to a folder elsewhere"
                ) from error
            yield False
            return
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                break
        os.close(descriptor)  # its last holder has removed it meanwhile
    try:
        yield True
    finally:
        with suppress(OSError):  # another user's, in a folder where such files stay
            path.unlink()
        os.close(descriptor)


def _opened(path: Path) -> int:
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK  # a FIFO of that name would let it wait
    with suppress(PermissionError):  # another user's, in a folder where such files are not created over
        return os.open(path, flags | os.O_CREAT, 0o666)
    return os.open(path, flags)
