"""Sockets that never block: bounded buffers between a server's loop and its clients."""

from __future__ import annotations

import socket
from typing import Protocol

CHUNK_BYTES = 65536


class Session(Protocol):
    """The protocol between one client and the server, without the socket."""

    closing: bool

    def greeting(self) -> bytes:
        """Greeting of the server."""

    def receive(self, chunk: bytes) -> bytes:
        """Process received data and return the answer.

        Raises:
            ConnectionLostError: the client does not follow this protocol.
        """

    def close(self) -> None:
        """The client has disconnected."""


class ClientConnection:
    """One client's socket and the bytes that it has not yet read.

    Args:
        sock: connected; made non-blocking here.
        session: of the client.
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
        """Send as much as the socket accepts and keep the rest; too much of it closes the connection."""
        if not self.open or not content:
            return
        self._waiting += content
        self.flush()
        if len(self._waiting) > self._limit:
            self.overflowed = True
            self.close()

    def flush(self) -> None:
        """Send queued data, as far as the socket accepts them."""
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
        """Received data; a client that has disconnected is closed."""
        try:
            chunk = self.sock.recv(CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            chunk = b""
        if not chunk:
            self.close()
        return chunk

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        if self.open:
            self.open = False
            self._waiting.clear()
            self.sock.close()
            self.session.close()
