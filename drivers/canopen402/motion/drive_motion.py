"""Moves the drives: enables them, sends targets after every SYNC, and stops them; never enables after a fault.

canopen's own profile (BaseNode402) is not used: its fault reset goes on to operation enabled.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from drivers.can.bus import Frame, Sender
from drivers.canopen402.motion.target_path import BRIDGED, SdoStop, TargetPath
from drivers.canopen402.protocol.emcy import HOW_TO_RESET
from drivers.canopen402.protocol.objects import (
    MODE_CYCLIC_TORQUE,
    MODE_PROFILE_POSITION,
    RPDO1,
    RPDO2,
    SYNC,
    TPDO1,
    TPDO2,
    mode_words,
)
from drivers.canopen402.protocol.state_machine import (
    CHANGE_AT_ONCE,
    DISABLE_VOLTAGE,
    ENABLE_OPERATION,
    ENABLING,
    FAULTY,
    NEW_SET_POINT,
    POWERED,
    QUICK_STOP,
    SET_POINT_ACKNOWLEDGED,
    DriveState,
    drive_state,
)
from drivers.core.arrays import IntArray
from drivers.core.clock import STALL_LIMIT, SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionLostError, DriverStateError, MotionRefusedError

STOP_LIMIT = 3.0
"""How long [s] the drives may go on without coming to rest or slowing down: then their voltage is switched off."""
STANDING = 0.02
"""How long [s] a stopped drive's position must stay where it is."""
SLOWER = 0.9
"""Share of the speed before, from which on drives are slowing down."""
OFF_LIMIT = 0.3
"""How long [s] they may take to switch off."""
PUSH_LIMIT = 0.1
"""Longest time [s] without a new torque of an arm that is led by hand: the last one may no longer carry it."""
MODE_CHANGE = 0.2
"""How long [s] drives may take to go over to torques."""
_POLL = 0.002

_TARGET = struct.Struct("<Hbi")
_STATE = struct.Struct("<Hbi")
_TORQUE = struct.Struct("<h")
_SPEED_BYTES = 4

Phase = Literal["idle", "enabling", "moving", "led", "stopping", "off"]


@dataclass(frozen=True)
class DriveReport:
    """What a drive said last."""

    time: float  # of its arrival [s, host's monotonic clock]
    statusword: int  # of the drive
    mode: int  # of operation, as it displays it
    position: int  # [counts]

    @property
    def state(self) -> DriveState:
        """State of the power stage (CiA 402)."""
        return drive_state(self.statusword)


class DriveMotion:
    """The drives of an arm, from standstill to standstill.

    Args:
        joints: names.
        ids: node ids, in the joints' order.
        mode: of operation.
        period: of SYNC, and of the commands [s].
        standstill: (n,) speed below which a joint is at rest [counts/s].
        latest: identifier → the newest frame; written by the receiving thread.
        sender: of the bus.
        beside: reaches drives that no longer answer SYNC.
        clock: the host's.
    """

    def __init__(
        self,
        joints: Sequence[str],
        ids: Sequence[int],
        mode: int,
        period: float,
        standstill: Sequence[float],
        latest: Mapping[int, Frame],
        sender: Sender,
        beside: SdoStop,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._joints, self._ids, self._mode = tuple(joints), tuple(ids), mode
        self._period = period
        self._standstill = tuple(standstill)
        self._latest = latest
        self._sender = sender
        self._beside = beside
        self._clock = clock
        self._phase: Phase = "idle"
        self._halted = clock.event()
        self._controlword = DISABLE_VOLTAGE
        self._targets = [0] * len(self._ids)
        self._path = TargetPath(self._targets, period)
        self._set_points: list[int | None] = [None] * len(self._ids)
        self._offered = [False] * len(self._ids)
        self._last_moment = math.nan
        # In cyclic position drives go on with their velocity, then jolt; a profile ends by itself.
        self._longest_stall = (
            STALL_LIMIT if mode == MODE_PROFILE_POSITION else min((BRIDGED + 0.5) * period, STALL_LIMIT)
        )
        self._stood: list[tuple[float, float]] = []
        self._pushed: tuple[float, list[int]] = (-math.inf, [])
        self._led_since = -math.inf
        self.ended_by: str | None = None
        """Why it ended by itself: a drive that left operation enabled; None where it did not."""
        self.dropped_out: int | None = None
        """Which joint's drive left operation enabled by itself; None where none did."""

    @property
    def idle(self) -> bool:
        """Return whether the drives have not been enabled, or are off again."""
        return self._phase == "idle"

    @property
    def moving(self) -> bool:
        """Return whether the drives are enabled and follow targets."""
        return self._phase == "moving"

    @property
    def active(self) -> bool:
        """Return whether the drives follow targets, or did until one of them left the motion by itself."""
        return self._phase in ("moving", "led") or self.ended_by is not None

    @property
    def mode(self) -> int:
        """Return the mode of operation, in which the drives are to be."""
        return self._mode

    def heard(self, index: int) -> DriveReport | None:
        """Return what a drive said last; None where it said nothing yet."""
        frame = self._latest.get(TPDO1 + self._ids[index])
        if frame is None or len(frame[2]) != _STATE.size:
            return None
        return DriveReport(frame[0], *_STATE.unpack(frame[2]))

    def outputs(self, moment: float, left_out: int = 0) -> Sequence[tuple[int, bytes]]:
        """The frames for the next SYNC to apply; called by the SYNC thread once a period.

        Args:
            moment: of the present SYNC in its schedule [s, host's monotonic clock].
            left_out: SYNCs up to then that were not sent; the frames given last were not applied.
        """
        phase = self._phase
        if phase == "idle":
            return ()
        stalled, self._last_moment = moment - self._last_moment - (0 if left_out else self._period), moment
        if phase in ("moving", "led"):
            self._watch_for_drop_outs()
            if stalled > self._longest_stall and self.ended_by is None:  # the drives have had no target meanwhile
                self.ended_by = f"this computer stalled for {stalled:.3f} s, more than {self._longest_stall:g} s"
                self._phase = "stopping"
        wanted = self._path.at(moment, 0 if self._mode == MODE_PROFILE_POSITION else left_out)
        if self._phase == "moving" and self._mode != MODE_PROFILE_POSITION and self._path.run_out:
            self._phase = "stopping"  # along their ramp; the caller knows why
        if self._phase == "led" and self._clock.now() - self._pushed[0] > PUSH_LIMIT:
            self.ended_by, self._phase = f"no torque was commanded for {PUSH_LIMIT:g} s", "stopping"
        targets = [self._output(index, wanted[index]) for index in range(len(self._ids))]
        if self._phase != "led":
            return targets
        pairs = zip(self._ids, self._pushed[1], strict=True)
        return [*((RPDO2 + node, _TORQUE.pack(torque)) for node, torque in pairs), *targets]

    def enable(self, timeout: float) -> None:
        """Bring all drives to operation enabled, each holding its position.

        Raises:
            DriverStateError: a drive is in fault, does not come along in time, or the motion was halted meanwhile.
            MotionRefusedError: a drive is powered already.
        """
        deadline = self._clock.now() + timeout
        if self._phase != "idle":
            raise DriverStateError("the drives are being stopped", hint="start again before the next motion")
        self._check_faults()
        self._check_unpowered()
        self._phase = "enabling"
        try:
            for controlword, goal in ENABLING:
                self._controlword = controlword
                asked = self._clock.now()
                self._wait(partial(_reached, asked, goal), goal, deadline)
                if goal is DriveState.READY:
                    self._wait(lambda heard: heard.mode == self._mode, None, deadline)
        except DriverStateError:
            self._phase = "stopping"  # what is enabled already must not stay so
            raise
        self._path = TargetPath(self._targets, self._period)
        self._phase = "moving"

    def command(self, counts: IntArray, due: float | None = None) -> None:
        """Aim at positions (n,) [counts], along a straight line from the last ones; `due` [s, host's clock], else now.

        Raises:
            DriverStateError: the drives are not enabled, or no longer.
            ValueError: a position does not fit into the drive's 32 bits.
        """
        if self._phase != "moving":
            late = "the commands came too late, and the arm was stopped"
            reason = self.ended_by or (late if self._path.run_out else "the drives are not enabled")
            raise DriverStateError(f"the arm does not move: {reason}", hint="start again before the next motion")
        if np.any(np.abs(counts) > 2**31 - 1):
            raise ValueError("a target does not fit into 32 bits of counts")
        self._path.put(self._clock.now() if due is None else due, [int(count) for count in counts])

    def release(self, torque: IntArray) -> None:
        """Let the drives give torques (n,) [‰ of their rated ones] from the next SYNC on.

        Raises:
            DriverStateError: they are not enabled.
            ValueError: a torque that does not fit into 16 bits.
        """
        if self._phase != "moving":
            raise DriverStateError(f"the arm is not let go: {self.ended_by or 'the drives are not enabled'}")
        self._push(torque)
        self._longest_stall = min((BRIDGED + 0.5) * self._period, STALL_LIMIT)
        self._mode, self._led_since = MODE_CYCLIC_TORQUE, self._clock.now()
        self._phase = "led"

    def push(self, torque: IntArray) -> None:
        """Take torques (n,) [‰ of the rated ones] of an arm that is let go; raises as `release`."""
        if self._phase != "led":
            raise DriverStateError(f"the arm accepts no torque commands: {self.ended_by or 'it is not let go'}")
        self._push(torque)

    def _push(self, torque: IntArray) -> None:
        if np.any(np.abs(torque) > 2**15 - 1):
            raise ValueError("a torque does not fit into 16 bits")
        self._pushed = self._clock.now(), torque.tolist()

    def halt(self) -> None:
        """Quick-stop all drives with the next SYNC, without waiting; safe at any time."""
        self._halted.set()
        if self._phase in ("enabling", "moving", "led"):
            self._phase = "stopping"

    def stop(self, sync_runs: Callable[[], bool]) -> list[str]:
        """Quick stop, wait for rest, switch off the voltage; never raises.

        Args:
            sync_runs: whether SYNC is being sent; where it is not, this sends it.

        Returns:
            What went wrong, in words: drives that did not confirm that they are at rest and off.
        """
        self._halted.set()
        if self._phase == "idle":
            return []
        self._phase = "stopping"
        self._stood = [(math.inf, math.inf)] * len(self._ids)
        unconfirmed = self._send_until(sync_runs, self._at_rest, STOP_LIMIT)
        moving = [index for index in unconfirmed if self._speed(index) > 1.0]
        self._controlword = DISABLE_VOLTAGE
        self._phase = "off"
        still_on = self._send_until(sync_runs, self._is_off, OFF_LIMIT)
        self._phase = "idle"
        return [
            f"{self._joints[index]}: "
            + (
                f"the drive went on for {STOP_LIMIT:g} s after its quick stop without slowing down; its voltage was cut"
                if index in moving and index not in still_on
                else "the drive did not confirm that it is at rest and off"
            )
            for index in sorted({*unconfirmed, *still_on})
        ]

    def _send_until(
        self, sync_runs: Callable[[], bool], settled: Callable[[int, float], bool], limit: float
    ) -> list[int]:
        """Send to all drives at once until they have settled; those that neither have nor slow down for `limit` [s]."""
        asked = since = self._clock.now()
        slowest = max(map(self._speed, range(len(self._ids))))
        with contextlib.suppress(ConnectionLostError):
            self._sender.send_all(self.outputs(self._clock.now()))  # now, not only after the next SYNC
        while True:
            if not sync_runs():
                with contextlib.suppress(ConnectionLostError):
                    self._sender.send_all([*self.outputs(self._clock.now()), (SYNC, b"")])
                self._clock.sleep(5.0 * _POLL)
            open_ones = [index for index in range(len(self._joints)) if not settled(index, asked)]
            speed = max((self._speed(index) for index in open_ones), default=0.0)
            if speed < SLOWER * slowest:
                slowest, since = speed, self._clock.now()
            if not open_ones or self._clock.now() - since > limit:
                return open_ones
            self._clock.sleep(_POLL)

    def _speed(self, index: int) -> float:
        """A drive's last speed, over that below which it is at rest."""
        frame = self._latest.get(TPDO2 + self._ids[index], (0.0, 0, b""))
        speed = int.from_bytes(frame[2][:_SPEED_BYTES], "little", signed=True)
        return abs(speed) / self._standstill[index]

    def _at_rest(self, index: int, asked: float) -> bool:
        heard = self.heard(index)
        if heard is None or heard.time <= asked:
            return self._beside.is_off(index, asked, QUICK_STOP)
        if heard.state is not DriveState.QUICK_STOP:
            return heard.state not in POWERED and heard.state is not DriveState.UNKNOWN
        frame = self._latest.get(TPDO2 + self._ids[index])
        if frame is None or frame[0] <= asked or len(frame[2]) < _SPEED_BYTES:
            return False
        return self._speed(index) <= 1.0 and self._stands(index, heard)

    def _stands(self, index: int, heard: DriveReport) -> bool:
        """Whether a drive's position has stayed for `STANDING`: its velocity may have another unit than counts/s."""
        since, position = self._stood[index]
        if abs(heard.position - position) <= self._standstill[index] * STANDING:
            return heard.time - since >= STANDING
        self._stood[index] = heard.time, heard.position
        return False

    def _is_off(self, index: int, asked: float) -> bool:
        heard = self.heard(index)
        if heard is None or heard.time <= asked:
            return self._beside.is_off(index, asked, DISABLE_VOLTAGE)
        return heard.state not in POWERED

    def _output(self, index: int, wanted: int) -> tuple[int, bytes]:
        heard = self.heard(index)
        controlword = self._controlword
        if self._phase == "moving":
            controlword = ENABLE_OPERATION | self._follow(index, wanted, heard)
        elif self._phase in ("enabling", "led"):
            if self._phase == "led":
                controlword = ENABLE_OPERATION
            if heard is not None and (self._phase == "led" or heard.state is not DriveState.ENABLED):
                self._targets[index] = heard.position  # so that enabling moves nothing
        elif self._phase == "stopping":
            controlword = QUICK_STOP
        return RPDO1 + self._ids[index], _TARGET.pack(controlword, self._mode, self._targets[index])

    def _follow(self, index: int, wanted: int, heard: DriveReport | None) -> int:
        """Take over the target that is wanted; further bits of the controlword."""
        if self._mode != MODE_PROFILE_POSITION:
            self._targets[index] = wanted
            return 0
        # Handshake of profile position mode: offer until acknowledged, withdraw until that is gone, next.
        acknowledged = heard is not None and bool(heard.statusword & SET_POINT_ACKNOWLEDGED)
        if self._offered[index]:
            self._offered[index] = not acknowledged
        elif not acknowledged and wanted != self._set_points[index]:
            self._targets[index] = self._set_points[index] = wanted
            self._offered[index] = True
        return CHANGE_AT_ONCE | (NEW_SET_POINT if self._offered[index] else 0)

    def _watch_for_drop_outs(self) -> None:
        changing = self._clock.now() - self._led_since < MODE_CHANGE
        for index, joint in enumerate(self._joints):
            heard = self.heard(index)
            if heard is None or (heard.state is DriveState.ENABLED and (changing or heard.mode == self._mode)):
                continue
            self.dropped_out = index
            said = f"operation enabled: {heard.state.value}"
            if heard.state is DriveState.ENABLED:
                said = f"mode {mode_words(self._mode)}: it displays {mode_words(heard.mode)}"
            self.ended_by = f"{joint} left {said}"
            self._phase = "stopping"  # the others must not go on without it
            return

    def _check_faults(self) -> None:
        for index, joint in enumerate(self._joints):
            heard = self.heard(index)
            if heard is not None and heard.state in FAULTY:
                raise DriverStateError(
                    "the drive is in fault, and is not enabled",
                    where=f"{joint} (node {self._ids[index]})",
                    hint=HOW_TO_RESET,
                )

    def _check_unpowered(self) -> None:
        """Enabling begins with a controlword that cuts the voltage: not of drives that somebody else runs."""
        for index, joint in enumerate(self._joints):
            heard = self.heard(index)
            if heard is not None and heard.state in POWERED:
                raise MotionRefusedError(
                    f"the drive is already powered ({heard.state.value}), but not by dynid",
                    where=f"{joint} (node {self._ids[index]})",
                    hint="end the program that moves the arm, or switch the drive off",
                )

    def _wait(self, met: Callable[[DriveReport], bool], goal: DriveState | None, deadline: float) -> None:
        while True:
            if self._halted.is_set():
                raise DriverStateError("the arm is being stopped", hint="start again before the next motion")
            self._check_faults()
            heard = [self.heard(index) for index in range(len(self._ids))]
            behind = [index for index, answer in enumerate(heard) if answer is None or not met(answer)]
            if not behind:
                return
            if self._clock.now() > deadline:
                raise self._too_late(behind[0], heard[behind[0]], goal)
            self._clock.sleep(_POLL)

    def _too_late(self, index: int, heard: DriveReport | None, goal: DriveState | None) -> DriverStateError:
        where = f"{self._joints[index]} (node {self._ids[index]})"
        if heard is None:
            return DriverStateError("the drive does not answer SYNC", where=where)
        if goal is None:
            return DriverStateError(
                f"the drive displays mode {mode_words(heard.mode)} instead of {mode_words(self._mode)}",
                where=where,
                hint="does it need another setting to accept this mode?",
            )
        return DriverStateError(
            f"the drive does not reach '{goal.value}': it stays at '{heard.state.value}' "
            f"(statusword 0x{heard.statusword:04X})",
            where=where,
            hint="check the power supply, safe-torque-off and enable inputs",
        )


def _reached(asked: float, goal: DriveState, heard: DriveReport) -> bool:
    return heard.time > asked and heard.state is goal
