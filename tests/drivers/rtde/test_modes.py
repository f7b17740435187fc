"""The dashboard ends a program, or says nothing; it never raises and never hangs."""

from __future__ import annotations

import socket
from collections.abc import Sequence

import pytest
from exact_plant import ExactPlant
from rtde_in_process import HOST, NOWHERE, serving
from simulated_clock import START, SimulatedClock

from drivers.rtde.modes import PORT, serial_number, stop_program
from sim_drivers.rtde.control_script import ControlScript
from sim_drivers.rtde.dashboard import SERIAL_NUMBER
from sim_drivers.rtde.server import RtdeServer

GREETING = b"Connected: Universal Robots Dashboard Server\n"


class Answering:
    """Says these things in turn, a second apart, whatever it hears."""

    def __init__(self, clock: SimulatedClock, answers: Sequence[bytes]) -> None:
        self._clock = clock
        self._answers = answers
        self._far_end: socket.socket | None = None

    def connect(self, host: str, port: int, timeout: float) -> socket.socket:
        assert (host, port, timeout) == (HOST, PORT, 30.0)
        ours, self._far_end = socket.socketpair()
        for number, answer in enumerate(self._answers, 1):
            self._clock.call_at(self._clock.now() + number, lambda answer=answer: self._say(answer))
        return ours

    def close(self) -> None:
        if self._far_end is not None:
            self._far_end.close()

    def _say(self, answer: bytes) -> None:
        assert self._far_end is not None
        if not answer:
            self._far_end.close()
        elif self._far_end.fileno() >= 0:
            self._far_end.sendall(answer)


def test_it_ends_a_program(clock: SimulatedClock) -> None:
    server = RtdeServer(ExactPlant(), ports=NOWHERE, clock=clock)
    with serving(server) as network:
        server.controller.start_program(ControlScript(0))
        clock.sleep(0.1)
        assert stop_program(HOST, 2.0, network.connect, clock)
        assert server.controller.script is None
        assert network.asked == [PORT]
        assert clock.now() <= START + 0.1 + 2 * 0.002


def test_it_tells_the_serial_number_or_nothing(clock: SimulatedClock) -> None:
    server = RtdeServer(ExactPlant(), ports=NOWHERE, clock=clock)
    with serving(server) as network:
        assert serial_number(HOST, 2.0, network.connect, clock) == SERIAL_NUMBER
    for answer, told in ((b"20195500123\r\n", "20195500123"), (b"could not understand: get\n", ""), (b"\xff\n", "")):
        other = Answering(clock, (GREETING, answer))
        assert serial_number(HOST, 30.0, other.connect, clock) == told
        other.close()


@pytest.mark.parametrize(
    ("answers", "seconds"),
    [
        ((GREETING, b"Failed to execute: stop\n"), 2.0),
        ((GREETING,), 30.0),
        ((GREETING, b"Stop", b"ping"), 30.0),
        ((b"no line", b""), 2.0),
        ((b"x" * 5000,), 1.0),
        ((), 30.0),
    ],
)
def test_any_other_answer_is_none_within_the_time_limit(
    clock: SimulatedClock, answers: tuple[bytes, ...], seconds: float
) -> None:
    other = Answering(clock, answers)
    assert not stop_program(HOST, 30.0, other.connect, clock)
    assert clock.now() == pytest.approx(START + seconds, abs=1e-9)
    clock.sleep(5.0)
    other.close()


def test_nobody_there_is_no_error() -> None:
    assert not stop_program("bad\0host", 0.3)

    def refuse(host: str, port: int, timeout: float) -> socket.socket:
        raise ConnectionRefusedError(111, "Connection refused")

    assert not stop_program(HOST, 0.3, refuse)
