"""One simulated servo drive on CANopen: CiA 301 outside, CiA 402 inside, a joint of the plant behind it."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import MASTER_MISSED
from drivers.canopen402.protocol.state_machine import DISABLE_VOLTAGE, QUICK_STOP
from sim_drivers.canopen.axis import FAULTY, FOLLOWING_ERROR, OVER_TEMPERATURE, Axis
from sim_drivers.canopen.error_control import NodeErrorControl
from sim_drivers.canopen.motion import AxisReference
from sim_drivers.canopen.object_dictionary import ObjectDictionary, SdoServer
from sim_drivers.canopen.pdo import ReceivePdo, TransmitPdo
from sim_drivers.canopen.setup import DriveFeedback, DriveSetup, fixed_values

_NMT_STATES = {0x01: objects.STATE_OPERATIONAL, 0x02: objects.STATE_STOPPED, 0x80: objects.STATE_PRE_OPERATIONAL}
"""NMT command → state."""
NMT_RESET_NODE, NMT_RESET_COMMUNICATION = 0x81, 0x82

BOOT_TIME = 1.0
"""From power on to the boot-up message [s]."""

LEFT_OPERATIONAL, RPDO_TOO_SHORT = 0x8100, 0x8210
"""Error codes of the communication."""
_REGISTER = {
    OVER_TEMPERATURE: 0x09,
    LEFT_OPERATIONAL: 0x11,
    MASTER_MISSED: 0x11,
    RPDO_TOO_SHORT: 0x11,
    FOLLOWING_ERROR: 0x21,
}
"""Error code → error register (0x1001)."""
AFTER_SILENCE = {0: objects.STATE_PRE_OPERATIONAL, 2: objects.STATE_STOPPED}
"""Error behaviour (0x1029) → NMT state of an operational node after a communication error; 1 changes nothing."""
_COMMANDS = {objects.AbortOption.DISABLE_VOLTAGE: DISABLE_VOLTAGE, objects.AbortOption.QUICK_STOP: QUICK_STOP}


class SimulatedDrive:
    """One node.

    `send` is called with (identifier, data, newest wins) of every frame.

    Attributes:
        axis: its CiA 402 side.
        error_control: heartbeats and guarding.
        nmt: its NMT state.
    """

    def __init__(
        self, node: int, setup: DriveSetup, feedback: DriveFeedback, send: Callable[[int, bytes, bool], None]
    ) -> None:
        self.node = node
        self._send = send
        self.objects = ObjectDictionary(node, fixed_values(setup))
        self.axis = Axis(setup, feedback, self.objects, self._emergency)
        self.error_control = NodeErrorControl(self.objects, node, send)
        self.objects.allow(objects.ABORT_OPTION.index, 0, tuple(objects.AbortOption))
        self.objects.allow(objects.ERROR_BEHAVIOUR.index, 1, (0, 1, 2))
        self.transmitted = tuple(TransmitPdo(self.objects, number) for number in range(3))
        self.received = tuple(ReceivePdo(self.objects, number) for number in range(2))
        self._sdo = SdoServer(self.objects)
        self.nmt = objects.STATE_BOOT_UP
        self.powered_at: float = -math.inf

    @property
    def enabled(self) -> bool:
        """Return whether the motor moves the joint; else the brake holds it."""
        return self.axis.enabled

    def network_command(self, content: bytes) -> None:
        """Obey an NMT command."""
        if len(content) < 2 or content[1] not in (0, self.node) or self.nmt == objects.STATE_BOOT_UP:
            return
        command = content[0]
        if command in _NMT_STATES:
            self._change_nmt(_NMT_STATES[command])
        elif command == NMT_RESET_NODE:
            self._restart()
            self._boot()
        elif command == NMT_RESET_COMMUNICATION:
            self._change_nmt(objects.STATE_PRE_OPERATIONAL)
            self.objects.reset_communication()
            self._reconfigure()
            self._boot()

    def receive(self, identifier: int, content: bytes) -> None:
        """Process a frame that is neither NMT nor SYNC, nor for error control."""
        if self.nmt in (objects.STATE_BOOT_UP, objects.STATE_STOPPED):
            return
        if identifier == objects.SDO_REQUEST + self.node:
            answer = self._sdo.answer(content)
            self._reconfigure()
            self.axis.obey()
            if answer is not None:
                self._send(objects.SDO_ANSWER + self.node, answer, False)
        elif self.nmt == objects.STATE_OPERATIONAL:
            for pdo in self.received:
                if pdo.identifier != identifier:
                    continue
                if not pdo.receive(content):
                    self._emergency(RPDO_TOO_SHORT)
                elif not pdo.synchronous:
                    self.axis.obey()

    def heartbeat(self, producer: int, time: float) -> None:
        """Process the heartbeat of another node at a time [s]."""
        if self.nmt != objects.STATE_BOOT_UP and self.error_control.heartbeat(producer, time):
            self._found()

    def guard_request(self, time: float) -> None:
        """Answer the master's request for the NMT state at a time [s]."""
        if self.nmt != objects.STATE_BOOT_UP and self.error_control.guard_request(time, self.nmt):
            self._found()

    def sync(self, time: float, cycle: float) -> None:
        """Obey a SYNC: apply received values and the cyclic set-point, send the measurement.

        The axis' feedback must be that of the SYNC's time [s, the drives' own clock]; `cycle` is the distance of two
        SYNCs [s], 0 where that is unknown.
        """
        if self.nmt != objects.STATE_OPERATIONAL:
            return
        for received in self.received:
            if received.synchronous:
                received.apply()
        self.axis.obey()
        self.axis.take_setpoint(time, cycle)
        for transmitted in self.transmitted:
            content = transmitted.on_sync()
            if content is not None and transmitted.identifier is not None:
                self._send(transmitted.identifier, content, True)

    def tick(self, time: float) -> None:
        """Timed work at a time [s]: booting, error control, event-driven PDOs, temperature supervision."""
        if self.nmt == objects.STATE_BOOT_UP:
            if time >= self.powered_at:
                self._boot()
            return
        self.axis.check_temperature()
        if self.error_control.tick(time, self.nmt):
            self._lose_connection(MASTER_MISSED)
            if self.nmt == objects.STATE_OPERATIONAL:
                self.nmt = AFTER_SILENCE.get(self.objects.number(objects.ERROR_BEHAVIOUR.index, 1), self.nmt)
        if self.nmt == objects.STATE_OPERATIONAL:
            for pdo in self.transmitted:
                content = pdo.on_time(time)
                if content is not None and pdo.identifier is not None:
                    self._send(pdo.identifier, content, True)

    def power_cycle(self, time: float) -> None:
        """Lose power at a time [s], and boot again."""
        self.powered_at = time + BOOT_TIME
        self.error_control.muted = False
        self._restart()

    def fault(self, code: int) -> None:
        """Fall into fault, with an emergency message."""
        if self.nmt != objects.STATE_BOOT_UP:
            self.axis.fault(code)

    def step(self, duration: float, actual: float) -> AxisReference:
        """The reference one step of the control loop later; `actual` is the joint's position [rad]."""
        return self.axis.step(duration, actual)

    def _lose_connection(self, code: int) -> None:
        """Send an emergency, and apply the abort connection option (0x6007) of a drive that is enabled."""
        option = self.objects.number(objects.ABORT_OPTION.index)
        if self.enabled and option == objects.AbortOption.FAULT:
            self.fault(code)
            return
        self._emergency(code)
        if self.enabled and option in _COMMANDS:
            self.axis.command(_COMMANDS[objects.AbortOption(option)])

    def _found(self) -> None:
        """A watched node that had fallen silent is present again."""
        if self.axis.machine.state not in FAULTY:
            self._emergency(0)

    def _emergency(self, code: int) -> None:
        register = _REGISTER.get(code, 0x01) if code else 0x00
        self.objects.set(objects.ERROR_REGISTER.index, 0, register)
        self._send(objects.EMCY + self.node, struct.pack("<HB5x", code, register), False)

    def _change_nmt(self, state: int) -> None:
        before, self.nmt = self.nmt, state
        if state == objects.STATE_OPERATIONAL != before:
            for pdo in (*self.transmitted, *self.received):
                pdo.restart()
        if before == objects.STATE_OPERATIONAL != state and self.enabled:
            self._lose_connection(LEFT_OPERATIONAL)

    def _boot(self) -> None:
        self.nmt = objects.STATE_PRE_OPERATIONAL
        self.error_control.restart()
        self._sdo.reset()
        self._send(objects.HEARTBEAT + self.node, bytes([objects.STATE_BOOT_UP]), False)
        self.axis.machine.initialised()

    def _restart(self) -> None:
        """Start as after power on."""
        self.nmt = objects.STATE_BOOT_UP
        self.objects.reset()
        self.axis.restart()
        self._reconfigure()

    def _reconfigure(self) -> None:
        for pdo in (*self.transmitted, *self.received):
            pdo.configured()
