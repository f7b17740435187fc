"""A lock on an arm: of all programs on this computer, one at a time moves it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager

from daq.robot.schema import Robot
from daq.session.connections import connection_keys, connection_names
from drivers.errors import MotionRefusedError
from drivers.lock_file import held_lock

_PLACE = ("host", "port", "interface", "channel", "url")
"""Keys that tell where an arm is."""
_WITHIN_A_PROCESS = "virtual"
"""python-can's interface that no other program can reach."""


@contextmanager
def only_mover(robot: Robot, wire: str | None = None, host: str | None = None) -> Iterator[None]:
    """Hold the lock on the arm at the end of a connection; the system releases it when this program dies.

    A connection that does not say where its arm is, and computers without `flock`, have no lock.

    Args:
        robot: names the connections.
        wire: which of them; the first where None.
        host: in place of the connection's own.

    Raises:
        MotionRefusedError: another program holds it.
        UsageError: no such connection.
    """
    name = connection_names(robot, wire)[0]
    keys = {key: value for key, value in connection_keys(robot, name).items() if key in _PLACE}
    if host is not None:
        keys["host"] = host
    if not keys or keys.get("interface") == _WITHIN_A_PROCESS:
        yield
        return
    place = ", ".join(str(value) for value in keys.values())
    text = json.dumps([robot.connections[name].driver, keys], sort_keys=True, default=str)
    with held_lock(text) as alone:
        if not alone:
            raise MotionRefusedError(
                "another program on this computer moves this arm", where=place, hint="wait until it has ended"
            )
        yield
