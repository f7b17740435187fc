"""Simulated drives on a bus: in simulated time with a bare master, and once in real time with the `canopen` library."""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files

import can
import canopen
import numpy as np
import pytest
from drive_bench import bus_settings, six_joints
from exact_plant import ExactPlant
from simulated_clock import SimulatedClock

from drivers.can.bus import open_bus
from drivers.core.errors import ConnectionFailedError
from sim_drivers.canopen.drive import BOOT_TIME
from sim_drivers.canopen.object_dictionary import EDS_NAME, entries
from sim_drivers.canopen.server import GRANULARITY, LONGEST_WAIT, CanopenServer

CHANNEL = "canopen-server"
LOOK = LONGEST_WAIT + GRANULARITY + 1e-3
"""How long [s] the drives may take to do what is due: they look so often, and a frame takes its time."""
PATIENCE = 60.0
"""[s], in real time."""


@dataclass(frozen=True)
class Heard:
    """A frame, and when it came [s]."""

    time: float
    id: int
    data: bytes


class Master:
    """Sends frames as it is told, and notes what comes."""

    def __init__(self, server: CanopenServer, clock: SimulatedClock) -> None:
        self.server, self.clock = server, clock
        self.bus = can.Bus(interface="virtual", channel=CHANNEL)

    def send(self, identifier: int, data: bytes = b"") -> float:
        """Send a frame; when that was [s]."""
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        return self.clock.now()

    def guard(self, node: int) -> float:
        """Ask a node for its state; when that was [s]."""
        self.bus.send(can.Message(arbitration_id=0x700 + node, is_remote_frame=True, dlc=1, is_extended_id=False))
        return self.clock.now()

    def hear(self, seconds: float) -> list[Heard]:
        """What comes in so many seconds."""
        end = self.clock.now() + seconds
        found = []
        while (left := end - self.clock.now()) > 0.0:
            message = self.bus.recv(left)
            if message is not None:
                identifier = -1 if message.is_error_frame else message.arbitration_id
                found.append(Heard(self.clock.now(), identifier, bytes(message.data)))
        return found

    def write(self, node: int, index: int, subindex: int, value: int, size: int) -> None:
        """Write an object of a drive."""
        content = struct.pack("<BHBI", 0x23 | 4 - size << 2, index, subindex, value)
        self.send(0x600 + node, content)
        assert [one.data[0] for one in self.hear(LOOK) if one.id == 0x580 + node] == [0x60]


@pytest.fixture
def master(clock: SimulatedClock) -> Iterator[Master]:
    """Six drives that have just booted, and their master."""
    with CanopenServer(ExactPlant(), six_joints(), bus_settings(channel=CHANNEL), clock=clock) as server:
        master = Master(server, clock)
        assert [(one.id, one.data) for one in master.hear(0.1)] == [(0x700 + node, b"\0") for node in range(1, 7)]
        yield master
    master.bus.shutdown()
    assert server.failure is None


def test_heartbeats_emergencies_and_typed_faults(master: Master) -> None:
    master.write(2, 0x1017, 0, 50, 2)
    beats = master.hear(1.0)
    assert {(one.id, one.data) for one in beats} == {(0x702, b"\x7f")}
    assert len(beats) == pytest.approx(20, abs=1)
    np.testing.assert_allclose(np.diff([one.time for one in beats]), 0.05, atol=LOOK)
    master.server.obey("over-temperature j2")
    told = [one for one in master.hear(LONGEST_WAIT + LOOK) if one.id == 0x82]
    assert [one.data for one in told] == [b"\x10\x43\x09\0\0\0\0\0"]
    master.server.obey("heartbeat-stop 2")
    master.hear(LOOK)
    assert master.hear(0.5) == []
    begun = master.clock.now()
    master.server.obey("power-cycle 2")
    (booted,) = master.hear(BOOT_TIME + 2 * LOOK)
    assert (booted.id, booted.data) == (0x702, b"\0")
    assert BOOT_TIME <= booted.time - begun < BOOT_TIME + 2 * LOOK


def test_node_guarding_is_answered_and_its_end_noticed(master: Master) -> None:
    master.write(4, 0x100C, 0, 50, 2)
    master.write(4, 0x100D, 0, 3, 1)
    answers, last = [], 0.0
    for _ in range(8):
        last = master.guard(4)
        answers += master.hear(0.05)
    assert [(one.id, one.data) for one in answers] == [(0x704, b"\x7f"), (0x704, b"\xff")] * 4
    (missed,) = master.hear(0.2)
    assert (missed.id, missed.data) == (0x84, b"\x30\x81\x11\0\0\0\0\0")
    assert 0.15 < missed.time - last < 0.15 + LOOK + LONGEST_WAIT


def test_a_heartbeat_is_awaited(master: Master) -> None:
    master.write(5, 0x1016, 1, 100 << 16 | 150, 4)
    last = 0.0
    for _ in range(4):
        last = master.send(0x700 + 100, b"\x05")
        assert master.hear(0.1) == []
    (missed,) = master.hear(0.2)
    assert (missed.id, missed.data) == (0x85, b"\x30\x81\x11\0\0\0\0\0")
    assert 0.15 < missed.time - last < 0.15 + LOOK + LONGEST_WAIT
    master.send(0x700 + 100, b"\x05")
    (found,) = master.hear(0.1)
    assert (found.id, found.data) == (0x85, bytes(8))


def answers(master: Master) -> list[tuple[int, int]]:
    """Identifier and length of what comes within 0.1 s of a SYNC."""
    master.send(0x80)
    return [(one.id, len(one.data)) for one in master.hear(0.1)]


def test_faults_of_the_bus_are_seen(master: Master) -> None:
    for node in range(1, 7):
        master.write(node, 0x1800, 2, 1, 1)
    master.send(0, bytes([1, 0]))
    master.hear(0.1)
    everybody = [(0x180 + node, 2) for node in range(1, 7)]
    assert answers(master) == everybody
    server = master.server
    server.obey("drop 4")
    master.hear(LOOK)
    assert answers(master) == everybody[4:]
    server.obey("truncate 2")
    master.hear(LOOK)
    assert answers(master) == [(0x181, 1), (0x182, 1), *everybody[2:]]
    server.obey("garbage 20")
    assert len(master.hear(LOOK)) == 20
    server.obey("bus-off 0.3")
    assert [one.id for one in master.hear(LOOK)] == [-1]
    assert answers(master) == []
    master.clock.sleep(0.2)
    assert answers(master) == everybody
    server.obey("freeze 0.3")
    master.hear(LOOK)
    assert answers(master) == []
    master.clock.sleep(0.2)
    assert answers(master) == everybody
    for line in ("unplug", "heat 1 3", "block j2"):
        server.obey(line)
    master.hear(0.1)
    assert list(server.messages) == ["there is no adapter to unplug; only --wire slcan has one"]
    assert server.status().faulted == 4 + 2 + 6  # neither what nobody heard, nor what nobody was asked for
    assert "6 drives operational, 0 enabled, 6 SYNCs" in server.live_line()


def test_a_stall_of_this_computer_costs_no_answer(master: Master) -> None:
    for node in range(1, 7):
        master.write(node, 0x1800, 2, 1, 1)
    master.send(0, bytes([1, 0]))
    master.hear(0.1)
    for _ in range(20):
        master.send(0x80)
        master.clock.stall(0.01)  # nobody else runs meanwhile
    begun = master.clock.now()
    heard = master.hear(0.1)
    assert [one.id for one in heard] == [0x180 + node for _ in range(20) for node in range(1, 7)]
    assert all(one.time - begun < LOOK for one in heard)
    assert (master.server.status().counts.syncs, master.server.status().counts.stalls) == (20, 0)


@pytest.mark.realtime
def test_the_canopen_library_reads_writes_and_maps_what_the_sheet_says() -> None:
    pid = os.getpid()
    place = {"interface": "udp_multicast", "channel": f"239.76.{pid % 250}.{pid // 250 % 250 + 1}"}
    try:
        bus = open_bus(place["interface"], place["channel"], 1_000_000, {"port": 20000 + pid % 30000})
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    except (ConnectionFailedError, can.CanOperationError) as error:
        pytest.skip(f"no multicast here: {error}")
    settings = bus_settings(**place, options={"hop_limit": 0, "port": 20000 + pid % 30000})
    network = canopen.Network(bus)
    network.connect()
    number = 3
    node = network.add_node(number, canopen.import_od(str(files("sim_drivers.canopen").joinpath(EDS_NAME)), number))
    node.sdo.RESPONSE_TIMEOUT = PATIENCE
    booted, received, failed = threading.Event(), threading.Event(), threading.Event()
    node.nmt.add_heartbeat_callback(lambda state: booted.set())
    node.emcy.add_callback(lambda error: failed.set() if error.code == 0x4310 else None)
    with CanopenServer(ExactPlant(), six_joints(), settings) as server:
        assert booted.wait(PATIENCE)
        written = 0
        for (index, subindex), entry in entries(number).items():
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
        pdo = node.tpdo[2]
        pdo.read()
        pdo.clear()
        for name in ("Velocity actual value", "Torque actual value", "Current actual value"):
            pdo.add_variable(name)
        pdo.trans_type, pdo.enabled = 1, True
        pdo.save()
        pdo.add_callback(lambda _: received.set())
        node.nmt.state = "OPERATIONAL"
        network.sync.transmit()
        assert received.wait(PATIENCE)
        assert [variable.raw for variable in pdo] == [0, 0, 0]
        server.obey("over-temperature j3")
        assert failed.wait(PATIENCE)
        network.notifier.stop(PATIENCE)
    bus.shutdown()
    assert server.failure is None


def test_a_bus_that_cannot_be_had_is_told_in_words(clock: SimulatedClock) -> None:
    settings = bus_settings(interface="socketcan", channel="nocan7")
    with pytest.raises(ConnectionFailedError):
        CanopenServer(ExactPlant(), six_joints(), settings, clock=clock).start()
