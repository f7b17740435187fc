"""One command in a process of its own, of limited time and memory, and what it did that no command may do."""

from __future__ import annotations

import faulthandler
import gc
import importlib
import os
import pkgutil
import re
import resource
import select
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

CPU_LIMIT = 20
"""Processor time of one command [s]."""
MEMORY_LIMIT = 2 * 10**9
"""[B]"""
STALLED = 120.0
"""A command that neither ends nor uses the processor for so long [s] hangs."""
COMPARED = 10**7
"""Files up to this size [B] are compared byte by byte."""
PROGRESS = re.compile(r" *\d+ s  ")
"""A line of a slow step, such as of a file that is read until the time limit."""
BAD_WORDS = ("Traceback (most recent call last)", "Warning:", "HDF5-DIAG", "Segmentation fault")


@dataclass(frozen=True)
class Outcome:
    """What a command did."""

    status: int  # exit status; minus the signal that ended it
    # output, errors: on standard output and standard error
    output: str
    errors: str
    seconds: float  # of processor time, with that of its processes
    memory: int  # the largest resident size of it or its processes [B]
    problems: tuple[str, ...]  # what it may not do, in words; empty where all was well


def load_all_modules() -> None:
    """Import all of dynid, so that every command starts at once."""
    for name in ("drivers", "daq", "ident", "sim_drivers", "dynid"):
        package = importlib.import_module(name)
        for module in pkgutil.walk_packages(package.__path__, f"{name}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
    gc.collect()
    gc.freeze()


def run_command(arguments: Sequence[str], folder: Path) -> Outcome:
    """Run `dynid` with arguments in a folder that holds only inputs."""
    before = {path: _content(path) for path in folder.rglob("*") if path.is_file()}
    outputs = folder.with_name(folder.name + "-stdout"), folder.with_name(folder.name + "-stderr")
    child = os.fork()
    if child == 0:
        _run_and_exit(arguments, folder, outputs)
    status, usage = _waited_for(child)
    output, errors = (path.read_text(encoding="utf-8", errors="replace") for path in outputs)
    for path in outputs:
        path.unlink()
    seconds = usage.ru_utime + usage.ru_stime
    memory = usage.ru_maxrss * 1024
    problems = list(_problems_of_words(status, output, errors))
    if status == -signal.SIGXCPU or seconds > 2 * CPU_LIMIT:
        problems.append(f"took more than {CPU_LIMIT} s of processor time")
    if memory > MEMORY_LIMIT:
        problems.append(f"took {memory / 1e9:.2f} GB of memory")
    after = {path for path in folder.rglob("*") if path.is_file()}
    problems += [
        f"changed the input {path.name}" for path in before if path not in after or _content(path) != before[path]
    ]
    made = sorted(path.relative_to(folder).as_posix() for path in after - set(before))
    # A recording that was begun stays, with the reason of its end in it.
    kept = status == 0 or (status == 1 and arguments[:1] == ["record"])
    if any(".dynid-" in name for name in made) or (made and not kept):
        problems.append(f"left {', '.join(made)} behind")
    return Outcome(status, output, errors, seconds, memory, tuple(problems))


def _content(path: Path) -> object:
    """What changes where a file is changed: its bytes, or of a large one its size and time."""
    about = path.stat()
    return path.read_bytes() if about.st_size < COMPARED else (about.st_ino, about.st_size, about.st_mtime_ns)


def _problems_of_words(status: int, output: str, errors: str) -> list[str]:
    problems = []
    if status < 0:
        problems.append(f"was ended by {signal.Signals(-status).name}")
    elif status not in (0, 1, 2):
        problems.append(f"exit status {status}")
    problems += [f"said '{word}'" for word in BAD_WORDS if word in errors or word in output]
    lines = [line for line in errors.splitlines() if not PROGRESS.match(line)]
    if status == 2 and (len(lines) != 1 or not lines[0].startswith("dynid: ")) and '"error"' not in output:
        problems.append(f"{len(lines)} lines instead of one")
    if any(character < " " and character not in "\n\t\r" for character in errors + output):
        problems.append("printed control characters")
    return problems


def _waited_for(child: int) -> tuple[int, resource.struct_rusage]:
    descriptor = os.pidfd_open(child)
    try:
        if not select.select([descriptor], [], [], STALLED)[0]:
            os.killpg(child, signal.SIGKILL)
    finally:
        os.close(descriptor)
    _, status, usage = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), usage


def _run_and_exit(arguments: Sequence[str], folder: Path, outputs: tuple[Path, Path]) -> None:
    status = 99
    try:
        faulthandler.disable()
        os.setsid()
        os.chdir(folder)
        for descriptor, path in enumerate(outputs, start=1):
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
            os.dup2(file, descriptor)
            os.close(file)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT, CPU_LIMIT + 5))
        resource.setrlimit(resource.RLIMIT_AS, (2 * MEMORY_LIMIT + 10**9, 2 * MEMORY_LIMIT + 10**9))
        importlib.reload(warnings)  # pytest keeps those of its process, forked ones included, to itself
        warnings.resetwarnings()
        for silent in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", silent)
        sys.argv = ["dynid", *arguments]
        from dynid.command import main

        try:
            main()
            status = 0
        except SystemExit as stopped:
            status = stopped.code if isinstance(stopped.code, int) else 0 if stopped.code is None else 1
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)
