"""One BLAS thread at a time, whatever program calls dynid."""

from __future__ import annotations

from contextlib import AbstractContextManager


def one_blas_thread() -> AbstractContextManager[object]:
    """A context in which the BLAS libraries of this process use one thread; the caller's number comes back after it.

    dynid multiplies many small matrices, for which a second thread costs more than it brings: on two busy cores an
    identification from Python took nine times the processor time.
    """
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, "blas")  # type: ignore[no-any-return]
