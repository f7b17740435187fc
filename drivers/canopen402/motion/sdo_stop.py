"""Stopping drives by SDO that no longer take part in PDOs: those that left operational by themselves.

A drive that misses its master goes to pre-operational (CiA 301, object 0x1029); it neither hears an RPDO then, nor
answers SYNC, but it still answers SDO.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

from drivers.can.bus import Sender
from drivers.canopen402.protocol.objects import CONTROLWORD, SDO_ANSWER, SDO_REQUEST, STATUSWORD
from drivers.canopen402.protocol.state_machine import POWERED, DriveState, drive_state
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError

PATIENCE = 0.1
"""How long [s] a drive may take to answer SYNC before it is asked by SDO."""
REPEAT = 0.03
"""From one request to the next [s]."""
_READ, _WRITE = 0x40, 0x2B
_SIZE = slice(4, 4 + STATUSWORD.size)
_PLACE = bytes([*STATUSWORD.index.to_bytes(2, "little"), STATUSWORD.subindex])


class SdoStop:
    """Asks drives for their statusword, and switches off those that are still powered; waits for none.

    Args:
        sender: of the bus.
        ids: node ids.
        clock: the host's.
    """

    def __init__(self, sender: Sender, ids: Sequence[int], clock: Clock = SYSTEM_CLOCK) -> None:
        self._sender, self._ids, self._clock = sender, tuple(ids), clock
        self._index = {node: index for index, node in enumerate(ids)}
        self._answered = [(-math.inf, DriveState.UNKNOWN)] * len(self._ids)
        self._asked = [-math.inf] * len(self._ids)

    def on_answer(self, identifier: int, data: bytearray, arrived: float) -> None:
        """Take an answer to an SDO request, if it is one with a statusword; called by the receiving thread."""
        if len(data) == 8 and data[0] >> 5 == 2 and data[1:4] == _PLACE:
            state = drive_state(int.from_bytes(data[_SIZE], "little"))
            self._answered[self._index[identifier - SDO_ANSWER]] = arrived, state

    def is_off(self, index: int, asked: float, controlword: int) -> bool:
        """Whether a drive has said by SDO that it is without power.

        Args:
            index: of the drive.
            asked: when it was asked to be by PDO [s, host's monotonic clock]; what it said before does not count.
            controlword: for a drive that is still powered.
        """
        now = self._clock.now()
        answered, state = self._answered[index]
        known = answered > max(asked, self._asked[index])
        if known and state not in POWERED and state is not DriveState.UNKNOWN:
            return True
        if now - asked < PATIENCE or now - self._asked[index] < REPEAT:
            return False
        self._asked[index] = now
        request = bytes([_READ]) + _PLACE + bytes(4)
        if known and state in POWERED:
            place = bytes([*CONTROLWORD.index.to_bytes(2, "little"), CONTROLWORD.subindex])
            request = bytes([_WRITE]) + place + CONTROLWORD.encode(controlword) + bytes(2)
        with contextlib.suppress(ConnectionLostError):
            self._sender.send(SDO_REQUEST + self._ids[index], request)
        return False
