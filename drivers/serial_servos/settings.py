"""The keys of a connection to serial bus servos in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from drivers.connection_settings import ConnectionSettings, Text, read_settings, refused, require_motor_per_joint
from drivers.core.errors import UsageError
from drivers.core.units import TURN
from drivers.serial_servos.joint_map import JointScale, MotorCalibration, read_calibration, scale_of
from drivers.serial_servos.registers import ServoTable, known_models, servo_table

OnStop = Literal["hold", "limp"]


class ServoMotorKeys(ConnectionSettings):
    """One servo."""

    id: int = Field(ge=0, le=252, description="of the servo on the bus")
    model: str | None = Field(None, description="of the servo; the connection's `model` if absent")
    zero: float | None = Field(None, ge=-1e6, le=1e6, description="[steps] that it reports when the joint is at 0")
    direction: Literal[1, -1] | None = Field(None, description="-1 if it counts against the joint")
    at_lowest: float | None = Field(
        None, ge=-100.0, le=100.0, description="[rad] of the joint at the lowest steps of its calibration"
    )


class ServoKeys(ConnectionSettings):
    """How to reach the servos, and how they move the arm."""

    url: Text = Field(description="a device such as /dev/ttyACM0 or COM3, or a pyserial URL")
    host: Text | None = Field(None, description="the device in place of url; --host gives it")
    baudrate: int = Field(1_000_000, ge=9600, le=10_500_000, description="[bit/s]")
    rate: float = Field(100.0, ge=1.0, le=1000.0, description="[Hz] at which the servos are read and commanded")
    model: str | None = Field(None, description="of servos without their own")
    motors: dict[str, ServoMotorKeys] = Field(description="a mapping of joint → {id: …}")
    calibration: Text | None = Field(None, description="a calibration file of LeRobot, from the robot file's folder")
    turn: float = Field(TURN, ge=0.1, le=10 * TURN, description="[rad] that the steps of a turn cover")
    on_stop: OnStop = Field("hold", description="what the arm does when a motion ends or is stopped")
    torque_limit: float = Field(1.0, ge=0.01, le=1.0, description="share of the full duty cycle, set in the servos")
    acceleration: float | None = Field(
        None, ge=0.1, le=1e4, description="[rad/s²] of the servos' own profile; absent: none, they follow at once"
    )
    speed: float | None = Field(None, ge=0.01, le=100.0, description="[rad/s] of that profile; absent: no limit")
    watchdog: float = Field(
        0.2, ge=0.02, le=2.54, description="[s] without a request after which Dynamixel servos stop by themselves"
    )
    current_sign_bit: int | None = Field(
        None, ge=8, le=15, description="bit of a Feetech servo's current that is its sign; absent: it has none"
    )
    fast_sync_read: bool = Field(True, description="whether Dynamixel servos answer in one packet, where they can")
    configure: bool = Field(False, description="whether EEPROM is written; --configure gives it")
    read_only: bool = Field(False, description="whether nothing is written to any servo")

    @field_validator("motors")
    @classmethod
    def _a_motor_per_joint(cls, motors: dict[str, ServoMotorKeys], info: ValidationInfo) -> dict[str, ServoMotorKeys]:
        require_motor_per_joint(motors, (info.context or {})["joints"], "servo")
        return motors

    @model_validator(mode="after")
    def _models(self) -> Self:
        for name, motor in self.motors.items():
            model = motor.model or self.model
            if model is None:
                raise refused(f"key 'motors.{name}.model' is missing", f"allowed: {', '.join(known_models())}")
            if model not in known_models():
                raise refused(f"no servo model is called {model!r}", f"allowed: {', '.join(known_models())}")
        return self


@dataclass(frozen=True)
class ServoMotor:
    """A servo and its joint."""

    joint: str  # name
    id: int  # on the bus
    table: ServoTable  # of its model
    scale: JointScale  # from steps to the joint
    calibration: MotorCalibration | None  # of LeRobot; None without
    assumed_zero: bool  # whether nothing says where the joint is at 0


@dataclass(frozen=True)
class ServoSettings:
    """A connection's keys, checked."""

    url: str  # of the port
    motors: tuple[ServoMotor, ...]  # in the joints' order, all of one protocol
    keys: ServoKeys  # the others


def parse_settings(
    connection: Mapping[str, object], joints: Sequence[str], folder: Path | None = None, driver: str = "feetech"
) -> ServoSettings:
    """Check a connection's keys.

    A relative `calibration` starts at `folder`, the current folder where None.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed; or the calibration cannot be
            used.
    """
    keys = read_settings(ServoKeys, connection, driver, {"joints": tuple(joints)})
    calibrations: dict[str, MotorCalibration] = {}
    if keys.calibration is not None:
        path = (folder or Path()) / Path(keys.calibration).expanduser()
        calibrations = read_calibration(path)
        if missing := [name for name in joints if name not in calibrations]:
            raise UsageError(f"has no joint {', '.join(missing)}", where=str(path))
    motors = []
    for name in joints:
        motor = keys.motors[name]
        table = servo_table(motor.model or keys.model or "")
        if table.protocol != driver:
            raise UsageError(f"{table.model} of {name} is no {driver} servo", hint=f"driver: {table.protocol}")
        calibration = calibrations.get(name)
        if calibration is not None and calibration.motor != motor.id:
            raise UsageError(
                f"{name} has id {motor.id} here, and {calibration.motor} in {keys.calibration}",
                hint="use the calibration of this arm",
            )
        scale = scale_of(table.steps, calibration, motor.zero, motor.direction, motor.at_lowest, keys.turn)
        motors.append(ServoMotor(name, motor.id, table, scale, calibration, calibration is None and motor.zero is None))
    return ServoSettings(keys.host or keys.url, tuple(motors), keys)
