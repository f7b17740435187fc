"""What serial servos ask of their line, and what `dynid check` says of it before anything is opened."""

from __future__ import annotations

from functools import partial

from drivers.base import DriverSettings
from drivers.bus_budget import Budget, FrameGroup
from drivers.serial_port import BITS_A_BYTE
from drivers.serial_servos.bus import PROTOCOLS, ServoBus
from drivers.serial_servos.line import ServoLine
from drivers.serial_servos.settings import ServoSettings, parse_settings
from drivers.serial_servos.setup import USUAL_TIMER


def servo_budget(connection: DriverSettings, driver: str) -> Budget:
    """Return what a connection to servos asks of its line."""
    settings = _parsed(connection, driver)
    bus, motors = ServoBus(settings), settings.motors
    protocol, (address, size), count = bus.line.protocol, bus.block, len(motors)
    ids = [motor.id for motor in motors]

    def group(meaning: str, number: int, data: int, length: int) -> FrameGroup:
        return FrameGroup(meaning, number, data, length * BITS_A_BYTE)

    if all(motor.table.sync_read for motor in motors):
        request = len(protocol.sync_read(address, size, ids))
        cycle = [group("request to all", 1, count, request), group("answers", count, size, protocol.answer_size(size))]
    else:
        request = len(protocol.read(ids[0], address, size))
        cycle = [group("requests", count, 2, request), group("answers", count, size, protocol.answer_size(size))]
    if not settings.keys.read_only:
        goal = motors[0].table.registers["goal_position"].size
        written = len(protocol.sync_write(0, dict.fromkeys(ids, bytes(goal))))
        asked = len(protocol.read(ids[0], 0, 1)) + protocol.answer_size(1)
        cycle += [group("goals", 1, count * goal, written), group("watching the torque", 1, 1, asked)]
    return Budget(
        settings.keys.baudrate, settings.keys.rate, tuple(cycle), (), "without the pauses of servos and adapter"
    )


def servo_advice(connection: DriverSettings, driver: str) -> list[str]:
    """Return what to mind of a connection to servos, one line each."""
    settings, said = _parsed(connection, driver), []
    timer = ServoLine(settings.url, settings.keys.baudrate, ServoBus(settings).line.protocol).latency_timer()
    if timer is not None and timer > USUAL_TIMER:
        said.append(
            f"the adapter at {settings.url} delivers bytes only every {timer} ms: write 1 into its latency_timer"
        )
    if any(motor.assumed_zero for motor in settings.motors):
        said.append("no calibration: the middle of a servo's turn is used as its joint's zero (docs/serial-servos.md)")
    return said


def _parsed(settings: DriverSettings, driver: str) -> ServoSettings:
    return parse_settings(settings.connection, settings.joints, settings.folder, driver)


feetech_budget, dynamixel_budget = (partial(servo_budget, driver=name) for name in PROTOCOLS)
feetech_advice, dynamixel_advice = (partial(servo_advice, driver=name) for name in PROTOCOLS)
