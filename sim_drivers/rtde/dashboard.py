"""The dashboard port (29999) and the secondary interface (port 30002) of a simulated controller.

The dashboard has one line per request and one per answer; wordings: Universal Robots, "Dashboard Server e-Series", as
far as ur_rtde 1.6.5 reads them.

The secondary interface sends Configuration Data alone of the controller's state. A real one repeats it ten times a
second among other parts; this one says it once, to every client that connects.
"""

from __future__ import annotations

import struct

import numpy as np

from drivers.core.errors import ConnectionLostError
from drivers.rtde.configuration import CONFIGURATION_DATA, CONTENT, HEADER, ROBOT_STATE
from sim_drivers.rtde.controller import NORMAL
from sim_drivers.rtde.session import Session

LONGEST_LINE = 4096
SERIAL_NUMBER = "20000000000"


class DashboardSession(Session):
    """One client of the dashboard."""

    _pending = b""

    def greeting(self) -> bytes:
        """Greeting of the dashboard."""
        return b"Connected: Universal Robots Dashboard Server\n"

    def receive(self, chunk: bytes) -> bytes:
        """Answer every line that is complete."""
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        if len(self._pending) > LONGEST_LINE:
            raise ConnectionLostError("a dashboard command does not end")
        answers = [self._answer(line.decode("utf-8", errors="replace").strip()) for line in lines]
        return "".join(f"{answer}\n" for answer in answers).encode()

    def _answer(self, line: str) -> str:  # noqa: C901, PLR0912 — a branch per request
        controller = self._controller
        playing, normal = controller.script is not None, controller.safety_mode == NORMAL
        match line.lower():
            case "polyscopeversion":
                return f"URSoftware {controller.version} (simulated by dynid)"
            case "get serial number":
                return SERIAL_NUMBER
            case "is in remote control":
                return "true" if controller.remote_control else "false"
            case "robotmode":
                return "Robotmode: RUNNING"
            case "safetymode":
                return f"Safetymode: {'NORMAL' if normal else 'PROTECTIVE_STOP'}"
            case "safetystatus":
                return f"Safetystatus: {'NORMAL' if normal else 'PROTECTIVE_STOP'}"
            case "running":
                return f"Program running: {'true' if playing else 'false'}"
            case "programstate":
                return f"{'PLAYING' if playing else 'STOPPED'} rtde_control"
            case "stop" | "power on" | "brake release" if not controller.remote_control:
                return "Command is not allowed due to safety reasons"
            case "stop":
                controller.stop_program()
                return "Stopped"
            case "power on":
                return "Powering on"
            case "brake release":
                return "Brake releasing"
            case "close safety popup":
                return "closing safety popup"
            case "close popup":
                return "closing popup"
            case "unlock protective stop":
                if controller.unlock_protective_stop():
                    return "Protective stop releasing"
                return "Cannot unlock protective stop until 5s after occurrence"
            case "quit":
                self.closing = True
                return "Disconnected"
        return f"could not understand: '{line}'"


_REST = struct.Struct(">4i")
"""Numbers of board, box, robot and variant."""


class SecondarySession(Session):
    """One client of the secondary interface."""

    def greeting(self) -> bytes:
        """The joints' limits and the arm's lengths."""
        controller = self._controller
        position = np.column_stack([controller.lower, controller.upper])
        motion = np.column_stack([controller.speed_limit, controller.acceleration_limit])
        upper_arm, forearm, shoulder, wrist = controller.lengths
        table = [0.0, -upper_arm, -forearm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, shoulder, wrist, 0.0, *[0.0] * 12]
        content = CONTENT.pack(*position.ravel(), *motion.ravel(), *[0.0] * 5, *table) + _REST.pack(*[0] * 4)
        package = HEADER.pack(HEADER.size + len(content), CONFIGURATION_DATA) + content
        return HEADER.pack(HEADER.size + len(package), ROBOT_STATE) + package

    def receive(self, _chunk: bytes) -> bytes:
        """Nothing: scripts go to port 30003 here."""
        return b""
