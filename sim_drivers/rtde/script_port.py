"""The script port (30003) of a simulated controller: receives the control script of ur_rtde and starts it.

URScript is not interpreted: of a whole program only its name and its register offset are read. The real port also
sends the controller's state; this one is silent, as ur_rtde does not listen.
"""

from __future__ import annotations

import re

from drivers.core.errors import ConnectionLostError
from sim_drivers.rtde.control_script import ControlScript
from sim_drivers.rtde.controller import Controller

CONTROL_PROGRAM = "rtde_control"
LONGEST_SCRIPT = 250_000

_HEADER = re.compile(r"^(?:def|sec)\s+(\w+)\s*\(\s*\)\s*:", re.MULTILINE)
_END = re.compile(r"^end[ \t\r]*\n", re.MULTILINE)
_OFFSET = re.compile(r"reg_offset_int\s*=[^\n]*\n\s*(\d+)")


class ScriptSession:
    """One client of the script port."""

    def __init__(self, controller: Controller) -> None:
        self.closing = False
        self._controller = controller
        self._pending = ""

    def greeting(self) -> bytes:
        """No greeting."""
        return b""

    def close(self) -> None:
        """A program continues when its client disconnects."""

    def receive(self, chunk: bytes) -> bytes:
        """Start every program that is complete with this chunk.

        Raises:
            ConnectionLostError: a program does not end.
        """
        self._pending += chunk.decode("utf-8", errors="replace")
        while (end := _END.search(self._pending)) is not None:
            body, self._pending = self._pending[: end.start()], self._pending[end.end() :]
            header = _HEADER.search(body)
            if header is not None:
                self._start(header[1], body)
        if len(self._pending) > LONGEST_SCRIPT:
            raise ConnectionLostError("a script does not end")
        return b""

    def _start(self, name: str, body: str) -> None:
        if name != CONTROL_PROGRAM:
            self._controller.messages.append(f"the program '{name}' was not run: URScript is not interpreted")
            return
        if not self._controller.remote_control:
            self._controller.messages.append(
                f"the program '{name}' was not run: the controller is not in remote control"
            )
            return
        offset = _OFFSET.search(body)
        self._controller.start_program(ControlScript(24 if offset is not None and offset[1] == "24" else 0))
