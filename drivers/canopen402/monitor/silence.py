"""Which drives keep rows from coming, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.can.bus import Frame
from drivers.canopen402.protocol.objects import TPDO_BASES


class Silence:
    """Response time-outs of the drives.

    Args:
        joints: names.
        ids: node ids, in the joints' order.
        latest: identifier → the newest frame; written by the receiving thread.
    """

    def __init__(self, joints: Sequence[str], ids: Sequence[int], latest: Mapping[int, Frame]) -> None:
        self._joints, self._ids, self._latest = tuple(joints), tuple(ids), latest

    def who(self, since: float) -> tuple[str, float]:
        """The drives that have not sent both TPDOs since a time, and when the last of them had.

        Both times [s, host's monotonic clock]; no words where all have.
        """
        silent: dict[str, float] = {}
        for joint, node in zip(self._joints, self._ids, strict=True):
            heard = min(self._latest.get(base + node, (-math.inf,))[0] for base in TPDO_BASES)
            if heard < since:
                silent[f"{joint} (node {node})"] = heard
        words = "any drive" if len(silent) == len(self._ids) > 1 else ", ".join(silent)
        return words, max(silent.values(), default=-math.inf)

    def explain(self, now: float, drained: float, last_sync: float, limit: float) -> str:
        """Why no row came for about `limit` [s]; empty where all drives answer.

        Args:
            now: [s, host's monotonic clock].
            drained: all that arrived before this time [s, host's monotonic clock] is known.
            last_sync: when the last SYNC was sent [s, host's monotonic clock].
            limit: [s].
        """
        recent = 0.5 * limit  # a row is handed out one SYNC after its frames came, and the session looks later still
        if now - last_sync > recent:
            return f"no SYNC sent for {now - last_sync:.2f} s: this computer was late"
        if now - drained > recent:
            return f"the bus was not read for {now - drained:.2f} s: this computer was late"
        who, heard = self.who(drained - recent)
        return f"no answer to SYNC of {who} for {drained - heard:.2f} s" if who else ""
