"""Register tables of servo models: addresses, units and signs, read from the data files beside this module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from drivers.core.errors import UsageError
from drivers.core.text import did_you_mean
from drivers.core.units import TURN
from drivers.core.validation import load_yaml

_MINUTE = 60.0


@dataclass(frozen=True)
class Register:
    """One entry of a servo's memory."""

    name: str  # of the entry
    address: int  # of its first byte
    size: int  # number of bytes
    eeprom: bool = False  # whether it outlives the power; never written without `--configure`
    scale: float = 1.0  # of one count, in SI units (rad, rad/s, rad/s², V, A, °C, s, or a share)
    sign: str | int = "none"  # "none", "two's complement", or the number of the bit that says the sign of a magnitude
    big_endian: bool = False  # whether the high byte comes first

    def decoded(self, data: bytes) -> int:
        """The counts, with their sign, in bytes read from the register."""
        raw = int.from_bytes(data[: self.size], "big" if self.big_endian else "little")
        if isinstance(self.sign, int):
            bit = 1 << self.sign
            return -(raw & (bit - 1)) if raw & bit else raw & (bit - 1)
        if self.sign == "two's complement" and raw >= 1 << (8 * self.size - 1):
            return raw - (1 << 8 * self.size)
        return raw

    def encoded(self, counts: int) -> bytes:
        """The bytes of signed counts.

        Raises:
            ValueError: they do not fit.
        """
        least, most = self.bounds
        if not least <= counts <= most:
            raise ValueError(f"{self.name}: {counts} is not within {least} to {most}")
        if isinstance(self.sign, int):
            counts = abs(counts) | (1 << self.sign if counts < 0 else 0)
        return (counts % (1 << 8 * self.size)).to_bytes(self.size, "big" if self.big_endian else "little")

    @property
    def bounds(self) -> tuple[int, int]:
        """Least and largest counts that it can hold."""
        if isinstance(self.sign, int):
            return 1 - (1 << self.sign), (1 << self.sign) - 1
        half = 1 << (8 * self.size - 1)
        return (-half, half - 1) if self.sign == "two's complement" else (0, 2 * half - 1)


@dataclass(frozen=True)
class Indirect:
    """Bytes of a servo's memory in which it shows others, wherever those are."""

    address: int  # of the first of the words that say which byte is shown
    data: int  # where the first of them is shown
    count: int  # of words, and bytes


@dataclass(frozen=True)
class ServoTable:
    """What the documents say of a servo model."""

    model: str  # its name in robot files
    protocol: str  # "feetech" or "dynamixel"
    number: int  # that it answers as its model
    steps: int  # of its encoder in a turn
    registers: Mapping[str, Register]  # by name
    feedback: Mapping[str, str]  # registers that are recorded, by the quantity of the recording; contiguous in memory
    errors: Mapping[int, str]  # bit of its status → what it means
    sync_read: bool  # whether one request reads all servos
    fast_sync_read: bool  # whether their answers may come as one packet
    magnitudes: frozenset[str]  # quantities of the feedback without a sign
    documents: Mapping[str, str]  # what says so
    indirect: Indirect | None = None  # where it shows bytes from all over its memory; None where it does not

    @property
    def gathered(self) -> dict[str, int]:
        """Registers that are read in a motion where it shows them side by side, and how far behind the first byte."""
        places, size = dict[str, int](), 0
        for name in ("torque_enable", *self.feedback.values()):
            places[name] = size
            size += self.registers[name].size
        return places

    @property
    def gathered_bytes(self) -> list[int]:
        """Addresses of their bytes."""
        entries = (self.registers[name] for name in self.gathered)
        return [place for entry in entries for place in range(entry.address, entry.address + entry.size)]

    @property
    def block(self) -> tuple[int, int]:
        """First address and number of bytes that hold the whole feedback."""
        entries = [self.registers[name] for name in self.feedback.values()]
        first = min(entry.address for entry in entries)
        return first, max(entry.address + entry.size for entry in entries) - first

    def error_words(self, bits: int) -> list[str]:
        """Return what the bits of a status mean."""
        return [words for bit, words in self.errors.items() if bits >> bit & 1]


def known_models() -> tuple[str, ...]:
    """Names of the models with a table."""
    names = (entry.name for entry in (files(__package__) / "tables").iterdir())
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


@cache
def servo_table(model: str) -> ServoTable:
    """The table of a model.

    Raises:
        UsageError: there is none; names those that there are.
    """
    models = known_models()
    if model not in models:
        hint = f"known: {', '.join(models)}; {did_you_mean(model, models)}".rstrip("; ")
        raise UsageError(f"no servo model is called '{model}'", hint=hint)
    content = load_yaml((files(__package__) / "tables" / f"{model}.yaml").read_text("utf-8"))
    steps, big_endian = content["steps"], content.get("big_endian", False)
    units = {
        "step": TURN / steps,
        "step/s": TURN / steps,
        "step/s²": TURN / steps,
        "rev/min": TURN / _MINUTE,
        "rev/min²": TURN / _MINUTE**2,
    }
    registers = {}
    for name, entry in content["registers"].items():
        scale = entry.get("scale", 1.0) * units.get(entry.get("unit", ""), 1.0)
        sign = entry.get("sign", "none")
        registers[name] = Register(
            name, entry["address"], entry["size"], entry.get("eeprom", False), scale, sign, big_endian
        )
    return ServoTable(
        model,
        content["protocol"],
        content["number"],
        steps,
        registers,
        content["feedback"],
        content["errors"],
        content.get("sync_read", True),
        content.get("fast_sync_read", False),
        frozenset(content.get("magnitudes", ())),
        content["documents"],
        Indirect(**content["indirect"]) if "indirect" in content else None,
    )
