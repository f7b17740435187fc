"""Serving a simulated device until it is interrupted, whatever its bus."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

from drivers.core.errors import DynidError, UsageError, WorkError
from drivers.core.terminal import styled, visible
from sim_drivers.served import Served

REFRESH = 0.5
"""[s] between two status lines."""
CLEAR_LINE = "\r\x1b[K"


def serve_until_interrupted(served: Served, name: str, obey: Callable[[str], None], *, live: bool) -> None:
    """Start a simulated device, report it in one JSON object on standard output, and wait for Ctrl-C or SIGTERM.

    Lines that are typed go to `obey`, which refuses them by a UsageError.

    Raises:
        ConnectionFailedError: its bus or port is not available.
        WorkError: the simulation broke down.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if hasattr(signal, "SIGTTIN"):
        # In the background reading the terminal must fail, not stop the process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    shown = False
    with served:
        # A full collection takes longer than a period.
        gc.collect()
        gc.freeze()
        print(json.dumps({"ready": True, "robot": name, "pid": os.getpid(), **served.ready()}), flush=True)
        # Typed by a person: it runs in real time, whatever clock the device has.
        threading.Thread(target=_obey_typed_lines, args=(served, obey), name="faults", daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            while served.failure is None:
                time.sleep(REFRESH)
                while served.messages:
                    _say(served.messages.popleft(), live=shown)
                if live and _in_foreground():
                    shown = True
                    line = visible(served.live_line())
                    print(f"{CLEAR_LINE}{line}", end="", file=styled(sys.stderr), flush=True)
    if shown:
        print(file=sys.stderr)
    if isinstance(served.failure, DynidError):
        raise served.failure
    if served.failure is not None:
        raise WorkError(f"the simulation broke down: {served.failure!r}") from served.failure


def _in_foreground() -> bool:
    """Whether standard error is a terminal that no other program has: a status line would overwrite what is typed."""
    if not sys.stderr.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stderr.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # no such thing as a foreground
        return True


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _obey_typed_lines(served: Served, obey: Callable[[str], None]) -> None:
    try:
        for line in sys.stdin:
            if not line.strip():
                continue
            try:
                obey(line)
            except UsageError as error:
                served.messages.append(str(error))
    except (OSError, ValueError, AttributeError):
        return  # no standard input, or not ours to read


def _say(message: str, *, live: bool) -> None:
    print(f"{CLEAR_LINE if live else ''}dynid: {visible(message)}", file=styled(sys.stderr), flush=True)
