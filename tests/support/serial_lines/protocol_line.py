"""pyserial's URLs `line://name`."""

from __future__ import annotations

import serial

from serial_lines import LINES


class Serial(serial.SerialBase):
    """The reader's port of a line."""

    def open(self) -> None:
        if self.port not in LINES:
            raise FileNotFoundError(2, "No such file or directory", self.port)
        self._line = LINES[self.port]
        self._plug = self._line.open()
        self.is_open = True

    def read(self, size: int = 1) -> bytes:
        return self._line.read(self._plug, size, self.timeout)

    def close(self) -> None:
        if self.is_open:
            self._line.close(self._plug)
            self.is_open = False

    def _reconfigure_port(self) -> None:
        """Nothing to set."""
