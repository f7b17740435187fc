"""The power drive system state machine of CiA 402-2: controlword in, state and statusword out."""

from __future__ import annotations

from enum import Enum


class State(Enum):
    """A state; its value is bits 0–3, 5 and 6 of the statusword (CiA 402-2, statusword coding)."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class StateCommand(Enum):
    """Commands of a controlword."""

    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    ENABLE_OPERATION = "enable operation"


FAULT_RESET_BIT = 0x80
VOLTAGE_ENABLED = 0x10
REMOTE = 0x200

DISABLE_AT_ONCE = 0
"""Quick stop option (0x605A) without a ramp."""
STAY_IN_QUICK_STOP = (5, 6)
"""Quick stop options (0x605A) that end in quick stop active; the others go on to switch on disabled."""

# The numbers are those of the transitions in CiA 402-2. Missing ones are ignored, as in the profile.
TRANSITIONS = {
    (State.SWITCH_ON_DISABLED, StateCommand.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 2
    (State.READY_TO_SWITCH_ON, StateCommand.SWITCH_ON): State.SWITCHED_ON,  # 3
    (State.READY_TO_SWITCH_ON, StateCommand.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 3, then 4
    (State.SWITCHED_ON, StateCommand.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 4
    (State.OPERATION_ENABLED, StateCommand.SWITCH_ON): State.SWITCHED_ON,  # 5, "disable operation"
    (State.SWITCHED_ON, StateCommand.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 6
    (State.READY_TO_SWITCH_ON, StateCommand.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 7
    (State.READY_TO_SWITCH_ON, StateCommand.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 7
    (State.OPERATION_ENABLED, StateCommand.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 8
    (State.OPERATION_ENABLED, StateCommand.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 9
    (State.SWITCHED_ON, StateCommand.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, StateCommand.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 10
    (State.OPERATION_ENABLED, StateCommand.QUICK_STOP): State.QUICK_STOP_ACTIVE,  # 11
    (State.QUICK_STOP_ACTIVE, StateCommand.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 12
    (State.QUICK_STOP_ACTIVE, StateCommand.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 16
}


def command_of(controlword: int) -> StateCommand:
    """StateCommand in bits 0–3 of a controlword."""
    if not controlword & 0x02:
        return StateCommand.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return StateCommand.QUICK_STOP
    if not controlword & 0x01:
        return StateCommand.SHUTDOWN
    return StateCommand.ENABLE_OPERATION if controlword & 0x08 else StateCommand.SWITCH_ON


class StateMachine:
    """One drive's state; their effect on the motor is up to the drive.

    Attributes:
        state: now.
        quick_stop_option: object 0x605A.
    """

    def __init__(self) -> None:
        self.state = State.NOT_READY_TO_SWITCH_ON
        self.quick_stop_option = 2
        self._reset_bit = False

    @property
    def statusword(self) -> int:
        """The bits of the state, with voltage enabled and remote; the others belong to the drive."""
        return self.state.value | VOLTAGE_ENABLED | REMOTE

    def initialised(self) -> None:
        """The self-test is over: transitions 0 and 1."""
        if self.state is State.NOT_READY_TO_SWITCH_ON:
            self.state = State.SWITCH_ON_DISABLED

    def control(self, controlword: int) -> None:
        """Obey a controlword; an edge of its bit 7 resets a fault (15), which does not enable the drive."""
        reset = bool(controlword & FAULT_RESET_BIT)
        edge, self._reset_bit = reset and not self._reset_bit, reset
        if self.state is State.FAULT:
            if edge:
                self.state = State.SWITCH_ON_DISABLED
            return
        if reset:
            return
        command = command_of(controlword)
        stays = self.quick_stop_option in STAY_IN_QUICK_STOP
        if self.state is State.QUICK_STOP_ACTIVE and command is StateCommand.ENABLE_OPERATION and not stays:
            return
        reached = TRANSITIONS.get((self.state, command), self.state)
        if reached is State.QUICK_STOP_ACTIVE and self.quick_stop_option == DISABLE_AT_ONCE:
            reached = State.SWITCH_ON_DISABLED
        self.state = reached

    def stopped(self) -> None:
        """The drive is at rest: ends a quick stop (12) and a fault reaction (14)."""
        if self.state is State.FAULT_REACTION_ACTIVE:
            self.state = State.FAULT
        elif self.state is State.QUICK_STOP_ACTIVE and self.quick_stop_option not in STAY_IN_QUICK_STOP:
            self.state = State.SWITCH_ON_DISABLED

    def fault(self) -> None:
        """A fault has occurred (13)."""
        if self.state is not State.FAULT:
            self.state = State.FAULT_REACTION_ACTIVE
