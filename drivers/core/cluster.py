"""The workers of a Dask cluster, for whatever takes an executor; the memory that one of any kind has used."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import partial
from typing import Any

from drivers.core.errors import ConnectionFailedError, UsageError

CONNECT_TIMEOUT = 20.0
"""For the scheduler's first answer [s]."""


@contextmanager
def cluster_executor(scheduler: str) -> Iterator[Executor]:
    """The workers behind a scheduler (tcp://host:8786), which are given and return pickled paths, and not samples.

    Raises:
        UsageError: Dask is not installed.
        ConnectionFailedError: the scheduler does not answer.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError("a scheduler needs Dask", where="--scheduler", hint="pip install 'dynid[dask]'") from error
    try:
        client = Client(scheduler, timeout=CONNECT_TIMEOUT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise ConnectionFailedError(f"no Dask scheduler answers: {error}", where=scheduler) from error
    with client:
        yield ClusterExecutor(client)


def why_lost(error: Exception) -> str:
    """Why a task has no result, where what it called has not said so itself."""
    if isinstance(error, CancelledError):
        return "the scheduler was lost before it was done"
    return f"its worker failed: {type(error).__name__}: {error}"


def peak_memory() -> float:
    """Largest memory of this process so far [MB]; nan where the system does not tell."""
    if sys.platform == "win32":
        return float("nan")
    import resource  # not on Windows

    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


class ClusterExecutor(Executor):
    """An executor on a Dask client; of Dask's own, a future whose result is lost while fetched never ends."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call `fn(*args, **kwargs)` on a worker."""
        there = self._client.submit(fn, *args, pure=False, **kwargs)
        here: Future[Any] = Future()
        here.add_done_callback(lambda ended: there.cancel() if ended.cancelled() and not there.done() else None)
        there.add_done_callback(partial(_hand_over, here))
        return here


def _hand_over(here: Future[Any], there: Any) -> None:
    """End a future as Dask's has ended; a result that cannot be fetched is its exception."""
    if not here.set_running_or_notify_cancel():
        return
    try:
        here.set_result(there.result())
    except BaseException as error:  # of a thread of Dask's, which would keep it
        here.set_exception(error)
