"""Virtual time beside the host's clock: periods that start on a fixed grid, so that no lateness accumulates."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator


def periods(
    period: float,
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[float]:
    """Yield at start + k·period, k = 1, 2, …; each value is how late the yield is [s].

    A consumer that is late gets its next periods at once until it has caught up: none is left out. Iteration ends
    when the consumer breaks out of it.

    Args:
        period: [s].
        clock: monotonic time [s].
        sleep: waits so many seconds, possibly less or more.

    Raises:
        ValueError: a period that is not positive.
    """
    if not period > 0.0:
        raise ValueError(f"a period must be positive, not {period}")
    start, count = clock(), 0
    while True:
        count += 1
        due = start + count * period
        while (left := due - clock()) > 0.0:
            sleep(left)
        yield -left
