"""Processes of dynid's own: a Ctrl-C reaches all of a terminal's, but only the one that started them decides."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, Thread
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

_STARTING = Lock()


@contextmanager
def started_without_main() -> Iterator[None]:
    """Start processes (`multiprocessing`) in this context: they don't run the user's script again.

    Python's children import the module that runs, so that a script without `if __name__ == "__main__":` would begin
    once more in each, with an arm that moves perhaps. What dynid's processes need is in modules.
    """
    with _STARTING:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main


@contextmanager
def started_without_interrupt() -> Iterator[None]:
    """Do what `started_without_main` does, and block Ctrl-C in the processes from the first instruction.

    Blocked, not ignored: this process gets a Ctrl-C of this moment a little later.
    """
    if not hasattr(signal, "pthread_sigmask"):
        with started_without_main():
            yield
        return
    from multiprocessing import resource_tracker  # not on Windows

    resource_tracker.ensure_running()  # before: where it starts, it lifts the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with started_without_main():
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """Let this process end at once, whatever it does, when the one that started it (`multiprocessing`) has died."""
    from multiprocessing import parent_process

    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()  # processes run by the computer's clock, whatever ours is


def leave(process: BaseProcess, patience: float) -> None:
    """Wait until a process has ended, for so long [s]; then kill it."""
    process.join(patience)
    if process.is_alive():
        process.kill()
        process.join()
