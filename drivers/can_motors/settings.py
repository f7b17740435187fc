"""The keys of a connection to CAN motors in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from drivers.can.settings import CanSettings
from drivers.can_motors.codec import MotorAddress, MotorCodec
from drivers.can_motors.mit import CubemarsCodec, DamiaoCodec
from drivers.can_motors.moteus import MoteusCodec
from drivers.can_motors.odrive import OdriveCodec
from drivers.can_motors.robstride import RobstrideCodec
from drivers.can_motors.tables import motor_family
from drivers.connection_settings import ConnectionSettings, read_settings, refused, require_motor_per_joint
from drivers.core.arrays import FloatArray

CODECS: Mapping[str, type[MotorCodec]] = {
    "damiao": DamiaoCodec,
    "robstride": RobstrideCodec,
    "cubemars": CubemarsCodec,
    "moteus": MoteusCodec,
    "odrive": OdriveCodec,
}
HOSTS = {"robstride": 0xFD, "cubemars": 0, "moteus": 0, "odrive": 0}
"""This computer's id, or what motors answer on, where the file names none; Damiao motors answer on id + 16."""
DAMIAO_HOST = 0x10
MOST_ID = {"damiao": 0x7FE, "robstride": 0x7F, "cubemars": 0x7F, "moteus": 0x7F, "odrive": 0x3E}
OnStop = Literal["hold", "limp"]


class MotorKeys(ConnectionSettings):
    """One motor."""

    id: int = Field(ge=0, le=0x7FE, description="of the motor on the bus")
    answers_on: int | None = Field(
        None, ge=0, le=0x7FF, description="identifier that it answers on (Damiao: its master id; CubeMars)"
    )
    model: str | None = Field(None, description="of the motor; the connection's `model` if absent")
    zero: float = Field(0.0, ge=-1e4, le=1e4, description="[rad] that it reports when the joint is at 0")
    direction: Literal[1, -1] = Field(1, description="-1 if it counts against the joint")
    ratio: float = Field(1.0, ge=1e-3, le=1e4, description="turns of the motor's output shaft per turn of the joint")
    kp: float | None = Field(None, ge=0.0, le=1e6, description="[N·m/rad] of the joint: the spring to its goal")
    kd: float | None = Field(None, ge=0.0, le=1e5, description="[N·m·s/rad] of the joint: the damper")
    torque_limit: float | None = Field(None, ge=0.01, le=1e4, description="[N·m] of the joint, set in the motor")
    speed_limit: float | None = Field(None, ge=0.01, le=1e3, description="[rad/s] of the joint, set in the motor")
    current_limit: float | None = Field(None, ge=0.01, le=1e3, description="[A], set in the motor")
    velocity_range: float | None = Field(
        None, ge=0.1, le=1e3, description="[rad/s] of full scale, instead of the table's"
    )
    torque_range: float | None = Field(None, ge=0.1, le=1e4, description="[N·m] of full scale, instead of the table's")
    thermistor: bool = Field(False, description="whether a moteus reads one in the motor's windings")


class CanMotorKeys(CanSettings):
    """The bus, the motors on it, and how they move the arm."""

    rate: float = Field(200.0, ge=1.0, le=2000.0, description="[Hz] at which the motors are read and commanded")
    model: str | None = Field(None, description="of motors without their own")
    motors: dict[str, MotorKeys] = Field(description="a mapping of joint → {id: …}")
    host_id: int | None = Field(None, ge=0, le=0xFF, description="this computer's id (RobStride, moteus)")
    kp: float | None = Field(None, ge=0.0, le=1e6, description="[N·m/rad] of joints without their own")
    kd: float | None = Field(None, ge=0.0, le=1e5, description="[N·m·s/rad] of joints without their own")
    on_stop: OnStop = Field("hold", description="what the arm does when a motion ends or is stopped")
    when_lost: OnStop | None = Field(
        None, description="what it does when commands stop, by the motors' command time-out; as on_stop"
    )
    watchdog: float = Field(0.1, ge=0.01, le=10.0, description="[s] without a command after which motors go limp")
    temperature_offset: float = Field(0.0, ge=-100.0, le=100.0, description="[°C] added to a CubeMars' temperature")
    data_bitrate: int = Field(5_000_000, ge=100_000, le=8_000_000, description="[bit/s] of CAN FD's data (moteus)")
    read_only: bool = Field(False, description="whether nothing is written to any motor")
    reset_faults: bool = Field(False, description="whether opening resets faults of motors; --reset-faults gives it")

    @field_validator("motors")
    @classmethod
    def _a_motor_per_joint(cls, motors: dict[str, MotorKeys], info: ValidationInfo) -> dict[str, MotorKeys]:
        context = info.context or {}
        require_motor_per_joint(motors, context["joints"], "motor")
        for name, motor in motors.items():
            if motor.id > MOST_ID[context["family"]]:
                raise refused(f"{name} has id {motor.id}", f"allowed: at most {MOST_ID[context['family']]}")
        if context["family"] == "damiao":
            _require_own_answers(motors)
        return motors

    @model_validator(mode="after")
    def _motors_fit(self, info: ValidationInfo) -> Self:
        family = motor_family((info.context or {})["family"])
        codec = CODECS[family.name]
        for name, motor in self.motors.items():
            model = motor.model or self.model or (next(iter(family.models)) if len(family.models) == 1 else None)
            allowed = f"allowed: {', '.join(family.models)}"
            if model is None:
                raise refused(f"key 'motors.{name}.model' is missing", allowed)
            if model not in family.models:
                raise refused(f"no {family.name} motor is called {model!r}", allowed)
            for limit in ("torque_limit", "speed_limit", "current_limit"):
                if getattr(motor, limit) is not None and limit not in codec.keeps:
                    kept = ", ".join(codec.keeps) or "none"
                    raise refused(f"{name}: a {family.name} motor accepts no {limit}", f"it accepts: {kept}")
            if motor.thermistor and family.name != "moteus":
                raise refused(f"{name}: only moteus controllers have 'thermistor'")
            scale = family.models[model]
            for gain, most in (("kp", scale.kp), ("kd", scale.kd)):
                value = getattr(motor, gain) if getattr(motor, gain) is not None else getattr(self, gain)
                if value is None and not self.read_only:
                    whose = "the motor's spring and damper" + ("" if codec.gains else ", as its controller has them")
                    raise refused(f"key 'motors.{name}.{gain}' is missing", whose)
                if value is not None and most is not None and value / motor.ratio**2 > most:
                    raise refused(
                        f"{name}: {gain} {value:g} is more than its motor allows", f"{model}: at most {most:g}"
                    )
        if self.when_lost == "limp" and not codec.times_out:
            raise refused(f"when_lost: limp cannot be commanded: {family.name} motors have no programmable time-out")
        return self


def _require_own_answers(motors: Mapping[str, MotorKeys]) -> None:
    """Damiao motors say in their answers the last four bits of their ids alone."""
    owners: dict[tuple[int, int], str] = {}
    for name, motor in motors.items():
        answer = motor.id + DAMIAO_HOST if motor.answers_on is None else motor.answers_on, motor.id & 0x0F
        if answer in owners:
            raise refused(
                f"answers of {owners[answer]} and {name} are alike: on {answer[0]}, ids that end in the same four bits",
                "give one of them another master id (answers_on)",
            )
        owners[answer] = name


@dataclass(frozen=True)
class CanMotor:
    """A motor and its joint."""

    joint: str  # name
    model: str  # of its table
    zero: float  # [rad] that the motor reports where the joint is at 0
    direction: int  # 1, or −1 where it counts against the joint
    ratio: float  # turns of the motor's output shaft per turn of the joint
    address: MotorAddress  # what its protocol needs, at the motor's output shaft

    @property
    def id(self) -> int:
        """Return its identifier on the bus."""
        return self.address.id

    @property
    def name(self) -> str:
        """Return its name in messages."""
        return f"{self.joint} (id {self.id})"

    def to_joint(self, quantity: str, value: float) -> float:
        """A quantity of the joint, of the motor's."""
        match quantity:
            case "position":
                return self.direction * (value - self.zero) / self.ratio
            case "velocity":
                return self.direction * value / self.ratio
            case "torque":
                return self.direction * value * self.ratio
            case "current":
                return self.direction * value
        return value

    def goal(self, position: float) -> float:
        """The motor's position [rad] of a joint's [rad]."""
        return self.zero + self.direction * self.ratio * position


@dataclass(frozen=True)
class CanMotorSettings:
    """A connection's keys, checked."""

    family: str  # name of the motors' family
    motors: tuple[CanMotor, ...]  # in the joints' order
    keys: CanMotorKeys  # the others

    @property
    def where(self) -> str:
        """The bus in messages."""
        return f"{self.keys.interface} {self.keys.channel}"

    @property
    def when_lost(self) -> OnStop:
        """Return what the arm does where commands fail to come."""
        if not CODECS[self.family].times_out:
            return "hold"
        return self.keys.when_lost or self.keys.on_stop

    def gains(self) -> dict[str, FloatArray]:
        """`gain_p` and `gain_d` (n,) of the joints, where this connection moves them."""
        if self.keys.read_only:
            return {}
        ratios = np.array([motor.ratio for motor in self.motors]) ** 2
        kp, kd = np.array([[motor.address.kp, motor.address.kd] for motor in self.motors]).T
        return {"gain_p": kp * ratios, "gain_d": kd * ratios}

    def codecs(self) -> list[MotorCodec]:
        """One a motor, in the joints' order."""
        return [CODECS[self.family](motor.address) for motor in self.motors]


def parse_settings(connection: Mapping[str, object], joints: Sequence[str], family: str) -> CanMotorSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed.
    """
    keys = read_settings(CanMotorKeys, connection, family, {"joints": tuple(joints), "family": family})
    settings = CanMotorSettings(family, (), keys)
    table = motor_family(family)
    watchdog = keys.watchdog if settings.when_lost == "limp" else None

    def motor(joint: str) -> CanMotor:
        own = keys.motors[joint]
        model = own.model or keys.model or next(iter(table.models))
        scale = table.models[model]
        scale = replace(scale, velocity=own.velocity_range or scale.velocity, torque=own.torque_range or scale.torque)
        host = own.id + DAMIAO_HOST if family == "damiao" else HOSTS[family]
        host = host if keys.host_id is None or family == "damiao" else keys.host_id
        address = MotorAddress(
            own.id,
            host if own.answers_on is None else own.answers_on,
            table,
            scale,
            (own.kp if own.kp is not None else keys.kp or 0.0) / own.ratio**2,
            (own.kd if own.kd is not None else keys.kd or 0.0) / own.ratio**2,
            None if own.torque_limit is None else own.torque_limit / own.ratio,
            None if own.speed_limit is None else own.speed_limit * own.ratio,
            own.current_limit,
            watchdog,
            own.thermistor,
            keys.temperature_offset,
        )
        return CanMotor(joint, model, own.zero, own.direction, own.ratio, address)

    return replace(settings, motors=tuple(motor(joint) for joint in joints))
