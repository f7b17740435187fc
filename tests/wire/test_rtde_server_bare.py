"""A simulated controller against bare sockets: rates, recipes, faults, and clients that mean harm."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from exact_plant import ExactPlant
from hypothesis import given, settings
from hypothesis import strategies as st
from rtde_bench import BareClient

from drivers.errors import ConnectionFailedError, ConnectionLostError, UsageError
from drivers.rtde import wire
from sim_drivers.controller import Controller
from sim_drivers.rtde_protocol import output_variables, parse_version
from sim_drivers.rtde_server import Ports, RtdeServer
from sim_drivers.rtde_session import RtdeSession
from sim_drivers.serve import simulate

pytestmark = pytest.mark.realtime
ANY = Ports(0, 0, 0)


@contextmanager
def listening(version: str = "5.22", **settings: int) -> Iterator[RtdeServer]:
    with RtdeServer(ExactPlant(), version=version, ports=ANY, **settings) as server:
        yield server
    assert server.failure is None


def client_of(server: RtdeServer, **settings: bool) -> BareClient:
    return BareClient(server.host, server.ports.rtde, **settings)


def still_serves(server: RtdeServer) -> bool:
    with client_of(server) as client:
        client.stream(["timestamp"])
        return bool(client.row()["timestamp"] >= 0.0)


def read_on(client: BareClient) -> None:
    while True:
        client.next()


def eventually(condition: object, seconds: float = 3.0) -> bool:
    assert callable(condition)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


@pytest.mark.parametrize(("version", "rate"), [("3.15", 125.0), ("5.22", 500.0), ("5.23", 500.0), ("10.10", 500.0)])
def test_version_and_rate_are_announced_and_kept(version: str, rate: float) -> None:
    with listening(version) as server, client_of(server) as client:
        told = wire.decode_control_version(client.ask(wire.GET_CONTROL_VERSION))
        assert f"{told.major}.{told.minor}" == version
        assert told.maximum_rate == rate
        client.stream(["timestamp"], rate)
        stamps = np.array([float(client.row()["timestamp"]) for _ in range(30)])
        np.testing.assert_allclose(np.diff(stamps), 1.0 / rate, rtol=1e-9)


@pytest.mark.parametrize("rate", [125.0, 100.0, 50.0])
def test_a_client_gets_the_rate_that_it_asked_for(rate: float) -> None:
    with listening() as server, client_of(server) as client:
        client.stream(["timestamp"], rate)
        stamps = np.array([float(client.row()["timestamp"]) for _ in range(10)])
        np.testing.assert_allclose(np.diff(stamps), 1.0 / rate, rtol=1e-9)


def test_the_clock_of_the_wall_is_kept() -> None:
    with listening() as server, client_of(server) as client:
        client.stream(["timestamp"])
        first, began = float(client.row()["timestamp"]), time.monotonic()
        while (last := float(client.row()["timestamp"])) - first < 1.0:
            pass
        assert last - first == pytest.approx(time.monotonic() - began, abs=0.25)


def test_two_clients_with_their_own_recipes() -> None:
    with listening() as server, client_of(server) as one, client_of(server) as other:
        one.stream(["timestamp", "actual_q", "joint_mode", "actual_digital_output_bits"])
        other.stream(["actual_current", "runtime_state"], 125.0)
        np.testing.assert_array_equal(one.row()["actual_q"], ExactPlant().position)
        np.testing.assert_array_equal(other.row()["actual_current"], ExactPlant().position + 0.5)
        assert other.row()["runtime_state"] == 1
        assert one.ask(wire.PAUSE) == b"\x01"
        one.sock.settimeout(0.1)
        with pytest.raises(TimeoutError):
            read_on(one)


def test_unknown_variables_are_not_found() -> None:
    with listening() as server, client_of(server) as client:
        assert client.types(wire.SETUP_OUTPUTS, ["timestamp", "nonsense"]) == (0, ["DOUBLE", "NOT_FOUND"])
        assert client.ask(wire.START) == b"\x00"
        assert client.types(wire.SETUP_OUTPUTS, ["actual_current_as_torque"])[1] == ["NOT_FOUND"]
        # ur_rtde ends its lists with a comma, and is answered with one.
        answer = client.ask(wire.SETUP_OUTPUTS, struct.pack(">d", 125.0) + b"timestamp,actual_q,")
        assert answer == b"\x01DOUBLE,VECTOR6D,"
    assert "actual_current_as_torque" in output_variables(parse_version("5.23"))


def test_an_input_belongs_to_one_client_until_it_leaves() -> None:
    with listening() as server, client_of(server) as client:
        with client_of(server) as owner:
            assert owner.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (1, ["INT32"])
            assert owner.types(wire.SETUP_INPUTS, ["input_int_register_0", "speed_slider_mask"])[0] == 2
            assert client.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (0, ["IN_USE"])
        assert eventually(lambda: client.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (1, ["INT32"]))


def test_registers_written_are_read_back() -> None:
    with listening() as server, client_of(server) as client:
        number, _ = client.types(wire.SETUP_INPUTS, ["input_int_register_5", "input_double_register_7"])
        client.stream(["input_int_register_5", "input_double_register_7"])
        client.send(wire.DATA_PACKAGE, struct.pack(">Bid", number, -7, 2.5))
        row = client.until(lambda row: row["input_int_register_5"] != 0)
        assert (row["input_int_register_5"], row["input_double_register_7"]) == (-7, 2.5)


def test_dropped_packages_leave_a_gap_in_the_timestamps() -> None:
    with listening() as server, client_of(server) as client:
        client.stream(["timestamp"])
        before = float(client.row()["timestamp"])
        server.faults.drop(7)
        gap = 0.0
        for _ in range(100):
            stamp = float(client.row()["timestamp"])
            gap, before = max(gap, stamp - before), stamp
        assert gap == pytest.approx(8 * 0.002)
        assert server.status().faulted == 7


def test_dropped_packages_are_counted_for_each_client() -> None:
    with listening() as server, client_of(server) as fast, client_of(server) as slow:
        fast.stream(["timestamp"])
        slow.stream(["timestamp"], 50.0)
        stamp = float(slow.row()["timestamp"])
        server.faults.drop(2)
        later = [float(slow.row()["timestamp"]) for _ in range(5)]
        assert np.max(np.diff([stamp, *later])) == pytest.approx(3 * 0.02)


def test_a_frozen_controller_is_silent_and_then_goes_on() -> None:
    with listening() as server, client_of(server) as client:
        client.stream(["timestamp"])
        before = float(client.row()["timestamp"])
        server.faults.freeze(0.3)
        longest = gap = 0.0
        for _ in range(50):
            asked = time.monotonic()
            stamp = float(client.row()["timestamp"])
            longest = max(longest, time.monotonic() - asked)
            gap, before = max(gap, stamp - before), stamp
        assert longest > 0.25
        assert gap > 0.25


def test_a_cut_ends_rtde_connections_but_not_the_server() -> None:
    with listening() as server, client_of(server) as client:
        client.stream(["timestamp"])
        client.row()
        server.faults.cut()
        with pytest.raises((EOFError, ConnectionResetError)):
            read_on(client)
        assert still_serves(server)


def test_protective_stop_and_heat_are_seen_by_clients() -> None:
    with listening() as server, client_of(server) as client:
        names = ["safety_mode", "safety_status_bits", "runtime_state", "joint_temperatures"]
        client.stream(names)
        before = client.row()
        assert (before["safety_mode"], before["safety_status_bits"]) == (1, 1)
        server.faults.heat(2, 15.0)
        server.faults.protective_stop()
        row = client.until(lambda row: row["safety_mode"] == 3)
        assert row["safety_status_bits"] >> 2 & 1
        assert not row["safety_status_bits"] & 1
        rise = row["joint_temperatures"] - before["joint_temperatures"]
        np.testing.assert_allclose(rise, [0, 0, 15, 0, 0, 0])


def test_dashboard_answers_lines() -> None:
    with listening() as server, socket.create_connection((server.host, server.ports.dashboard), 5) as sock:
        lines = sock.makefile("rw", newline="\n")
        assert lines.readline().startswith("Connected")
        for question, answer in (
            ("PolyscopeVersion", "URSoftware 5.22.0.0"),
            ("robotmode", "Robotmode: RUNNING"),
            ("safetystatus", "Safetystatus: NORMAL"),
            ("running", "Program running: false"),
            ("is in remote control", "true"),
            ("stop", "Stopped"),
            ("open the door", "could not understand"),
        ):
            lines.write(question + "\n")
            lines.flush()
            assert lines.readline().startswith(answer)
        lines.write("get serial number\nquit\n")
        lines.flush()
        assert lines.readline().strip().isdigit()
        assert lines.readline() == "Disconnected\n"
        assert lines.readline() == ""


def test_another_protocol_version_is_refused() -> None:
    with listening() as server, client_of(server, greet=False) as client:
        assert client.ask(wire.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 1)) == b"\x00"
        client.send(wire.SETUP_OUTPUTS, b"timestamp")
        with pytest.raises((EOFError, ConnectionResetError)):
            client.next()
        assert still_serves(server)
        assert server.status().broken == 1


@pytest.mark.parametrize(
    "rubbish",
    [b"GET / HTTP/1.1\r\n\r\n", bytes(range(256)) * 40, b"\x00\x00\x00", b"\x00\x02V", b"\xff\xff?" + b"x" * 70000],
)
def test_rubbish_is_hung_up_on(rubbish: bytes) -> None:
    with listening() as server:
        for port in (server.ports.rtde, server.ports.dashboard, server.ports.script):
            with socket.create_connection((server.host, port), 5) as sock:
                sock.sendall(rubbish)
        assert still_serves(server)


def test_an_oversized_length_and_half_a_package_only_wait() -> None:
    with listening() as server, client_of(server) as big, client_of(server) as slow:
        big.sock.sendall(b"\xff\xffO" + b"a" * 1000)
        for byte in wire.encode_package(wire.GET_CONTROL_VERSION):
            assert still_serves(server)
            slow.sock.sendall(bytes([byte]))
        assert slow.next().kind == wire.GET_CONTROL_VERSION


def test_endless_lines_and_scripts_are_hung_up_on() -> None:
    with listening() as server:
        for port, endless in ((server.ports.dashboard, b"a" * 10_000), (server.ports.script, b"def a():\n" * 40_000)):
            with socket.create_connection((server.host, port), 5) as sock:
                try:
                    sock.sendall(endless)
                    sock.settimeout(3)
                    while sock.recv(65536):
                        pass
                except ConnectionError:
                    pass
        assert server.status().broken == 2
        assert still_serves(server)


def test_a_client_that_never_reads_is_dropped_and_counted() -> None:
    with listening(buffer_limit=20_000) as server, client_of(server) as reader:
        sock = socket.socket()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.connect((server.host, server.ports.rtde))
        recipe = struct.pack(">d", 500.0) + b",".join([b"actual_q"] * 300)
        sock.sendall(
            wire.encode_protocol_request()
            + wire.encode_package(wire.SETUP_OUTPUTS, recipe)
            + wire.encode_package(wire.START)
        )
        reader.stream(["timestamp"])
        stamps = [float(reader.row()["timestamp"]) for _ in range(300)]
        assert eventually(lambda: server.status().overflowed == 1)
        np.testing.assert_allclose(np.diff(stamps), 0.002, rtol=1e-6)
        sock.close()


def test_more_connections_than_it_holds_are_refused() -> None:
    with listening() as server:
        socks = [socket.create_connection((server.host, server.ports.rtde), 5) for _ in range(80)]
        assert eventually(lambda: server.status().refused == 16)
        for sock in socks:
            sock.close()
        assert eventually(lambda: server.status().rtde_clients == 0)
        assert still_serves(server)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(b"VvMUOISPx"), st.binary(max_size=60)), max_size=8), st.integers(1, 50))
def test_no_sequence_of_packages_breaks_a_session(packages: list[tuple[int, bytes]], cut: int) -> None:
    session = RtdeSession(Controller(ExactPlant(), parse_version("5.22"), 0.002), {})
    session.receive(wire.encode_protocol_request())
    content = b"".join(wire.encode_package(kind, payload) for kind, payload in packages)
    try:
        for start in range(0, len(content), cut):
            session.receive(content[start : start + cut])
            session.data_package()
    except ConnectionLostError:
        pass


def test_what_cannot_be_served_is_refused() -> None:
    for version in ("4.0", "5", "five", "5.22.1.2.3"):
        with pytest.raises(UsageError):
            RtdeServer(ExactPlant(), version=version)
    with pytest.raises(UsageError):
        RtdeServer(ExactPlant(joints=7))
    with pytest.raises(UsageError):
        RtdeServer(ExactPlant(), version="3.15", rate=500.0)
    with listening() as server, pytest.raises(ConnectionFailedError):
        RtdeServer(ExactPlant(), ports=Ports(server.ports.rtde, 0, 0)).start()


@pytest.mark.parametrize(
    ("robot", "wire_name", "version", "message"),
    [
        ("ur5e", "carrier-pigeon", "5.22", "cannot be simulated yet"),
        ("ur5e", "rtde", "4.1", "no version"),
        ("panda", "rtde", "5.22", "6 joints, not 7"),
    ],
)
def test_the_command_refuses_in_words(robot: str, wire_name: str, version: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate(robot, wire_name, "127.0.0.1", version, 1, live=False)


def test_a_plant_that_breaks_down_is_reported() -> None:
    arm = ExactPlant()
    server = RtdeServer(arm, ports=ANY)
    server.start()
    arm.advance = None  # type: ignore[assignment,method-assign]
    assert eventually(lambda: server.failure is not None)
    server.stop()
    assert "rtde-server" not in [thread.name for thread in threading.enumerate()]
