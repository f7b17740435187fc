"""Error codes in words: EMCY (CiA 301, 7.2.7; CiA 402-1) and SDO abort codes (CiA 301, 7.2.4.3)."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

_EMCY = struct.Struct("<HB5s")

MASTER_MISSED = 0x8130
"""Error code of a node that misses the heartbeat or the guarding that it watches."""

HOW_TO_RESET = "remove the cause, then reset the fault: dynid check ROBOT --connect --reset-faults"
"""What to do about a drive in fault."""

# The most specific entry counts: whole code, then its upper three digits, two, one.
_ERROR_CODES: Mapping[int, str] = {
    0x0000: "error cleared",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current on the device's input side",
    0x2110: "short circuit or earth leakage on the input side",
    0x2200: "current inside the device",
    0x2300: "current on the device's output side",
    0x2310: "continuous over-current on the output side",
    0x2320: "short circuit or earth leakage on the output side",
    0x2330: "earth leakage on the output side",
    0x2340: "short circuit of the phases",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "mains phase failure",
    0x3200: "voltage inside the device",
    0x3210: "over-voltage of the DC link",
    0x3220: "under-voltage of the DC link",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4110: "ambient temperature too high",
    0x4120: "ambient temperature too low",
    0x4200: "device temperature",
    0x4210: "device temperature too high",
    0x4220: "device temperature too low",
    0x4300: "drive temperature",
    0x4310: "drive temperature too high",
    0x4320: "drive temperature too low",
    0x4400: "temperature of the supply",
    0x4410: "temperature of the supply too high",
    0x5000: "device hardware",
    0x5100: "supply of the device's electronics",
    0x5200: "measuring or control hardware",
    0x5400: "power section",
    0x5440: "contactors",
    0x5500: "memory",
    0x6000: "device software",
    0x6100: "internal software",
    0x6200: "user software",
    0x6300: "data record",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7100: "power module",
    0x7110: "brake chopper",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7300: "sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed sensor",
    0x7320: "position sensor",
    0x7380: "position encoder",
    0x7500: "communication module",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun: frames lost",
    0x8120: "CAN error passive",
    MASTER_MISSED: "heartbeat or life guarding missed",
    0x8140: "recovered from bus-off",
    0x8150: "two devices send one identifier",
    0x8200: "protocol error",
    0x8210: "PDO too short to be used",
    0x8220: "PDO longer than mapped",
    0x8240: "SYNC of unexpected length",
    0x8250: "RPDO missed",
    0x8300: "torque control",
    0x8311: "torque too high",
    0x8400: "velocity control",
    0x8500: "position control",
    0x8600: "positioning",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "SYNC control: SYNC missed or not regular",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "manufacturer's own error",
}

_REGISTER_BITS = ("generic", "current", "voltage", "temperature", "communication", "profile", "", "manufacturer's own")
"""Bits of the error register 0x1001."""


@dataclass(frozen=True)
class Emergency:
    """An emergency message."""

    code: int  # error code; 0 where the error is gone
    register: int  # error register
    detail: bytes  # five bytes of the manufacturer's own

    @property
    def cleared(self) -> bool:
        """Return whether it says that an error is gone."""
        return self.code & 0xFF00 == 0

    def __str__(self) -> str:
        if self.cleared:
            return "error cleared (EMCY 0x0000)"
        own = f", manufacturer's bytes {self.detail.hex(' ')}" if any(self.detail) else ""
        words = register_words(self.register)
        register = f", register: {words}" if words else ""
        return f"{describe_error(self.code)} (EMCY 0x{self.code:04X}{register}{own})"


def register_words(register: int) -> str:
    """The bits of the error register (0x1001) in words; empty where none is set."""
    return ", ".join(word for bit, word in enumerate(_REGISTER_BITS) if word and register >> bit & 1)


def decode_emergency(data: bytes) -> Emergency | None:
    """An EMCY frame; None where it is not eight bytes long."""
    return Emergency(*_EMCY.unpack(data)) if len(data) == _EMCY.size else None


def describe_error(code: int) -> str:
    """An error code in words, as exactly as the standard knows it."""
    if code & 0xFF00 == 0xFF00:
        return f"{_ERROR_CODES[0xFF00]} {code & 0xFF:02X}"
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        register = code & mask
        if register in _ERROR_CODES and (register or code <= 0xFF):
            return _ERROR_CODES[register]
    return "unknown error"


_NOT_THERE = "the drive does not have this object; is it the drive that the robot file describes?"
_STATE = "the drive's state does not allow it now; switch it off and on"
_VALUE = "the drive does not allow this value"
_AGAIN = "try again; check wiring and termination"

_ABORT_CODES: Mapping[int, tuple[str, str]] = {
    0x05030000: ("toggle bit not alternated", _AGAIN),
    0x05040000: ("the transfer timed out", _AGAIN),
    0x05040001: ("unknown SDO command", "does another master talk to this node?"),
    0x05040005: ("the drive is out of memory", _STATE),
    0x06010000: ("access not supported", "the drive's manufacturer fixes this object"),
    0x06010001: ("the object can only be written", "the drive's manufacturer fixes this object"),
    0x06010002: ("the object can only be read", "the drive's manufacturer fixes this object"),
    0x06020000: ("the object does not exist", _NOT_THERE),
    0x06040041: ("the object cannot be mapped into a PDO", "this drive cannot deliver what dynid needs in a PDO"),
    0x06040042: ("the objects do not fit into the PDO", "this drive cannot deliver what dynid needs in a PDO"),
    0x06040043: ("incompatible parameters", _VALUE),
    0x06040047: ("incompatible inside the device", _VALUE),
    0x06060000: ("a hardware error in the drive", "switch it off and on; see the manufacturer's manual"),
    0x06070010: ("the length does not match", _NOT_THERE),
    0x06070012: ("the value is too long", _NOT_THERE),
    0x06070013: ("the value is too short", _NOT_THERE),
    0x06090011: ("the subindex does not exist", _NOT_THERE),
    0x06090030: ("the value is out of range", _VALUE),
    0x06090031: ("the value is too high", _VALUE),
    0x06090032: ("the value is too low", _VALUE),
    0x060A0023: ("a resource is not available", _STATE),
    0x08000000: ("general error", _STATE),
    0x08000020: ("the value cannot be stored", _STATE),
    0x08000021: (
        "local control keeps the value from being stored",
        "end the manufacturer's own tool that controls the drive",
    ),
    0x08000022: ("the drive's state keeps the value from being stored", _STATE),
    0x08000023: ("the drive has no object dictionary", _NOT_THERE),
    0x08000024: ("no data", _STATE),
}
NOT_THERE = frozenset({0x06010000, 0x06010001, 0x06010002, 0x06020000, 0x06090011})
"""Abort codes of an object that is missing or fixed: no harm where it is optional."""
VALUE_REFUSED = frozenset({0x06090030, 0x06090031, 0x06090032})
"""Abort codes of an object that does not take this value."""


def describe_abort(code: int) -> tuple[str, str]:
    """An SDO abort code in words, and what to do."""
    words, hint = _ABORT_CODES.get(code, ("refused", "see the manufacturer's manual"))
    return f"{words} (abort code 0x{code:08X})", hint
