"""A serial port without hardware: a pseudo-terminal at a path that stays the same while it is pulled out."""

from __future__ import annotations

import contextlib
import os
import select
import tempfile
import tty
from pathlib import Path
from typing import Self

from drivers.core.errors import UsageError


class PseudoTerminal:
    """A device's end of a pseudo-terminal that any program on this computer can open; one method at a time.

    It is in a temporary folder where no path is given.

    Attributes:
        path: of the port.

    Raises:
        UsageError: something else is at `path`.
    """

    def __init__(self, path: str | None = None) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if path is None:
            self._folder = tempfile.TemporaryDirectory(prefix="dynid-serial-")
            path = str(Path(self._folder.name) / "port")
        elif os.path.exists(path):
            raise UsageError("the path exists already", where=path, hint="choose another path, or remove it")
        self.path = path
        self._master: int | None = None

    @classmethod
    def at(cls, url: str) -> Self:
        """One where a connection's `url` says, if that is the path of no device; else in a temporary folder."""
        return cls(url if os.path.isabs(url) and not url.startswith("/dev/") else None)

    def plug_in(self) -> None:
        """Create the port; nothing where it exists."""
        if self._master is not None:
            return
        master, slave = os.openpty()
        # Bytes as they are: no echo, no line editing, on either side.
        tty.setraw(master)
        tty.setraw(slave)
        if os.path.islink(self.path):
            os.unlink(self.path)  # left by a process that was killed
        os.symlink(os.ttyname(slave), self.path)
        os.close(slave)
        os.set_blocking(master, False)
        self._master = master

    def pull_out(self) -> None:
        """Remove the port; nothing where there is none."""
        master, self._master = self._master, None
        if master is not None:
            os.close(master)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.path)

    def fileno(self) -> int:
        """The descriptor of the device's end.

        Raises:
            OSError: it is pulled out.
        """
        if self._master is None:
            raise OSError("the port is disconnected")
        return self._master

    def write(self, data: bytes) -> int:
        """Send without waiting; the number of bytes that went out: none where no client has the port open."""
        if self._master is None:
            return 0
        poll = select.poll()
        poll.register(self._master, select.POLLHUP)
        if any(event & select.POLLHUP for _, event in poll.poll(0)):  # no client has the port open
            return 0
        with contextlib.suppress(OSError):
            os.read(self._master, 4096)  # discard what the client sends
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def remove(self) -> None:
        """Leave nothing behind."""
        if self._folder is not None:
            self._folder.cleanup()
