"""A simulated controller against bare sockets: rates, recipes, faults, and clients that mean harm."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from each import each
from exact_plant import ExactPlant
from hypothesis import given, settings
from hypothesis import strategies as st
from rtde_bench import BareClient
from rtde_in_process import NOWHERE
from simulated_clock import START, SimulatedClock

from drivers.core.errors import ConnectionFailedError, ConnectionLostError, UsageError
from drivers.rtde import protocol as wire
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.server import LONGEST_LAG, MAXIMUM_CONNECTIONS, Ports, RtdeServer, Service
from sim_drivers.rtde.session import RtdeSession
from sim_drivers.rtde.variables import output_variables, parse_version
from sim_drivers.served import SimOptions
from sim_drivers.serving import simulate

PERIOD = 0.002


class Wires:
    """A server that listens nowhere, and its clients' ends of sockets."""

    def __init__(self, clock: SimulatedClock, version: str = "5.22", **settings: int) -> None:
        self.clock = clock
        self.server = RtdeServer(ExactPlant(), version=version, ports=NOWHERE, clock=clock, **settings)
        self.server.start()
        self._made: list[socket.socket] = []

    def socket(self, service: Service = "rtde") -> socket.socket:
        ours, theirs = socket.socketpair()
        self._made.append(ours)
        self.server.serve(theirs, service)
        return ours

    def client(self, *, greet: bool = True) -> BareClient:
        return BareClient(self.socket(), self.clock, greet=greet)

    def still_serves(self) -> bool:
        client = self.client()
        client.stream(["timestamp"])
        return bool(client.row()["timestamp"] >= 0.0)

    def close(self) -> None:
        for end in self._made:
            end.close()
        self.server.stop()
        assert self.server.failure is None


@pytest.fixture
def make_wires(clock: SimulatedClock) -> Iterator[Callable[..., Wires]]:
    with ExitStack() as made:
        yield lambda version="5.22", **keys: made.enter_context(closing(Wires(clock, version, **keys)))


@pytest.fixture
def wires(make_wires: Callable[..., Wires]) -> Wires:
    return make_wires()


def stamps_of(client: BareClient, count: int) -> np.ndarray:
    return np.array([float(client.row()["timestamp"]) for _ in range(count)])


def read_on(client: BareClient) -> None:
    while True:
        client.next(1.0)


@pytest.mark.parametrize(("version", "rate"), [("3.15", 125.0), ("5.22", 500.0), ("5.23", 500.0), ("10.10", 500.0)])
def test_version_and_rate_are_announced_and_kept_by_the_hosts_clock(
    make_wires: Callable[..., Wires], version: str, rate: float
) -> None:
    wires = make_wires(version)
    client = wires.client()
    told = wire.decode_control_version(client.ask(wire.GET_CONTROL_VERSION))
    assert f"{told.major}.{told.minor}" == version
    assert told.maximum_rate == rate
    client.stream(["timestamp"], rate)
    for _ in range(500):
        # The first period begins with the server, and its sample is stamped when it ends.
        assert float(client.row()["timestamp"]) == pytest.approx(wires.clock.now() - START + 1.0 / rate)


@each("rate", [125.0, 100.0, 50.0])
def test_a_client_gets_the_rate_that_it_asked_for(wires: Wires, rate: float) -> None:
    client = wires.client()
    client.stream(["timestamp"], rate)
    np.testing.assert_allclose(np.diff(stamps_of(client, 10)), 1.0 / rate, rtol=1e-9)


@pytest.mark.parametrize(("seconds", "behind"), [(0.2, 0.0), (0.3, 0.3 - 2 * PERIOD)])
def test_a_stall_is_made_up_for_or_virtual_time_falls_behind(wires: Wires, seconds: float, behind: float) -> None:
    client = wires.client()
    client.stream(["timestamp"])
    first = stamps_of(client, 10)[-1]
    assert (seconds > LONGEST_LAG) == (behind > 0.0)
    wires.clock.stall(seconds)
    stamps = stamps_of(client, 500)
    np.testing.assert_allclose(np.diff([first, *stamps]), PERIOD, rtol=1e-6)  # no gap that the arm did not have
    assert wires.server.status().stalls == (behind > 0.0)
    assert wires.clock.now() - START + PERIOD - stamps[-1] == pytest.approx(behind, abs=1e-9)


def test_two_clients_with_their_own_recipes(wires: Wires) -> None:
    one, other = wires.client(), wires.client()
    one.stream(["timestamp", "actual_q", "joint_mode", "actual_digital_output_bits"])
    other.stream(["actual_current", "runtime_state"], 125.0)
    np.testing.assert_array_equal(one.row()["actual_q"], ExactPlant().position)
    np.testing.assert_array_equal(other.row()["actual_current"], ExactPlant().position + 0.5)
    assert other.row()["runtime_state"] == 1
    assert one.ask(wire.PAUSE) == b"\x01"
    with pytest.raises(TimeoutError):
        read_on(one)


def test_unknown_variables_are_not_found(wires: Wires) -> None:
    client = wires.client()
    assert client.types(wire.SETUP_OUTPUTS, ["timestamp", "nonsense"]) == (0, ["DOUBLE", "NOT_FOUND"])
    assert client.ask(wire.START) == b"\x00"
    assert client.types(wire.SETUP_OUTPUTS, ["actual_current_as_torque"])[1] == ["NOT_FOUND"]
    # ur_rtde ends its lists with a comma, and is answered with one.
    answer = client.ask(wire.SETUP_OUTPUTS, struct.pack(">d", 125.0) + b"timestamp,actual_q,")
    assert answer == b"\x01DOUBLE,VECTOR6D,"
    assert "actual_current_as_torque" in output_variables(parse_version("5.23"))


def test_an_input_belongs_to_one_client_until_it_leaves(wires: Wires) -> None:
    client, owner = wires.client(), wires.client()
    assert owner.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (1, ["INT32"])
    assert owner.types(wire.SETUP_INPUTS, ["input_int_register_0", "speed_slider_mask"])[0] == 2
    assert client.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (0, ["IN_USE"])
    owner.sock.close()
    wires.clock.sleep(PERIOD)
    assert client.types(wire.SETUP_INPUTS, ["input_int_register_0"]) == (1, ["INT32"])


def test_registers_written_are_read_back_in_the_next_period(wires: Wires) -> None:
    client = wires.client()
    number, _ = client.types(wire.SETUP_INPUTS, ["input_int_register_5", "input_double_register_7"])
    client.stream(["input_int_register_5", "input_double_register_7"])
    client.row()
    client.send(wire.DATA_PACKAGE, struct.pack(">Bid", number, -7, 2.5))
    row = client.row()
    assert (row["input_int_register_5"], row["input_double_register_7"]) == (-7, 2.5)


def test_dropped_packages_leave_a_gap_in_the_timestamps(wires: Wires) -> None:
    client = wires.client()
    client.stream(["timestamp"])
    client.row()
    wires.server.obey("drop 7")
    stamps = stamps_of(client, 100)
    assert sorted(np.rint(np.diff(stamps) / PERIOD))[-2:] == [1.0, 1.0]
    assert stamps[0] == pytest.approx(wires.clock.now() - START - 98 * PERIOD)
    assert wires.server.status().faulted == 7


def test_dropped_packages_are_counted_for_each_client(wires: Wires) -> None:
    fast, slow = wires.client(), wires.client()
    fast.stream(["timestamp"])
    slow.stream(["timestamp"], 50.0)
    stamps = [*stamps_of(slow, 1)]
    wires.server.obey("drop 2")
    stamps += [*stamps_of(slow, 5)]
    assert np.max(np.diff(stamps)) == pytest.approx(3 * 0.02)


def test_a_frozen_controller_is_silent_and_then_goes_on(wires: Wires) -> None:
    client = wires.client()
    client.stream(["timestamp"])
    client.row()
    wires.server.obey("freeze 0.3")
    begun = wires.clock.now()
    stamp = float(client.row()["timestamp"])
    assert wires.clock.now() - begun == pytest.approx(0.3 + PERIOD)
    assert stamp == pytest.approx(wires.clock.now() - START + PERIOD)
    assert wires.server.status().faulted == 150


def test_a_frozen_controller_hears_nothing_until_it_goes_on(wires: Wires) -> None:
    client = wires.client()
    wires.clock.sleep(0.1)
    wires.server.obey("freeze 0.3")
    wires.clock.sleep(PERIOD)
    late = wires.client(greet=False)
    begun = wires.clock.now()
    client.ask(wire.GET_CONTROL_VERSION)
    assert wires.clock.now() - begun == pytest.approx(0.3, abs=2 * PERIOD)
    assert late.ask(wire.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 2)) == b"\x01"


def test_a_cut_ends_rtde_connections_but_not_the_server(wires: Wires) -> None:
    client = wires.client()
    client.stream(["timestamp"])
    client.row()
    wires.server.obey("cut")
    with pytest.raises((EOFError, ConnectionResetError)):
        read_on(client)
    assert wires.still_serves()


def test_protective_stop_and_heat_are_seen_by_clients(wires: Wires) -> None:
    client = wires.client()
    client.stream(["safety_mode", "safety_status_bits", "runtime_state", "joint_temperatures"])
    before = client.row()
    assert (before["safety_mode"], before["safety_status_bits"]) == (1, 1)
    wires.server.obey("heat 3 15.0")
    wires.server.obey("protective-stop")
    row = client.row()
    assert row["safety_mode"] == 3
    assert row["safety_status_bits"] >> 2 & 1
    assert not row["safety_status_bits"] & 1
    rise = row["joint_temperatures"] - before["joint_temperatures"]
    np.testing.assert_allclose(rise, [0, 0, 15, 0, 0, 0])


def receive(wires: Wires, sock: socket.socket) -> bytes:
    """What comes next; nothing where the server hung up."""
    assert wires.clock.select([sock], [], 5.0)[0]
    try:
        return sock.recv(65536)
    except ConnectionError:
        return b""


def test_dashboard_answers_lines(wires: Wires) -> None:
    sock = wires.socket("dashboard")
    assert receive(wires, sock).startswith(b"Connected")
    for question, answer in (
        (b"PolyscopeVersion", b"URSoftware 5.22.0.0"),
        (b"robotmode", b"Robotmode: RUNNING"),
        (b"safetystatus", b"Safetystatus: NORMAL"),
        (b"running", b"Program running: false"),
        (b"is in remote control", b"true"),
        (b"stop", b"Stopped"),
        (b"open the door", b"could not understand"),
    ):
        sock.sendall(question + b"\n")
        assert receive(wires, sock).startswith(answer)
    sock.sendall(b"get serial number\nquit\n")
    number, said = receive(wires, sock).splitlines()
    assert number.isdigit()
    assert said == b"Disconnected"
    assert receive(wires, sock) == b""


def test_another_protocol_version_is_refused(wires: Wires) -> None:
    client = wires.client(greet=False)
    assert client.ask(wire.REQUEST_PROTOCOL_VERSION, struct.pack(">H", 1)) == b"\x00"
    client.send(wire.SETUP_OUTPUTS, b"timestamp")
    with pytest.raises((EOFError, ConnectionResetError)):
        client.next()
    assert wires.still_serves()
    assert wires.server.status().broken == 1


SERVICES: tuple[Service, ...] = ("rtde", "dashboard", "script")


@each(
    "rubbish",
    [b"GET / HTTP/1.1\r\n\r\n", bytes(range(256)) * 40, b"\x00\x00\x00", b"\x00\x02V", b"\xff\xff?" + b"x" * 70000],
)
def test_rubbish_is_hung_up_on(wires: Wires, rubbish: bytes) -> None:
    for service in SERVICES:
        with wires.socket(service) as sock:
            sock.sendall(rubbish)
            wires.clock.sleep(PERIOD)
    assert wires.still_serves()


def test_an_oversized_length_and_half_a_package_only_wait(wires: Wires) -> None:
    big, slow = wires.client(), wires.client()
    big.sock.sendall(b"\xff\xffO" + b"a" * 1000)
    for byte in wire.encode_package(wire.GET_CONTROL_VERSION):
        assert wires.still_serves()
        slow.sock.sendall(bytes([byte]))
    assert slow.next().kind == wire.GET_CONTROL_VERSION


@pytest.mark.parametrize(("service", "endless"), [("dashboard", b"a" * 10_000), ("script", b"def a():\n" * 1_000)])
def test_endless_lines_and_scripts_are_hung_up_on(wires: Wires, service: Service, endless: bytes) -> None:
    sock = wires.socket(service)
    wires.clock.sleep(PERIOD)
    for _ in range(100):
        try:
            sock.sendall(endless)
        except BrokenPipeError:
            break
        wires.clock.sleep(PERIOD)
    assert wires.server.status().broken == 1
    assert wires.still_serves()


def test_a_client_that_never_reads_is_dropped_and_counted(make_wires: Callable[..., Wires]) -> None:
    wires = make_wires(buffer_limit=20_000)
    lazy, reader = wires.socket(), wires.client()
    recipe = struct.pack(">d", 500.0) + b",".join([b"actual_q"] * 300)
    lazy.sendall(
        wire.encode_protocol_request()
        + wire.encode_package(wire.SETUP_OUTPUTS, recipe)
        + wire.encode_package(wire.START)
    )
    reader.stream(["timestamp"])
    stamps = stamps_of(reader, 300)
    assert wires.server.status().overflowed == 1
    np.testing.assert_allclose(np.diff(stamps), PERIOD, rtol=1e-6)


def test_more_connections_than_it_holds_are_refused(wires: Wires) -> None:
    socks = [wires.socket() for _ in range(MAXIMUM_CONNECTIONS + 16)]
    wires.clock.sleep(2 * PERIOD)
    assert wires.server.status().refused == 16
    assert wires.server.status().rtde_clients == MAXIMUM_CONNECTIONS
    assert all(receive(wires, sock) == b"" for sock in socks[MAXIMUM_CONNECTIONS:])
    for sock in socks:
        sock.close()
    wires.clock.sleep(2 * PERIOD)
    assert wires.server.status().rtde_clients == 0
    assert wires.still_serves()


@settings(max_examples=60)
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


def test_what_cannot_be_served_is_refused(clock: SimulatedClock) -> None:
    for version in ("4.0", "5", "five", "5.22.1.2.3"):
        with pytest.raises(UsageError):
            RtdeServer(ExactPlant(), version=version)
    with pytest.raises(UsageError):
        RtdeServer(ExactPlant(joints=7))
    with pytest.raises(UsageError):
        RtdeServer(ExactPlant(), version="3.15", rate=500.0)
    with (
        RtdeServer(ExactPlant(), ports=Ports(0, None, None, None), clock=clock) as server,
        pytest.raises(ConnectionFailedError),
    ):
        RtdeServer(ExactPlant(), ports=Ports(server.ports.rtde, 0, 0, 0), clock=clock).start()


@each(
    ("robot", "wire_name", "version", "message"),
    [
        ("ur5e", "carrier-pigeon", "5.22", "cannot be simulated"),
        ("ur5e", "rtde", "4.1", "not a version"),
        ("panda", "rtde", "5.22", "6 joints, not 7"),
    ],
)
def test_the_command_refuses_in_words(robot: str, wire_name: str, version: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate(SimOptions(robot=robot, wire=wire_name, version=version), live=False)
    with pytest.raises(UsageError, match="is not a payload"):
        simulate(SimOptions(robot="ur5e", wire="rtde", payload="2.0"), live=False)


def test_a_plant_that_breaks_down_is_reported(clock: SimulatedClock) -> None:
    arm = ExactPlant()
    server = RtdeServer(arm, ports=NOWHERE, clock=clock)
    server.start()
    clock.sleep(0.1)
    assert server.failure is None
    arm.advance = None  # type: ignore[assignment,method-assign]
    clock.sleep(PERIOD)
    assert isinstance(server.failure, TypeError)
    server.stop()
