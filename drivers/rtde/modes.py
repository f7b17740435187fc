"""What the controller's mode numbers mean (Universal Robots, "RTDE Guide"), and how much each matters."""

from __future__ import annotations

import socket
from collections.abc import Mapping

from drivers.base import Level
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.rtde.protocol import Connect, connect_tcp

PORT = 29999
ANSWER_LIMIT = 4096


def stop_program(host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK) -> bool:
    """Ask a controller to end its program; whether it says so within `timeout` [s]. Never raises.

    Controllers from software 10 on have no dashboard; others obey only in remote control.
    """
    return _asked(b"stop", host, timeout, connect, clock).lower() == "stopped"


def serial_number(host: str, timeout: float, connect: Connect = connect_tcp, clock: Clock = SYSTEM_CLOCK) -> str:
    """A controller's serial number, as `stop_program` is asked; empty where it tells none. Never raises."""
    answer = _asked(b"get serial number", host, timeout, connect, clock)
    return answer if answer.isprintable() and " " not in answer else ""  # else it does not know the question


def _asked(question: bytes, host: str, timeout: float, connect: Connect, clock: Clock) -> str:
    deadline = clock.now() + timeout
    try:
        with connect(host, PORT, timeout) as connection:
            connection.setblocking(False)
            _line(connection, deadline, clock)  # the greeting
            connection.sendall(question + b"\n")
            return _line(connection, deadline, clock).strip().decode("ascii")
    except (OSError, UnicodeError):
        return ""


def _line(connection: socket.socket, deadline: float, clock: Clock) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        readable, _ = clock.select([connection], [], deadline - clock.now())
        received = connection.recv(1) if readable else b""
        if not received or len(line) >= ANSWER_LIMIT:
            raise OSError("the dashboard does not answer")
        line += received
    return line


ROBOT_MODES: Mapping[int, str] = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle",
    6: "backdrive",
    7: "running",
    8: "updating firmware",
}
SAFETY_MODES: Mapping[int, str] = {
    1: "normal",
    2: "reduced",
    3: "protective stop",
    4: "recovery",
    5: "safeguard stop",
    6: "system emergency stop",
    7: "robot emergency stop",
    8: "violation",
    9: "fault",
    10: "validate joint id",
    11: "undefined safety mode",
}
RUNTIME_STATES: Mapping[int, str] = {
    0: "stopping",
    1: "stopped",
    2: "playing",
    3: "pausing",
    4: "paused",
    5: "resuming",
}

RUNTIME_STOPPED, RUNTIME_PLAYING = 1, 2
"""`runtime_state` of a controller that plays no program, and of one that does."""

NAMES: Mapping[str, Mapping[int, str]] = {
    "robot_mode": ROBOT_MODES,
    "safety_mode": SAFETY_MODES,
    "runtime_state": RUNTIME_STATES,
}
"""Variable → number → meaning."""

# Where the arm can move; every other robot or safety mode must stop a session.
_SOUND: Mapping[str, frozenset[int]] = {"robot_mode": frozenset({7}), "safety_mode": frozenset({1, 2})}


_HINTS: Mapping[str, Mapping[int, str]] = {
    "robot_mode": {},
    "safety_mode": {
        3: "find out what it touched, release the stop on the pendant, and lower --speed-scale",
        5: "close the safeguard that the input monitors",
        6: "release the emergency stop",
        7: "release the emergency stop",
    },
}
_OTHERWISE = {
    "robot_mode": "switch the arm on and release its brakes on the pendant",
    "safety_mode": "see the pendant's log",
}


def describe_mode(variable: str, value: int) -> tuple[Level, str, str]:
    """Return how much a mode matters, in words, and what to do about it where it stops a session."""
    text = f"{variable.replace('_', ' ')}: {NAMES[variable].get(value, f'unknown ({value})')}"
    sound = _SOUND.get(variable)
    if sound is None or value in sound:
        return "info", text, ""
    return "error", text, _HINTS[variable].get(value, _OTHERWISE[variable])
