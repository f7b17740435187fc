"""The secondary interface (port 30002) of a simulated controller: of its state only Configuration Data.

A real one repeats it ten times a second among other parts; this one says it once, to every client that connects.
"""

from __future__ import annotations

import struct

import numpy as np

from drivers.rtde.configuration import CONFIGURATION_DATA, CONTENT, HEADER, ROBOT_STATE
from sim_drivers.rtde.controller import Controller

_REST = struct.Struct(">4i")
"""Numbers of board, box, robot and variant."""


class SecondarySession:
    """One client of the secondary interface."""

    def __init__(self, controller: Controller) -> None:
        self.closing = False
        self._controller = controller

    def greeting(self) -> bytes:
        """The joints' limits and the arm's lengths."""
        controller = self._controller
        position = np.column_stack([controller.lower, controller.upper])
        motion = np.column_stack([controller.speed_limit, controller.acceleration_limit])
        upper_arm, forearm, shoulder, wrist = controller.lengths
        table = [0.0, -upper_arm, -forearm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, shoulder, wrist, 0.0, *[0.0] * 12]
        content = CONTENT.pack(*position.ravel(), *motion.ravel(), *[0.0] * 5, *table) + _REST.pack(*[0] * 4)
        part = HEADER.pack(HEADER.size + len(content), CONFIGURATION_DATA) + content
        return HEADER.pack(HEADER.size + len(part), ROBOT_STATE) + part

    def close(self) -> None:
        """Nothing to close."""

    def receive(self, _chunk: bytes) -> bytes:
        """Nothing: scripts go to port 30003 here."""
        return b""
