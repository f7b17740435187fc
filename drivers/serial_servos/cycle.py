"""The thread that reads all servos again and again, and what it tells of them: rows, losses, faults."""

from __future__ import annotations

from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, DriverStateError
from drivers.polled_rows import PolledRows
from drivers.serial_servos.bus import ServoBus, ServoFeedback, called
from drivers.serial_servos.control import ServoControl
from drivers.serial_servos.settings import ServoMotor, ServoSettings
from drivers.streams import ChannelLayout

ALERT = 0x80
"""Bit of a Dynamixel servo's errors: its hardware error status says which."""


class ServoCycle(PolledRows):
    """Reads the feedback of all servos at a rate."""

    def __init__(self, bus: ServoBus, control: ServoControl, settings: ServoSettings, clock: Clock) -> None:
        super().__init__(f"servos {settings.url}", settings.keys.rate, control.sent, clock)
        self._bus, self._control = bus, control
        self._motors = settings.motors
        self._garbled = 0

    def losses(self) -> str:
        """Return why rows were lost, in words; empty where none were."""
        said = [super().losses(), f"{self._garbled} bytes belonged to no answer" if self._garbled else ""]
        return "; ".join(filter(None, said))

    def _read(self) -> None:
        feedback = self._bus.feedback()
        others = ", ".join(f"id {motor}" for motor in feedback.others)
        said = f"unexpected answers of {others}" if others else ""
        self.besides = f"{feedback.strange} bytes belonged to no answer" if feedback.strange else said
        for motor in self._motors:
            if (packet := feedback.answers.get(motor.id)) is not None:
                self.answered[motor.id] = feedback.received
                self._note_fault(motor, packet.code)
        missing = [motor for motor in self._motors if motor.id not in feedback.answers]
        watched = self._control.active and not self._control.led
        if watched and self._bus.gathered and (off := [m for m in self._motors if self._is_off(m, feedback)]):
            said = f"the torque of {', '.join(map(called, off))} is off"
            self._tell(
                "error", said, "its power was interrupted, or it protected itself: check supply, temperature and load"
            )
            return  # whose power was interrupted shows other bytes than those asked for
        self._garbled += feedback.strange
        if missing:
            self._note_missing(missing, feedback)
        else:
            self._add(feedback.time, feedback.received, self._row(feedback))
        if watched and not self._bus.gathered:
            self._look_closer()

    def _is_off(self, motor: ServoMotor, feedback: ServoFeedback) -> bool:
        answer = feedback.answers.get(motor.id)
        return answer is not None and not self._bus.value(motor, "torque_enable", answer)

    def _row(self, feedback: ServoFeedback) -> dict[str, list[float]]:
        row: dict[str, list[float]] = {}
        for motor in self._motors:
            answer = feedback.answers[motor.id]
            for quantity, name in motor.table.feedback.items():
                counts = self._bus.value(motor, name, answer)
                if quantity == "position":
                    value = motor.scale.position(counts)
                else:
                    value = counts * motor.table.registers[name].scale
                    if quantity in SIGNED and quantity not in motor.table.magnitudes:
                        value *= motor.scale.direction
                row.setdefault(quantity, []).append(value)
        return row

    def _note_missing(self, missing: list[ServoMotor], feedback: ServoFeedback) -> None:
        if self._bus.fast and not feedback.answers:
            self._bus.fast = False  # in one packet all wait for the servo that is silent: asked singly, it shows
            self._tell("warning", "the servos no longer answer in one packet: they are read one after the other")
        self._lose([called(motor) for motor in missing], feedback.received)

    def _note_fault(self, motor: ServoMotor, code: int) -> None:
        before = self._faults.get(motor.id, 0)
        if motor.table.protocol == "dynamixel":
            code = self._hardware_error(motor, before) if code & ALERT else 0
        if code == before:
            return
        self._faults[motor.id] = code
        words = motor.table.error_words(code & ~before)
        if words or not code:
            self._report_fault(called(motor), words, moving=self._control.active)

    def _hardware_error(self, motor: ServoMotor, before: int) -> int:
        """Bits of a Dynamixel servo's hardware error, asked for once."""
        if before:
            return before
        try:
            entry = motor.table.registers["status"]
            return entry.decoded(self._bus.read_bytes(motor, entry.address, entry.size, hurried=True))
        except ConnectionFailedError:  # it will be asked again with the next row
            return 0

    def _look_closer(self) -> None:
        try:
            self._control.watch()
        except DriverStateError as error:
            self._tell("error", error.message, error.hint)
        except ConnectionFailedError:
            pass  # the feedback says who is silent


SIGNED = ("velocity", "load", "current")
"""Quantities that a servo counts in its own direction."""


def feedback_channels(settings: ServoSettings) -> tuple[ChannelLayout, ...]:
    """The channels of the stream `joints`: a quantity has the joints whose servos report it."""
    channels = []
    for quantity in dict.fromkeys(name for motor in settings.motors for name in motor.table.feedback):
        motors = [motor for motor in settings.motors if quantity in motor.table.feedback]
        columns = tuple(motor.joint for motor in motors)
        unit = {"load": "1", "supply_voltage": "V"}.get(quantity, "")
        magnitude = any(quantity in motor.table.magnitudes for motor in motors)
        what = {"load": "share of the full duty cycle, not a torque", "supply_voltage": "of the servo's supply"}.get(
            quantity, f"{quantity} that the servo reports"
        )
        said = f"{what}; time is the middle of the reading, by this computer's clock"
        channels.append(ChannelLayout(quantity, columns, unit, said, magnitude))
    return tuple(channels)
