"""What the drives report beside their samples, as notices: statuswords that change, emergencies, heartbeats."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from drivers.base import Level, Notice, drained
from drivers.canopen402.monitor.life_signs import HeartbeatClocks
from drivers.canopen402.monitor.presence import Presence
from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import HOW_TO_RESET, MASTER_MISSED, Emergency, decode_emergency
from drivers.canopen402.protocol.state_machine import (
    FAULTY,
    FOLLOWING_ERROR,
    INTERNAL_LIMIT_BIT,
    POWERED,
    WARNING_BIT,
    DriveState,
    drive_state,
)
from drivers.canopen402.samples.alignment import Aligned
from drivers.core.arrays import FloatArray, IntArray
from drivers.core.text import counted

FAULT = "fault"
ALIGNMENT_PERIOD = 1.0
NOT_SENT = "SYNC(s) not sent: this computer was late"
"""Missing and extra frames are reported at most once in so many seconds."""
_MARKS = ((WARNING_BIT, "warning"), (INTERNAL_LIMIT_BIT, "internal limit active"), (FOLLOWING_ERROR, "following error"))


class DriveWatch:
    """Turns what drives report into notices; frames come from the receiving thread, the rest from the reader's.

    Args:
        joints: names.
        ids: node ids, in the joints' order.
        expected: whether each drive shows that it is there.
        presence: judges their heartbeats or answers.
        watching: whether each drive watches dynid.
        clock: a host's monotonic time [s] in the source's clock [s].
        moved_in: the mode of operation in which the drives are being moved; None where they are not.
        clocks: compares the drives' with this computer's; None where they send no heartbeats.
    """

    def __init__(
        self,
        joints: Sequence[str],
        ids: Sequence[int],
        expected: Sequence[bool],
        presence: Presence,
        watching: Sequence[bool],
        clock: Callable[[float], float],
        moved_in: Callable[[], int | None],
        clocks: HeartbeatClocks | None = None,
    ) -> None:
        self._clocks, self._clocks_told = clocks, False
        self._joints, self._ids = tuple(joints), tuple(ids)
        self._index = {node: index for index, node in enumerate(ids)}
        self._expected = tuple(expected)
        self._presence = presence
        self._watching = tuple(watching)
        self._clock = clock
        self._moved_in = moved_in
        self._notices: deque[Notice] = deque()
        self._emergency: list[Emergency | None] = [None] * len(self._ids)
        self._begin = math.inf
        self._other_master = False
        self._troubles_reported = -math.inf
        self._forget(math.nan)

    def start(self, now: float) -> None:
        """Begin anew; drives are to be heard from `now` [s, host's monotonic clock] on."""
        self._begin = now
        self._presence.start(now)
        self._forget(now)

    def _forget(self, now: float) -> None:
        """Know nothing of the drives but that they were heard at a time [s, host's monotonic clock]."""
        count = len(self._ids)
        self._heard = [now] * count
        self._nmt: list[int | None] = [None] * count
        self._gone, self._not_operational = [False] * count, [False] * count
        self._status: IntArray | None = None
        self._mode: IntArray | None = None
        self._troubles = np.zeros((3, 2, count), dtype=np.int64)
        self._unanswered = np.zeros(count, dtype=np.int64)
        self._skipped = self._all_skipped = 0

    def stop(self) -> None:
        """Expect nothing more."""
        self._begin = math.inf

    def notices(self) -> list[Notice]:
        """Notices since the last call."""
        return drained(self._notices)

    def on_emergency(self, identifier: int, data: bytearray, arrived: float) -> None:
        """Take an EMCY frame; called by the receiving thread."""
        index = self._index[identifier - objects.EMCY]
        emergency = decode_emergency(bytes(data))
        if emergency is None:
            self._report(arrived, "warning", f"{self._joints[index]}: an EMCY frame of {len(data)} bytes")
            return
        self._emergency[index] = None if emergency.cleared else emergency
        if emergency.code == MASTER_MISSED and self._watching[index] and math.isfinite(self._begin):
            # It stops now, and may take part in PDOs no longer: nothing else would say why.
            why = "it stopped receiving from dynid; did this computer stall, or was the bus cut?"
            self._report(arrived, "error", f"{self._joints[index]}: {emergency}: {why}")
            return
        level: Level = "info" if emergency.cleared else "warning" if self._moved_in() is None else "error"
        self._report(arrived, level, f"{self._joints[index]}: {emergency}")

    def on_other_master(self, identifier: int, _data: bytearray, arrived: float) -> None:
        """Take another master's heartbeat, which appeared after this driver was opened; reported once."""
        if not self._other_master:
            self._other_master = True
            node = identifier - objects.HEARTBEAT
            said = f"another master is on the bus: a heartbeat as node {node} (0x{identifier:03X}) that is not dynid's"
            self._report(arrived, "warning" if self._moved_in() is None else "error", said)

    def on_error_control(self, identifier: int, data: bytearray, arrived: float) -> None:
        """Take a heartbeat, an answer to guarding or a boot-up message; called by the receiving thread."""
        index = self._index[identifier - objects.HEARTBEAT]
        if not data:
            return
        state = data[0] & 0x7F
        self._presence.take(index, data[0], arrived)
        if self._clocks is not None and state != objects.STATE_BOOT_UP:
            self._clocks.take(index, arrived)
            if (wrong := self._clocks.wrong) and not self._clocks_told:
                self._clocks_told = True
                self._report(arrived, "warning" if self._moved_in() is None else "error", wrong)
        self._heard[index], self._nmt[index] = arrived, state
        if state == objects.STATE_BOOT_UP and math.isfinite(self._begin):
            self._report(
                arrived, "error", f"{self._joints[index]}: the drive restarted, and has lost its configuration"
            )

    def check_presence(self, drained: float) -> None:
        """Report drives that fell silent; all that arrived before `drained` [s, host's monotonic clock] is known."""
        for index, joint in enumerate(self._joints):
            if not self._expected[index] or math.isinf(self._begin):
                continue
            missing = self._presence.missing(index, drained)
            if missing and not self._gone[index]:
                self._gone[index] = True
                self._report(drained, "error", f"{joint} (node {self._ids[index]}): {missing}; is its power on?")
            elif not missing and self._gone[index]:
                self._gone[index] = False
                self._report(drained, "info", f"{joint}: {self._presence.back}")
            nmt = self._nmt[index]
            if nmt not in (None, objects.STATE_OPERATIONAL, objects.STATE_BOOT_UP):
                if self._heard[index] - self._begin > self._presence.limit and not self._not_operational[index]:
                    self._not_operational[index] = True
                    state = objects.NMT_STATES.get(nmt or 0, f"unknown state {nmt}")
                    self._report(drained, "error", f"{joint}: the drive is no longer operational, but {state}")
            else:
                self._not_operational[index] = False

    def check_status(self, time: FloatArray, statusword: IntArray, mode: IntArray) -> None:
        """Report changes of state, and drives that leave the mode of the motion.

        Rows have the source's time (N,) [s]; statuswords and modes, as displayed, are (N, n).
        """
        if not len(time):
            return
        wanted = self._moved_in()
        first = self._status is None
        before = statusword[0] if self._status is None else self._status
        changed = statusword != np.concatenate([before[np.newaxis], statusword[:-1]])
        if first:
            self._report_states(float(time[0]), statusword[0])
        for row in np.flatnonzero(changed.any(axis=1)):
            previous = before if row == 0 else statusword[row - 1]
            self._report_changes(float(time[row]), previous, statusword[row], moving=wanted is not None)
        self._status = statusword[-1].copy()
        before_mode = mode[0] if self._mode is None else self._mode
        left = (np.vstack([before_mode, mode[:-1]]) == wanted) & (mode != wanted)
        for row, index in np.argwhere(left):
            shown = objects.mode_words(int(mode[row, index]))
            said = f"{self._joints[index]}: the drive left the mode of the motion: it displays mode {shown}"
            self._notices.append(Notice(float(time[row]), "error", said))
        self._mode = mode[-1].copy()

    def check_alignment(self, aligned: Aligned, skipped: int, now: float) -> None:
        """Note frames that did not come once a SYNC, and SYNCs that were not sent; reported from time to time.

        `skipped` SYNCs were not sent since the last call; `now` is in the host's monotonic clock [s].
        """
        self._troubles += np.stack([aligned.missing, aligned.extra, aligned.misfit])
        self._skipped += skipped
        self._all_skipped += skipped
        self._unanswered += aligned.missing.max(axis=0)
        if now - self._troubles_reported >= ALIGNMENT_PERIOD:
            self.report_alignment(now)

    def report_alignment(self, now: float) -> None:
        """Report what `check_alignment` noted and did not report yet; `now` [s, host's monotonic clock]."""
        if not (self._troubles.any() or self._skipped):
            return
        self._troubles_reported = now
        said = [counted(self._skipped, NOT_SENT)] if self._skipped else []
        kinds = ("no answer to SYNC", "more than one answer to SYNC", "frames of a wrong length")
        for counts, words in zip(self._troubles, kinds, strict=True):
            if (counts == counts[0, 0]).all() and counts.any() and counts.size > 2:
                said.append(f"{words}: all joints {counts[0, 0]}")
                continue
            each = [
                f"{self._joints[index]} TPDO{tpdo + 1} {counts[tpdo, index]}" for tpdo, index in np.argwhere(counts)
            ]
            if each:
                said.append(f"{words}: {', '.join(each)}")
        self._troubles[:] = 0
        self._skipped = 0
        self._report(now, "warning", "; ".join(said))

    def losses(self) -> str:
        """Return why rows were lost since `start`, in words: this computer was late, or drives did not answer."""
        said = [counted(self._all_skipped, NOT_SENT)] if self._all_skipped else []
        silent = [f"{self._joints[index]} {self._unanswered[index]}" for index in np.flatnonzero(self._unanswered)]
        if silent:
            said.append(f"no answer to SYNC in time: {', '.join(silent)}")
        return "; ".join(said)

    def powered(self, index: int) -> bool:
        """Return whether the drive's last statusword says that its motor is powered."""
        return self._status is not None and drive_state(int(self._status[index])) in POWERED

    def cause(self, index: int) -> str:
        """Return what a drive said last about its error, in words; empty where it said nothing."""
        emergency = self._emergency[index]
        return "" if emergency is None else str(emergency)

    def _report_states(self, time: float, statusword: IntArray) -> None:
        states = [drive_state(int(word)) for word in statusword]
        for state in dict.fromkeys(states):
            who = [joint for joint, own in zip(self._joints, states, strict=True) if own is state]
            level: Level = "warning" if state in FAULTY else "info"
            self._notices.append(Notice(time, level, f"{self._who(who)}: {state.value}"))

    def _report_changes(self, time: float, previous: IntArray, statusword: IntArray, *, moving: bool) -> None:
        grouped: dict[tuple[Level, str], list[str]] = {}
        for index, joint in enumerate(self._joints):
            old, new = int(previous[index]), int(statusword[index])
            before, state = drive_state(old), drive_state(new)
            for bit, words in _MARKS:
                if new & bit and not old & bit:
                    grouped.setdefault(("warning", words), []).append(joint)
            if state is before:
                continue
            if state in FAULTY and before not in FAULTY:
                grouped.setdefault(("error", self._fault_words(index)), []).append(joint)
            elif moving and before is DriveState.ENABLED and state not in FAULTY:
                grouped.setdefault(("error", f"left operation enabled: {state.value}"), []).append(joint)
            else:
                grouped.setdefault(("info", state.value), []).append(joint)
        for (level, words), who in grouped.items():
            hint = HOW_TO_RESET if words.startswith(FAULT) else ""
            self._notices.append(Notice(time, level, f"{self._who(who)}: {words}", hint))

    def _fault_words(self, index: int) -> str:
        cause = self.cause(index)
        return f"{FAULT}: {cause}" if cause else f"{FAULT} (no EMCY so far)"

    def _who(self, joints: Sequence[str]) -> str:
        return "all joints" if len(joints) == len(self._joints) > 1 else ", ".join(joints)

    def _report(self, host_time: float, level: Level, message: str) -> None:
        self._notices.append(Notice(self._clock(host_time), level, message))
