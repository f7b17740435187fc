"""Error control of a simulated node: heartbeats sent and awaited, node and life guarding (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from drivers.canopen402.protocol.objects import (
    CONSUMER_HEARTBEAT,
    GUARD_TIME,
    HEARTBEAT,
    HEARTBEAT_TIME,
    LIFE_TIME_FACTOR,
)
from sim_drivers.canopen.object_dictionary import Abort, ObjectDictionary, SdoAbortError

TOGGLE = 0x80
HIGHEST_NODE = 127


class NodeErrorControl:
    """Error control of one node.

    A producer is watched from its first heartbeat on, a guarding master from its first request on; after a loss, from
    the next one on. A node that sends heartbeats does not answer guarding.

    Attributes:
        muted: whether it sends nothing; a fault on request.
    """

    def __init__(self, objects: ObjectDictionary, node: int, send: Callable[[int, bytes, bool], None]) -> None:
        self.muted = False
        self._objects, self._node, self._send = objects, node, send
        self._places = [
            subindex for index, subindex in sorted(objects.entries) if index == CONSUMER_HEARTBEAT.index and subindex
        ]
        for place in self._places:
            objects.on_write(CONSUMER_HEARTBEAT.index, place, partial(self._check, place))
        self.restart()

    def restart(self) -> None:
        """The node has booted."""
        self._next_heartbeat = -math.inf
        self._toggle = 0
        self._heard: dict[int, float] = {}
        self._requested: float | None = None
        self._missed: set[int | None] = set()

    def heartbeat(self, producer: int, time: float) -> bool:
        """Another node's heartbeat came at a time [s]; whether with it no watched node is missing any more."""
        if producer not in dict(self._awaited()):
            return False
        self._heard[producer] = time
        return self._found(producer)

    def guard_request(self, time: float, nmt: int) -> bool:
        """The master requested the NMT state at a time [s]; whether no watched node is missing any more."""
        if self._objects.number(HEARTBEAT_TIME.index):
            return False
        if not self.muted:
            self._send(HEARTBEAT + self._node, bytes([nmt | self._toggle]), False)
        self._toggle ^= TOGGLE
        self._requested = time
        return self._found(None)

    def tick(self, time: float, nmt: int) -> bool:
        """Send a heartbeat that is due at a time [s]; whether a watched node has fallen silent just now."""
        period = 1e-3 * self._objects.number(HEARTBEAT_TIME.index)
        if period > 0.0 and time >= self._next_heartbeat:
            late = not time - self._next_heartbeat < period
            self._next_heartbeat = (time if late else self._next_heartbeat) + period
            if not self.muted:
                self._send(HEARTBEAT + self._node, bytes([nmt]), False)
        lost: set[int | None] = set()
        for producer, limit in self._awaited():
            if producer in self._heard and time - self._heard[producer] > limit:
                del self._heard[producer]
                lost.add(producer)
        life = 1e-3 * self._objects.number(GUARD_TIME.index) * self._objects.number(LIFE_TIME_FACTOR.index)
        if self._requested is not None and 0.0 < life < time - self._requested:
            self._requested = None
            lost.add(None)
        self._missed |= lost
        return bool(lost)

    def _awaited(self) -> list[tuple[int, float]]:
        """Node id and time limit [s] of every producer that is to be watched."""
        values = [self._objects.number(CONSUMER_HEARTBEAT.index, place) for place in self._places]
        return [(value >> 16 & 0xFF, 1e-3 * (value & 0xFFFF)) for value in values if _is_used(value)]

    def _found(self, who: int | None) -> bool:
        missed = bool(self._missed)
        self._missed.discard(who)
        return missed and not self._missed

    def _check(self, place: int, value: int) -> None:
        others = [self._objects.number(CONSUMER_HEARTBEAT.index, other) for other in self._places if other != place]
        if _is_used(value) and any(_is_used(other) and other >> 16 == value >> 16 for other in others):
            raise SdoAbortError(Abort.INCOMPATIBLE)
        self._heard.pop(self._objects.number(CONSUMER_HEARTBEAT.index, place) >> 16 & 0xFF, None)


def _is_used(value: int) -> bool:
    """Return whether an entry of object 0x1016 names a producer and a time; others are to be ignored."""
    return 1 <= value >> 16 <= HIGHEST_NODE and value & 0xFFFF > 0
