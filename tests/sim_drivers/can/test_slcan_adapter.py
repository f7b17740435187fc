"""A simulated slcan adapter: its protocol over a bare port, and python-can's own client on the other side."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest
from drive_bench import bus_settings, six_joints
from each import each
from exact_plant import ExactPlant
from hypothesis import given
from hypothesis import strategies as st
from simulated_clock import SimulatedClock
from simulated_serial import SimulatedLine, simulated_line

from drivers.core.clock import SYSTEM_CLOCK
from sim_drivers.can.slcan_adapter import BACKLOG_LIMIT, SlcanAdapter, format_frame, parse_frame
from sim_drivers.canopen.server import CanopenServer

_channels = itertools.count()
MINUTE = 60.0


@pytest.fixture
def line(clock: SimulatedClock) -> Iterator[SimulatedLine]:
    with simulated_line(clock) as made:
        yield made


PluggedIn = Callable[..., tuple[SlcanAdapter, can.BusABC]]


@pytest.fixture
def plugged_in(clock: SimulatedClock, line: SimulatedLine) -> Iterator[PluggedIn]:
    """Plugs an adapter into the line; gives it, and somebody else on the bus behind it."""
    with contextlib.ExitStack() as stack:

        def make(bitrate: int = 1_000_000) -> tuple[SlcanAdapter, can.BusABC]:
            channel = f"slcan-{next(_channels)}"
            other = stack.enter_context(can.Bus(interface="virtual", channel=channel))
            bus = can.Bus(interface="virtual", channel=channel)
            return stack.enter_context(SlcanAdapter(bus, bitrate, line, clock)), other

        yield make


def client_of(adapter: SlcanAdapter, seconds: float = 2.0) -> Any:
    """python-can's client, once the adapter has obeyed it: commands are not waited for."""
    client: Any = can.Bus(interface="slcan", channel=adapter.path, sleep_after_open=0, bitrate=1_000_000)
    assert client.get_version(seconds) == (10, 13)
    return client


def talk(line: SimulatedLine, command: bytes) -> bytes:
    line.near.sendall(command + b"\r")
    return line.read_until(b"\r\a")


def messages() -> st.SearchStrategy[can.Message]:
    return st.builds(
        lambda extended, identifier, data, remote: can.Message(
            arbitration_id=identifier % (1 << 29 if extended else 1 << 11),
            is_extended_id=extended,
            is_remote_frame=remote,
            dlc=len(data),
            data=b"" if remote else data,
        ),
        st.booleans(),
        st.integers(0, (1 << 29) - 1),
        st.binary(max_size=8),
        st.booleans(),
    )


@given(messages())
def test_frames_are_read_as_they_are_written(message: can.Message) -> None:
    found = parse_frame(format_frame(message)[:-1])
    assert found is not None
    assert found.equals(message, timestamp_delta=None, check_direction=False)


@each("text", [b"", b"t", b"t1812AB", b"t18199", b"t1810AB", b"tGGG0", b"t8000", b"T200000000", b"x1230"])
def test_what_is_no_frame_is_refused(text: bytes) -> None:
    assert parse_frame(text) is None


def test_the_protocol_of_a_bare_port(plugged_in: PluggedIn, line: SimulatedLine) -> None:
    _, other = plugged_in()
    for command, answer in (
        (b"", b"\r"),
        (b"V", b"V1013\r"),
        (b"N", b"NA402\r"),
        (b"C", b"\a"),
        (b"t1230", b"\a"),
        (b"S9", b"\a"),
        (b"S8", b"\r"),
        (b"O", b"\r"),
        (b"O", b"\a"),
        (b"S8", b"\a"),
        (b"t1232AABB", b"z\r"),
        (b"T000001230", b"Z\r"),
        (b"t1232AA", b"\a"),
        (b"F", b"F00\r"),
        (b"q" * 2000, b"\a"),
        (b"C", b"\r"),
        (b"L", b"\r"),
        (b"t1230", b"\a"),
    ):
        assert talk(line, command) == answer, command
    first, second = other.recv(0.0), other.recv(0.0)
    assert first is not None
    assert (first.arbitration_id, bytes(first.data)) == (0x123, b"\xaa\xbb")
    assert second is not None
    assert second.is_extended_id
    assert other.recv(0.0) is None


def test_time_stamps_are_appended_on_request(plugged_in: PluggedIn, line: SimulatedLine, clock: SimulatedClock) -> None:
    _, other = plugged_in()
    assert talk(line, b"Z1") == b"\r"
    assert talk(line, b"O") == b"\r"
    clock.sleep(60.0 - clock.now() % 60.0 - 0.5)
    for stamp in (59_500, 0, 500):  # they count a minute
        other.send(can.Message(arbitration_id=0x7, is_extended_id=False, data=b"\x01"))
        assert line.read_until(b"\r") == b"t007101%04X\r" % stamp
        clock.sleep(0.5)


def test_an_adapter_at_another_bit_rate_gets_nothing_across(plugged_in: PluggedIn, line: SimulatedLine) -> None:
    _, other = plugged_in()
    assert talk(line, b"S6") == b"\r"
    assert talk(line, b"O") == b"\r"
    assert talk(line, b"t1230") == b"\a"
    other.send(can.Message(arbitration_id=0x7, is_extended_id=False))
    assert line.read_until(b"\r") == b""
    assert other.recv(0.1) is None
    assert talk(line, b"F") == b"F80\r"


def test_an_error_on_the_bus_is_a_flag(plugged_in: PluggedIn, line: SimulatedLine, clock: SimulatedClock) -> None:
    _, other = plugged_in()
    assert talk(line, b"O") == b"\r"
    other.send(can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8)))
    clock.sleep(0.001)
    assert talk(line, b"F") == b"F80\r"
    assert talk(line, b"F") == b"F00\r"


def exchange(client: Any, other: can.BusABC, count: int, seconds: float) -> None:
    """Frames to the client, and each of them back."""
    sent = [
        can.Message(arbitration_id=k % 0x7FF, is_extended_id=False, data=k.to_bytes(4, "big")) for k in range(count)
    ]
    for message in sent:
        other.send(message)
    for message in sent:
        received = client.recv(seconds)
        assert received is not None
        assert bytes(received.data) == bytes(message.data)
        client.send(received)
        back = other.recv(seconds)
        assert back is not None
        assert back.arbitration_id == message.arbitration_id


def test_python_cans_client_loses_nothing_and_meets_truncated_lines(plugged_in: PluggedIn) -> None:
    adapter, other = plugged_in()
    client = client_of(adapter)
    exchange(client, other, 100, 1.0)
    assert adapter.lost == 0
    adapter.truncate(1)
    for _ in range(2):
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
    truncated, whole = client.recv(1.0), client.recv(1.0)
    assert (truncated.dlc, len(truncated.data)) == (8, 7)  # it says more bytes than it has
    assert (whole.dlc, len(whole.data)) == (8, 8)
    client.shutdown()


def test_a_host_that_does_not_read_loses_frames_and_is_told(
    plugged_in: PluggedIn, line: SimulatedLine, clock: SimulatedClock
) -> None:
    adapter, other = plugged_in()
    assert talk(line, b"O") == b"\r"
    sent = 2 * BACKLOG_LIMIT // len("t001800112233445566FF\r")
    for number in range(sent):
        other.send(can.Message(arbitration_id=1, is_extended_id=False, data=number.to_bytes(8, "big")))
        clock.sleep(1e-4)
    assert adapter.lost > 0
    said = b""
    while (chunk := line.read_until(b"\r", 0.1)) != b"":
        said += chunk
    frames = [parse_frame(text) for text in said.split(b"\r")[:-1]]
    numbers = [int.from_bytes(frame.data, "big") for frame in frames if frame is not None]
    assert numbers == list(range(sent - adapter.lost))  # those before it was full
    assert talk(line, b"F") == b"F08\r"


def send_until(moment: float, client: Any, message: can.Message) -> None:
    while SYSTEM_CLOCK.now() < moment:
        client.send(message)


@pytest.mark.realtime
def test_drives_behind_an_adapter_on_a_pseudo_terminal_until_it_is_pulled_out() -> None:
    channel = f"slcan-{next(_channels)}"
    adapter = SlcanAdapter(can.Bus(interface="virtual", channel=channel))
    server = CanopenServer(ExactPlant(), six_joints(), bus_settings(channel=channel), adapter=adapter)
    with server:
        assert server.ready()["channel"] == adapter.path
        client = client_of(adapter, MINUTE)
        ask = can.Message(arbitration_id=0x601, is_extended_id=False, data=b"\x40\x18\x10\x04" + bytes(4))
        limit, answer = SYSTEM_CLOCK.now() + MINUTE, None
        while answer is None or answer.arbitration_id != 0x581:  # a drive that boots does not answer yet
            assert SYSTEM_CLOCK.now() < limit
            client.send(ask)
            answer = client.recv(0.2)
        assert answer.data[4] == 1
        server.obey("garbage 5")
        server.obey("unplug")
        with pytest.raises(can.CanOperationError):
            send_until(limit, client, ask)
        with contextlib.suppress(can.CanError):
            client.shutdown()
    assert server.failure is None
