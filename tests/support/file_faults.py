"""Faults at each step of writing files: an error of the system, or the death of the process."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STEPS = ("mkdir", "pwrite", "fsync", "link", "replace", "rename", "unlink")
"""Functions of `os` that change what is on the disk."""
DIED = 9


@contextmanager
def fault_at(number: int, fault: Callable[[], None], steps: tuple[str, ...] = STEPS) -> Iterator[list[str]]:
    """Call `fault` in place of a step, by its number from 0; yields the names of the steps so far."""
    taken: list[str] = []

    def hooked(name: str, step: Callable[..., Any]) -> Callable[..., Any]:
        def take(*arguments: Any, **options: Any) -> Any:
            taken.append(name)
            if len(taken) == number + 1:
                fault()
            return step(*arguments, **options)

        return take

    real = {name: getattr(os, name) for name in steps}
    for name, step in real.items():
        setattr(os, name, hooked(name, step))
    try:
        yield taken
    finally:
        for name, step in real.items():
            setattr(os, name, step)


def deaths(job: Callable[[], None], steps: tuple[str, ...] = STEPS) -> Iterator[int]:
    """Do a job in a fork that dies before its first step, its second one and so on, as by SIGKILL; the steps so far.

    Raises:
        AssertionError: the job failed in another way.
    """
    for number in itertools.count():
        process = os.fork()
        if process == 0:
            status = 1
            try:
                with fault_at(number, lambda: os._exit(DIED), steps):
                    job()
                status = 0
            finally:
                os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        if status == 0:
            return
        assert status == DIED, f"the job failed before step {number}"
        yield number
