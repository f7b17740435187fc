"""The dashboard ends a program, or says nothing; it never raises and never hangs."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from drivers.rtde.dashboard import stop_program

GREETING = b"Connected: Universal Robots Dashboard Server\n"


@contextmanager
def answering(*answers: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """A server that says these things in turn, each after a line from the client but the first; its port."""
    heard: list[bytes] = []

    def serve(listener: socket.socket) -> None:
        with listener.accept()[0] as client:
            client.settimeout(5.0)
            for number, answer in enumerate(answers):
                if number:
                    heard.append(client.recv(100))
                client.sendall(answer)
            with suppress(OSError):
                client.recv(1)  # until the other end leaves

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve, args=(listener,), daemon=True)
        thread.start()
        yield listener.getsockname()[1], heard
        thread.join(5.0)


def test_it_ends_a_program() -> None:
    with answering(GREETING, b"Stopped\n") as (port, heard):
        assert stop_program("127.0.0.1", 2.0, port)
    assert heard == [b"stop\n"]


@pytest.mark.parametrize(
    "answers", [(GREETING, b"Failed to execute: stop\n"), (GREETING,), (b"",), (b"no line",), (b"x" * 5000,)]
)
def test_any_other_answer_is_none(answers: tuple[bytes, ...]) -> None:
    begun = time.monotonic()
    with answering(*answers) as (port, _):
        assert not stop_program("127.0.0.1", 0.3, port)
    assert time.monotonic() - begun < 2.0


def test_nobody_there_is_no_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert not stop_program("127.0.0.1", 0.3, port)
    assert not stop_program("not a name", 0.3)
