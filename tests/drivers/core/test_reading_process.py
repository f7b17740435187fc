"""A file is read in a process of its own: what loops, crashes or fills memory there is refused in one line."""

from __future__ import annotations

import collections
import contextlib
import itertools
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from drivers.core import reading_process
from drivers.core.errors import ImportFileError, RecordingError
from drivers.core.reading_process import Progress, read_apart
from drivers.core.terminal import open_standard_streams

PATH = Path("run.h5")

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def children() -> set[str]:
    """This process's children; other tests of the same worker may have left pools."""
    return {child for task in Path("/proc/self/task").glob("*/children") for child in task.read_text().split()}


@pytest.fixture(autouse=True)
def _no_process_is_left():
    before = children()
    yield
    assert children() <= before


def test_the_result_and_the_progress_come_back() -> None:
    steps: list[str] = []

    def read(progress: Progress) -> tuple[int, np.ndarray]:
        progress("one")
        progress("two")
        return os.getpid(), np.arange(12.0).reshape(3, 4).T

    process, values = read_apart(read, PATH, RecordingError, progress=steps.append)
    assert process != os.getpid()
    assert steps == ["one", "two"]
    np.testing.assert_array_equal(values, np.arange(12.0).reshape(3, 4).T)
    assert values.flags.writeable


@pytest.mark.parametrize("opened", [False, True])
def test_a_process_without_standard_streams_reads_as_well(opened: bool) -> None:
    """Opened on nothing, they stay open in processes that it starts."""
    process = os.fork()
    if process == 0:
        ended = 1
        try:
            os.closerange(0 if opened else 1, 3)
            if opened:
                open_standard_streams()
            inherited = opened and all(map(os.get_inheritable, range(3)))
            ended = 2 * (inherited == opened) if read_apart(lambda progress: 7, PATH, RecordingError) == 7 else 1
        finally:
            os._exit(ended)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 2


def test_an_error_for_people_keeps_its_words() -> None:
    def read(progress: Progress) -> None:
        raise ImportFileError("is wrong", where="run.csv, line 3", hint="mend it")

    with pytest.raises(ImportFileError) as caught:
        read_apart(read, PATH, RecordingError)
    assert (caught.value.message, caught.value.where, caught.value.hint) == ("is wrong", "run.csv, line 3", "mend it")


def test_a_bug_keeps_its_traceback() -> None:
    def faulty(progress: Progress) -> None:
        raise KeyError(lambda: None)  # cannot be pickled

    with pytest.raises(RuntimeError, match="in faulty"):
        read_apart(faulty, PATH, RecordingError)


def endless_in_a_library() -> None:
    collections.deque(itertools.count(), maxlen=0)  # never looks at signals


def endless_in_python() -> None:
    while True:
        pass


@pytest.mark.parametrize("endless", [endless_in_a_library, endless_in_python])
def test_an_endless_loop_is_ended(endless) -> None:
    with pytest.raises(RecordingError, match=r"run.h5: cannot be read within 1 s of processor time"):
        read_apart(lambda progress: endless(), PATH, RecordingError, time_limit=1.0, waiting_limit=3600.0)


@pytest.mark.parametrize("read", [lambda: bytes(10**10), lambda: [bytes(10**7) for _ in range(1000)]])
def test_memory_is_limited(monkeypatch, read) -> None:
    monkeypatch.setattr(reading_process, "MEMORY_LIMIT", 10**8)
    with pytest.raises(RecordingError, match=r"run.h5: takes more than 100 MB of memory to read"):
        read_apart(lambda progress: read(), PATH, RecordingError)


class Greedy:
    """Takes all memory while it is handed over."""

    def __reduce__(self) -> str:
        raise MemoryError


def test_a_result_that_cannot_be_handed_over_for_want_of_memory_is_refused() -> None:
    with pytest.raises(RecordingError, match="of memory to read"):
        read_apart(lambda progress: [np.ones(1_000_000), Greedy()], PATH, RecordingError)


def test_a_crash_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"run.h5: is damaged: the library that reads it crashed \(SIGSEGV\)"):
        read_apart(lambda progress: os.kill(os.getpid(), signal.SIGSEGV), PATH, RecordingError)


def test_what_is_unpacked_to_the_disk_is_limited(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(reading_process, "UNPACKED_LIMIT", 10_000)

    def read(progress: Progress) -> int:
        with contextlib.suppress(OSError):
            (tmp_path / "unpacked").write_bytes(bytes(20_000))
        return (tmp_path / "unpacked").stat().st_size

    assert read_apart(read, PATH, RecordingError) <= 10_000


def test_an_interruption_ends_the_process_too() -> None:
    def interrupt(step: str) -> None:
        raise KeyboardInterrupt

    def read(progress: Progress) -> None:
        progress("begun")
        endless_in_python()

    with pytest.raises(KeyboardInterrupt):
        read_apart(read, PATH, RecordingError, progress=interrupt)
