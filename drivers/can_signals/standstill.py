"""Whether an arm has come to rest, from its own positions."""

from __future__ import annotations

import contextlib
from collections import deque

import numpy as np

from drivers.can.bus import Receiver
from drivers.can_signals.assembly import Assembler
from drivers.can_signals.signals import batches
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import ConnectionLostError
from drivers.streams import FloatArray

REST_LIMIT = 2.0
"""How long [s] an arm may take to come to rest."""
REST_WINDOW = 0.1
REST_SPEED = 0.02
"""[rad/s]: slower than this over `REST_WINDOW` [s] is rest."""
_WAIT = 0.02


def comes_to_rest(receiver: Receiver | None, joints: Assembler, clock: Clock = SYSTEM_CLOCK) -> bool:
    """Whether the positions in the joints' rows stand still before `REST_LIMIT` is over; False without a connection."""
    if receiver is None:
        return False
    members = [index for index, signal in enumerate(joints.signals) if signal.quantity == "position"]
    seen: deque[tuple[float, FloatArray]] = deque()
    end = clock.now() + REST_LIMIT
    with contextlib.suppress(ConnectionLostError):
        while clock.now() < end:
            frames = receiver.take(_WAIT)
            rows = joints.take(frames, dict(batches(frames)))
            seen.extend(zip(rows.host_time.tolist(), rows.values[:, members], strict=True))
            while len(seen) > 1 and seen[1][0] <= seen[-1][0] - REST_WINDOW:
                seen.popleft()
            if len(seen) < 2 or (span := seen[-1][0] - seen[0][0]) < REST_WINDOW:
                continue
            travelled = np.ptp(np.array([position for _, position in seen]), axis=0)
            if np.all(travelled < REST_SPEED * span):
                return True
    return False
