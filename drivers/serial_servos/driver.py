"""The driver of an arm of serial bus servos: Feetech SCS and STS, Dynamixel protocol 2.0."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from drivers.base import DeviceLimits, DriverSettings
from drivers.core.errors import UsageError
from drivers.polled_arm import PolledArm
from drivers.serial_servos.bus import PROTOCOLS, ServoBus, called
from drivers.serial_servos.control import ServoControl
from drivers.serial_servos.cycle import ServoCycle, feedback_channels
from drivers.serial_servos.line import LEAST_PATIENCE
from drivers.serial_servos.settings import parse_settings
from drivers.serial_servos.setup import ServoIdentity, configure, identity, reading_time, slow_reading
from drivers.streams import ChannelLayout

LONGEST_PATIENCE = 0.05
"""[s] that answers are waited for at most."""


class SerialServoDriver(PolledArm):
    """Serial bus servos on one line; implements `drivers.base.Driver`.

    The connection's keys are those of `drivers.serial_servos.settings.ServoKeys`.

    Raises:
        UsageError: the connection's keys are wrong, or its calibration cannot be used.
    """

    def __init__(self, settings: DriverSettings, protocol: str) -> None:
        self._settings = parse_settings(settings.connection, settings.joints, settings.folder, protocol)
        keys, names = self._settings.keys, {motor.id: called(motor) for motor in self._settings.motors}
        super().__init__(settings, self._settings.url, keys.rate, names, "servo", read_only=keys.read_only)
        self._bus = ServoBus(self._settings, self._clock)
        self._control: ServoControl = ServoControl(self._bus, self._settings, self._clock)
        self._identities: tuple[ServoIdentity, ...] = ()

    def _connect(self) -> None:
        self._bus.open()
        for change in configure(self._bus, self._settings) if self._settings.keys.configure else ():
            self._tell("info", change)
        self._identities = tuple(identity(self._bus, motor) for motor in self._settings.motors)
        self._require_own_calibration()
        lasted = reading_time(self._bus, self._clock)
        self._bus.line.patience = min(max(LEAST_PATIENCE, 2.0 * lasted), LONGEST_PATIENCE)
        for trouble in slow_reading(self._bus, self._settings, lasted):
            self._tell("warning", trouble)

    def _disconnect(self) -> None:
        self._bus.close()

    def _new_cycle(self) -> ServoCycle:
        return ServoCycle(self._bus, self._control, self._settings, self._clock)

    def _channels(self) -> tuple[ChannelLayout, ...]:
        return feedback_channels(self._settings)

    def device_limits(self) -> DeviceLimits:
        """The position limits that the servos keep."""
        self._require_open("tell limits")
        bounds = [
            sorted((motor.scale.position(servo.min_position), motor.scale.position(servo.max_position)))
            if servo.min_position < servo.max_position
            else [math.nan, math.nan]
            for motor, servo in zip(self._settings.motors, self._identities, strict=True)
        ]
        nothing = np.full(len(bounds), np.nan)
        lowest, highest = np.array(bounds).T
        return DeviceLimits(lowest, highest, nothing, nothing, {"position": "the servos' position limits"})

    def cautions(self) -> Sequence[str]:
        """Return what the arm does before, at a stop and where this computer dies."""
        keys, motors = self._settings.keys, self._settings.motors
        said = [f"first the servos' torque is switched on: the arm stiffens where it is; then, {self._stop_words()}"]
        if motors[0].table.protocol == "feetech":
            said.append(
                "Feetech servos have no watchdog: if this computer dies or the cable is cut during a motion, the arm "
                "holds its last goal with torque on until it is switched off"
            )
        else:
            said.append(
                f"the servos' bus watchdog is armed: {keys.watchdog:g} s after the last request they stop by themselves"
            )
        if assumed := [motor for motor in motors if motor.assumed_zero]:
            said.append(
                f"no calibration: {assumed[0].table.steps // 2} steps are used as the zero of "
                f"{', '.join(motor.joint for motor in assumed)} (keys `calibration`, or `zero` of a motor)"
            )
        return said

    def guiding_refusal(self, *, pushed: bool) -> str:
        """Return why the arm cannot be led by hand: not with torques."""
        return "these servos follow positions and accept no torques" if pushed else ""

    def _stop_words(self) -> str:
        if self._settings.keys.on_stop == "limp":
            return "when the motion ends or is stopped, the torque is switched off: THE ARM FALLS (on_stop: limp)"
        return (
            "when the motion ends or is stopped, the arm holds, torque on, even after dynid has ended (on_stop: hold)"
        )

    def _stopped_words(self) -> str:
        limp = self._settings.keys.on_stop == "limp"
        return "the torque is off, the arm is limp" if limp else "the arm holds, its torque stays on"

    def _require_own_calibration(self) -> None:
        for motor, servo in zip(self._settings.motors, self._identities, strict=True):
            expected = motor.calibration
            if expected is not None and servo.homing_offset != expected.homing_offset:
                raise UsageError(
                    f"{called(motor)} has homing offset {servo.homing_offset}, and {expected.homing_offset} in "
                    f"{self._settings.keys.calibration}: its positions would be wrong",
                    where=self._settings.url,
                    hint="use the calibration of this arm, or write it: dynid check --connect --configure",
                )


feetech, dynamixel = (partial(SerialServoDriver, protocol=protocol) for protocol in PROTOCOLS)
