"""Reading in a process of its own, of bounded memory and processor time, so that no content of a file can hang dynid.

The libraries behind the formats (HDF5, SQLite, zstd, zlib, …) may loop, crash or ask for any memory on bytes that they
do not expect. No check beforehand can exclude that, but a process can be ended from outside.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, BinaryIO, NoReturn, TypeVar

from drivers.core.errors import DynidError, InputError
from drivers.core.files import GB, size_text

if sys.platform == "linux":
    import resource

APART = sys.platform == "linux"
"""Whether files are read in a process of their own."""
Result = TypeVar("Result")
Progress = Callable[[str], None]
"""Tells a user what is being done."""

TIME_LIMIT = 15.0
"""Processor time [s] for one file; the largest of numbers, 64 million, take about 5 s."""
WAITING_LIMIT = 120.0
"""Time by the clock [s]: a library may sleep, too. A busy computer takes several times the processor time."""
MEMORY_LIMIT = 1_300_000_000
"""Memory [B] beside what the process has already; with the result, which is handed over, and what dynid itself takes,
2 GB."""
UNPACKED_LIMIT = 2 * GB
"""Size [B] of any file that is written while reading: compressed files of a bag are unpacked to the disk."""
_TIME_TO_CLEAN_UP = 1
"""[s] from the first signal to the last."""


class _OutOfTimeError(BaseException):
    """The processor time is used up; no `except Exception` of a library may catch it."""


def read_apart(
    read: Callable[[Progress], Result],
    path: Path,
    refusal: type[InputError],
    *,
    time_limit: float = TIME_LIMIT,
    waiting_limit: float | None = None,
    progress: Progress = lambda step: None,
) -> Result:
    """The result of a function that reads a file, called in a process of its own.

    The process is a copy (fork) of this one, so a function may refer to anything. Elsewhere than on Linux the function
    is called in this process, without limits.

    Args:
        read: reads the file; gets a function that tells what is being done.
        path: of the file, for messages.
        refusal: error that is raised where a limit is exceeded.
        time_limit: processor time [s].
        waiting_limit: time by the clock [s]; `WAITING_LIMIT`, or four times `time_limit` where that is longer, if None.
        progress: called with what `read` reports.

    Raises:
        InputError: `refusal`, where reading took too much time or memory, or crashed; or what `read` raises.
    """
    if not APART:
        return read(progress)
    if waiting_limit is None:
        waiting_limit = max(WAITING_LIMIT, 4 * time_limit)
    receiving, sending = os.pipe()
    with warnings.catch_warnings():
        # Python ≥ 3.12 warns of locks that other threads hold; the libraries used in the child take their own care.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        os.close(receiving)
        _read_and_exit(read, sending, time_limit, waiting_limit)
    os.close(sending)
    status = None
    try:
        with os.fdopen(receiving, "rb") as answers:
            kind, content = _last_answer(answers, progress)
        status = os.waitpid(child, 0)[1]
    finally:
        if status is None:  # Ctrl-C, or an error of `progress`
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    if kind == "result":
        result: Result = content
        return result
    if kind == "error":
        raise content
    ended_by = -os.waitstatus_to_exitcode(status)
    if kind == "time" or ended_by in (signal.SIGXCPU, signal.SIGKILL):
        raise refusal(
            f"cannot be read within {time_limit:.0f} s of processor time; it is damaged or too large", where=str(path)
        )
    if ended_by == signal.SIGALRM:
        raise refusal(
            f"cannot be read within {waiting_limit:.2g} s; it is damaged, or its disk is too slow", where=str(path)
        )
    if kind == "memory" or ended_by <= 0:
        raise refusal(
            f"takes more than {size_text(MEMORY_LIMIT)} of memory to read; it is damaged or too large", where=str(path)
        )
    raise refusal(
        f"is damaged: the library that reads it crashed ({signal.Signals(ended_by).name})",
        where=str(path),
        hint="copy it again from its source",
    )


def _last_answer(answers: BinaryIO, progress: Progress) -> tuple[str, Any]:
    """Kind and content of what the child sent last; an empty kind where it died before."""
    while True:
        try:
            kind, content = pickle.load(answers)
        except (EOFError, pickle.UnpicklingError):
            return "", None
        if kind != "progress":
            return kind, content
        progress(content)


def _read_and_exit(read: Callable[[Progress], Any], sending: int, time_limit: float, waiting_limit: float) -> NoReturn:
    """Return what the child does; it never returns to its caller's code, and leaves no output of it twice."""
    status = 1
    try:
        with os.fdopen(os.dup(sending), "wb") as answers:  # `sending` may be 2, where standard error is closed

            def answer(kind: str, content: object = None) -> None:
                pickle.dump((kind, content), answers, protocol=pickle.HIGHEST_PROTOCOL)
                answers.flush()

            _set_limits(time_limit, waiting_limit)
            _silence()
            try:
                answer("result", read(lambda step: answer("progress", step)))
            except _OutOfTimeError:
                answer("time")
            except MemoryError:
                answer("memory")
            except DynidError as error:
                answer("error", error)
            except Exception as error:  # a bug: of a strange class perhaps, which may not pass the pipe
                answer("error", RuntimeError("".join(traceback.format_exception(error))))
            status = 0
    finally:
        os._exit(status)


def _set_limits(time_limit: float, waiting_limit: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends both processes
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, waiting_limit)
    signal.signal(signal.SIGXCPU, _out_of_time)
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    # A loop within a library never comes to the signal's handler: the hard limit ends it.
    seconds = max(1, round(time_limit))
    for limit, soft, hard in (
        (resource.RLIMIT_CORE, 0, 0),
        (resource.RLIMIT_CPU, seconds, seconds + _TIME_TO_CLEAN_UP),
        (resource.RLIMIT_AS, used + MEMORY_LIMIT, used + MEMORY_LIMIT),
        (resource.RLIMIT_FSIZE, UNPACKED_LIMIT, UNPACKED_LIMIT),
    ):
        allowed = resource.getrlimit(limit)[1]
        if allowed == resource.RLIM_INFINITY or allowed >= hard:
            resource.setrlimit(limit, (soft, hard))
        else:
            resource.setrlimit(limit, (min(soft, allowed), allowed))


def _silence() -> None:
    """What a library or the system says about a crash is no line for people; the parent says one."""
    faulthandler.disable()
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    os.close(nothing)


def _out_of_time(number: int, frame: FrameType | None) -> NoReturn:
    raise _OutOfTimeError
