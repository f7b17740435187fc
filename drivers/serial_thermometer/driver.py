"""The driver of a serial thermometer: one stream of joint temperatures beside whatever moves the arm.

A thermometer has no clock of its own: `time` is the host's monotonic clock at the arrival of the line, worked out from
the bytes of a chunk and the baud rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers.base import DriverSettings, Level, require_state
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionFailedError, DriverStateError
from drivers.life_cycle import LifeCycle
from drivers.serial_port import BITS_A_BYTE
from drivers.serial_thermometer.port import Chunk, LineParser, Lost, Restored, SerialPort, ThermometerReading
from drivers.serial_thermometer.settings import ThermometerSettings, parse_settings
from drivers.streams import Batch, ChannelLayout, StreamLayout

STREAM = "thermometer"
SILENT_PERIODS = 5.0
SILENT_FLOOR = 0.2
"""Without a temperature for so many periods, and for this long [s], the thermometer counts as silent; a shorter
silence may be that of a busy computer."""
ROW_PATIENCE = 0.05
"""How long [s] an unfinished row waits for its other joints, or one period where that is longer."""
NOTICE_PERIOD = 10.0
"""[s] between two notices on lines that were ignored."""
STILL_GONE_PERIOD = 60.0
"""[s] between two notices on a port that is still gone."""


class SerialThermometerDriver(LifeCycle):
    """Temperatures of some joints; implements `drivers.base.Driver`, but moves nothing.

    The connection's keys are those of `drivers.serial_thermometer.settings.ThermometerSettings`.

    Raises:
        UsageError: the connection's keys are wrong.
    """

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self._settings = parse_settings(settings.connection, settings.joints)
        mapped = self._settings.channels.values()
        self._silent_after = max(SILENT_PERIODS / self._settings.rate, SILENT_FLOOR)
        self._joints = tuple(joint for joint in settings.joints if joint in mapped)
        self._port = SerialPort(self._settings.url, self._settings.baudrate, self._clock)
        self._parser = LineParser(self._settings)
        self._rows = RowAssembler(self._joints)
        self._heard = self._opened = math.nan
        self._silent = False
        self._lost_since: float | None = None
        self._reported_gone = math.nan
        self._reported_rejected = -math.inf
        self._reported_unknown: set[str] = set()
        self._dropped = self._reported_dropped = 0

    def _connect(self) -> None:
        self._port.open()
        self._await_temperature()

    def _disconnect(self) -> None:
        self._port.close()

    def streams(self) -> tuple[StreamLayout, ...]:
        """One stream, a column for each joint that has a channel."""
        self._require_open("list its streams")
        described = "temperature by an external sensor; the stamps are the host's clock, the sensor has none"
        channel = ChannelLayout("temperature", self._joints, "", described)
        return (StreamLayout(STREAM, (channel,), self._settings.rate, essential=self._settings.required),)

    def start(self) -> None:
        """Make samples flow."""
        require_state(self._state, "open", "start")
        self._port.clear()
        self._parser.restart()
        self._rows.clear()
        self._heard = self._opened = self._clock.now()
        self._silent = False
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Temperatures that have arrived, waiting at most `timeout` [s] for the first; empty where none came.

        A row holds what each channel said since the row before, nan where a channel said nothing. A port that has gone
        raises nothing: it is opened again as soon as it is back, and notices tell.
        """
        require_state(self._state, "running", "read")
        rows: list[tuple[float, FloatArray]] = []
        read_until = self._port.read_until  # asked first: what came until then is in the arrivals
        arrivals = self._port.take(timeout)
        if self._port.dropped != self._dropped:  # what was read before and what comes now are not one line
            self._dropped = self._port.dropped
            self._parser.restart(cut=True)
        for arrival in arrivals:
            match arrival:
                case Chunk():
                    for reading in self._parser.feed(arrival.data):
                        when = _arrival(arrival, reading, self._settings)
                        self._hear(when)
                        rows.extend(self._rows.add(when, reading))
                case Lost():
                    self._lose(arrival)
                case Restored():
                    self._restore(arrival)
        now = self._clock.now()
        if not arrivals:
            rows.extend(self._rows.flush(before=now - max(1.0 / self._settings.rate, ROW_PATIENCE)))
        self._watch(now, read_until)
        if not rows:
            return ()
        stamps = np.array([when for when, _ in rows])
        values = {"temperature": np.array([row for _, row in rows])}
        return (Batch(STREAM, stamps, stamps.copy(), values),)

    def command_rate(self) -> float:
        """0: a thermometer moves nothing."""
        return 0.0

    def take_control(self) -> None:
        """Refuse: a thermometer moves nothing."""
        raise DriverStateError(
            "a thermometer cannot move an arm",
            hint="choose the arm's own connection, and record this one beside it (`with`)",
        )

    def command(self, position: FloatArray) -> None:
        """Refuse, as `take_control`."""
        self.take_control()

    def stop(self) -> None:
        """End the samples; safe in every state, never raises."""
        if self._state == "running":
            self._state = "open"
            self._report_rejected(self._clock.now(), at_once=True)

    def _await_temperature(self) -> None:
        deadline = self._clock.now() + self._settings.timeout
        self._parser.restart()
        received = 0
        while (left := deadline - self._clock.now()) > 0.0:
            for arrival in self._port.take(left):
                if isinstance(arrival, Chunk):
                    received += len(arrival.data)
                    if self._parser.feed(arrival.data):
                        self._parser.take_rejected()  # a thermometer that has just started may greet
                        return
                elif isinstance(arrival, Lost):
                    raise ConnectionFailedError(f"the port is gone: {arrival.reason}", where=self._settings.url)
        raise ConnectionFailedError(self._no_temperature(received), where=self._settings.url, hint=self._hint(received))

    def _no_temperature(self, received: int) -> str:
        said = f"no temperature within {self._settings.timeout:g} s"
        if not received:
            return f"{said}, not a single character"
        if ignored := self._parser.take_rejected():
            return f"{said}; {ignored}"
        if self._parser.unknown:
            return f"{said}; only of channels that 'channels' does not name: {_list(self._parser.unknown)}"
        return f"{said}; {received} characters, but no whole line"

    def _hint(self, received: int) -> str:
        if not received:
            return "check its power and the port"
        return f"is {self._settings.baudrate} its baud rate, and does 'pattern' match its lines?"

    def _hear(self, when: float) -> None:
        if self._silent:
            self._tell("info", f"sends again after {when - self._heard:.1f} s", time=when)
        self._heard, self._silent = when, False

    def _lose(self, lost: Lost) -> None:
        self._parser.restart(cut=True)
        self._lost_since = self._reported_gone = lost.time
        self._tell(
            self._loss_level, f"the port is gone: {lost.reason}; it is opened again when it is back", time=lost.time
        )

    def _restore(self, restored: Restored) -> None:
        since = restored.time if self._lost_since is None else self._lost_since
        self._lost_since, self._opened = None, restored.time
        gone = restored.time - since
        self._tell(
            "info", f"the port is open again after {gone:.1f} s, attempt {restored.attempts}", time=restored.time
        )

    def _watch(self, now: float, read_until: float) -> None:
        if self._lost_since is not None:
            if now - self._reported_gone >= STILL_GONE_PERIOD:
                self._reported_gone = now
                gone = now - self._lost_since
                self._tell(
                    "warning", f"the port is still gone after {gone:.0f} s, {self._port.attempts} attempts", time=now
                )
        elif not self._silent and read_until - max(self._heard, self._opened) > self._silent_after:
            # Not `now`: where this computer was stalled, the port's thread may not have had its turn since.
            self._silent = True
            self._tell(self._loss_level, f"no temperature for {read_until - self._heard:.2f} s", time=now)
        self._report_rejected(now, at_once=False)

    def _report_rejected(self, now: float, *, at_once: bool) -> None:
        if not at_once and now - self._reported_rejected < NOTICE_PERIOD:
            return
        texts = [self._parser.take_rejected()]
        if new := self._parser.unknown - self._reported_unknown:
            self._reported_unknown |= new
            texts.append(f"values of channels that 'channels' does not name: {_list(new)}")
        if (dropped := self._port.dropped - self._reported_dropped) > 0:
            self._reported_dropped += dropped
            texts.append(f"{dropped} characters were dropped because they were not read")
        for text in filter(None, texts):
            self._reported_rejected = now
            self._tell("warning", text, time=now)

    @property
    def _loss_level(self) -> Level:
        return "error" if self._settings.required else "warning"


class RowAssembler:
    """Gathers readings of single joints into rows; a row is complete when every joint has come, or one comes again."""

    def __init__(self, joints: Sequence[str]) -> None:
        self._column = {joint: number for number, joint in enumerate(joints)}
        self.clear()

    def clear(self) -> None:
        """Forget an unfinished row."""
        self._row = np.full(len(self._column), np.nan)
        self._when = math.nan

    def add(self, when: float, reading: ThermometerReading) -> list[tuple[float, FloatArray]]:
        """Rows that this reading, at `when` [s], completes: none, one, or two; each with the time of its last value."""
        column = self._column[reading.joint]
        rows = [] if np.isnan(self._row[column]) else self.flush(before=math.inf)
        self._row[column], self._when = reading.value, when
        return rows if np.isnan(self._row).any() else [*rows, *self.flush(before=math.inf)]

    def flush(self, before: float) -> list[tuple[float, FloatArray]]:
        """The unfinished row, if its last value came before this time [s]."""
        if not self._when < before:
            return []
        finished = (self._when, self._row)
        self.clear()
        return [finished]


def _arrival(chunk: Chunk, reading: ThermometerReading, settings: ThermometerSettings) -> float:
    """When a line's last byte came [s]: as many bytes before the chunk's end as follow it, but within the chunk."""
    span = min(chunk.until - chunk.since, len(chunk.data) * BITS_A_BYTE / settings.baudrate)
    return chunk.until - span * (1.0 - (reading.end + 1) / len(chunk.data))


def _list(channels: set[str]) -> str:
    shown = sorted(channels)
    return ", ".join(repr(channel) for channel in shown[:5]) + (" …" if len(shown) > 5 else "")
