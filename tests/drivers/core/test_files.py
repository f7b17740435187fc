"""Input files: regular ones of a bounded size are read, everything else is refused at once."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import InputError, UsageError
from drivers.core.files import HDF5_SIGNATURE, InputKind, check_input, held_lock, read_bytes, read_text, size_text

SMALL = InputKind("a small file", 100)


def make_fifo(path: Path) -> None:
    os.mkfifo(path)


def make_zeros(path: Path) -> None:
    path.symlink_to("/dev/zero")


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


def make_link_to_fifo(path: Path) -> None:
    os.mkfifo(path.with_name("behind"))
    path.symlink_to("behind")


def make_large(path: Path) -> None:
    path.touch()
    os.truncate(path, 10**12)  # a hole: no disk is used


WRONG = {
    "not a regular file, so it is not read as a small file": (make_fifo, make_zeros, make_socket, make_link_to_fifo),
    "is larger than 0.1 kB, too large for a small file": (make_large,),
    "is a folder, not a file": (Path.mkdir,),
    "no such file": (lambda path: None, lambda path: path.symlink_to("nowhere")),
}


@pytest.mark.parametrize(("words", "make"), [(words, make) for words, makers in WRONG.items() for make in makers])
def test_what_is_no_small_regular_file_is_refused_before_it_is_opened(tmp_path: Path, words: str, make) -> None:
    path = tmp_path / "given"
    make(path)
    for read in (check_input, read_bytes, read_text):
        with pytest.raises(UsageError, match=words) as caught:
            read(path, SMALL, UsageError)
        assert caught.value.where == str(path)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "file/below", "a\udcffb"])
def test_a_name_that_cannot_be_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"cannot be read|no such file|not UTF-8"):
        read_bytes(tmp_path / name, SMALL, UsageError)


@pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="no /proc")
def test_a_file_that_says_it_is_empty_but_goes_on_is_refused() -> None:
    assert check_input(Path("/proc/self/smaps"), SMALL, UsageError) == 0
    with pytest.raises(UsageError, match="is larger than"):
        read_bytes(Path("/proc/self/smaps"), SMALL, UsageError)


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="no /proc")
def test_a_file_that_cannot_be_read_to_its_end_is_named() -> None:
    with pytest.raises(UsageError, match="/proc/self/mem: cannot be read: Input/output error"):
        read_bytes(Path("/proc/self/mem"), SMALL, UsageError)


def test_a_recording_in_place_of_a_text_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "run.h5").write_bytes(HDF5_SIGNATURE + bytes(40))
    with pytest.raises(UsageError, match="is an HDF5 file, as recordings are, and not a ") as refused:
        read_text(tmp_path / "run.h5", SMALL, UsageError)
    assert refused.value.hint == ""


@given(st.binary(max_size=130))
def test_any_bytes_are_read_as_they_are_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any"
    path.write_bytes(content)
    if len(content) > SMALL.largest:
        with pytest.raises(UsageError, match="is larger than"):
            read_bytes(path, SMALL, UsageError)
        return
    assert read_bytes(path, SMALL, UsageError) == content
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        with pytest.raises(UsageError, match="is not UTF-8"):
            read_text(path, SMALL, UsageError)
    else:
        assert read_text(path, SMALL, UsageError) == text


def test_a_lock_is_never_waited_for_and_what_cannot_be_locked_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with held_lock("name") as held, held_lock("name") as again:
        assert (held, again) == (True, False)
        (lock,) = tmp_path.iterdir()
    os.mkfifo(lock)
    with held_lock("name") as held:
        assert held

    def unlockable(*_: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", unlockable)
    with pytest.raises(InputError, match=f"{lock}: cannot be locked: No locks available"), held_lock("name"):
        pass


def test_sizes_are_written_as_people_do() -> None:
    assert [size_text(size) for size in (500_000, 10**6, 2 * 10**9, 2_500_000)] == ["500 kB", "1 MB", "2 GB", "2.5 MB"]
