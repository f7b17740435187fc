"""Opening serial ports, and why one failed, in words."""

from __future__ import annotations

import os

import serial

from drivers.core.errors import ConnectionFailedError, UsageError

BITS_A_BYTE = 10
"""Start bit, eight data bits, stop bit."""


def open_port(url: str, baudrate: int, timeout: float, write_timeout: float | None = None) -> serial.SerialBase:
    """Open a port for this program alone: two readers of one device would each get a part of the bytes.

    Its baud rate is in bit/s; a reading waits for `timeout` [s], a writing for `write_timeout` [s], without end where
    None.

    Raises:
        ConnectionFailedError: no such device, no permission, or it is in use.
        UsageError: not a URL, or a baud rate that the port does not have.
    """
    try:
        port: serial.SerialBase = serial.serial_for_url(
            url, baudrate=baudrate, timeout=timeout, write_timeout=write_timeout, exclusive=True
        )
    except ValueError as error:
        raise UsageError(str(error), where=url, hint="a device, or a URL that pyserial knows") from error
    except Exception as error:  # pyserial lets through whatever the system or a protocol's module raises
        raise ConnectionFailedError(
            f"cannot be opened: {reason(error)}",
            where=url,
            hint="is it plugged in, and are you in the group that owns it (dialout)?",
        ) from error
    return port


def reason(error: Exception) -> str:
    """Return why a port failed, in words."""
    text = str(error) or type(error).__name__
    if "exclusively lock" in text:
        return "another program has opened it"
    if isinstance(error, OSError) and error.errno:  # pyserial's own text repeats the port
        return os.strerror(error.errno)
    return text.partition(" (device disconnected")[0]
