"""Sockets that never block: bounded buffers between a server's loop and its clients."""

from __future__ import annotations

import socket
from typing import Protocol

CHUNK = 65536


class Session(Protocol):
    """The protocol between one client and the server, without the socket."""

    closing: bool

    def greeting(self) -> bytes:
        """What the server says first."""

    def receive(self, chunk: bytes) -> bytes:
        """Take what the client sent, give what to answer.

        Raises:
            ConnectionLostError: the client does not follow this protocol.
        """

    def close(self) -> None:
        """The client is gone."""


class ClientConnection:
    """One client's socket and the bytes that it has not yet read.

    Args:
        sock: connected; made non-blocking here.
        session: what to say to it.
        limit: bytes that may wait for a client that does not read.
    """

    def __init__(self, sock: socket.socket, session: Session, limit: int) -> None:
        sock.setblocking(False)
        self.sock = sock
        self.session = session
        self.open = True
        self.overflowed = False
        self._limit = limit
        self._waiting = bytearray()

    @property
    def has_waiting(self) -> bool:
        """Whether bytes wait for the client to read."""
        return bool(self._waiting)

    def send(self, content: bytes) -> None:
        """Send what the socket takes and keep the rest; too much of it closes the connection."""
        if not self.open or not content:
            return
        self._waiting += content
        self.flush()
        if len(self._waiting) > self._limit:
            self.overflowed = True
            self.close()

    def flush(self) -> None:
        """Send what waits, as far as the socket takes it."""
        while self.open and self._waiting:
            try:
                sent = self.sock.send(self._waiting)
            except BlockingIOError:
                return
            except OSError:
                self.close()
                return
            del self._waiting[:sent]

    def read(self) -> bytes:
        """What the client sent; a client that has hung up is closed."""
        try:
            chunk = self.sock.recv(CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            chunk = b""
        if not chunk:
            self.close()
        return chunk

    def close(self) -> None:
        """Let go of the socket; safe to call twice."""
        if self.open:
            self.open = False
            self._waiting.clear()
            self.sock.close()
            self.session.close()
