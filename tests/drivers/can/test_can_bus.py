from __future__ import annotations

import itertools
import os
import pty
import socket
import time
import tty
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_clock import START, SimulatedClock, simulated_time
from simulated_serial import simulated_line

from drivers.can.bus import EXTENDED, RECEIVE_BUFFER_BYTES, Frame, Sender, close_bus, open_bus
from drivers.can.receiver import NOTICE_PERIOD, POLL, Receiver
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

MINUTE = 60.0
STAMP_ERROR = 1e-6
"""Error of the virtual bus's stamps, which are rounded as clocks of day are [s]."""
_CHANNELS = itertools.count()


def message(identifier: int, data: bytes = b"", **keys: object) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **keys)  # type: ignore[arg-type]


class FedBus(can.BusABC):
    """Hands out what a test gives it: messages, errors to raise, and pauses [s]."""

    channel_info = "fed"

    def __init__(self, clock: Clock, *items: can.Message | Exception | float) -> None:
        self.clock = clock
        self.items = deque(items)
        self.flushed = 0
        super().__init__("fed")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        item = self.items.popleft() if self.items else float(timeout or 0.0)
        if isinstance(item, float):
            self.clock.sleep(item)
            return None
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("Transmit buffer full")

    def flush(self) -> None:
        self.flushed += 1


class SocketcanBus(FedBus):
    """By its name, error frames are read as Linux writes them."""


@contextmanager
def receiving(
    bus: can.BusABC, clock: Clock, *, other: Callable[[int, bytes, float], None] | None = None
) -> Iterator[Receiver]:
    receiver = Receiver(bus, None if other is None else {1}, other, clock)
    receiver.start()
    try:
        yield receiver
    finally:
        receiver.stop()
        close_bus(bus)


def take(receiver: Receiver, count: int) -> list[Frame]:
    return receiver.take(MINUTE, at_least=count)


def lost(receiver: Receiver) -> ConnectionLostError:
    with pytest.raises(ConnectionLostError) as caught:
        receiver.take(MINUTE)
    return caught.value


@pytest.fixture
def ends(clock: SimulatedClock) -> Iterator[tuple[Receiver, Sender]]:
    """A receiver and a sender on one bus."""
    name = f"bus-{next(_CHANNELS)}"
    near, far = (open_bus("virtual", name, 1_000_000, {}) for _ in range(2))
    with receiving(near, clock) as receiver:
        yield receiver, Sender(far, clock)
    close_bus(far)


def test_frames_arrive_in_order_with_their_time(ends: tuple[Receiver, Sender], clock: SimulatedClock) -> None:
    receiver, sender = ends
    times = []
    for index in range(100):
        times.append(sender.send(0x100 + index, bytes([index])))
        clock.sleep(0.001)
    assert times == [pytest.approx(START + 0.001 * index, rel=0, abs=1e-9) for index in range(100)]
    frames = take(receiver, 100)
    assert [frame[1:] for frame in frames] == [(0x100 + index, bytes([index])) for index in range(100)]
    assert [frame[0] for frame in frames] == [pytest.approx(sent, rel=0, abs=STAMP_ERROR) for sent in times]
    assert receiver.latest[0x163][2] == b"\x63"
    assert frames[-1][0] <= receiver.drained <= clock.now()
    silence = clock.now()
    clock.sleep(2 * POLL)
    assert receiver.drained > silence  # a silent bus is a known past, too


def test_frames_that_are_read_late_bear_the_time_of_their_arrival(
    ends: tuple[Receiver, Sender], clock: SimulatedClock
) -> None:
    receiver, sender = ends
    for late, told in ((0.3, 0.0), (1.5, 1.5)):  # a stamp older than a second is not believed
        sent = sender.send(1, b"")
        clock.stall(late)
        ((arrived, _, _),) = take(receiver, 1)
        assert arrived == pytest.approx(sent + told, rel=0, abs=STAMP_ERROR)


def test_take_waits_for_as_many_as_are_wanted(ends: tuple[Receiver, Sender], clock: SimulatedClock) -> None:
    receiver, sender = ends
    sender.send_all([(1, b"a"), (2, b"b")])
    begun = clock.now()
    assert len(receiver.take(0.1, at_least=3)) == 2
    assert clock.now() == pytest.approx(begun + 0.1)
    begun = clock.now()
    for number in range(3):
        clock.call_at(begun + 0.1 * number, lambda: sender.send(1, b"a"))
    assert len(receiver.take(2.0, at_least=3)) == 3
    assert clock.now() == pytest.approx(begun + 0.2)


def test_extended_identifiers_are_told_apart(ends: tuple[Receiver, Sender]) -> None:
    receiver, sender = ends
    sender.send_all([(0x123, b""), (0x123 | EXTENDED, b"")])
    assert [frame[1] for frame in take(receiver, 2)] == [0x123, 0x80000123]


def test_frames_that_are_not_stored_go_elsewhere_and_what_fails_there_is_told(clock: SimulatedClock) -> None:
    others: list[int] = []

    def other(identifier: int, data: bytes, arrived: float) -> None:
        others.append(identifier)
        if not data:
            raise IndexError

    bus = FedBus(clock, message(1, b"x"), message(2, b"x"), message(3), message(1, b"y"))
    with receiving(bus, clock, other=other) as receiver:
        assert [frame[2] for frame in take(receiver, 2)] == [b"x", b"y"]
        assert others == [2, 3]
        assert [notice.message for notice in receiver.notices()] == ["1 frame 0x3 not understood (IndexError)"]


def test_truncated_and_unreadable_frames_are_left_out_and_counted(clock: SimulatedClock) -> None:
    broken: list[can.Message | Exception] = [message(1, b"12", dlc=8) for _ in range(5)]
    foreign = can.CanOperationError("could not unpack received message")
    foreign.__cause__ = ValueError("not msgpack")
    bus = FedBus(clock, *broken, foreign, ValueError("invalid literal"), IndexError(), message(2, b"12"))
    with receiving(bus, clock) as receiver:
        assert [frame[1] for frame in take(receiver, 1)] == [2]
        told = [notice.message for notice in receiver.notices()]
        assert told == ["1 truncated frame dropped", "1 unreadable frame dropped"]  # at most one a second
        clock.sleep(NOTICE_PERIOD - 0.001)
        assert receiver.notices() == []
        clock.sleep(0.002)
        told = [notice.message for notice in receiver.notices()]
        assert told == ["4 truncated frames dropped", "2 unreadable frames dropped"]
        assert bus.flushed == 3


def test_frames_of_can_fd_are_left_out_and_counted(clock: SimulatedClock) -> None:
    flexible = message(1, bytes(12), is_fd=True)
    with receiving(FedBus(clock, message(1, b"a"), flexible, flexible, message(1, b"b")), clock) as receiver:
        assert [data for _, _, data in take(receiver, 2)] == [b"a", b"b"]
        receiver.report_rest()
        said = [notice.message for notice in receiver.notices()]
    assert said == ["1 CAN FD frame dropped", "1 CAN FD frame dropped"]


def test_what_was_not_told_yet_is_told_at_the_end(clock: SimulatedClock) -> None:
    bus = FedBus(clock, *[message(1, b"12", dlc=8) for _ in range(3)], message(2, b"12"))
    with receiving(bus, clock) as receiver:
        take(receiver, 1)
        for told in (["1 truncated frame dropped", "2 truncated frames dropped"], []):
            receiver.report_rest()
            assert [notice.message for notice in receiver.notices()] == told


def test_garbage_without_end_is_a_lost_adapter(clock: SimulatedClock) -> None:
    with receiving(FedBus(clock, *[ValueError("noise") for _ in range(2000)]), clock) as receiver:
        assert "unreadable frames in a row" in lost(receiver).message


def test_a_vanished_adapter_shows_after_what_came_before(clock: SimulatedClock) -> None:
    gone = can.CanOperationError("Could not read from serial device")
    gone.__cause__ = OSError(5, "Input/output error")
    with receiving(FedBus(clock, message(1, b"x"), gone), clock) as receiver:
        clock.sleep(0.05)
        assert len(receiver.take()) == 1
        error = lost(receiver)
        assert error.message == "the CAN adapter is gone: Input/output error"
        assert receiver.failure is error


@pytest.mark.parametrize(
    ("identifier", "data", "words"),
    [
        (0x04, "00 08 00 00 00 00 00 00", "1 error frame: send error warning"),
        (0x04, "00 30 00 00 00 00 00 00", "1 error frame: error passive (receiving), error passive (sending)"),
        (0x20, "00 00 00 00 00 00 00 00", "1 error frame: no acknowledgement"),
        (0x80, "00 00 00 00 00 00 00 00", "1 error frame: bus error"),
        (0x01, "00 00 00 00 00 00 00 00", "1 error frame"),
    ],
)
def test_error_frames_of_linux_in_words(clock: SimulatedClock, identifier: int, data: str, words: str) -> None:
    bus = SocketcanBus(clock, message(identifier, bytes.fromhex(data), is_error_frame=True), message(1, b"x"))
    with receiving(bus, clock) as receiver:
        assert len(take(receiver, 1)) == 1
        assert [notice.message for notice in receiver.notices()] == [words]


def test_bus_off_is_a_lost_connection(clock: SimulatedClock) -> None:
    with receiving(SocketcanBus(clock, message(0x40, bytes(8), is_error_frame=True)), clock) as receiver:
        assert "bus-off" in lost(receiver).message


def test_an_adapter_that_takes_no_frames(clock: SimulatedClock) -> None:
    with pytest.raises(ConnectionLostError, match="does not accept frames: Transmit buffer full"):
        Sender(FedBus(clock), clock).send(0x80, b"")


def multicast(group: str) -> can.BusABC:
    try:
        return open_bus("udp_multicast", group, 1_000_000, {})
    except ConnectionFailedError as error:
        pytest.skip(str(error))


@pytest.mark.realtime
def test_udp_multicast_keeps_what_nobody_reads_yet() -> None:
    group = f"239.74.{163 + os.getpid() % 80}.{1 + os.getpid() // 80 % 250}"
    near, far = multicast(group), multicast(group)
    sender = Sender(far)
    for index in range(200):  # as many as any system's buffer holds
        sender.send(index % 0x7FF, index.to_bytes(4, "little"))
    with receiving(near, SYSTEM_CLOCK) as receiver:
        assert [int.from_bytes(data, "little") for _, _, data in take(receiver, 200)] == list(range(200))
        with socket.socket(fileno=os.dup(near.fileno())) as shared:
            largest = int(Path("/proc/sys/net/core/rmem_max").read_text())
            assert shared.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= min(RECEIVE_BUFFER_BYTES, largest)
    close_bus(far)


@pytest.mark.realtime
def test_udp_multicast_groups_are_separate_buses() -> None:
    groups = [f"239.{75 + number}.{os.getpid() % 256}.{1 + os.getpid() // 256 % 250}" for number in range(2)]
    buses = [multicast(group) for group in (*groups, groups[0])]
    with receiving(buses[0], SYSTEM_CLOCK) as receiver:
        Sender(buses[1]).send(0x222, b"")
        Sender(buses[2]).send_all([(0x111, b""), (0x112, b"")])
        assert [frame[1] for frame in take(receiver, 2)] == [0x111, 0x112]
    for bus in buses[1:]:
        close_bus(bus)


def test_slcan_with_truncated_lines_garbage_and_the_plug_pulled(
    clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    with simulated_line(clock) as line:
        bus = open_bus("slcan", line.path, 1_000_000, {})
        assert sum(slept) == 0.0  # python-can's default is 2 s
        with receiving(bus, clock) as receiver:
            line.write(b"t1812ABCD\r")
            assert take(receiver, 1)[0][1:] == (0x181, b"\xab\xcd")
            line.write(b"t1812AB\rtxyz\r\xff\xfe\xfd\r")
            clock.sleep(0.1)
            line.write(b"t18311A\r")
            assert take(receiver, 1)[0][1:] == (0x183, b"\x1a")
            told = {notice.message.split(" ", 1)[1] for notice in receiver.notices()}
            assert told == {"truncated frame dropped", "unreadable frame dropped"}
            line.pull_out()
            error = lost(receiver)
            assert "the CAN adapter is gone" in error.message
            assert error.where == f"slcan {line.path}"


@pytest.mark.realtime
def test_slcan_on_a_pseudo_terminal_until_the_plug_is_pulled() -> None:
    far, near = pty.openpty()
    tty.setraw(near)
    with receiving(open_bus("slcan", os.ttyname(near), 1_000_000, {}), SYSTEM_CLOCK) as receiver:
        os.write(far, b"t1812ABCD\rt18311A\r")
        assert [frame[1:] for frame in take(receiver, 2)] == [(0x181, b"\xab\xcd"), (0x183, b"\x1a")]
        os.close(near)
        os.close(far)
        assert "the CAN adapter is gone" in lost(receiver).message


@settings(max_examples=50)
@given(st.lists(st.binary(max_size=20), max_size=10))
def test_whatever_a_serial_line_says_the_next_good_frame_is_read(noise: list[bytes]) -> None:
    with (
        simulated_time() as clock,
        simulated_line(clock) as line,
        receiving(open_bus("slcan", line.path, 1_000_000, {}), clock) as receiver,
    ):
        for piece in noise:
            line.write(piece)
            clock.sleep(0.001)
        line.write(b"\r")
        clock.sleep(2 * POLL)
        line.write(b"t7001AA\r")
        clock.sleep(2 * POLL)
        assert receiver.take()[-1][1:] == (0x700, b"\xaa")
        assert receiver.failure is None


@each(
    ("interface", "name", "options", "words"),
    [
        ("socketkan", "can0", {}, "no interface 'socketkan'"),
        ("slcan", "/dev/no-such-adapter", {}, "there is no channel '/dev/no-such-adapter'"),
        ("udp_multicast", "239.74.163.2", {"hop_limit": "far"}, "cannot be opened"),
        ("udp_multicast", "10.0.0.1", {}, "cannot be opened"),
        ("slcan", "/dev/null", {"speed": 3, "tty_baudrate": "fast"}, "cannot be opened|does not take|does not accept"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_why(
    interface: str, name: str, options: dict[str, object], words: str
) -> None:
    with pytest.raises(ConnectionFailedError, match=words) as caught:
        open_bus(interface, name, 1_000_000, options)
    assert caught.value.where == f"{interface} {name}"
    assert caught.value.hint
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(os.getuid() == 0, reason="root may open everything")
def test_no_permission(tmp_path: object) -> None:
    path = f"{tmp_path}/tty"
    os.mkfifo(path, 0)
    with pytest.raises(ConnectionFailedError, match="no permission"):
        open_bus("slcan", path, 1_000_000, {})
