"""The vendors' own packages read and write the simulated servos: ROBOTIS' dynamixel_sdk, Feetech's scservo_sdk."""

from __future__ import annotations

import dynamixel_sdk
import numpy as np
import pytest
import scservo_sdk
from servo_bench import START, STEP, ServoBench, servos
from simulated_clock import SimulatedClock

from drivers.serial_servos.registers import servo_table

FEETECH, DYNAMIXEL = scservo_sdk.PacketHandler(0), dynamixel_sdk.PacketHandler(2.0)


class SimulatedPort:
    """What both packages want of a port, in simulated time."""

    def __init__(self, bench: ServoBench) -> None:
        self._port, self._clock = bench.port(), bench.clock
        self.is_using, self._end = False, 0.0

    def clearPort(self) -> None:
        self._port.reset_input_buffer()

    def readPort(self, length: int) -> list[int]:
        return list(self._port.read(length)) if length > 0 else []

    def writePort(self, packet: list[int]) -> int:
        return self._port.write(bytes(packet))

    def setPacketTimeout(self, length: int) -> None:
        self._end = self._clock.now() + 0.05

    def isPacketTimeout(self) -> bool:
        return self._clock.now() > self._end


def test_feetech_s_package(clock: SimulatedClock):
    with servos(clock) as bench:
        port = SimulatedPort(bench)
        assert FEETECH.ping(port, 1) == (777, 0, 0)
        assert FEETECH.ping(port, 3)[1] == scservo_sdk.COMM_RX_TIMEOUT
        steps, result, error = FEETECH.read2ByteTxRx(port, 1, 56)
        assert (result, error) == (0, 0)
        assert (steps - 2048) * STEP == pytest.approx(START[0], abs=STEP)
        # Writing, and what it does.
        assert FEETECH.write2ByteTxRx(port, 1, 42, steps + 100) == (0, 0)
        clock.sleep(0.5)
        assert bench.server.plant.arm.position[0] == pytest.approx(START[0] + 100 * STEP, abs=0.03)
        # All at once.
        writing = scservo_sdk.GroupSyncWrite(port, FEETECH, 42, 2)
        for motor, goal in ((1, 1500), (7, 2200)):
            assert writing.addParam(motor, [scservo_sdk.SCS_LOBYTE(goal), scservo_sdk.SCS_HIBYTE(goal)])
        assert writing.txPacket() == 0
        clock.sleep(0.5)
        reading = scservo_sdk.GroupSyncRead(port, FEETECH, 56, 15)
        assert reading.addParam(1)
        assert reading.addParam(7)
        assert reading.txRxPacket() == 0
        told = [(reading.getData(motor, 56, 2), reading.getData(motor, 62, 1)) for motor in (1, 7)]
        assert np.array(told) == pytest.approx(np.array([[1500, 120], [2200, 120]]), abs=20)
        bench.server.servos[1].protect(2)
        assert FEETECH.ping(port, 7) == (777, 0, scservo_sdk.ERRBIT_OVERHEAT)


def test_robotis_package(clock: SimulatedClock):
    with servos(clock, "dynamixel") as bench:
        port = SimulatedPort(bench)
        assert DYNAMIXEL.ping(port, 1) == (1060, 0, 0)
        assert DYNAMIXEL.read2ByteTxRx(port, 7, 144)[:2] == (120, 0)
        # EEPROM is locked while the torque is on.
        assert DYNAMIXEL.write1ByteTxRx(port, 1, 11, 1)[1] & 0x7F == 7
        for fast in (False, True):
            reading = dynamixel_sdk.GroupSyncRead(port, DYNAMIXEL, 124, 23)
            assert reading.addParam(1)
            assert reading.addParam(7)
            assert (reading.fastSyncRead() if fast else reading.txRxPacket()) == 0
            steps = np.array([reading.getData(motor, 132, 4) for motor in (1, 7)])
            assert (steps - 2048) * STEP * [1, -1] == pytest.approx(START, abs=2 * STEP)
        writing = dynamixel_sdk.GroupSyncWrite(port, DYNAMIXEL, 116, 4)
        for motor, goal in ((1, 1500), (7, 0x00FDFFFF)):  # the second has to be stuffed
            assert writing.addParam(motor, list(goal.to_bytes(4, "little")))
        assert writing.txPacket() == 0
        clock.sleep(0.05)
        assert [servo.get("goal_position") for servo in bench.server.servos] == [1500, 0x00FDFFFF]
        bench.server.servos[1].protect(5)
        clock.sleep(0.05)
        assert DYNAMIXEL.read1ByteTxRx(port, 7, 70) == (1 << 5, 0, 0x80)
        assert DYNAMIXEL.reboot(port, 7)[0] == 0
        clock.sleep(0.6)
        assert DYNAMIXEL.read1ByteTxRx(port, 7, 70) == (0, 0, 0)


def test_robotis_package_reads_what_indirect_addresses_gather(clock: SimulatedClock):
    with servos(clock, "dynamixel") as bench:
        port = SimulatedPort(bench)
        words = [place for first, size in ((64, 1), (132, 4), (146, 1)) for place in range(first, first + size)]
        for index, place in enumerate(words):
            assert DYNAMIXEL.write2ByteTxRx(port, 1, 168 + 2 * index, place)[1] & 0x7F == 7  # while the torque is on
        for motor in (1, 7):
            assert DYNAMIXEL.write1ByteTxRx(port, motor, 64, 0) == (0, 0)
            for index, place in enumerate(words):
                assert DYNAMIXEL.write2ByteTxRx(port, motor, 168 + 2 * index, place) == (0, 0)
        at = {1: servo_table("xl430-w250").indirect.data, 7: servo_table("xl330-m288").indirect.data}
        for fast in (False, True):
            reading = dynamixel_sdk.GroupBulkRead(port, DYNAMIXEL)
            for motor, data in at.items():
                assert reading.addParam(motor, data, len(words))
            assert (reading.fastBulkRead() if fast else reading.txRxPacket()) == 0
            steps = np.array([reading.getData(motor, data + 1, 4) for motor, data in at.items()])
            assert (steps - 2048) * STEP * [1, -1] == pytest.approx(START, abs=0.1)  # it falls meanwhile
            assert [reading.getData(motor, data, 1) for motor, data in at.items()] == [0, 0]
