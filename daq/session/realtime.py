"""Real-time priority for the process that records, and a processor that does not sleep meanwhile (Linux)."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from drivers.core.errors import UsageError

WAKE_LATENCY = Path("/dev/cpu_dma_latency")
"""Linux keeps processors out of sleeps that take longer to end [µs, int32] than what holds this file open says."""
PRIORITY = 20
"""Priority of SCHED_FIFO: above all ordinary processes, below the kernel's own threads that serve interrupts (50)."""


def ask_for_realtime() -> None:
    """Give this thread, and all threads and processes that it starts from now on, SCHED_FIFO.

    Raises:
        UsageError: the system has no real-time priority, or does not allow it.
    """
    if not hasattr(os, "sched_setscheduler"):
        raise UsageError("this system has no real-time priority", hint="leave out --realtime")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        raise UsageError(
            f"real-time priority was refused: {error.strerror}",
            hint="allow it in /etc/security/limits.d (rtprio 20 for your user), or leave out --realtime",
        ) from error


def may_have_realtime() -> bool:
    """Return whether the system allows it; tried in a short-lived thread, since priority is per thread."""
    refusals: list[UsageError] = []

    def ask() -> None:
        try:
            ask_for_realtime()
        except UsageError as error:
            refusals.append(error)

    thread = threading.Thread(target=ask)  # it waits for nothing, so no clock makes it
    thread.start()
    thread.join()
    return not refusals


@contextmanager
def ordinary_priority() -> Iterator[None]:
    """Start processes in this context that need no real-time priority: a display must not disturb what it shows.

    To give it back themselves would be too late: the second in which a process imports its modules is as much as the
    kernel allows real-time threads before it halts all of them for 50 ms (sched_rt_runtime_us).
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


@contextmanager
def awake_processor() -> Iterator[None]:
    """Keep the processor from sleeping, where the system allows it (root, or a rule for the file).

    An idle processor needs up to 0.1 ms to wake up; that of a virtual machine, which its host gives to others
    meanwhile, needed up to 70 ms (docs/measurements/faults.md).
    """
    with ExitStack() as held:
        with suppress(OSError):
            held.enter_context(WAKE_LATENCY.open("wb", buffering=0)).write(bytes(4))
        yield
