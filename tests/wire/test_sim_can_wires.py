"""`dynid sim --wire canopen|slcan|can` as a process of its own, met by real clients."""

from __future__ import annotations

import signal
import subprocess
import time
from typing import Any

import can
import numpy as np
import pytest
from rtde_bench import served

from daq.robot import load_robot
from drivers.base import DriverSettings
from drivers.can_bus import close_bus, open_bus
from drivers.canopen402.driver import Canopen402Driver
from drivers.errors import ConnectionFailedError, DynidError, UsageError
from drivers.gains import DriveGain
from drivers.streams import Block, FloatArray
from sim_drivers.serve import BusOptions, simulate

READ_SERIAL = b"\x40\x18\x10\x04" + bytes(4)
SIM = ("-c", "from drivers.command import main; main()", "sim")


def multicast_bus(channel: str) -> can.BusABC:
    """A bus that reaches other processes; skipped where this computer has no route for multicast."""
    try:
        bus = open_bus("udp_multicast", channel, 1_000_000, {})
        bus.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    except (ConnectionFailedError, can.CanOperationError) as error:
        pytest.skip(f"no multicast here: {error}")
    return bus


def serial_number(bus: Any, node: int, seconds: float = 5.0) -> int | None:
    """What a drive says of itself; None where it says nothing."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        bus.send(can.Message(arbitration_id=0x600 + node, is_extended_id=False, data=READ_SERIAL))
        while (answer := bus.recv(0.2)) is not None:
            if answer.arbitration_id == 0x580 + node:
                return int.from_bytes(answer.data[4:], "little")
    return None


def interrupted(process: subprocess.Popen[str]) -> int:
    process.send_signal(signal.SIGINT)
    return process.wait(10)


def test_drives_on_a_multicast_bus_until_ctrl_c() -> None:
    bus = multicast_bus("239.74.163.201")
    with served(*SIM, "ur5e", "--wire", "canopen", "--channel", "239.74.163.201", "--swap", "1,2") as (ready, process):
        assert ready["interface"] == "udp_multicast"
        assert ready["channel"] == "239.74.163.201"
        assert ready["bitrate"] == 1_000_000
        assert list(ready["nodes"].values()) == [2, 1, 3, 4, 5, 6]  # type: ignore[attr-defined]
        assert [serial_number(bus, node) for node in (1, 2, 3)] == [2, 1, 3]
        assert process.stdin is not None
        process.stdin.write("nonsense\npower-cycle 3\n")
        process.stdin.flush()
        time.sleep(0.2)
        assert serial_number(bus, 3, 0.3) is None
        assert serial_number(bus, 3) == 3
        assert interrupted(process) == 0
    close_bus(bus)


def test_our_own_driver_moves_the_simulated_arm() -> None:
    close_bus(multicast_bus("239.74.163.202"))
    robot = load_robot("ur5e").robot
    keys = {**(robot.connections["canopen"].model_extra or {}), "channel": "239.74.163.202", "sync_rate": 200}
    gains = tuple(DriveGain(robot.drive(joint).gain) for joint in robot.joint_names)
    driver = Canopen402Driver(DriverSettings(robot.joint_names, keys, gains))
    with served(*SIM, "ur5e", "--wire", "canopen", "--channel", "239.74.163.202") as (_, process):
        driver.open()
        try:
            driver.start()
            rows: list[Block] = []
            start: FloatArray | None = None
            begun = time.monotonic()
            while (elapsed := time.monotonic() - begun) < 2.5:
                rows += [block for block in driver.read(0.01) if block.stream == "joints"]
                if start is None and rows:
                    start = rows[0].values["position"][0].copy()
                if start is not None:
                    driver.command(start + 0.05 * (1.0 - np.cos(np.pi * min(elapsed, 2.0) / 2.0)))
            driver.stop()
        finally:
            driver.close()
        assert start is not None
        np.testing.assert_allclose(rows[-1].values["position"][-1] - start, 0.1, atol=2e-3)
        torque = np.concatenate([block.values["torque"] for block in rows])
        current = np.concatenate([block.values["current"] for block in rows])
        # Both are the same motor signal, cut to whole per mille of the rated values by the drive.
        np.testing.assert_allclose(torque, current * [gain.gain for gain in gains], atol=0.15)
        assert interrupted(process) == 0


def test_drives_behind_a_serial_port() -> None:
    with served(*SIM, "ur5e", "--wire", "slcan") as (ready, process):
        assert ready["interface"] == "slcan"
        bus = open_bus("slcan", str(ready["channel"]), 1_000_000, {})
        assert serial_number(bus, 6) == 6
        process.stdin.write("unplug\n")  # type: ignore[union-attr]
        process.stdin.flush()  # type: ignore[union-attr]
        time.sleep(0.5)
        with pytest.raises(can.CanOperationError):
            bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        close_bus(bus)
        assert interrupted(process) == 0


@pytest.mark.parametrize(
    ("robot", "wire", "bus", "message"),
    [
        ("ur5e", "canopen", BusOptions(swap="1"), "two joints"),
        ("ur5e", "canopen", BusOptions(swap="1,9"), "no joint"),
        ("ur5e", "canopen", BusOptions(interface="pigeon"), "no interface 'pigeon'"),
        ("ur5e", "slcan", BusOptions(channel="/dev/ttyUSB0"), "its own port"),
        ("ur5e", "can", BusOptions(), "can_frames"),
        ("panda", "canopen", BusOptions(interface="virtual", channel="x", swap="7,7"), "two joints"),
    ],
)
def test_what_cannot_be_served_is_refused(robot: str, wire: str, bus: BusOptions, message: str) -> None:
    with pytest.raises(DynidError, match=message) as refused:
        simulate(robot, wire, "127.0.0.1", "5.22", 1, live=False, bus=bus)
    assert isinstance(refused.value, UsageError | ConnectionFailedError)
