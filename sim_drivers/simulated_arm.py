"""A simulated arm in a separate process, and recordings of it with the user's command."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.recording.recording import JOINTS_STREAM
from daq.session.realtime import may_have_realtime
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionFailedError, WorkError

HOSTS = tuple(f"127.0.0.{host}" for host in (1, 2, 3, 4, 5))
"""Loopback addresses that are tried in turn: the ports are fixed, another simulated arm may have them."""

START_LIMIT = 60.0
"""Time limit [s] for the simulator to listen."""

STOP_LIMIT = 10.0


@dataclass(frozen=True)
class Recorded:
    """How many samples of the joints a recording holds, and how many were lost."""

    samples: int
    lost: int


Record = Callable[[Path, Path], Recorded]
"""Plays a trajectory file and writes the recording."""


@contextmanager
def over_rtde(robot: str, seed: int, position: FloatArray | None = None) -> Iterator[Record]:
    """Serve a simulated arm over RTDE within the context; returns its recorder in another process.

    It stands at a `position` (n,) [rad or m] at first, in the middle of the joints' ranges where None.

    Raises:
        ConnectionFailedError: it could not be started.
    """
    with simulated_arm(robot, seed, position=position) as host:

        def record(trajectory: Path, out: Path) -> Recorded:
            joints = record_over_wire(robot, host, trajectory, out)["streams"][JOINTS_STREAM]
            return Recorded(joints["samples"], joints["lost"])

        yield record


@contextmanager
def simulated_arm(
    robot: str, seed: int, hosts: Sequence[str] = HOSTS, position: FloatArray | None = None
) -> Iterator[str]:
    """Serve a simulated arm over RTDE while the block runs; gives the address that it listens on.

    Raises:
        ConnectionFailedError: it could not be started on any of the addresses.
    """
    process, host = _start(robot, seed, hosts, position)
    try:
        yield host
    finally:
        process.terminate()
        try:
            process.wait(STOP_LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _start(
    robot: str, seed: int, hosts: Sequence[str], position: FloatArray | None
) -> tuple[subprocess.Popen[str], str]:
    start = [] if position is None else ["--position=" + ",".join(repr(float(angle)) for angle in position)]
    reason = "no address was tried"
    for host in hosts:
        arguments = _dynid("sim", robot, "--host", host, "--seed", str(seed), "--no-ui", *start, *_priority())
        process = subprocess.Popen(
            arguments, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        if _ready(process):
            return process, host
        process.kill()
        _, errors = process.communicate()
        reason = errors.strip().splitlines()[-1] if errors.strip() else "it did not become ready"
    raise ConnectionFailedError(f"the simulated {robot} did not start: {reason}", where=", ".join(hosts))


def _ready(process: subprocess.Popen[str]) -> bool:
    lines: queue.Queue[str] = queue.Queue()
    out = process.stdout
    if out is None:
        raise ValueError("the process has no pipe")
    # Another process is waited for: no clock but the computer's will do.
    threading.Thread(target=lambda: lines.put(out.readline()), daemon=True).start()
    try:
        return bool(lines.get(timeout=START_LIMIT))
    except queue.Empty:
        return False


def record_over_wire(robot: str, host: str, trajectory: Path, out: Path) -> dict[str, Any]:
    """`dynid record ROBOT --host HOST --trajectory FILE -o OUT --yes`, in a separate process; returns its JSON object.

    Raises:
        WorkError: the recording did not run to its end.
    """
    arguments = _dynid("record", robot, "--host", host, "--trajectory", str(trajectory), "-o", str(out))
    arguments += ["--yes", "--force", "--no-ui", "--json", *_priority()]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    try:
        report = json.loads(done.stdout)
    except json.JSONDecodeError:
        report = {}
    if done.returncode != 0:
        reason = report.get("error") or report.get("stopped_by") or done.stderr.strip() or "it ended without a message"
        raise WorkError(f"the recording stopped: {reason}", where=str(out))
    return dict(report)


def _priority() -> list[str]:
    """Real-time priority where available: here robot and recorder share one computer with other processes."""
    return ["--realtime"] if may_have_realtime() else []


def _dynid(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "dynid", *arguments]
