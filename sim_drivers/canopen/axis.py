"""The CiA 402 side of a simulated drive: state machine, modes of operation, references, statusword."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.state_machine import INTERNAL_LIMIT_BIT
from drivers.canopen402.samples.alignment import PER_MILLE
from drivers.canopen402.setup.drive_limits import NO_TORQUE_LIMIT, NO_WINDOW
from sim_drivers.canopen.motion import AxisReference, CyclicPosition, Profile, ReferenceMotion, Standstill
from sim_drivers.canopen.object_dictionary import ObjectDictionary
from sim_drivers.canopen.setup import DriveFeedback, DriveSetup
from sim_drivers.canopen.state import State, StateMachine

BRAKE_DECELERATION = 20.0
"""Deceleration by the holding brake [rad/s²]: an assumption."""
WARM, HOT = 80.0, 90.0
"""Housing temperatures [°C] of the warning bit and of the fault."""
QUICK_STOP_OPTIONS = (0, 1, 2, 5, 6)
MODES = (0, objects.MODE_PROFILE_POSITION, objects.MODE_CYCLIC_POSITION, objects.MODE_CYCLIC_TORQUE)

FAULTY = (State.FAULT_REACTION_ACTIVE, State.FAULT)

OVER_TEMPERATURE, FOLLOWING_ERROR = 0x4310, 0x8611
"""Error codes."""
TEMPERATURE = objects.DriveObject(0x2031, 1, 2, True, "housing temperature")

NEW_SET_POINT, CHANGE_AT_ONCE, RELATIVE, HALT = 0x10, 0x20, 0x40, 0x100
"""Bits of the controlword in profile position mode; halt in every mode."""
WARNING, TARGET_REACHED, MODE_BIT_12, FOLLOWING_ERROR_BIT = 0x80, 0x400, 0x1000, 0x2000
"""Bits of the statusword; bit 12: set-point acknowledged, or the drive follows the cyclic set-points."""


class Axis:
    """One drive's motor, brake and their control.

    The values that it publishes and obeys are connected to the node's objects; `emergency` is called with every error
    code, 0 once the error is gone.

    Attributes:
        feedback: the last measurement.
        reference: where the joint is to be.
    """

    def __init__(
        self, setup: DriveSetup, feedback: DriveFeedback, dictionary: ObjectDictionary, emergency: Callable[[int], None]
    ) -> None:
        self.setup, self.feedback, self.objects = setup, feedback, dictionary
        self._emergency = emergency
        self.machine = StateMachine()
        self.reference = AxisReference(feedback.position)
        self._motion: ReferenceMotion = Standstill(self.reference, BRAKE_DECELERATION)
        self._time = 0.0
        self._active_mode = 0
        self._controlword = 0
        self._setpoint: float | None = None
        self._next_setpoint: float | None = None
        self._acknowledged = self._limited = False
        self._connect_objects()

    @property
    def enabled(self) -> bool:
        """Return whether the motor moves the joint; else the brake holds it."""
        return self.machine.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)

    @property
    def largest_torque(self) -> float:
        """Max torque (0x6072) of the motor, joint side [N·m]; infinite where it limits nothing."""
        share = self._number(objects.MAX_TORQUE)
        return math.inf if share == NO_TORQUE_LIMIT else PER_MILLE * share * self.setup.rated_torque

    @property
    def pushed(self) -> float | None:
        """Torque [N·m], joint side, that its master commands; None where it controls its position."""
        if self.machine.state is not State.OPERATION_ENABLED or self._active_mode != objects.MODE_CYCLIC_TORQUE:
            return None
        torque = PER_MILLE * self.setup.direction * self.setup.rated_torque * self._number(objects.TARGET_TORQUE)
        return min(max(torque, -self.largest_torque), self.largest_torque)

    def position_of(self, counts: int) -> float:
        """Joint position [rad] of position counts."""
        return self.setup.zero + counts / self.setup.counts_per_radian

    def counts_of(self, position: float) -> int:
        """Position counts of a joint position [rad]."""
        return round((position - self.setup.zero) * self.setup.counts_per_radian)

    def restart(self) -> None:
        """Start as after power on; the brake falls in."""
        self.machine = StateMachine()
        self._controlword, self._active_mode = 0, 0
        self._setpoint = self._next_setpoint = None
        self._acknowledged = False
        self._motion = Standstill(self.reference, BRAKE_DECELERATION)

    def fault(self, code: int) -> None:
        """Fall into fault, with an emergency message."""
        moving = self.enabled
        self.machine.fault()
        self.objects.set(objects.ERROR_CODE.index, 0, code)
        self._emergency(code)
        ramp = self._deceleration(objects.QUICK_STOP_DECELERATION) if moving else BRAKE_DECELERATION
        self._motion = Standstill(self.reference, ramp)

    def command(self, controlword: int) -> None:
        """Do as if the master had sent a controlword; the one that it sent last must not come into force again."""
        self.objects.set(objects.CONTROLWORD.index, 0, controlword)
        self.obey()

    def check_temperature(self) -> None:
        """Fall into fault where it is too hot."""
        if self.feedback.temperature >= HOT and self.machine.state not in FAULTY:
            self.fault(OVER_TEMPERATURE)

    def take_setpoint(self, time: float, cycle: float) -> None:
        """Apply the cyclic set-point of a SYNC at a time [s]; `cycle` [s] from the last one, 0 where unknown."""
        if not isinstance(self._motion, CyclicPosition) or self.machine.state is not State.OPERATION_ENABLED:
            return
        target = self._within_range(self.position_of(self._number(objects.TARGET_POSITION)))
        if abs(target - self.reference.position) > self._following_error_window():
            self.fault(FOLLOWING_ERROR)
        else:
            self._motion.aim(target, time, cycle)

    def step(self, duration: float, actual: float) -> AxisReference:
        """The reference one step of the control loop later; `actual` is the joint's position [rad]."""
        self._time += duration
        if self._next_setpoint is not None and self._motion.finished:
            self._begin_profile(self._next_setpoint)
            self._next_setpoint = None
            self._acknowledge()
        if self.pushed is None:
            self.reference = self._motion.step(duration)
        else:  # from where it is, its control goes on once it is no longer pushed
            self.reference = AxisReference(actual, self.feedback.velocity)
        state = self.machine.state
        if state in (State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE) and self._motion.finished:
            self.machine.stopped()
        elif (
            state is State.OPERATION_ENABLED and abs(self.reference.position - actual) > self._following_error_window()
        ):
            self.fault(FOLLOWING_ERROR)
        return self.reference

    def obey(self) -> None:
        """Follow mode and controlword, once all values received with them are in the objects."""
        if self._number(objects.MODE) != self._active_mode:
            self._take_mode()
        word = self._number(objects.CONTROLWORD)
        before, self._controlword = self._controlword, word
        state = self.machine.state
        self.machine.quick_stop_option = self._number(objects.QUICK_STOP_OPTION)
        self.machine.control(word)
        if self.machine.state is not state:
            self._entered(state)
        elif state is State.OPERATION_ENABLED:
            if self._active_mode == objects.MODE_PROFILE_POSITION:
                self._control_profile(word, word & ~before)
            if word & ~before & HALT:
                self._motion = Standstill(self.reference, self._deceleration(objects.PROFILE_DECELERATION))
            elif before & ~word & HALT:
                self._go_on()
        self._acknowledge()

    def _control_profile(self, word: int, rising: int) -> None:
        if not rising & NEW_SET_POINT or self._next_setpoint is not None:
            return
        counts = self._number(objects.TARGET_POSITION)
        target = self.position_of(counts)
        if word & RELATIVE:
            start = self._setpoint if self._setpoint is not None else self.reference.position
            target = start + target - self.setup.zero
        target = self._within_range(target)
        if word & CHANGE_AT_ONCE or self._motion.finished:
            self._begin_profile(target)
        else:
            self._next_setpoint = target
        self._acknowledged = True

    def _within_range(self, target: float) -> float:
        """A target within the software position limits (0x607D), which lie the home offset off; nearer where beyond."""
        ends = [self._number(entry) for entry in (objects.LOWEST_POSITION, objects.HIGHEST_POSITION)]
        if ends[0] >= ends[1]:
            return target
        home = self._number(objects.HOME_OFFSET)
        lowest, highest = sorted(self.position_of(end - home) for end in ends)
        within = min(max(target, lowest), highest)
        self._limited = within != target
        return within

    def _following_error_window(self) -> float:
        """The largest following error [rad]; infinite where it is not supervised."""
        window = self._number(objects.FOLLOWING_ERROR_WINDOW)
        return math.inf if window == NO_WINDOW else window / abs(self.setup.counts_per_radian)

    def _go_on(self) -> None:
        """Continue after a halt."""
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
        speed = min(self._number(objects.PROFILE_VELOCITY), self._number(objects.MAX_PROFILE_VELOCITY))
        self._motion = Profile(
            self.reference,
            target,
            max(speed, 1) / abs(self.setup.counts_per_radian),
            self._deceleration(objects.PROFILE_ACCELERATION),
            self._deceleration(objects.PROFILE_DECELERATION),
        )

    def _entered(self, before: State) -> None:
        """Effect of a change of state on the motion."""
        state = self.machine.state
        self._setpoint = self._next_setpoint = None
        self._acknowledged = self._limited = False
        if state is State.OPERATION_ENABLED:
            self.reference = AxisReference(self.feedback.position)
            self._take_mode()
        elif state is State.QUICK_STOP_ACTIVE:
            slow = self.machine.quick_stop_option in (1, 5)
            ramp = objects.PROFILE_DECELERATION if slow else objects.QUICK_STOP_DECELERATION
            self._motion = Standstill(self.reference, self._deceleration(ramp))
        elif before in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            self._motion = Standstill(self.reference, BRAKE_DECELERATION)
        elif before is State.FAULT:
            self.objects.set(objects.ERROR_CODE.index, 0, 0)
            self._emergency(0)

    def _take_mode(self) -> None:
        """Follow the mode of operation; set-points of another mode are void."""
        self._active_mode = self._number(objects.MODE)
        if self.machine.state is not State.OPERATION_ENABLED:
            return
        if self._active_mode == objects.MODE_CYCLIC_POSITION:
            self._motion = CyclicPosition(self.reference, self._time)
        else:
            self._motion = Standstill(self.reference, BRAKE_DECELERATION)

    def _number(self, item: objects.DriveObject) -> int:
        return self.objects.number(item.index, item.subindex)

    def _deceleration(self, item: objects.DriveObject) -> float:
        """An acceleration in rad/s²; at least one count/s², so that every ramp ends."""
        return max(self._number(item), 1) / abs(self.setup.counts_per_radian)

    def _statusword(self) -> int:
        word = self.machine.statusword
        if self.feedback.temperature >= WARM:
            word |= WARNING
        if self.machine.state is State.OPERATION_ENABLED:
            word |= INTERNAL_LIMIT_BIT if self._limited else 0
            if self._active_mode in (objects.MODE_CYCLIC_POSITION, objects.MODE_CYCLIC_TORQUE):
                word |= MODE_BIT_12
            elif self._active_mode == objects.MODE_PROFILE_POSITION:
                word |= MODE_BIT_12 if self._acknowledged else 0
                word |= TARGET_REACHED if self._motion.finished and self._next_setpoint is None else 0
        elif self._number(objects.ERROR_CODE) == FOLLOWING_ERROR:
            word |= FOLLOWING_ERROR_BIT
        return word

    def _per_mille(self, value: float, rated: float) -> int:
        # Without voltage there is no current; the brake holds the joint.
        share = 1000.0 * self.setup.direction * value / rated if self.enabled else 0.0
        return min(max(round(share), -32768), 32767)

    def _connect_objects(self) -> None:
        dictionary, setup = self.objects, self.setup
        live: tuple[tuple[objects.DriveObject, Callable[[], int]], ...] = (
            (objects.STATUSWORD, self._statusword),
            (objects.MODE_DISPLAY, lambda: dictionary.number(objects.MODE.index)),
            (objects.POSITION, lambda: _int32(self.counts_of(self.feedback.position))),
            (objects.VELOCITY, lambda: _int32(round(self.feedback.velocity * setup.counts_per_radian))),
            (objects.TORQUE, lambda: self._per_mille(self.feedback.torque, setup.rated_torque)),
            (objects.CURRENT, lambda: self._per_mille(self.feedback.current, setup.rated_current)),
            (TEMPERATURE, lambda: min(max(round(10.0 * self.feedback.temperature), -32768), 32767)),
        )
        for item, read in live:
            dictionary.live(item.index, item.subindex, read)
        dictionary.allow(objects.MODE.index, 0, MODES)
        dictionary.allow(objects.QUICK_STOP_OPTION.index, 0, QUICK_STOP_OPTIONS)


def _int32(value: int) -> int:
    """Wrap around as a drive's 32-bit counter does."""
    return (value + (1 << 31) & 0xFFFFFFFF) - (1 << 31)
