"""The driver of an arm of CAN motors: Damiao, RobStride, CubeMars, moteus, ODrive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from drivers.base import DeviceLimits, DriverSettings, Notice
from drivers.can_motors.bus import MotorBus
from drivers.can_motors.control import MotorControl
from drivers.can_motors.cycle import MotorCycle, feedback_channels
from drivers.can_motors.settings import CODECS, CanMotor, parse_settings
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionFailedError
from drivers.polled_arm import PolledArm
from drivers.streams import ChannelLayout

TOLD_RANGES = ("position", "velocity", "torque")
"""Full scale of a motor's frames that its registers tell, where they do."""
CLEARING = 0.05
"""[s] that a motor may take to reset a fault."""


@dataclass(frozen=True)
class MotorIdentity:
    """What a motor says of itself."""

    joint: str  # it moves
    id: int  # on the bus
    model: str  # of its table
    position: float  # of the joint [rad]
    temperature: float  # of the windings [°C]; nan where it tells none
    drive_temperature: float  # of the power stage [°C]; nan where it tells none
    driving: bool | None  # whether it drives; None where it does not say
    fault: str  # in words; empty without
    # velocity_range, torque_range: full scale of its frames [rad/s, N·m]; nan where they carry plain numbers
    velocity_range: float
    torque_range: float
    torque_constant: float  # [N·m/A], read from the motor, else from its table; nan where neither says


class CanMotorDriver(PolledArm):
    """CAN motors of one family on one bus; implements `drivers.base.Driver`.

    The connection's keys are those of `drivers.can_motors.settings.CanMotorKeys`.

    Raises:
        UsageError: the connection's keys are wrong.
    """

    def __init__(self, settings: DriverSettings, family: str) -> None:
        self._settings = parse_settings(settings.connection, settings.joints, family)
        keys, names = self._settings.keys, {motor.id: motor.name for motor in self._settings.motors}
        super().__init__(settings, self._settings.where, keys.rate, names, "motor", read_only=keys.read_only)
        self._bus = MotorBus(self._settings, self._clock)
        self._control: MotorControl = MotorControl(self._bus, self._settings, self._clock)

    def _connect(self) -> None:
        self._bus.open()
        if {f"{name}_range" for name in TOLD_RANGES} <= self._bus.codecs[0].registers.keys():
            self._take_told_ranges()
        if self._settings.keys.reset_faults:
            self._reset_faults()
        self._identities = tuple(self._identity(index, motor) for index, motor in enumerate(self._settings.motors))
        self._require_own_ids()

    def _take_leave(self) -> None:
        self._control.part()

    def _disconnect(self) -> None:
        self._bus.close()

    def _new_cycle(self) -> MotorCycle:
        return MotorCycle(self._bus, self._control, self._settings, self._clock)

    def _channels(self) -> tuple[ChannelLayout, ...]:
        return feedback_channels(self._settings)

    def _gains(self) -> Mapping[str, FloatArray]:
        return self._settings.gains()

    def notices(self) -> Sequence[Notice]:
        """Faults of motors, missing answers, errors of the bus, since the last call."""
        return [*super().notices(), *self._bus.notices()]

    def device_limits(self) -> DeviceLimits:
        """Torque limits that the motors keep for this program."""
        self._require_open("tell limits")
        nothing = np.full(len(self._settings.motors), np.nan)
        torque = np.array(
            [
                math.nan if motor.address.torque_limit is None else motor.address.torque_limit * motor.ratio
                for motor in self._settings.motors
            ]
        )
        return DeviceLimits(nothing, nothing, nothing, torque, {"torque": "torque_limit of the connection's motors"})

    def cautions(self) -> Sequence[str]:
        """Return what the arm does before, at a stop and where this computer dies."""
        codec = CODECS[self._settings.family]
        said = [f"first the motors are switched on: the arm stiffens where it is; then, {self._stop_words()}"]
        if codec.times_out:
            said.append(f"if this computer dies or the cable is cut during a motion: {self._control.left_alone()}")
        elif self._settings.family == "odrive":
            said.append(
                "if this computer dies or the cable is cut during a motion, each axis holds its last goal, torque on, "
                "unless its own configuration has its watchdog on (then it is limp)"
            )
        else:
            said.append(
                "these motors have no command time-out that a program sets: where this computer dies or the cable is "
                "cut in a motion, each holds its last goal with torque on until it is switched off"
            )
        if "torque_limit" not in codec.keeps:
            said.append(f"{self._settings.family} motors accept no torque limit: stiff goals press hard")
        return said

    def guiding_refusal(self, *, pushed: bool) -> str:
        """Return why the arm cannot be led by hand: motors that take no torques, or keep one for ever."""
        codec, family = CODECS[self._settings.family], self._settings.family
        if not pushed:
            return ""
        if not codec.takes_torque:
            return f"dynid commands no torques of {family} motors"
        if not codec.times_out:
            return f"{family} motors have no command time-out: they would keep a dead computer's last torque"
        return ""

    def _stop_words(self) -> str:
        if self._settings.keys.on_stop == "limp":
            return "when the motion ends or is stopped, the motors are switched off: THE ARM FALLS (on_stop: limp)"
        if self._settings.when_lost == "limp":
            return (
                "when the motion ends or is stopped, the arm holds while dynid runs, and goes limp when dynid ends: "
                "THE ARM FALLS THEN (on_stop: hold, when_lost: limp)"
            )
        return (
            "when the motion ends or is stopped, the arm holds, torque on, even after dynid has ended (on_stop: hold)"
        )

    def _stopped_words(self) -> str:
        if self._settings.keys.on_stop == "limp":
            return "the motors are off, the arm is limp"
        if self._settings.when_lost == "limp":
            return f"the arm was held; {self._control.left_alone()}"
        return "the arm holds, its torque stays on"

    def _reset_faults(self) -> None:
        for index, motor in enumerate(self._settings.motors):
            if fault := self._bus.state(index).fault:
                self._bus.send(self._bus.codecs[index].clear())
                self._clock.sleep(CLEARING)
                words = ", ".join(motor.address.family.fault_words(fault))
                gone = not self._bus.state(index).fault
                self._tell("info" if gone else "warning", f"{motor.name}: {words}, {'reset' if gone else 'persists'}")

    def _require_own_ids(self) -> None:
        if self._settings.keys.read_only:
            return  # noticed while they are read
        if names := [self._settings.motors[index].name for index in self._bus.doubled()]:
            raise ConnectionFailedError(
                f"{', '.join(names)}: two motors answer to this id, or another program commands it",
                where=self._settings.where,
                hint="give each motor its own id with the manufacturer's tool",
            )

    def _take_told_ranges(self) -> None:
        """Scale of each motor's frames as the motor has it, where the table's is another."""
        motors = []
        for index, motor in enumerate(self._settings.motors):
            scale = motor.address.model
            reported = {name: self._bus.read(index, f"{name}_range") for name in TOLD_RANGES}
            if not all(math.isfinite(value) and value > 0.0 for value in reported.values()):
                raise ConnectionFailedError(
                    f"{motor.name} reports {reported} as the full scale of its frames", where=self._settings.where
                )
            other = {name: value for name, value in reported.items() if not math.isclose(value, getattr(scale, name))}
            if other:
                said = ", ".join(
                    f"{name} {getattr(scale, name):g}, the motor {value:g}" for name, value in other.items()
                )
                self._tell("info", f"{motor.name}: the table of {motor.model} says {said}: the motor's value is used")
            address = replace(motor.address, model=replace(scale, **reported))
            motors.append(replace(motor, address=address))
        self._settings = replace(self._settings, motors=tuple(motors))
        self._bus.codecs[:] = self._settings.codecs()
        self._control = MotorControl(self._bus, self._settings, self._clock)

    def _identity(self, index: int, motor: CanMotor) -> MotorIdentity:
        state, scale = self._bus.state(index), motor.address.model
        constant = scale.torque_constant
        if "torque_constant" in self._bus.codecs[index].registers:
            constant = self._bus.read(index, "torque_constant")
        return MotorIdentity(
            motor.joint,
            motor.id,
            motor.model,
            motor.to_joint("position", state.values["position"]),
            state.values.get("temperature", math.nan),
            state.values.get("drive_temperature", math.nan),
            state.enabled,
            ", ".join(motor.address.family.fault_words(state.fault)),
            math.nan if scale.velocity is None else scale.velocity,
            math.nan if scale.torque is None else scale.torque,
            math.nan if constant is None else constant,
        )


damiao, robstride, cubemars, moteus, odrive = (partial(CanMotorDriver, family=family) for family in CODECS)
