"""Lines of text from a serial line, cut out of the bytes as they arrive, and the temperatures that they hold."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from drivers.core.units import ZERO_CELSIUS
from drivers.serial_thermometer.settings import ThermometerSettings

LONGEST_LINE = 1024
"""Bytes; beyond, something else than lines is coming, and waiting for an end would fill the memory."""
MOST_UNKNOWN = 100
"""Channels that are remembered though the robot file does not name them."""
SHOWN = 40
"""Characters of a rejected line that a message quotes."""
_LINE_END = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"\s*[+-]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?\s*")

NO_MATCH = "do not match the pattern"
NOT_A_NUMBER = "hold no number where the value should be"
OUT_OF_RANGE = "hold a temperature outside the believed range"
TOO_LONG = f"are longer than {LONGEST_LINE} characters"
CUT = "were cut off"


@dataclass(frozen=True)
class ThermometerReading:
    """One temperature.

    Attributes:
        end: index of the byte at which its line ended, in the bytes last fed.
        joint: name.
        value: [°C].
    """

    end: int
    joint: str
    value: float


class LineParser:
    """Cuts bytes into lines, lines into temperatures; what is no temperature is counted.

    Args:
        settings: pattern, channels, unit and range.

    Attributes:
        rejected: why → how many lines, since the last `take_rejected`.
        last_rejected: the beginning of the last one.
        unknown: channels that the robot file does not name, seen so far.
    """

    def __init__(self, settings: ThermometerSettings) -> None:
        self._settings = settings
        self._rest = b""
        self._skipping = True
        self.rejected: Counter[str] = Counter()
        self.last_rejected = ""
        self.unknown: set[str] = set()

    def restart(self, *, cut: bool = False) -> None:
        """Begin anew in the middle of a line: what comes before its end is dropped; `cut` counts what was there."""
        if cut and self._rest:
            self._reject(CUT, self._rest)
        self._rest, self._skipping = b"", True

    def feed(self, data: bytes) -> list[ThermometerReading]:
        """Temperatures of the lines that end within `data`, in their order."""
        readings: list[ThermometerReading] = []
        start = 0
        for end in _LINE_END.finditer(data):
            line = self._rest + data[start : end.start()]
            self._rest, start = b"", end.end()
            if self._skipping:  # the first piece may be the end of a line: "12=20" would be read as "2=20"
                self._skipping = False
            elif len(line) > LONGEST_LINE:
                self._reject(TOO_LONG, line)
            elif line.strip():
                readings.extend(self._parse(line, end.start()))
        self._rest += data[start:]
        if len(self._rest) > LONGEST_LINE:
            if not self._skipping:
                self._reject(TOO_LONG, self._rest)
            self._rest, self._skipping = b"", True
        return readings

    def take_rejected(self) -> str:
        """The lines rejected since the last call, in words; empty where there are none."""
        if not self.rejected:
            return ""
        reasons = ", ".join(f"{count} {why}" for why, count in self.rejected.most_common())
        total = sum(self.rejected.values())
        self.rejected.clear()
        return f"{total} line(s) ignored: {reasons}; the last one: {self.last_rejected!r}"

    def _parse(self, line: bytes, end: int) -> list[ThermometerReading]:
        text = line.decode("ascii", "replace")
        readings: list[ThermometerReading] = []
        trouble = NO_MATCH
        for number, match in enumerate(self._settings.pattern.finditer(text)):
            trouble = trouble if number else ""
            channel, value = match["channel"] or "", self._celsius(match["value"])
            joint = self._settings.channels.get(channel)
            if joint is None:
                if len(self.unknown) < MOST_UNKNOWN:  # garbage may invent channels
                    self.unknown.add(channel)
            elif value is None:
                trouble = NOT_A_NUMBER  # of this sensor; the others of the line still count
            elif not self._settings.range[0] <= value <= self._settings.range[1]:
                trouble = OUT_OF_RANGE
            else:
                readings.append(ThermometerReading(end, joint, value))
        if trouble:
            self._reject(trouble, line)
        return readings

    def _celsius(self, written: str | None) -> float | None:
        if written is None or _NUMBER.fullmatch(written) is None:
            return None
        value = float(written.replace(",", "."))  # a point or a comma, and at most one
        if self._settings.unit == "degF":
            return (value - 32.0) / 1.8
        return value - ZERO_CELSIUS if self._settings.unit == "K" else value

    def _reject(self, why: str, line: bytes) -> None:
        self.rejected[why] += 1
        self.last_rejected = line[:SHOWN].decode("ascii", "replace")
