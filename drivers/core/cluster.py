"""The workers of a Dask cluster, for whatever takes an executor."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

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
    with client, client.get_executor(pure=False) as executor:  # type: ignore[no-untyped-call]
        yield executor
