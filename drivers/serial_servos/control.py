"""Moving servos: taking control of them, commands, watching that they obey, and stopping them."""

from __future__ import annotations

import itertools
from collections import deque

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.polled_arm import HOLD_LEAD, STOP_LIMIT, STOP_SENDINGS, not_at_rest
from drivers.serial_servos.bus import ServoBus, called
from drivers.serial_servos.registers import Register
from drivers.serial_servos.settings import ServoMotor, ServoSettings
from drivers.standstill import StandstillWatch

POSITION_MODE = {"feetech": 0, "dynamixel": 3}
"""Operating mode in which a servo follows commanded positions within a turn."""


class ServoControl:
    """Commands of the servos of a connection; one thread at a time.

    Whatever exchanges bytes raises ConnectionLostError where the port is gone.

    Attributes:
        active: whether the servos were made to obey, and not yet stopped.
        led: whether the arm is released, to be led by hand.
        goal: (n,) position that was commanded last [rad]; None before.
        sent: commands since they were taken: (when [s, host's monotonic clock], (n,) [rad]).
    """

    def __init__(self, bus: ServoBus, settings: ServoSettings, clock: Clock) -> None:
        self._bus, self._settings, self._clock = bus, settings, clock
        self._motors = settings.motors
        self._turn = itertools.cycle(self._motors)
        self.active = self.led = False
        self.goal: FloatArray | None = None
        self.sent: deque[tuple[float, FloatArray]] = deque()

    def take(self) -> None:
        """Set limits and profiles in the servos, read them back, and let them hold where they are.

        Raises:
            DriverStateError: a servo is in fault, in another mode, or out of the range of its goals.
            ConnectionFailedError: a servo does not answer, or does not keep what is written.
        """
        keys = self._settings.keys
        for motor in self._motors:
            registers = motor.table.registers
            wanted = POSITION_MODE[motor.table.protocol]
            if "operating_mode" in registers and (mode := self._bus.read(motor, "operating_mode")) != wanted:
                raise DriverStateError(
                    f"{called(motor)} is in operating mode {mode}, and follows positions in {wanted}",
                    hint="dynid check --connect --configure sets it (in EEPROM)",
                )
            if faults := motor.table.error_words(self._bus.read(motor, "status")):
                raise DriverStateError(
                    f"{called(motor)} is in fault: {', '.join(faults)}",
                    hint="let it cool down, check its supply and load, then switch its power off and on",
                )
            if "bus_watchdog" in registers:
                self._bus.write(motor, "bus_watchdog", 0)  # one that has fired refuses goals
            self._set(motor, "acceleration", keys.acceleration)
            self._set(motor, "speed_limit", keys.speed)
            if "torque_limit" in registers:
                self._bus.write(motor, "torque_limit", _counts(registers["torque_limit"], keys.torque_limit))
        here = {motor.id: self._bus.read(motor, motor.table.feedback["position"]) for motor in self._motors}
        self._bus.write_all("goal_position", here)
        for motor in self._motors:
            if abs(self._bus.read(motor, "goal_position") - here[motor.id]) > 1:
                raise ConnectionFailedError(f"{called(motor)} does not accept a goal", where=self._bus.line.url)
        self.goal = np.array([motor.scale.position(here[motor.id]) for motor in self._motors])
        try:
            for motor in self._motors:
                self._bus.write(motor, "torque_enable", 1)
        finally:
            self.active = True  # where one does not obey, those that do are stopped as well
        for motor in self._motors:
            if "bus_watchdog" in motor.table.registers:
                entry = motor.table.registers["bus_watchdog"]
                self._bus.write(motor, "bus_watchdog", max(1, _counts(entry, keys.watchdog)))
        self._note(self.goal)

    def release(self, torque: FloatArray | None) -> None:
        """Switch the torque of all servos off.

        Raises:
            DriverStateError: they are to give torques.
            ConnectionFailedError: a servo does not answer, or does not keep what is written.
        """
        if torque is not None:
            self.push(torque)
        for motor in self._motors:
            self._bus.write(motor, "torque_enable", 0)
        self.active = self.led = True

    def push(self, torque: FloatArray) -> None:
        """Not possible.

        Raises:
            DriverStateError: always.
        """
        raise DriverStateError("these servos follow positions and accept no torques")

    def command(self, target: FloatArray) -> None:
        """Send goals (n,) [rad]; the nearest steps are what is noted as sent.

        Raises:
            DriverStateError: a position that the servo cannot be commanded.
        """
        counts = {}
        for motor, position in zip(self._motors, target.tolist(), strict=True):
            counts[motor.id] = steps = motor.scale.steps(position)
            least, most = motor.table.registers["goal_position"].bounds
            if not least <= steps <= most:
                raise DriverStateError(
                    f"{position:.4g} rad is {steps} steps, but {called(motor)} allows {least} to {most}",
                    hint="check its zero and direction, or its calibration",
                )
        self._bus.write_all("goal_position", counts)
        self.goal = np.array([motor.scale.position(counts[motor.id]) for motor in self._motors])
        self._note(self.goal)

    def watch(self) -> None:
        """Look at the next servo, in turn.

        Raises:
            DriverStateError: its torque is off though no command switched it off.
            ConnectionFailedError: it does not answer.
        """
        motor = next(self._turn)
        enable, status = motor.table.registers["torque_enable"], motor.table.registers["status"]
        near = 0 < status.address - enable.address < 8
        size = status.address + status.size - enable.address if near else enable.size
        data = self._bus.read_bytes(motor, enable.address, size, hurried=True)
        if not data[0] and self.active:
            faults = motor.table.error_words(status.decoded(data[status.address - enable.address :])) if near else []
            why = f": {', '.join(faults)}" if faults else ""
            raise DriverStateError(
                f"the torque of {called(motor)} is off{why}",
                hint="its power was interrupted, or it protected itself: check supply, temperature and load",
            )

    def stop(self) -> str:
        """Let the arm hold or go limp, as the connection says; what is wrong, in words, or nothing."""
        led, self.active, self.led = self.led, False, False
        limp = self._settings.keys.on_stop == "limp"
        try:
            if led and not limp:
                self.take()
                self.active = False
            if limp:
                for _ in range(STOP_SENDINGS):
                    self._bus.write_all("torque_enable", {motor.id: 0 for motor in self._motors})
            else:
                self._hold()
            watch, end = StandstillWatch(0.2), self._clock.now() + STOP_LIMIT
            heard: frozenset[int] = frozenset()
            while not watch.at_rest and self._clock.now() < end:
                feedback = self._bus.feedback()
                heard = heard | feedback.answers.keys()
                if len(feedback.answers) == len(self._motors):
                    here = [self._bus.position(motor, feedback.answers[motor.id]) for motor in self._motors]
                    watch.add(feedback.time, np.array(here))
                else:
                    self._clock.sleep(0.005)
            self._release_watchdog()
        except (ConnectionFailedError, ConnectionLostError, DriverStateError) as error:
            left = "limp where its torque is off" if led else "each holds its last goal with torque on"
            return f"the command to stop could not be sent to the servos ({error.message}): {left}"
        if watch.at_rest:
            return ""
        return not_at_rest([called(motor) for motor in self._motors if motor.id not in heard], limp=limp)

    def _hold(self) -> None:
        """Goals near where the joints are, of the servos that answer."""
        answers = self._bus.feedback().answers
        counts = {}
        for index, motor in enumerate(self._motors):
            if motor.id not in answers or self.goal is None:
                continue
            here = self._bus.position(motor, answers[motor.id])
            lead = float(np.clip(self.goal[index] - here, -HOLD_LEAD, HOLD_LEAD))
            counts[motor.id] = motor.scale.steps(here + lead)
        for _ in range(STOP_SENDINGS if counts else 0):
            self._bus.write_all("goal_position", counts)

    def _release_watchdog(self) -> None:
        """Disarm it: it would take the end of this program for its death."""
        armed = {motor.id: 0 for motor in self._motors if "bus_watchdog" in motor.table.registers}
        if armed:
            self._bus.write_all("bus_watchdog", armed)

    def _set(self, motor: ServoMotor, name: str, value: float | None) -> None:
        """Write a limit of the profile; where none is wanted, Dynamixel's is taken off and Feetech's is left."""
        entry = motor.table.registers.get(name)
        if entry is None:
            return
        if value is None:
            if motor.table.protocol == "dynamixel":
                self._bus.write(motor, name, 0)
            return
        self._bus.write(motor, name, max(1, min(_counts(entry, value), _most(motor, entry))))

    def _note(self, goal: FloatArray) -> None:
        self.sent.append((self._clock.now(), goal))


def _counts(entry: Register, value: float) -> int:
    return round(value / entry.scale)


def _most(motor: ServoMotor, entry: Register) -> int:
    """Largest value of a limit: Feetech's acceleration ends at 254."""
    return 254 if motor.table.protocol == "feetech" and entry.name == "acceleration" else entry.bounds[1]
