from __future__ import annotations

import os
import pty
import time
import tty
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_drives import channel

from drivers.can_bus import EXTENDED, Frame, Receiver, Sender, close_bus, open_bus
from drivers.errors import ConnectionFailedError, ConnectionLostError


def message(identifier: int, data: bytes = b"", **keys: object) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **keys)  # type: ignore[arg-type]


class FedBus(can.BusABC):
    """Hands out what a test gives it: messages, or errors to raise."""

    channel_info = "fed"

    def __init__(self, *items: can.Message | Exception) -> None:
        self.items = deque(items)
        self.flushed = 0
        super().__init__("fed")

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self.items:
            time.sleep(0.001)
            return None
        item = self.items.popleft()
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
    bus: can.BusABC, *, close: bool = True, other: Callable[[int, bytes, float], None] | None = None
) -> Iterator[Receiver]:
    receiver = Receiver(bus, None if other is None else {1}, other)
    receiver.start()
    try:
        yield receiver
    finally:
        receiver.stop()
        if close:
            close_bus(bus)


def take(receiver: Receiver, count: int) -> list[Frame]:
    frames: list[Frame] = []
    end = time.monotonic() + 3.0
    while len(frames) < count and time.monotonic() < end:
        frames += receiver.take(0.1)
    return frames


def lost(receiver: Receiver) -> ConnectionLostError:
    for _ in range(50):
        try:
            receiver.take(0.1)
        except ConnectionLostError as error:
            return error
    raise AssertionError("nothing was lost")


def test_frames_arrive_in_order_with_their_time() -> None:
    name = channel()
    near, far = (open_bus("virtual", name, 1_000_000, {}) for _ in range(2))
    with receiving(near) as receiver:
        sender = Sender(far)
        times = [sender.send(0x100 + index, bytes([index])) for index in range(100)]
        frames = take(receiver, 100)
        assert [(identifier, data) for _, identifier, data in frames] == [(0x100 + i, bytes([i])) for i in range(100)]
        for sent, (arrived, _, _) in zip(times, frames, strict=True):
            assert -1e-4 < arrived - sent < 0.5
        assert receiver.latest[0x163][2] == b"\x63"
        assert frames[-1][0] <= receiver.drained <= time.monotonic()
        silence = time.monotonic()
        time.sleep(0.1)
        assert receiver.drained > silence  # a silent bus is a known past, too
    close_bus(far)


def test_take_waits_for_as_many_as_are_wanted() -> None:
    name = channel()
    near, far = (open_bus("virtual", name, 1_000_000, {}) for _ in range(2))
    with receiving(near) as receiver:
        sender = Sender(far)
        sender.send_all([(1, b"a"), (2, b"b")])
        begun = time.monotonic()
        assert len(receiver.take(0.1, at_least=3)) == 2
        assert time.monotonic() - begun >= 0.1
        sender.send_all([(1, b"a"), (2, b"b"), (3, b"c")])
        assert len(receiver.take(2.0, at_least=3)) == 3
    close_bus(far)


def test_extended_identifiers_are_told_apart() -> None:
    name = channel()
    near, far = (open_bus("virtual", name, 1_000_000, {}) for _ in range(2))
    with receiving(near) as receiver:
        Sender(far).send_all([(0x123, b""), (0x123 | EXTENDED, b"")])
        assert [frame[1] for frame in take(receiver, 2)] == [0x123, 0x80000123]
    close_bus(far)


def test_frames_that_are_not_stored_go_elsewhere_and_what_fails_there_is_told() -> None:
    others: list[int] = []

    def other(identifier: int, data: bytes, arrived: float) -> None:
        others.append(identifier)
        if not data:
            raise IndexError

    bus = FedBus(message(1, b"x"), message(2, b"x"), message(3), message(1, b"y"))
    with receiving(bus, other=other) as receiver:
        assert [frame[2] for frame in take(receiver, 2)] == [b"x", b"y"]
        assert others == [2, 3]
        assert [notice.message for notice in receiver.notices()] == ["1 frame(s) 0x3 not understood (IndexError)"]


def test_truncated_and_unreadable_frames_are_left_out_and_counted() -> None:
    broken: list[can.Message | Exception] = [message(1, b"12", dlc=8) for _ in range(5)]
    foreign = can.CanOperationError("could not unpack received message")
    foreign.__cause__ = ValueError("not msgpack")
    bus = FedBus(*broken, foreign, ValueError("invalid literal"), IndexError(), message(2, b"12"))
    with receiving(bus) as receiver:
        assert [frame[1] for frame in take(receiver, 1)] == [2]
        told = [notice.message for notice in receiver.notices()]
        assert told == ["1 truncated frame(s) left out", "1 unreadable frame(s) left out"]  # at most one a second
        receiver.tell_rest()
        told = [notice.message for notice in receiver.notices()]
        assert told == ["4 truncated frame(s) left out", "2 unreadable frame(s) left out"]
        receiver.tell_rest()
        assert receiver.notices() == []
        assert bus.flushed == 3


def test_garbage_without_end_is_a_lost_adapter() -> None:
    with receiving(FedBus(*[ValueError("noise") for _ in range(2000)])) as receiver:
        assert "unreadable frames in a row" in lost(receiver).message


def test_a_vanished_adapter_shows_after_what_came_before() -> None:
    gone = can.CanOperationError("Could not read from serial device")
    gone.__cause__ = OSError(5, "Input/output error")
    with receiving(FedBus(message(1, b"x"), gone)) as receiver:
        time.sleep(0.05)
        assert len(receiver.take()) == 1
        error = lost(receiver)
        assert error.message == "the CAN adapter is gone: Input/output error"
        assert receiver.failure is error


@pytest.mark.parametrize(
    ("identifier", "data", "words"),
    [
        (0x04, "00 08 00 00 00 00 00 00", "1 error frame(s): send error warning"),
        (0x04, "00 30 00 00 00 00 00 00", "1 error frame(s): error passive (receiving), error passive (sending)"),
        (0x20, "00 00 00 00 00 00 00 00", "1 error frame(s): nobody acknowledges"),
        (0x80, "00 00 00 00 00 00 00 00", "1 error frame(s): bus error"),
        (0x01, "00 00 00 00 00 00 00 00", "1 error frame(s)"),
    ],
)
def test_error_frames_of_linux_in_words(identifier: int, data: str, words: str) -> None:
    bus = SocketcanBus(message(identifier, bytes.fromhex(data), is_error_frame=True), message(1, b"x"))
    with receiving(bus) as receiver:
        assert len(take(receiver, 1)) == 1
        assert [notice.message for notice in receiver.notices()] == [words]


def test_bus_off_is_a_lost_connection() -> None:
    with receiving(SocketcanBus(message(0x40, bytes(8), is_error_frame=True))) as receiver:
        assert "bus-off" in lost(receiver).message


def test_an_adapter_that_takes_no_frames() -> None:
    with pytest.raises(ConnectionLostError, match="does not take frames: Transmit buffer full"):
        Sender(FedBus()).send(0x80, b"")


def test_udp_multicast_between_two_buses() -> None:
    group = f"239.74.{163 + os.getpid() % 80}.{1 + os.getpid() // 80 % 250}"
    try:
        near, far = (open_bus("udp_multicast", group, 1_000_000, {}) for _ in range(2))
    except ConnectionFailedError as error:
        pytest.skip(str(error))
    with receiving(near) as receiver:
        sender = Sender(far)
        for index in range(2000):  # faster than anybody reads: it is the kernel that keeps them
            sender.send(index % 0x7FF, index.to_bytes(4, "little"))
        frames = take(receiver, 2000)
        assert [int.from_bytes(data, "little") for _, _, data in frames] == list(range(2000))
        assert [arrived for arrived, _, _ in frames] == sorted(arrived for arrived, _, _ in frames)
    close_bus(far)


def test_udp_multicast_groups_are_separate_buses() -> None:
    groups = [f"239.{75 + number}.{os.getpid() % 256}.{1 + os.getpid() // 256 % 250}" for number in range(2)]
    try:
        buses = [open_bus("udp_multicast", group, 1_000_000, {}) for group in (*groups, groups[0])]
    except ConnectionFailedError as error:
        pytest.skip(str(error))
    with receiving(buses[0]) as receiver:
        Sender(buses[1]).send(0x222, b"")
        Sender(buses[2]).send(0x111, b"")
        time.sleep(0.1)
        assert [frame[1] for frame in take(receiver, 1)] == [0x111]
    for bus in buses[1:]:
        close_bus(bus)


class Serial:
    """The far end of a serial line."""

    def __init__(self) -> None:
        self.far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.path = os.ttyname(self._near)

    def write(self, data: bytes) -> None:
        os.write(self.far, data)

    def unplug(self) -> None:
        os.close(self._near)
        os.close(self.far)


def test_slcan_with_truncated_lines_garbage_and_the_plug_pulled() -> None:
    line = Serial()
    begun = time.monotonic()
    bus = open_bus("slcan", line.path, 1_000_000, {})
    assert time.monotonic() - begun < 1.0
    with receiving(bus) as receiver:
        line.write(b"t1812ABCD\r")
        assert take(receiver, 1)[0][1:] == (0x181, b"\xab\xcd")
        line.write(b"t1812AB\rtxyz\r\xff\xfe\xfd\r")
        time.sleep(0.1)
        line.write(b"t18311A\r")
        assert take(receiver, 1)[0][1:] == (0x183, b"\x1a")
        told = {notice.message.split(" ", 1)[1] for notice in receiver.notices()}
        assert told == {"truncated frame(s) left out", "unreadable frame(s) left out"}
        line.unplug()
        error = lost(receiver)
        assert "the CAN adapter is gone" in error.message
        assert error.where == f"slcan {line.path}"


@settings(max_examples=20, deadline=None)
@given(st.lists(st.binary(max_size=20), max_size=10))
def test_whatever_a_serial_line_says_the_next_good_frame_is_read(noise: list[bytes]) -> None:
    line = Serial()
    with receiving(open_bus("slcan", line.path, 1_000_000, {})) as receiver:
        for piece in noise:
            line.write(piece)
        found = False
        for _ in range(100):
            line.write(b"\rt7001AA\r")
            found = any(frame[1:] == (0x700, b"\xaa") for frame in receiver.take(0.05))
            if found:
                break
        assert found
        assert receiver.failure is None
    line.unplug()


@pytest.mark.parametrize(
    ("interface", "name", "options", "words"),
    [
        ("socketkan", "can0", {}, "no interface 'socketkan'"),
        ("slcan", "/dev/no-such-adapter", {}, "there is no channel '/dev/no-such-adapter'"),
        ("udp_multicast", "239.74.163.2", {"hop_limit": "far"}, "cannot be opened"),
        ("udp_multicast", "10.0.0.1", {}, "cannot be opened"),
        ("slcan", "/dev/null", {"speed": 3, "tty_baudrate": "fast"}, "cannot be opened|does not take"),
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
