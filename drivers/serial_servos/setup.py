"""What servos say of themselves when they are opened, what slows their line, and what `--configure` writes."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, UsageError
from drivers.serial_servos.bus import ServoBus, called
from drivers.serial_servos.control import POSITION_MODE
from drivers.serial_servos.settings import ServoMotor, ServoSettings

READINGS = 5
"""How often the feedback is read to see how long it takes."""
TIGHT = 0.8
"""Share of a period from which on a reading leaves no room."""
USUAL_TIMER = 1
"""[ms] of an adapter that hands bytes on at once."""


@dataclass(frozen=True)
class ServoIdentity:
    """What a servo says of itself."""

    joint: str  # it moves
    id: int  # on the bus
    model: str  # of its table
    supply_voltage: float  # [V]
    temperature: float  # [°C]
    torque_on: bool  # whether its torque is on
    fault: str  # in words; empty without
    return_delay: float  # before an answer [s]
    # homing_offset, min_position, max_position: [steps]
    homing_offset: int
    min_position: int
    max_position: int


def identity(bus: ServoBus, motor: ServoMotor) -> ServoIdentity:
    """Ask a servo.

    Raises:
        ConnectionFailedError: it does not answer, or is another model.
        ConnectionLostError: the port is gone.
    """
    number = bus.read(motor, "model_number")
    if number != motor.table.number:
        raise ConnectionFailedError(
            f"{called(motor)} is a servo of model number {number}, and {motor.table.model} has {motor.table.number}",
            where=bus.line.url,
            hint="correct its `model` in the robot file, or its id",
        )
    registers = motor.table.registers

    def reading(name: str) -> float:
        return bus.read(motor, name) * registers[name].scale

    return ServoIdentity(
        motor.joint,
        motor.id,
        motor.table.model,
        reading("present_voltage"),
        reading("present_temperature"),
        bool(bus.read(motor, "torque_enable")),
        ", ".join(motor.table.error_words(bus.read(motor, "status"))),
        reading("return_delay"),
        bus.read(motor, "homing_offset") if "homing_offset" in registers else 0,
        bus.read(motor, "min_position"),
        bus.read(motor, "max_position"),
    )


def reading_time(bus: ServoBus, clock: Clock) -> float:
    """Return how long [s] one reading of all servos takes: the median of a few.

    Raises:
        ConnectionLostError: the port is gone.
    """
    lasted = []
    for _ in range(READINGS):
        begun = clock.now()
        bus.feedback()
        lasted.append(clock.now() - begun)
    return sorted(lasted)[READINGS // 2]


def slow_reading(bus: ServoBus, settings: ServoSettings, lasted: float) -> list[str]:
    """Return what to do where readings of so long [s] leave no room at the connection's rate; nothing where they do."""
    if lasted < TIGHT / settings.keys.rate:
        return []
    said = [f"one reading of all servos takes {1e3 * lasted:.1f} ms: {settings.keys.rate:g} Hz cannot be reached"]
    timer = bus.line.latency_timer()
    if timer is not None and timer > USUAL_TIMER:
        said.append(
            f"the adapter delivers bytes only every {timer} ms: write 1 into its latency_timer "
            "(/sys/bus/usb-serial/devices/…; with ROBOTIS' U2D2 see its manual)"
        )
    delays = [
        bus.read(motor, "return_delay") * motor.table.registers["return_delay"].scale for motor in settings.motors
    ]
    if settings.motors[0].table.protocol == "dynamixel" and sum(delays) > 0.1 * lasted:
        said.append(
            f"the servos wait {1e6 * max(delays):.0f} µs before they answer (return delay): "
            "dynid check --connect --configure sets it to 0 (in EEPROM)"
        )
    return said


def configure(bus: ServoBus, settings: ServoSettings) -> list[str]:
    """Write into EEPROM what a motion needs: position mode, no return delay, the calibration; says what was changed.

    Torque is switched off for it, so that the arm falls where nothing holds it.

    Raises:
        ConnectionFailedError: a servo does not answer, or does not keep what is written.
        ConnectionLostError: the port is gone.
        UsageError: it cannot hold what the calibration says.
    """
    said, changes = [], []
    for motor in settings.motors:
        wanted = {"return_delay": 0, "operating_mode": POSITION_MODE[motor.table.protocol]}
        if (calibration := motor.calibration) is not None:
            wanted |= {
                "homing_offset": calibration.homing_offset,
                "min_position": calibration.lowest,
                "max_position": calibration.highest,
            }
        wanted = {name: value for name, value in wanted.items() if name in motor.table.registers}
        changed = {name: held for name, value in wanted.items() if (held := bus.read(motor, name)) != value}
        for name in changed:  # before anything is written
            least, most = motor.table.registers[name].bounds
            if not least <= wanted[name] <= most:
                raise UsageError(
                    f"{called(motor)} cannot hold {wanted[name]} as {name}: from {least} to {most}",
                    where=bus.line.url,
                    hint="use the calibration of this arm",
                )
        changes += [(motor, wanted, changed)] if changed else []
    for motor, wanted, changed in changes:
        bus.write(motor, "torque_enable", 0)
        locked = "lock" in motor.table.registers
        if locked:
            bus.write(motor, "lock", 0)
        try:
            for name, held in changed.items():
                bus.write(motor, name, wanted[name], configure=True)
                said.append(f"{called(motor)}: {name} was {held}, is {wanted[name]}")
        finally:
            if locked:
                bus.write(motor, "lock", 1)
    return said
