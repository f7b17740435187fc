"""The thread that reads all servos again and again, and what it tells of them: rows, losses, faults."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from drivers.base import Notice
from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, DriverStateError, DynidError
from drivers.serial_servos.bus import Feedback, ServoBus, called
from drivers.serial_servos.control import ServoControl
from drivers.serial_servos.settings import ServoMotor, ServoSettings
from drivers.streams import Batch, ChannelLayout

ALERT = 0x80
"""Bit of a Dynamixel servo's errors: its hardware error status says which."""
BUFFERED = 100_000
"""Rows that wait for `take` before the oldest is dropped."""
NOTED_AGAIN = 10.0
"""[s] between two notices on answers that are missing."""


class ServoCycle:
    """Reads the feedback of all servos at a rate; `start` and `stop` begin and end its thread.

    Args:
        bus: open.
        control: of the same servos.
        settings: of the connection.
        clock: the host's.

    Attributes:
        latest: (n,) newest position [rad]; None before the first row.
        last_row: when it came [s, host's monotonic clock].
        answered: id → when the servo answered last.
        failure: what ended the thread; None while it runs.
    """

    def __init__(self, bus: ServoBus, control: ServoControl, settings: ServoSettings, clock: Clock) -> None:
        self._bus, self._control, self._settings, self._clock = bus, control, settings, clock
        self._motors = settings.motors
        self._changed = clock.condition()
        self._ending = clock.event()
        self._thread = clock.thread(self._run, f"servos {settings.url}")
        self._rows: deque[tuple[float, float, dict[str, list[float]]]] = deque(maxlen=BUFFERED)
        self._lost = 0
        self._faults: dict[int, int] = {}
        self._silent: Counter[str] = Counter()
        self._garbled = self._late = 0
        self._noted = -np.inf
        self.notices: deque[Notice] = deque()
        self.latest: np.ndarray | None = None
        self.last_row = clock.now()
        self.answered: dict[int, float] = {}
        self.failure: DynidError | None = None

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join(1.0)

    def take(self, timeout: float) -> list[Batch]:
        """Rows and commands since the last call, waiting at most `timeout` [s] for the first row.

        Raises:
            DynidError: what ended the thread, once its rows are taken.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._rows or self.failure is not None, timeout)
            rows = [self._rows.popleft() for _ in range(len(self._rows))]
            lost, self._lost = (self._lost, 0) if rows else (0, self._lost)
        if not rows and self.failure is not None:
            raise self.failure
        batches = []
        if rows:
            stamps, received = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
            values = {name: np.array([row[2][name] for row in rows]) for name in rows[0][2]}
            batches.append(Batch("joints", stamps, received, values, lost))
        sent = self._control.sent
        if commands := [sent.popleft() for _ in range(len(sent))]:
            stamps = np.array([moment for moment, _ in commands])
            goals = np.array([goal for _, goal in commands])
            batches.append(Batch("commands", stamps, stamps.copy(), {"target_position": goals}))
        return batches

    def losses(self) -> str:
        """Why rows were lost, in words; empty where none were."""
        said = [f"{name} did not answer {count} times" for name, count in self._silent.items()]
        if self._garbled:
            said.append(f"{self._garbled} bytes belonged to no answer")
        if self._late:
            said.append(f"{self._late} readings took longer than their period")
        return "; ".join(said)

    def _run(self) -> None:
        period = 1.0 / self._settings.keys.rate
        due = self._clock.now()
        try:
            while not self._ending.is_set():
                self._read()
                if self._control.active:
                    self._look_closer()
                due += period
                if (behind := self._clock.now() - due) > 0.0:
                    skipped = int(behind / period)  # what would have been read meanwhile is lost
                    due += skipped * period
                    if skipped:
                        with self._changed:
                            self._lost += skipped
                            self._late += skipped
                self._ending.wait(due - self._clock.now())
        except DynidError as error:
            with self._changed:
                self.failure = error
                self._changed.notify_all()

    def _read(self) -> None:
        feedback = self._bus.feedback()
        for motor, packet in feedback.answers.items():
            self.answered[motor] = feedback.received
            self._note_fault(motor, packet.code)
        missing = [motor for motor in self._motors if motor.id not in feedback.answers]
        self._garbled += feedback.strange
        if missing:
            self._note_missing(missing, feedback)
            with self._changed:
                self._lost += 1
            return
        row = self._row(feedback)
        self.latest = np.array(row["position"])
        self.last_row = feedback.received
        with self._changed:
            self._rows.append((feedback.time, feedback.received, row))
            self._changed.notify_all()

    def _row(self, feedback: Feedback) -> dict[str, list[float]]:
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

    def _note_missing(self, missing: list[ServoMotor], feedback: Feedback) -> None:
        if self._bus.fast and not feedback.answers:
            self._bus.fast = False  # in one packet all wait for the servo that is silent: asked singly, it shows
            self._notices_add("warning", "the servos no longer answer in one packet: they are read one after the other")
        for motor in missing:
            self._silent[called(motor)] += 1
        if feedback.received - self._noted > NOTED_AGAIN:
            self._noted = feedback.received
            garbled = f", {feedback.strange} bytes belonged to no answer" if feedback.strange else ""
            self._notices_add("warning", f"no answer of {', '.join(map(called, missing))}{garbled}")

    def _note_fault(self, motor: int, code: int) -> None:
        table = next(one for one in self._motors if one.id == motor)
        before = self._faults.get(motor, 0)
        if table.table.protocol == "dynamixel":
            code = self._hardware_error(table, before) if code & ALERT else 0
        if code == before:
            return
        self._faults[motor] = code
        if words := table.table.error_words(code & ~before):
            level = "error" if self._control.active else "warning"
            self._notices_add(
                level,
                f"{called(table)} reports {', '.join(words)}",
                "let it cool down; look at its supply, its load and what it touches",
            )
        elif not code:
            self._notices_add("info", f"{called(table)} reports no fault any more")

    def _hardware_error(self, motor: ServoMotor, known: int) -> int:
        """Bits of a Dynamixel servo's hardware error, asked for once."""
        if known:
            return known
        try:
            entry = motor.table.registers["status"]
            return entry.decoded(self._bus.read_bytes(motor, entry.address, entry.size, hurried=True))
        except ConnectionFailedError:  # it will be asked again with the next row
            return 0

    def _look_closer(self) -> None:
        try:
            self._control.watched()
        except DriverStateError as error:
            self._notices_add("error", error.message, error.hint)
        except ConnectionFailedError:
            pass  # the feedback says who is silent

    def _notices_add(self, level: str, message: str, hint: str = "") -> None:
        self.notices.append(Notice(self._clock.now(), level, message, hint))  # type: ignore[arg-type]


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
        what = {
            "load": "share of the full duty cycle, not a torque",
            "supply_voltage": "of the servo's supply",
        }.get(quantity, f"{quantity} that the servo reports")
        said = f"{what}; time is the middle of the reading, by this computer's clock"
        channels.append(ChannelLayout(quantity, columns, unit, said, magnitude))
    return tuple(channels)
