"""One simulated servo drive on CANopen: CiA 301 outside, CiA 402 inside, a joint of the plant behind it."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from drivers.canopen402.objects import (
    CONTROLWORD,
    CURRENT,
    EMCY,
    ERROR_CODE,
    HEARTBEAT,
    HEARTBEAT_TIME,
    MODE,
    MODE_CYCLIC_POSITION,
    MODE_DISPLAY,
    MODE_PROFILE_POSITION,
    POSITION,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    PROFILE_VELOCITY,
    QUICK_STOP_OPTION,
    SDO_ANSWER,
    STATUSWORD,
    TARGET_POSITION,
    TORQUE,
    VELOCITY,
    DriveObject,
)
from sim_drivers.drive_motion import AxisMotion, AxisReference, CyclicPosition, Profile, Standstill
from sim_drivers.drive_setup import QUICK_STOP_RAMP, DriveSetup, Feedback, fixed_values
from sim_drivers.drive_state import State, StateMachine
from sim_drivers.object_dictionary import Abort, ObjectDictionary, SdoAbortError
from sim_drivers.pdo import ReceivePdo, TransmitPdo
from sim_drivers.sdo_server import SdoServer

BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
"""NMT states (CiA 301, 7.2.8.3.2.2)."""
_NMT_STATES = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}
"""NMT command → state."""
NMT_RESET_NODE, NMT_RESET_COMMUNICATION = 0x81, 0x82

BOOT_TIME = 1.0
"""From power on to the boot-up message [s]."""
BRAKE_DECELERATION = 20.0
"""Of the holding brake [rad/s²]: an assumption."""
LARGEST_FOLLOWING_ERROR = 0.25
"""[rad]: more of it is a fault."""
WARM, HOT = 80.0, 90.0
"""Housing temperatures [°C] of the warning bit and of the fault."""
QUICK_STOP_OPTIONS = (0, 1, 2, 5, 6)

FAULTY = (State.FAULT_REACTION_ACTIVE, State.FAULT)

OVER_TEMPERATURE, COMMUNICATION, RPDO_TOO_SHORT, FOLLOWING_ERROR = 0x4310, 0x8100, 0x8210, 0x8611
_REGISTER = {OVER_TEMPERATURE: 0x09, COMMUNICATION: 0x11, RPDO_TOO_SHORT: 0x11, FOLLOWING_ERROR: 0x21}
"""Error code → error register (0x1001)."""
ERROR_REGISTER = DriveObject(0x1001, 0, 1, False, "error register")
TEMPERATURE = DriveObject(0x2031, 1, 2, True, "housing temperature")

NEW_SET_POINT, CHANGE_AT_ONCE, RELATIVE, HALT = 0x10, 0x20, 0x40, 0x100
"""Bits of the controlword in profile position mode; halt in every mode."""
WARNING, TARGET_REACHED, MODE_BIT_12, FOLLOWING_ERROR_BIT = 0x80, 0x400, 0x1000, 0x2000
"""Bits of the statusword; bit 12: set-point acknowledged, or the drive follows the cyclic set-points."""


class Drive:
    """One node.

    Args:
        node: node id.
        setup: what it is.
        feedback: at the start.
        send: takes (identifier, data, newest wins) of every frame.
    """

    def __init__(
        self, node: int, setup: DriveSetup, feedback: Feedback, send: Callable[[int, bytes, bool], None]
    ) -> None:
        self.node, self.setup, self.feedback = node, setup, feedback
        self._send = send
        self.objects = ObjectDictionary(node, fixed_values(setup))
        self.machine = StateMachine()
        self._connect_objects()
        self.transmitted = tuple(TransmitPdo(self.objects, number) for number in range(3))
        self.received = (ReceivePdo(self.objects, 0),)
        self._sdo = SdoServer(self.objects)
        self.nmt = BOOT_UP
        self.powered_at: float = -math.inf
        self.heartbeat_muted = False
        self.reference = AxisReference(feedback.position)
        self._motion: AxisMotion = Standstill(self.reference, BRAKE_DECELERATION)
        self._time = 0.0
        self._next_heartbeat = -math.inf
        self._active_mode = 0
        self._controlword = 0
        self._setpoint: float | None = None
        self._next_setpoint: float | None = None
        self._acknowledged = False

    @property
    def enabled(self) -> bool:
        """Whether the motor moves the joint; else the brake holds it."""
        return self.machine.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)

    def position_of(self, counts: int) -> float:
        """Joint position [rad] of position counts."""
        return self.setup.zero + counts / self.setup.counts_per_radian

    def counts_of(self, position: float) -> int:
        """Position counts of a joint position [rad]."""
        return round((position - self.setup.zero) * self.setup.counts_per_radian)

    # The network.

    def network_command(self, content: bytes) -> None:
        """Obey an NMT command."""
        if len(content) < 2 or content[1] not in (0, self.node) or self.nmt == BOOT_UP:
            return
        command = content[0]
        if command in _NMT_STATES:
            self._change_nmt(_NMT_STATES[command])
        elif command == NMT_RESET_NODE:
            self._restart()
            self._boot()
        elif command == NMT_RESET_COMMUNICATION:
            self._change_nmt(PRE_OPERATIONAL)
            self.objects.reset_communication()
            self._reconfigure()
            self._boot()

    def receive(self, identifier: int, content: bytes) -> None:
        """Take a frame that is neither NMT nor SYNC."""
        if self.nmt in (BOOT_UP, STOPPED):
            return
        if identifier == 0x600 + self.node:
            answer = self._sdo.answer(content)
            self._reconfigure()
            self._obey()
            if answer is not None:
                self._send(SDO_ANSWER + self.node, answer, False)
        elif self.nmt == OPERATIONAL:
            for pdo in self.received:
                if pdo.identifier != identifier:
                    continue
                if not pdo.receive(content):
                    self._emergency(RPDO_TOO_SHORT)
                elif not pdo.synchronous:
                    self._obey()

    def sync(self, time: float, cycle: float) -> None:
        """Obey a SYNC: apply what was received, take the cyclic set-point, send what was measured.

        `feedback` must be that of the SYNC's time.

        Args:
            time: of the SYNC in the drives' own clock [s].
            cycle: distance of two SYNCs [s]; 0 where that is unknown.
        """
        if self.nmt != OPERATIONAL:
            return
        for received in self.received:
            if received.synchronous:
                received.apply()
        self._obey()
        if isinstance(self._motion, CyclicPosition) and self.machine.state is State.OPERATION_ENABLED:
            target = self.position_of(self.objects.number(TARGET_POSITION.index))
            if abs(target - self.reference.position) > LARGEST_FOLLOWING_ERROR:
                self.fault(FOLLOWING_ERROR)
            else:
                self._motion.aim(target, time, cycle)
        for transmitted in self.transmitted:
            content = transmitted.on_sync()
            if content is not None and transmitted.identifier is not None:
                self._send(transmitted.identifier, content, True)

    def tick(self, time: float) -> None:
        """What goes by time [s]: booting, heartbeat, event-driven PDOs, temperature supervision."""
        if self.nmt == BOOT_UP:
            if time >= self.powered_at:
                self._boot()
            return
        if self.feedback.temperature >= HOT and self.machine.state not in FAULTY:
            self.fault(OVER_TEMPERATURE)
        period = 1e-3 * self.objects.number(HEARTBEAT_TIME.index)
        if period > 0.0 and time >= self._next_heartbeat:
            missed = not time - self._next_heartbeat < period
            self._next_heartbeat = (time if missed else self._next_heartbeat) + period
            if not self.heartbeat_muted:
                self._send(HEARTBEAT + self.node, bytes([self.nmt]), False)
        if self.nmt == OPERATIONAL:
            for pdo in self.transmitted:
                content = pdo.on_time(time)
                if content is not None and pdo.identifier is not None:
                    self._send(pdo.identifier, content, True)

    def power_cycle(self, time: float) -> None:
        """Lose power at a time [s], and boot again."""
        self.powered_at = time + BOOT_TIME
        self.heartbeat_muted = False
        self._restart()

    def fault(self, code: int) -> None:
        """Fall into fault, with an emergency message."""
        if self.nmt == BOOT_UP:
            return
        moving = self.enabled
        self.machine.fault()
        self.objects.set(ERROR_CODE.index, 0, code)
        self._emergency(code)
        ramp = self._deceleration(QUICK_STOP_RAMP.index) if moving else BRAKE_DECELERATION
        self._motion = Standstill(self.reference, ramp)

    # The motor.

    def step(self, duration: float, actual: float) -> AxisReference:
        """The reference one step of the control loop later; `actual` is the joint's position [rad]."""
        self._time += duration
        if self._next_setpoint is not None and self._motion.finished:
            self._begin_profile(self._next_setpoint)
            self._next_setpoint = None
            self._acknowledge()
        self.reference = self._motion.step(duration)
        state = self.machine.state
        if state in (State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE) and self._motion.finished:
            self.machine.stopped()
        elif state is State.OPERATION_ENABLED and abs(self.reference.position - actual) > LARGEST_FOLLOWING_ERROR:
            self.fault(FOLLOWING_ERROR)
        return self.reference

    @property
    def clock(self) -> float:
        """Time that the control loop has run [s]."""
        return self._time

    def _obey(self) -> None:
        """Follow mode and controlword, once everything that came with them is in the objects."""
        if self.objects.number(MODE.index) != self._active_mode:
            self._take_mode()
        word = self.objects.number(CONTROLWORD.index)
        before, self._controlword = self._controlword, word
        state = self.machine.state
        self.machine.quick_stop_option = self.objects.number(QUICK_STOP_OPTION.index)
        self.machine.control(word)
        if self.machine.state is not state:
            self._entered(state)
        elif state is State.OPERATION_ENABLED:
            if self._active_mode == MODE_PROFILE_POSITION:
                self._control_profile(word, word & ~before)
            if word & ~before & HALT:
                self._motion = Standstill(self.reference, self._deceleration(PROFILE_DECELERATION.index))
            elif before & ~word & HALT:
                self._go_on()
        self._acknowledge()

    def _control_profile(self, word: int, rising: int) -> None:
        if not rising & NEW_SET_POINT or self._next_setpoint is not None:
            return
        counts = self.objects.number(TARGET_POSITION.index)
        target = self.position_of(counts)
        if word & RELATIVE:
            start = self._setpoint if self._setpoint is not None else self.reference.position
            target = start + target - self.setup.zero
        if word & CHANGE_AT_ONCE or self._motion.finished:
            self._begin_profile(target)
        else:
            self._next_setpoint = target
        self._acknowledged = True

    def _go_on(self) -> None:
        """After a halt."""
        if self._setpoint is not None:
            self._begin_profile(self._setpoint)
        else:
            self._take_mode()

    def _acknowledge(self) -> None:
        """Set-point acknowledge falls once the controlword's bit has fallen and another set-point has room."""
        if not self._controlword & NEW_SET_POINT and self._next_setpoint is None:
            self._acknowledged = False

    def _begin_profile(self, target: float) -> None:
        self._setpoint = target
        self._motion = Profile(
            self.reference,
            target,
            max(self.objects.number(PROFILE_VELOCITY.index), 1) / abs(self.setup.counts_per_radian),
            self._deceleration(PROFILE_ACCELERATION.index),
            self._deceleration(PROFILE_DECELERATION.index),
        )

    def _entered(self, before: State) -> None:
        """What a change of state does to the motion."""
        state = self.machine.state
        self._setpoint = self._next_setpoint = None
        self._acknowledged = False
        if state is State.OPERATION_ENABLED:
            self.reference = AxisReference(self.feedback.position)
            self._take_mode()
        elif state is State.QUICK_STOP_ACTIVE:
            slow = self.machine.quick_stop_option in (1, 5)
            self._motion = Standstill(
                self.reference, self._deceleration(PROFILE_DECELERATION.index if slow else QUICK_STOP_RAMP.index)
            )
        elif before in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            self._motion = Standstill(self.reference, BRAKE_DECELERATION)
        elif before is State.FAULT:
            self.objects.set(ERROR_CODE.index, 0, 0)
            self._emergency(0)

    def _take_mode(self) -> None:
        """Follow the mode of operation; set-points of another mode are void."""
        self._active_mode = self.objects.number(MODE.index)
        if self.machine.state is not State.OPERATION_ENABLED:
            return
        if self._active_mode == MODE_CYCLIC_POSITION:
            self._motion = CyclicPosition(self.reference, self._time)
        else:
            self._motion = Standstill(self.reference, BRAKE_DECELERATION)

    def _set_mode(self, mode: int) -> None:
        if mode not in (0, MODE_PROFILE_POSITION, MODE_CYCLIC_POSITION):
            raise SdoAbortError(Abort.VALUE_RANGE)

    def _set_quick_stop_option(self, option: int) -> None:
        if option not in QUICK_STOP_OPTIONS:
            raise SdoAbortError(Abort.VALUE_RANGE)

    def _deceleration(self, index: int) -> float:
        """An acceleration object in rad/s²; at least one count/s², so that every ramp ends."""
        return max(self.objects.number(index), 1) / abs(self.setup.counts_per_radian)

    # What it says.

    def _statusword(self) -> int:
        word = self.machine.statusword
        if self.feedback.temperature >= WARM:
            word |= WARNING
        if self.machine.state is State.OPERATION_ENABLED:
            if self._active_mode == MODE_CYCLIC_POSITION:
                word |= MODE_BIT_12
            elif self._active_mode == MODE_PROFILE_POSITION:
                word |= MODE_BIT_12 if self._acknowledged else 0
                word |= TARGET_REACHED if self._motion.finished and self._next_setpoint is None else 0
        elif self.objects.number(ERROR_CODE.index) == FOLLOWING_ERROR:
            word |= FOLLOWING_ERROR_BIT
        return word

    def _per_mille(self, value: float, rated: float) -> int:
        # Without voltage there is no current; the brake holds the joint.
        share = 1000.0 * self.setup.direction * value / rated if self.enabled else 0.0
        return min(max(round(share), -32768), 32767)

    def _connect_objects(self) -> None:
        objects, setup = self.objects, self.setup
        live: tuple[tuple[DriveObject, Callable[[], int]], ...] = (
            (STATUSWORD, self._statusword),
            (MODE_DISPLAY, lambda: objects.number(MODE.index)),
            (POSITION, lambda: _int32(self.counts_of(self.feedback.position))),
            (VELOCITY, lambda: _int32(round(self.feedback.velocity * setup.counts_per_radian))),
            (TORQUE, lambda: self._per_mille(self.feedback.torque, setup.rated_torque)),
            (CURRENT, lambda: self._per_mille(self.feedback.current, setup.rated_current)),
            (TEMPERATURE, lambda: min(max(round(10.0 * self.feedback.temperature), -32768), 32767)),
        )
        for item, read in live:
            objects.live(item.index, item.subindex, read)
        objects.on_write(MODE.index, 0, self._set_mode)
        objects.on_write(QUICK_STOP_OPTION.index, 0, self._set_quick_stop_option)

    def _emergency(self, code: int) -> None:
        register = _REGISTER.get(code, 0x01) if code else 0x00
        self.objects.set(ERROR_REGISTER.index, 0, register)
        self._send(EMCY + self.node, struct.pack("<HB5x", code, register), False)

    def _change_nmt(self, state: int) -> None:
        before, self.nmt = self.nmt, state
        if state == OPERATIONAL != before:
            for pdo in (*self.transmitted, *self.received):
                pdo.restart()
        if before == OPERATIONAL != state and self.enabled:
            self.fault(COMMUNICATION)  # abort connection option 0x6007 = 1, "malfunction"

    def _boot(self) -> None:
        self.nmt = PRE_OPERATIONAL
        self._next_heartbeat = -math.inf
        self._sdo.reset()
        self._send(HEARTBEAT + self.node, bytes([BOOT_UP]), False)
        self.machine.initialised()

    def _restart(self) -> None:
        """As after power on; the brake falls in."""
        self.nmt = BOOT_UP
        self.objects.reset()
        self.machine = StateMachine()
        self._controlword, self._active_mode = 0, 0
        self._setpoint = self._next_setpoint = None
        self._acknowledged = False
        self._motion = Standstill(self.reference, BRAKE_DECELERATION)
        self._reconfigure()

    def _reconfigure(self) -> None:
        for pdo in (*self.transmitted, *self.received):
            pdo.configured()


def _int32(value: int) -> int:
    """As a drive's counter does: it wraps around."""
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)
