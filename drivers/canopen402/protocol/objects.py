"""Objects of CiA 301 and CiA 402 that are used: index, meaning, size; and the PDO mapping of this driver."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True)
class DriveObject:
    """An entry of a drive's object dictionary."""

    # index, subindex: of the entry
    index: int
    subindex: int
    size: int  # [bytes]
    signed: bool  # whether the number may be negative
    name: str  # in words

    def __str__(self) -> str:
        number = f"0x{self.index:04X}" + (f":{self.subindex}" if self.subindex else "")
        return f"{number} ({self.name})"

    @property
    def mapping(self) -> int:
        """Return its entry in a PDO's mapping (CiA 301, 7.5.2.36): index, subindex, length [bit]."""
        return self.index << 16 | self.subindex << 8 | 8 * self.size

    def decode(self, data: bytes) -> int:
        """The number in an SDO's answer; a drive may send more bytes than the object has."""
        return int.from_bytes(data[: self.size], "little", signed=self.signed)

    def encode(self, value: int) -> bytes:
        """The bytes of a number.

        Raises:
            OverflowError: it does not fit.
        """
        return value.to_bytes(self.size, "little", signed=self.signed)


DEVICE_TYPE = DriveObject(0x1000, 0, 4, False, "device type")
ERROR_REGISTER = DriveObject(0x1001, 0, 1, False, "error register")
CYCLE_PERIOD = DriveObject(0x1006, 0, 4, False, "communication cycle period")
DEVICE_NAME = DriveObject(0x1008, 0, 0, False, "device name")
FIRMWARE = DriveObject(0x100A, 0, 0, False, "software version")
GUARD_TIME = DriveObject(0x100C, 0, 2, False, "guard time")
LIFE_TIME_FACTOR = DriveObject(0x100D, 0, 1, False, "life time factor")
CONSUMER_HEARTBEAT = DriveObject(0x1016, 0, 1, False, "consumer heartbeat time")
"""Its number of entries; each entry, from subindex 1 on, has 4 bytes: node id · 2¹⁶ + time [ms]."""
HEARTBEAT_TIME = DriveObject(0x1017, 0, 2, False, "producer heartbeat time")
VENDOR = DriveObject(0x1018, 1, 4, False, "vendor")
PRODUCT = DriveObject(0x1018, 2, 4, False, "product code")
REVISION = DriveObject(0x1018, 3, 4, False, "revision")
SERIAL = DriveObject(0x1018, 4, 4, False, "serial number")
ERROR_BEHAVIOUR = DriveObject(0x1029, 1, 1, False, "error behaviour after communication errors")

ABORT_OPTION = DriveObject(0x6007, 0, 2, True, "abort connection option")
ERROR_CODE = DriveObject(0x603F, 0, 2, False, "error code")
CONTROLWORD = DriveObject(0x6040, 0, 2, False, "controlword")
STATUSWORD = DriveObject(0x6041, 0, 2, False, "statusword")
QUICK_STOP_OPTION = DriveObject(0x605A, 0, 2, True, "quick stop option")
MODE = DriveObject(0x6060, 0, 1, True, "mode of operation")
MODE_DISPLAY = DriveObject(0x6061, 0, 1, True, "mode of operation display")
FOLLOWING_ERROR_WINDOW = DriveObject(0x6065, 0, 4, False, "following error window")
POSITION = DriveObject(0x6064, 0, 4, True, "actual position")
VELOCITY = DriveObject(0x606C, 0, 4, True, "actual velocity")
TARGET_TORQUE = DriveObject(0x6071, 0, 2, True, "target torque")
MAX_TORQUE = DriveObject(0x6072, 0, 2, False, "max torque")
RATED_CURRENT = DriveObject(0x6075, 0, 4, False, "rated current")
RATED_TORQUE = DriveObject(0x6076, 0, 4, False, "rated torque")
TORQUE = DriveObject(0x6077, 0, 2, True, "actual torque")
CURRENT = DriveObject(0x6078, 0, 2, True, "actual current")
TARGET_POSITION = DriveObject(0x607A, 0, 4, True, "target position")
HOME_OFFSET = DriveObject(0x607C, 0, 4, True, "home offset")
LOWEST_POSITION = DriveObject(0x607D, 1, 4, True, "software position limit, lowest")
HIGHEST_POSITION = DriveObject(0x607D, 2, 4, True, "software position limit, highest")
MAX_PROFILE_VELOCITY = DriveObject(0x607F, 0, 4, False, "max profile velocity")
PROFILE_VELOCITY = DriveObject(0x6081, 0, 4, False, "profile velocity")
PROFILE_ACCELERATION = DriveObject(0x6083, 0, 4, False, "profile acceleration")
PROFILE_DECELERATION = DriveObject(0x6084, 0, 4, False, "profile deceleration")
QUICK_STOP_DECELERATION = DriveObject(0x6085, 0, 4, False, "quick stop deceleration")
ENCODER_INCREMENTS = DriveObject(0x608F, 1, 4, False, "encoder increments")
ENCODER_TURNS = DriveObject(0x608F, 2, 4, False, "motor revolutions of the encoder increments")
GEAR_MOTOR_TURNS = DriveObject(0x6091, 1, 4, False, "motor revolutions of the gear")
GEAR_SHAFT_TURNS = DriveObject(0x6091, 2, 4, False, "shaft revolutions of the gear")
INTERPOLATION_PERIOD = DriveObject(0x60C2, 1, 1, False, "interpolation time period")
INTERPOLATION_INDEX = DriveObject(0x60C2, 2, 1, True, "interpolation time index")
SUPPORTED_MODES = DriveObject(0x6502, 0, 4, False, "supported drive modes")


class AbortOption(IntEnum):
    """What a drive does that loses its connection: object 0x6007 (CiA 402-2)."""

    NOTHING = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


PROFILE_402 = 402
"""Low half of the device type of a drive (CiA 402-2)."""

MODE_PROFILE_POSITION = 1
MODE_CYCLIC_POSITION = 8
MODE_CYCLIC_TORQUE = 10
MODE_NAMES = {
    0: "none",
    MODE_PROFILE_POSITION: "profile position",
    3: "profile velocity",
    4: "torque profile",
    6: "homing",
    7: "interpolated position",
    MODE_CYCLIC_POSITION: "cyclic synchronous position",
    9: "cyclic synchronous velocity",
    MODE_CYCLIC_TORQUE: "cyclic synchronous torque",
}
"""CiA 402-2, object 0x6060."""


def mode_words(mode: int) -> str:
    """A mode of operation, such as "8 (cyclic synchronous position)"."""
    return f"{mode} ({MODE_NAMES.get(mode, 'of the manufacturer' if mode < 0 else 'reserved')})"


# Predefined connection set (CiA 301, 7.3.5): function code plus node id.
NMT = 0x000
SYNC = 0x080
EMCY = 0x080
TPDO1 = 0x180
RPDO1 = 0x200
TPDO2 = 0x280
RPDO2 = 0x300
RPDO_BASES = (RPDO1, RPDO2, 0x400, 0x500)
SDO_ANSWER = 0x580
SDO_REQUEST = 0x600
HEARTBEAT = 0x700
GUARDING_TOGGLE = 0x80
"""Bit of a drive's answer to node guarding; a heartbeat does not have it (CiA 301, 7.2.8.3.2)."""

NMT_START = 0x01
NMT_PRE_OPERATIONAL = 0x80
STATE_BOOT_UP, STATE_STOPPED, STATE_OPERATIONAL, STATE_PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
"""NMT states (CiA 301, 7.2.8.3.2.2)."""
NMT_STATES = {
    STATE_BOOT_UP: "boot-up",
    STATE_STOPPED: "stopped",
    STATE_OPERATIONAL: "operational",
    STATE_PRE_OPERATIONAL: "pre-operational",
}

TPDO_BASES = (TPDO1, TPDO2)
TPDO_OBJECTS = ((STATUSWORD, MODE_DISPLAY, POSITION), (VELOCITY, TORQUE, CURRENT))
"""What each TPDO carries, in order; answered to every SYNC (transmission type 1)."""
RPDO_OBJECTS = (CONTROLWORD, MODE, TARGET_POSITION)
"""What the RPDO carries; applied at the next SYNC."""
