"""`dynid record` and `dynid sim` on CAN wires, each in a process of its own, and somebody who asks the drives."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import yaml
from rtde_bench import ENVIRONMENT, ROOT, served

from daq.recording import Recording, read_recording
from daq.robot import load_robot
from drivers.can_bus import close_bus, open_bus
from drivers.errors import ConnectionFailedError

COMMAND = "import sys; from drivers.command import main; sys.exit(main())"
SYNC_RATE = 100
STATUSWORD, POSITION = 0x6041, 0x6064
ENABLED = 0x0027
"""Of the statusword's bits 0x006F: operation enabled."""
COUNTS_PER_RADIAN = 524288 / (2.0 * np.pi)
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Arm:
    """A robot file of its own on a multicast group of its own.

    Attributes:
        path: of the robot file.
        group: multicast address of both CAN buses.
        port: UDP port of the bus; programs that hear all groups of a port, such as python-can's logger, hear this bus.
    """

    path: Path
    group: str
    port: int


def an_arm(folder: Path, **canopen: object) -> Arm:
    """A UR5e with drives on CANopen, the AUBO i5's table of CAN frames and a thermometer; skipped without multicast."""
    number, pid = next(_numbers), os.getpid()
    group = f"239.75.{pid % 250}.{(pid // 250 + 17 * number) % 250 + 1}"
    port = 20000 + (97 * pid + number) % 30000
    arm = yaml.safe_load(load_robot("ur5e").text)
    other = yaml.safe_load(load_robot("aubo_i5").text)
    names = {theirs["name"]: ours["name"] for theirs, ours in zip(other["joints"], arm["joints"], strict=True)}
    for joint in arm["joints"]:
        joint["torque"] = None  # drives jerk where a busy computer leaves SYNCs out; that is not what is tested here
    connections = arm["connections"]
    connections["can"] = renamed(other["connections"]["can"], names)
    place = {"channel": group, "options": {"hop_limit": 0, "port": port}}
    connections["can"] |= place
    connections["canopen"] |= {**place, "sync_rate": SYNC_RATE, "with": ["thermometer"], **canopen}
    connections["thermometer"] = {
        "driver": "serial_thermometer",
        "url": str(folder / "port"),
        "baudrate": 9600,
        "pattern": r"T(?P<channel>\w+)=(?P<value>[-+.\d]+)",
        "channels": dict(enumerate(names.values(), start=1)),
        "unit": "degC",
        "rate": 5,
    }
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(arm, sort_keys=False), encoding="utf-8")
    try:
        bus = open_bus("udp_multicast", group, 1_000_000, {"port": port})
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
        close_bus(bus)
    except (ConnectionFailedError, can.CanOperationError) as error:
        pytest.skip(f"no multicast here: {error}")
    return Arm(path, group, port)


def renamed(content: Any, names: dict[str, str]) -> Any:
    """The same content with other names of joints."""
    if isinstance(content, dict):
        return {key: renamed(value, names) for key, value in content.items()}
    if isinstance(content, list):
        return [renamed(value, names) for value in content]
    return names.get(content, content) if isinstance(content, str) else content


def changed(arm: Arm, connection: str, **keys: object) -> None:
    """Change keys of a connection in the robot file."""
    content = yaml.safe_load(arm.path.read_text(encoding="utf-8"))
    content["connections"][connection] |= keys
    arm.path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def swing(folder: Path, duration: float = 30.0) -> Path:
    """A gentle motion around the simulated arm's first pose."""
    path = folder / "swing.yaml"
    sines = {"amplitude": [[0.1]] * 6, "frequency": [[1.5]] * 6, "offset": [0.0] * 6}
    path.write_text(yaml.safe_dump({"robot": "ur5e", "kind": "sines", "duration": duration, "ramp": 0.5, **sines}))
    return path


@contextmanager
def simulated(arm: Arm, wire: str, *options: str) -> Iterator[tuple[dict[str, Any], subprocess.Popen[str]]]:
    """The arm served on a wire."""
    with served("-c", COMMAND, "sim", str(arm.path), "--wire", wire, "--no-ui", *options) as (ready, process):
        yield dict(ready), process


@contextmanager
def recorder(arm: Arm, wire: str, out: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`dynid record` in a process of its own."""
    command = [sys.executable, "-c", COMMAND, "record", str(arm.path), "--wire", wire, "-o", str(out), "--no-ui"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([*command, *arguments], text=True, cwd=ROOT, env=ENVIRONMENT, **pipes)  # type: ignore[call-overload]
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


class Probe:
    """Asks drives by SDO what they do, beside everybody else."""

    def __init__(self, arm: Arm) -> None:
        self._bus = open_bus("udp_multicast", arm.group, 1_000_000, {"port": arm.port})

    def __enter__(self) -> Probe:
        return self

    def __exit__(self, *_: object) -> None:
        close_bus(self._bus)

    def read(self, node: int, index: int) -> int | None:
        """A drive's object, signed; None where it does not answer."""
        while self._bus.recv(0.0) is not None:
            pass
        asked = bytes([0x40, index & 0xFF, index >> 8, 0, 0, 0, 0, 0])
        self._bus.send(can.Message(arbitration_id=0x600 + node, is_extended_id=False, data=asked))
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            answer = self._bus.recv(0.1)
            if answer is not None and answer.arbitration_id == 0x580 + node and answer.data[1:3] == asked[1:3]:
                return int.from_bytes(answer.data[4:], "little", signed=True)
        return None

    def positions(self) -> list[float]:
        """Of all drives [rad]; nan where one does not answer."""
        found = [self.read(node, POSITION) for node in range(1, 7)]
        return [float("nan") if counts is None else counts / COUNTS_PER_RADIAN for counts in found]

    def enabled(self) -> list[int]:
        """The nodes whose drives are enabled."""
        words = {node: self.read(node, STATUSWORD) for node in range(1, 7)}
        return [node for node, word in words.items() if word is not None and word & 0x6F == ENABLED]

    def losses(self, since: float, seconds: float) -> dict[int, float]:
        """Nodes that say that they miss their master (EMCY 0x8130) → how long after `since` [s, clock of day]."""
        found: dict[int, float] = {}
        end = since + seconds
        while time.time() < end and len(found) < 6:
            frame = self._bus.recv(0.05)
            if frame is not None and 0x81 <= frame.arbitration_id <= 0x86 and frame.data[:2] == b"\x30\x81":
                found[frame.arbitration_id - 0x80] = frame.timestamp - since
        return found

    def wait_for_motion(self, process: subprocess.Popen[str]) -> None:
        """Until a drive's TPDO1 shows a motion; nothing is asked, which would disturb the driver's configuration."""
        end = time.monotonic() + 20.0
        first: dict[int, int] = {}
        while time.monotonic() < end and process.poll() is None:
            frame = self._bus.recv(0.1)
            if frame is None or not 0x181 <= frame.arbitration_id <= 0x186 or len(frame.data) != 7:
                continue
            counts = int.from_bytes(frame.data[3:], "little", signed=True)
            if abs(counts - first.setdefault(frame.arbitration_id, counts)) > 0.03 * COUNTS_PER_RADIAN:
                return
        said = process.communicate()[1] if process.poll() is not None else ""
        raise AssertionError(f"the arm does not move: {said}")

    def moved_in(self, seconds: float) -> float:
        """How far a joint moves within a while [rad]."""
        before = self.positions()
        time.sleep(seconds)
        return float(np.nanmax(np.abs(np.subtract(self.positions(), before))))


@dataclass(frozen=True)
class Outcome:
    """What came of a recording with a fault.

    Attributes:
        status: exit status.
        errors: standard error.
        recording: the file; None where there is none.
        seconds: from the fault to the end of the program.
        moved: how far a joint moves in 0.4 s afterwards [rad]; nan where nobody can tell.
        enabled: nodes enabled afterwards.
    """

    status: int
    errors: str
    recording: Recording | None
    seconds: float
    moved: float
    enabled: Sequence[int]

    def events(self) -> list[str]:
        """All events of the file, as level: message."""
        return [] if self.recording is None else [f"{e.level}: {e.message}" for e in self.recording.events]


def with_fault(
    arm: Arm,
    folder: Path,
    fault: str,
    *,
    wire: str = "canopen",
    duration: float | None = None,
    thermometer: bool = False,
) -> Outcome:
    """Record the simulated arm, type a fault once it moves (or records for a second), and see what comes of it."""
    out = folder / "run.h5"
    arguments = ["--trajectory", str(swing(folder))] if duration is None else ["--duration", str(duration)]
    options = ("--thermometer",) if thermometer else ()
    if not thermometer:
        changed(arm, "canopen", **{"with": []})
    with simulated(arm, wire, *options) as (ready, process), Probe(arm) as probe:
        if wire == "slcan":
            changed(arm, "canopen", interface="slcan", channel=ready["channel"], options={})
        with recorder(arm, "canopen" if wire == "slcan" else wire, out, *arguments) as program:
            if duration is None and wire == "canopen":
                probe.wait_for_motion(program)
            else:
                while not out.exists() and program.poll() is None:
                    time.sleep(0.01)
                time.sleep(1.0 if duration is not None else 4.0)
            assert process.stdin is not None
            print(fault, file=process.stdin, flush=True)
            begun = time.monotonic()
            errors = program.communicate(timeout=40)[1]
            seconds = time.monotonic() - begun
        time.sleep(0.2)
        told = wire == "canopen"
        moved = probe.moved_in(0.4) if told else float("nan")
        enabled = probe.enabled() if told else []
    return Outcome(program.returncode, errors, read_recording(out) if out.exists() else None, seconds, moved, enabled)


def assert_stopped(outcome: Outcome, *reasons: str) -> None:
    """One line says why, the file says it too, and the arm rests with its drives off."""
    assert outcome.status == 1
    assert outcome.errors.startswith("dynid: ")
    assert outcome.errors.count("\n") == 1
    assert any(reason in outcome.errors for reason in reasons), outcome.errors
    assert outcome.recording is not None
    assert not outcome.recording.complete
    assert len(outcome.recording.streams["joints"].time) > 10
    assert any(event.startswith("error: stopped: ") for event in outcome.events())
