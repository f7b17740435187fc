"""The numerical settings that dynid is written for, whatever program calls it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def numerical_settings() -> Iterator[None]:
    """One BLAS thread, and NumPy's floating-point errors as by default; the caller's settings come back afterwards.

    dynid multiplies many small matrices, for which a second thread costs more than it brings: on two busy cores an
    identification from Python took nine times the processor time. It relies on tiny numbers becoming 0, which a caller
    may have made an error (`np.seterr`).
    """
    import numpy as np
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"), np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
        yield
