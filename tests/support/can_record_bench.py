"""`dynid record` and `dynid sim` on CAN buses, each in a separate process, and an SDO client of the drives."""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import h5py
import numpy as np
import pytest
import yaml
from rtde_bench import ENVIRONMENT, ROOT, served

from daq.recording.reader import read_recording
from daq.recording.recover import half_written
from daq.robot.loader import load_robot
from drivers.can.bus import close_bus, open_bus
from drivers.core.errors import ConnectionFailedError

SIMULATOR = """
import sys
from dynid.command import main
from sim_drivers.canopen import network
network.LOOP_PERIOD = 5e-3  # of the drives, a fifth as often as usual: each turn costs processor time
sys.exit(main())
"""
STATUSWORD = 0x6041
NODES = range(1, 7)
PATIENCE = 240.0
"""Time limit [s] of every step."""
SOME_ROWS = 10
"""A recording with more of them has been going on."""
ENABLED = 0x0027
"""Value of the statusword's bits 0x006F in "operation enabled"."""
COUNTS_PER_RADIAN = 524288 / (2.0 * np.pi)
_numbers = itertools.count(1)


@dataclass(frozen=True)
class Arm:
    """A separate robot file and multicast group."""

    path: Path  # of the robot file
    group: str  # multicast address of both CAN buses
    port: int  # UDP port of the bus; programs that join all groups of a port (python-can's logger) see this bus


def an_arm(folder: Path, **canopen: object) -> Arm:
    """A UR5e with drives on CANopen; skipped without multicast."""
    number, pid = next(_numbers), os.getpid()
    group = f"239.75.{pid % 250}.{(pid // 250 + 17 * number) % 250 + 1}"
    port = 20000 + (97 * pid + number) % 30000
    arm = yaml.safe_load(load_robot("ur5e").text)
    for joint in arm["joints"]:
        joint["torque"] = None  # drives jerk where a busy computer leaves SYNCs out; that is not what is tested here
    arm["model"]["mounting"] = "free"  # its first pose, stretched out, is nearer to a table than what is kept
    arm["connections"]["canopen"] |= {"channel": group, "options": {"hop_limit": 0, "port": port}, **canopen}
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(arm, sort_keys=False), encoding="utf-8")
    try:
        bus = open_bus("udp_multicast", group, 1_000_000, {"port": port})
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
        close_bus(bus)
    except (ConnectionFailedError, can.CanOperationError) as error:
        pytest.skip(f"no multicast here: {error}")
    return Arm(path, group, port)


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
    """The arm served on a bus."""
    with served("-c", SIMULATOR, "sim", str(arm.path), "--wire", wire, "--no-ui", *options) as (ready, process):
        yield dict(ready), process


@contextmanager
def recorder(arm: Arm, wire: str, out: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`dynid record` in a separate process, with time limits that no stall passes."""
    command = [
        sys.executable,
        "tests/support/patient_dynid.py",
        "record",
        str(arm.path),
        "--wire",
        wire,
        "-o",
        str(out),
        "--yes",
        "--no-ui",
    ]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([*command, *arguments], text=True, cwd=ROOT, env=ENVIRONMENT, **pipes)  # type: ignore[call-overload]
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


class Probe:
    """Reads the drives' states by SDO, beside the other clients."""

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
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            answer = self._bus.recv(1.0)
            if answer is not None and answer.arbitration_id == 0x580 + node and answer.data[1:3] == asked[1:3]:
                return int.from_bytes(answer.data[4:], "little", signed=True)
        return None

    def enabled(self) -> list[int]:
        """The nodes whose drives are enabled."""
        words = {node: self.read(node, STATUSWORD) for node in NODES}
        return [node for node, word in words.items() if word is not None and word & 0x6F == ENABLED]

    def wait_until_off(self) -> list[int]:
        """Until no drive is enabled; the nodes that answered."""
        end = time.monotonic() + PATIENCE
        while self.enabled():
            assert time.monotonic() < end
        return [node for node in NODES if self.read(node, STATUSWORD) is not None]

    def wait_for_losses(self) -> list[int]:
        """Until all nodes reported a missing master (EMCY 0x8130), or for a minute; those that did."""
        missing: set[int] = set()
        end = time.monotonic() + PATIENCE
        while len(missing) < len(NODES) and time.monotonic() < end:
            frame = self._bus.recv(1.0)
            if frame is not None and 0x81 <= frame.arbitration_id <= 0x86 and frame.data[:2] == b"\x30\x81":
                missing.add(frame.arbitration_id - 0x80)
        return sorted(missing)

    def wait_for_motion(self, process: subprocess.Popen[str]) -> None:
        """Until a drive's TPDO1 shows a motion; nothing is asked, which would disturb the driver's configuration."""
        end = time.monotonic() + PATIENCE
        first: dict[int, int] = {}
        while time.monotonic() < end and process.poll() is None:
            frame = self._bus.recv(0.1)
            if frame is None or not 0x181 <= frame.arbitration_id <= 0x186 or len(frame.data) != 7:
                continue
            counts = int.from_bytes(frame.data[3:], "little", signed=True)
            if abs(counts - first.setdefault(frame.arbitration_id, counts)) > 0.01 * COUNTS_PER_RADIAN:
                return
        said = process.communicate()[1] if process.poll() is not None else ""
        raise AssertionError(f"the arm does not move: {said}")


def type_fault(simulator: subprocess.Popen[str], line: str, recording: subprocess.Popen[str], out: Path) -> None:
    """Type a fault into the simulator once the recording has some rows."""
    end = time.monotonic() + PATIENCE
    rows = 0
    while rows <= SOME_ROWS:
        assert recording.poll() is None, recording.communicate()
        assert time.monotonic() < end
        time.sleep(0.05)
        with (
            contextlib.suppress(OSError, KeyError),
            h5py.File(half_written(out), "r", libver="latest", swmr=True) as file,
        ):
            rows = len(file["streams/joints/time"])
    assert simulator.stdin is not None
    print(line, file=simulator.stdin, flush=True)


def assert_recorded(program: subprocess.Popen[str]) -> None:
    """A recording ends by itself and says nothing, but of samples that this computer was too busy for."""
    errors = program.communicate(timeout=PATIENCE)[1]
    assert _without_losses(errors) == []
    assert program.returncode == 0 or errors


def _without_losses(errors: str) -> list[str]:
    """Lines of standard error, without those about lost samples: a busy computer loses some, and dynid says so."""
    return [line for line in errors.splitlines() if "were lost" not in line]


def assert_stopped(program: subprocess.Popen[str], out: Path, *reasons: str) -> None:
    """The recording ends with status 1 and one line, which has one of the reasons; the file says it, too."""
    errors = program.communicate(timeout=PATIENCE)[1]
    assert program.returncode == 1
    assert [line.startswith("dynid: ") for line in _without_losses(errors)] == [True]
    assert any(reason in errors for reason in reasons), errors
    recording = read_recording(out)
    assert not recording.complete
    assert len(recording.streams["joints"].time) > SOME_ROWS
    assert any(event.level == "error" and event.message.startswith("stopped: ") for event in recording.events)
