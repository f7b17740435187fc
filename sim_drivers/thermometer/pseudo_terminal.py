"""A serial port without hardware: a pseudo-terminal at a path that stays the same while it is pulled out."""

from __future__ import annotations

import contextlib
import os
import select
import tempfile
import tty
from pathlib import Path

from drivers.errors import UsageError


class PseudoTerminal:
    """The device's end of a pseudo-terminal; implements `sim_drivers.thermometer.server.Plug`.

    Args:
        path: where the port appears; a folder of its own where None.

    Attributes:
        path: of the port.

    Raises:
        UsageError: something else is at `path`.
    """

    def __init__(self, path: str | None = None) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if path is None:
            self._folder = tempfile.TemporaryDirectory(prefix="dynid-thermometer-")
            path = str(Path(self._folder.name) / "port")
        elif os.path.exists(path):
            raise UsageError("there is something already", where=path, hint="choose another path, or remove it")
        self.path = path
        self._master: int | None = None

    def plug_in(self) -> None:
        """Let the port be there; nothing where it is."""
        if self._master is not None:
            return
        master, slave = os.openpty()
        tty.setraw(slave)
        if os.path.islink(self.path):
            os.unlink(self.path)  # left by one that was killed
        os.symlink(os.ttyname(slave), self.path)
        os.close(slave)
        os.set_blocking(master, False)
        self._master = master

    def pull_out(self) -> None:
        """Take the port away; nothing where there is none."""
        master, self._master = self._master, None
        if master is not None:
            os.close(master)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self.path)

    def write(self, data: bytes) -> int:
        """Send without waiting; how many characters somebody took: none where nobody has the port open."""
        if self._master is None:
            return 0
        poll = select.poll()
        poll.register(self._master, select.POLLHUP)
        if any(event & select.POLLHUP for _, event in poll.poll(0)):  # nobody has the port open
            return 0
        with contextlib.suppress(OSError):
            os.read(self._master, 4096)  # whatever is said to it
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def remove(self) -> None:
        """Leave nothing behind."""
        if self._folder is not None:
            self._folder.cleanup()
