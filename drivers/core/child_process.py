"""Processes of dynid's own: a Ctrl-C reaches all of a terminal's, but only the one that started them decides."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Worker(Protocol):
    """A process, under the names of `multiprocessing.Process`."""

    @property
    def pid(self) -> int | None: ...  # noqa: D102

    @property
    def exitcode(self) -> int | None: ...  # noqa: D102

    def is_alive(self) -> bool: ...  # noqa: D102

    def join(self, timeout: float | None = None) -> None: ...  # noqa: D102

    def kill(self) -> None: ...  # noqa: D102


@contextmanager
def started_without_interrupt() -> Iterator[None]:
    """Start processes (`multiprocessing`, spawn) in this context: Ctrl-C is blocked in them from the first instruction.

    Blocked, not ignored: this process gets a Ctrl-C of this moment a little later.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker  # not on Windows

    resource_tracker.ensure_running()  # before: where it starts, it lifts the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave(process: Worker, patience: float) -> None:
    """Wait until a process has ended, for so long [s]; then kill it."""
    process.join(patience)
    if process.is_alive():
        process.kill()
        process.join()
