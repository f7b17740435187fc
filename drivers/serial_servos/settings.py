"""The keys of a connection to serial bus servos in a robot file, and the joint positions that their steps are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from drivers.connection_settings import ConnectionSettings, Text, read_settings, refused, require_motor_per_joint
from drivers.core.errors import UsageError
from drivers.core.files import KB, InputKind, read_text
from drivers.core.text import parsed_json
from drivers.core.units import TURN
from drivers.serial_servos.registers import ServoTable, known_models, servo_table

CALIBRATION = InputKind("a calibration file of LeRobot", 256 * KB)


@dataclass(frozen=True)
class JointScale:
    """Position of a joint = direction · (steps − zero) · turn / steps a turn."""

    zero: float  # steps that the servo reports where the joint is at 0; may lie between two
    direction: int  # 1, or −1 where the servo counts against the joint
    step: float  # [rad] of one

    def position(self, steps: float) -> float:
        """[rad] of the joint."""
        return self.direction * (steps - self.zero) * self.step

    def steps(self, position: float) -> int:
        """The nearest steps of a joint position [rad]."""
        return round(self.zero + self.direction * position / self.step)


@dataclass(frozen=True)
class MotorCalibration:
    """A motor's entry in a calibration file of LeRobot."""

    motor: int  # id of the servo
    reversed: bool  # whether it counts against the joint (`drive_mode`)
    homing_offset: int  # that LeRobot wrote into the servo [steps]
    # lowest, highest: steps between which the joint moves
    lowest: int
    highest: int

    @property
    def middle(self) -> float:
        """Steps in the middle of the range, which LeRobot counts degrees from."""
        return 0.5 * (self.lowest + self.highest)


def read_calibration(path: Path) -> dict[str, MotorCalibration]:
    """The calibration of every motor of a file that `lerobot-calibrate` wrote, by its name.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    text = read_text(path, CALIBRATION, UsageError)
    hint = "such as the files below ~/.cache/huggingface/lerobot/calibration"
    try:
        content = parsed_json(text)
    except ValueError as error:
        raise UsageError(f"is not JSON: {error}", where=str(path), hint=hint) from None
    if not isinstance(content, dict) or not content:
        raise UsageError("is not a calibration: an object with a key per motor is expected", where=str(path), hint=hint)
    return {name: _entry(entry, f"{path}: {name}") for name, entry in content.items()}


def _entry(entry: object, where: str) -> MotorCalibration:
    keys = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
    if not isinstance(entry, dict) or not all(type(entry.get(key)) is int for key in keys):
        raise UsageError(f"needs the integers {', '.join(keys)}", where=where)
    number, mode, offset, lowest, highest = (entry[key] for key in keys)
    if not 0 <= number <= 252 or mode not in (0, 1) or not lowest < highest:
        raise UsageError(
            f"cannot be: id {number}, drive_mode {mode}, range {lowest} to {highest}",
            where=where,
            hint="an id from 0 to 252, a drive_mode of 0 or 1, and an increasing range",
        )
    return MotorCalibration(number, bool(mode), offset, lowest, highest)


def scale_of(
    steps_a_turn: int,
    calibration: MotorCalibration | None = None,
    zero: float | None = None,
    direction: int | None = None,
    at_lowest: float | None = None,
    turn: float = TURN,
) -> JointScale:
    """The scale of a joint; what is given goes before the calibration, and that before the middle of the turn.

    Args:
        steps_a_turn: of the encoder.
        calibration: of LeRobot; its joint is at 0 in the middle of its range, as LeRobot's degrees are.
        zero: steps at which the joint is at 0.
        direction: 1 or −1.
        at_lowest: position [rad] of the joint at the calibration's lowest steps, for one whose 0 is elsewhere.
        turn: [rad] that the steps of a turn cover.
    """
    step = turn / steps_a_turn
    if direction is None:
        direction = -1 if calibration is not None and calibration.reversed else 1
    if zero is None and calibration is not None:
        zero = calibration.middle
        if at_lowest is not None:
            zero = calibration.lowest - direction * at_lowest / step
    return JointScale(steps_a_turn / 2 if zero is None else zero, direction, step)


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
