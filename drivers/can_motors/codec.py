"""What every protocol of CAN motors gives: frames to a motor, and what a motor says in its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from drivers.can_motors.tables import MotorFamily, MotorModel

CanFrame = tuple[int, bytes]
"""Identifier, with `drivers.can.bus.EXTENDED` and `REMOTE`, and data."""


@dataclass(frozen=True)
class MotorAddress:
    """A motor as its protocol needs it; all at the motor's own output shaft."""

    id: int  # on the bus
    host: int  # this computer's id, or the identifier that the motor answers on, by the protocol
    family: MotorFamily  # table of its family
    model: MotorModel  # full scale of its frames
    kp: float = 0.0  # of its position loop [N·m/rad]
    kd: float = 0.0  # against velocity [N·m·s/rad]
    torque_limit: float | None = None  # that it keeps, where it keeps one [N·m]; None for its own
    speed_limit: float | None = None  # [rad/s]; None for its own
    current_limit: float | None = None  # [A]; None for its own
    # [s] without a command after which it lets go; None where it shall go on with its last one
    watchdog: float | None = None
    thermistor: bool = False  # whether its windings have one
    temperature_offset: float = 0.0  # added to the byte of its temperature [°C]


@dataclass(frozen=True)
class Answer:
    """What one frame of a motor says."""

    # quantity → value in the motor's own direction, from its own zero [rad, rad/s, N·m, A, °C, V]
    values: Mapping[str, float] = field(default_factory=dict)
    fault: int | None = None  # its code; None where the frame has none
    enabled: bool | None = None  # whether the motor drives; None where the frame does not say
    # number of a register and what it holds; None where the frame is no answer to a reading
    register: tuple[int, float] | None = None
    serial: bytes | None = None  # its serial number


class MotorCodec(ABC):
    """Frames of one motor.

    Attributes:
        motor: as given.
    """

    fd: ClassVar[bool] = False  # whether frames are of CAN FD
    reported: ClassVar[tuple[str, ...]] = ()  # what it reports in every cycle, where that is the same in any case
    keeps: ClassVar[tuple[str, ...]] = ()  # which of torque, speed and current limit it keeps (of `MotorAddress`)
    times_out: ClassVar[bool] = True  # whether a program can make it let go where commands fail to come
    gains: ClassVar[bool] = True  # whether kp and kd are sent, not configured in the motor
    unasked: ClassVar[bool] = False  # whether it may tell where it is without being asked
    answers_goals: ClassVar[bool] = True  # whether it tells where it is after each goal
    takes_torque: ClassVar[bool] = False  # whether it takes torques in place of goals
    roll_call_time: ClassVar[float] = 0.03  # how long [s] answers to a roll call are waited for
    registers: ClassVar[Mapping[str, int]] = {}  # name → number, of those that are read and written here

    def __init__(self, motor: MotorAddress) -> None:
        self.motor = motor

    def quantities(self, *, read_only: bool) -> tuple[str, ...]:
        """Return what it tells in every cycle; first of all `position`."""
        return self.reported

    @abstractmethod
    def poll(self, *, read_only: bool) -> Sequence[CanFrame]:
        """Frames after which it tells them and goes on as before; where `read_only`, nothing is written to it."""

    @abstractmethod
    def goal(self, position: float) -> Sequence[CanFrame]:
        """Frames by which it goes to a position [rad]."""

    def torque(self, torque: float) -> Sequence[CanFrame]:
        """Frames by which it gives a torque [N·m], where it takes any; then they are answered as goals are."""
        raise NotImplementedError(f"{self.motor.family.name} accepts no torque commands")

    def released(self) -> Sequence[CanFrame]:
        """Frames by which it carries nothing and is still read."""
        return self.torque(0.0)

    @abstractmethod
    def enable(self) -> Sequence[CanFrame]:
        """Frames that make it obey goals."""

    @abstractmethod
    def disable(self) -> Sequence[CanFrame]:
        """Frames that make it limp."""

    @abstractmethod
    def clear(self) -> Sequence[CanFrame]:
        """Frames that reset a fault; nothing where its family has none."""

    @abstractmethod
    def parse(self, identifier: int, data: bytes, asked: int | None = None) -> Answer | None:
        """Return what a frame says; None where it is not this motor's, or not understood.

        `asked` is the number of the register that it was asked for last, while its answer is awaited.
        """

    def roll_call(self, *, read_only: bool) -> Sequence[CanFrame]:
        """Frames that every motor with its id answers once; nothing where it has none."""
        return self.poll(read_only=read_only)[:1]

    def present(self, frames: Sequence[CanFrame]) -> int:
        """Return how many motors with its id answered a roll call, by the frames that came then."""
        answers = (self.parse(*frame) for frame in frames)
        return sum(answer is not None and "position" in answer.values for answer in answers)

    def preparation(self) -> Mapping[str, float]:
        """Return what its registers shall hold before it is enabled: its command time-out, its limits, its mode."""
        return {}

    def release(self) -> Mapping[str, float]:
        """Return what its registers hold so that it keeps holding when commands cease."""
        return {}

    def release_frames(self, position: float) -> Sequence[CanFrame]:
        """Frames by which it holds a position [rad] when commands cease."""
        return self.goal(position)

    def slow_poll(self) -> Sequence[CanFrame]:
        """Frames after which it tells what changes slowly, sent to one motor a cycle."""
        return ()

    def read(self, register: str) -> CanFrame:
        """A frame that asks for a register."""
        raise NotImplementedError(f"{self.motor.family.name} tells no {register}")

    def write(self, register: str, value: float) -> CanFrame:
        """A frame that writes a register of its volatile memory."""
        raise NotImplementedError(f"{self.motor.family.name} takes no {register}")


def to_counts(value: float, low: float, high: float, bits: int) -> int:
    """The nearest of 2^bits counts from `low` to `high`; beyond them the last."""
    most = (1 << bits) - 1
    return min(max(round((value - low) * most / (high - low)), 0), most)


def from_counts(counts: int, low: float, high: float, bits: int) -> float:
    """The value of counts of 2^bits from `low` to `high`."""
    return low + counts * (high - low) / ((1 << bits) - 1)
