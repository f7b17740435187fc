"""Simulated drives against the `canopen` library on a virtual bus, in wall-clock time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files

import can
import canopen
import pytest
from drive_bench import bus_settings, six_joints
from exact_plant import ExactPlant

from drivers.errors import ConnectionFailedError, UsageError
from sim_drivers.can_faults import BusOff, Drop, Freeze, Garbage, Heat, Truncate, Unplug, parse_can_fault
from sim_drivers.canopen_nodes import CanopenServer
from sim_drivers.object_dictionary import EDS_NAME, entries

pytestmark = pytest.mark.usefixtures("punctual")

_channels = itertools.count()


@contextmanager
def serving() -> Iterator[tuple[CanopenServer, canopen.Network, can.BusABC]]:
    channel = f"canopen-server-{next(_channels)}"
    with (
        can.Bus(interface="virtual", channel=channel) as listening,
        can.Bus(interface="virtual", channel=channel) as bus,
        CanopenServer(ExactPlant(), six_joints(), bus_settings(channel=channel)) as server,
    ):
        network = canopen.Network(bus)
        network.NOTIFIER_SHUTDOWN_TIMEOUT = 1.0
        network.connect()
        assert heard(listening, 0x706)
        try:
            yield server, network, listening
        finally:
            network.notifier.stop(0.1)
    assert server.failure is None


def heard(bus: can.BusABC, identifier: int, seconds: float = 3.0) -> can.Message | None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = bus.recv(0.1)
        if message is not None and message.arbitration_id == identifier:
            return message
    return None


def node_of(network: canopen.Network, number: int) -> canopen.RemoteNode:
    node = network.add_node(number, canopen.import_od(str(files("sim_drivers").joinpath("eds", EDS_NAME)), number))
    node.sdo.RESPONSE_TIMEOUT = 2.0
    return node


def test_every_object_of_the_sheet_is_read_and_what_can_be_is_written_back() -> None:
    with serving() as (_, network, _listening):
        node = node_of(network, 3)
        written = 0
        for (index, subindex), entry in entries(3).items():
            content = node.sdo.upload(index, subindex)
            assert len(content) == entry.size or entry.size == 0
            if entry.writable and index != 0x6040 and not 0x1400 <= index < 0x1B00:
                node.sdo.download(index, subindex, content)
                assert node.sdo.upload(index, subindex) == content
                written += 1
        assert written >= 8
        assert node.sdo[0x1008].raw == "dynid simulated drive"  # segmented
        assert node.sdo[0x100A].raw == "dynid-sim 1.0"
        assert node.sdo[0x1018]["Vendor-ID"].raw == 0x00000DD1
        with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
            node.sdo.upload(0x7777, 0)
        with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
            node.sdo.download(0x6041, 0, b"\x00\x00")


def test_the_librarys_own_pdo_configuration_is_obeyed() -> None:
    with serving() as (_, network, _listening):
        node = node_of(network, 1)
        node.nmt.state = "PRE-OPERATIONAL"
        pdo = node.tpdo[2]
        pdo.read()
        pdo.clear()
        for name in ("Velocity actual value", "Torque actual value", "Current actual value"):
            pdo.add_variable(name)
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
        node.nmt.state = "OPERATIONAL"
        time.sleep(0.05)
        network.sync.transmit()
        assert pdo.wait_for_reception(2.0) is not None
        assert [variable.raw for variable in pdo] == [0, 0, 0]


def test_heartbeat_and_emergency_reach_the_client() -> None:
    with serving() as (server, network, _listening):
        node = node_of(network, 2)
        node.sdo[0x1017].raw = 50
        assert node.nmt.wait_for_heartbeat(2.0) == "PRE-OPERATIONAL"
        server.obey("over-temperature j2")
        assert node.emcy.wait(0x4310, 2.0).register == 0x09
        server.obey("heartbeat-stop 2")
        time.sleep(0.1)
        with pytest.raises(canopen.nmt.NmtError):
            node.nmt.wait_for_heartbeat(0.3)
        server.obey("power-cycle 2")
        node.nmt.wait_for_bootup(3.0)


def test_the_librarys_node_guarding_is_answered_and_its_end_noticed() -> None:
    with serving() as (_, network, listening):
        node = node_of(network, 4)
        node.sdo[0x100C].raw, node.sdo[0x100D].raw = 50, 3
        node.nmt.start_node_guarding(0.05)
        answers = [heard(listening, 0x704) for _ in range(8)]
        node.nmt.stop_node_guarding()
        # The virtual bus hands out the requests as well.
        bits = [answer.data[0] for answer in answers if answer is not None and not answer.is_remote_frame]
        assert len(bits) >= 3
        assert all(one ^ other == 0x80 for one, other in itertools.pairwise(bits))
        assert {bit & 0x7F for bit in bits} == {0x7F}
        assert node.emcy.wait(0x8130, 2.0).register == 0x11


def test_a_heartbeat_of_the_librarys_network_is_awaited() -> None:
    with serving() as (_, network, _listening):
        node = node_of(network, 5)
        node.sdo[0x1016][1].raw = 100 << 16 | 150
        for _ in range(4):
            network.send_message(0x700 + 100, b"\x05")
            time.sleep(0.05)
        assert not node.emcy.log
        assert node.emcy.wait(0x8130, 2.0) is not None
        network.send_message(0x700 + 100, b"\x05")
        assert node.emcy.wait(0, 2.0) is not None


def test_faults_of_the_bus_are_seen() -> None:
    with serving() as (server, network, listening):
        for number in range(1, 7):
            node = node_of(network, number)
            node.sdo[0x1800][2].raw = 1
        network.nmt.state = "OPERATIONAL"
        network.sync.transmit()
        assert heard(listening, 0x186) is not None
        server.cause(Drop(6))
        time.sleep(0.02)
        network.sync.transmit()
        assert heard(listening, 0x186, 0.2) is None
        server.cause(Truncate(6))
        time.sleep(0.02)
        network.sync.transmit()
        cut = heard(listening, 0x186)
        assert cut is not None
        assert len(cut.data) == 1
        server.cause(Garbage(20))
        assert listening.recv(1.0) is not None
        server.cause(BusOff(0.3))
        error = listening.recv(1.0)
        while error is not None and not error.is_error_frame:
            error = listening.recv(1.0)
        assert error is not None
        assert error.arbitration_id & 0x40
        network.sync.transmit()
        assert heard(listening, 0x181, 0.2) is None
        time.sleep(0.2)
        network.sync.transmit()
        assert heard(listening, 0x181) is not None
        server.obey("unplug")
        server.obey("heat 1 3")
        server.obey("block j2")
        time.sleep(0.1)
        assert "no adapter" in server.messages[-1]
        assert server.status().faulted >= 12
        assert "6 drives operational" in server.live_line()


def test_a_bus_that_cannot_be_had_is_told_in_words() -> None:
    with pytest.raises(ConnectionFailedError):
        CanopenServer(ExactPlant(), six_joints(), bus_settings(interface="socketcan", channel="nocan7")).start()


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("drop 3", Drop(3)),
        ("freeze 0.5", Freeze(0.5)),
        ("heat elbow 5", Heat(1, 5.0)),
        ("unplug", Unplug()),
        ("garbage 2", Garbage(2)),
        ("truncate 1", Truncate(1)),
        ("bus-off 2", BusOff(2.0)),
    ],
)
def test_faults_are_typed(line: str, fault: object) -> None:
    assert parse_can_fault(line, ("pan", "elbow")) == fault


@pytest.mark.parametrize(
    "line", ["", "cut", "drop", "bus-off nan", "power-cycle", "power-cycle 3", "truncate 0", "unplug 2"]
)
def test_what_is_no_fault_of_a_bus_is_refused(line: str) -> None:
    with pytest.raises(UsageError):
        parse_can_fault(line, ("pan", "elbow"))
