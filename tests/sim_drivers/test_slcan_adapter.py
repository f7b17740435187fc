"""A simulated slcan adapter: its protocol over a bare port, and python-can's own client on the other side."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can
import pytest
import serial
from drive_bench import bus_settings, six_joints
from exact_plant import ExactPlant
from hypothesis import given
from hypothesis import strategies as st

from sim_drivers.canopen_nodes import CanopenServer
from sim_drivers.slcan_adapter import SlcanAdapter, format_frame, parse_frame

_channels = itertools.count()


@contextmanager
def plugged_in(bitrate: int = 1_000_000) -> Iterator[tuple[SlcanAdapter, can.BusABC]]:
    channel = f"slcan-{next(_channels)}"
    with (
        can.Bus(interface="virtual", channel=channel) as other,
        SlcanAdapter(can.Bus(interface="virtual", channel=channel), bitrate) as adapter,
    ):
        yield adapter, other


def client_of(adapter: SlcanAdapter) -> Any:
    """python-can's client, once the adapter has obeyed it: commands are not waited for."""
    client: Any = can.Bus(interface="slcan", channel=adapter.path, sleep_after_open=0, bitrate=1_000_000)
    assert client.get_version(2.0) == (10, 13)
    return client


def talk(port: serial.Serial, command: bytes) -> bytes:
    port.write(command + b"\r")
    answer = b""
    while not answer.endswith((b"\r", b"\a")):
        byte = port.read(1)
        assert byte, (command, answer)
        answer += byte
    return answer


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


@pytest.mark.parametrize(
    "text", [b"", b"t", b"t1812AB", b"t18199", b"t1810AB", b"tGGG0", b"t8000", b"T200000000", b"x1230"]
)
def test_what_is_no_frame_is_refused(text: bytes) -> None:
    assert parse_frame(text) is None


def test_the_protocol_of_a_bare_port() -> None:
    with plugged_in() as (adapter, other), serial.Serial(adapter.path, timeout=2) as port:
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
            (b"q" * 5000, b"\a"),
            (b"C", b"\r"),
            (b"L", b"\r"),
            (b"t1230", b"\a"),
        ):
            assert talk(port, command) == answer, command
        first = other.recv(1.0)
        assert first is not None
        assert (first.arbitration_id, bytes(first.data)) == (0x123, b"\xaa\xbb")
        second = other.recv(1.0)
        assert second is not None
        assert second.is_extended_id


def test_time_stamps_are_appended_on_request() -> None:
    with plugged_in() as (adapter, other), serial.Serial(adapter.path, timeout=2) as port:
        assert talk(port, b"Z1") == b"\r"
        assert talk(port, b"O") == b"\r"
        other.send(can.Message(arbitration_id=0x7, is_extended_id=False, data=b"\x01"))
        line = port.read_until(b"\r")
        assert line[:7] == b"t007101"
        assert 0 <= int(line[7:11], 16) < 60_000


def test_an_adapter_at_another_bit_rate_gets_nothing_across() -> None:
    with plugged_in() as (adapter, other), serial.Serial(adapter.path, timeout=0.3) as port:
        assert talk(port, b"S6") == b"\r"
        assert talk(port, b"O") == b"\r"
        assert talk(port, b"t1230") == b"\a"
        other.send(can.Message(arbitration_id=0x7, is_extended_id=False))
        assert port.read(10) == b""
        assert other.recv(0.1) is None
        assert talk(port, b"F") == b"F80\r"


def test_an_error_on_the_bus_is_a_flag() -> None:
    with plugged_in() as (adapter, other), serial.Serial(adapter.path, timeout=2) as port:
        assert talk(port, b"O") == b"\r"
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True, dlc=8, data=bytes(8)))
        time.sleep(0.1)
        assert talk(port, b"F") == b"F80\r"
        assert talk(port, b"F") == b"F00\r"


def test_python_cans_client_loses_nothing() -> None:
    with plugged_in() as (adapter, other):
        client = client_of(adapter)
        sent = [
            can.Message(arbitration_id=k % 0x7FF, is_extended_id=False, data=k.to_bytes(4, "big")) for k in range(500)
        ]
        for message in sent:
            other.send(message)
        for message in sent:
            received = client.recv(2.0)
            assert received is not None
            assert bytes(received.data) == bytes(message.data)
            client.send(received)
            back = other.recv(2.0)
            assert back is not None
            assert back.arbitration_id == message.arbitration_id
        assert adapter.lost == 0
        client.shutdown()


def test_a_truncated_line_says_more_bytes_than_it_has() -> None:
    with plugged_in() as (adapter, other):
        client = client_of(adapter)
        adapter.truncate(1)
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8)))
        received = client.recv(2.0)
        assert received is not None
        assert received.dlc == 8
        assert len(received.data) == 7
        client.shutdown()


def test_a_host_that_does_not_read_loses_frames_and_is_told() -> None:
    with plugged_in() as (adapter, other), serial.Serial(adapter.path, timeout=2) as port:
        assert talk(port, b"O") == b"\r"
        for _ in range(6000):
            other.send(can.Message(arbitration_id=1, is_extended_id=False, data=bytes(8)))
        end = time.monotonic() + 5
        while adapter.lost == 0 and time.monotonic() < end:
            time.sleep(0.01)
        assert adapter.lost > 0


def test_drives_behind_an_adapter_until_it_is_pulled_out() -> None:
    channel = f"slcan-{next(_channels)}"
    adapter = SlcanAdapter(can.Bus(interface="virtual", channel=channel))
    server = CanopenServer(ExactPlant(), six_joints(), bus_settings(channel=channel), adapter=adapter)
    with server:
        assert server.ready()["channel"] == adapter.path
        client, limit = client_of(adapter), time.monotonic() + 3.0
        answer = None
        while answer is None or answer.arbitration_id != 0x581:  # a drive that boots does not answer yet
            client.send(can.Message(arbitration_id=0x601, is_extended_id=False, data=b"\x40\x18\x10\x04" + bytes(4)))
            answer = client.recv(0.2)
            assert time.monotonic() < limit
        assert answer.data[4] == 1
        server.obey("garbage 5")
        server.obey("unplug")
        with pytest.raises(can.CanOperationError):
            send_for_ever(client)
        with contextlib.suppress(can.CanError):
            client.shutdown()
    assert server.failure is None


def send_for_ever(client: Any) -> None:
    for _ in range(500):
        client.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        time.sleep(0.01)
