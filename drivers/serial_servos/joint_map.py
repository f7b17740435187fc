"""Maps a servo's steps to its joint: direction, zero and range; also as LeRobot's calibration files have them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import UsageError
from drivers.core.files import KB, InputKind, read_text
from drivers.core.text import parsed_json
from drivers.core.units import TURN

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
