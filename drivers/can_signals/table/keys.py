"""What the keys of a can_frames connection are made of: frames and bits."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from drivers.can.bus import EXTENDED
from drivers.can_signals.table.bits import FRAME_BITS, FRAME_BYTES
from drivers.can_signals.table.signals import FixedFrame
from drivers.connection_settings import ConnectionSettings, refused

STANDARD_LIMIT = 0x7FF
EXTENDED_LIMIT = 0x1FFFFFFF
ALLOWED_IDENTIFIERS = f"0x0 to 0x{STANDARD_LIMIT:X}, not in quotes; with 'extended: true' up to 0x{EXTENDED_LIMIT:X}"


class IdentifiedKeys(ConnectionSettings):
    """Which frame it is."""

    extended: bool = Field(False, description="whether the identifier has 29 bits")
    id: int = Field(description=ALLOWED_IDENTIFIERS)

    @field_validator("id")
    @classmethod
    def _fits(cls, identifier: int | None, info: ValidationInfo) -> int | None:
        limit = EXTENDED_LIMIT if info.data.get("extended", True) else STANDARD_LIMIT
        if identifier is not None and not 0 <= identifier <= limit:
            raise refused(f"{identifier:#x} is not from 0x0 to 0x{limit:X}")
        return identifier

    @property
    def identifier(self) -> int:
        """The frame's identifier, with `EXTENDED` added to one of 29 bits."""
        return self.id | (EXTENDED if self.extended else 0)


class FrameKeys(IdentifiedKeys):
    """A frame that is sent as it stands."""

    data: str = Field("", description=f'up to {FRAME_BYTES} bytes in hexadecimal, such as "01 0F"; in quotes')

    @field_validator("data")
    @classmethod
    def _bytes(cls, data: str) -> str:
        try:
            count = len(bytes.fromhex(data))
        except ValueError:
            raise refused(f"{data!r} is not hexadecimal") from None
        if count > FRAME_BYTES:
            raise refused(f"has {count} bytes")
        return data

    @property
    def frame(self) -> FixedFrame:
        """The frame."""
        return FixedFrame(self.identifier, bytes.fromhex(self.data))


class BitKeys(ConnectionSettings):
    """Which bits of a frame."""

    start: int = Field(ge=0, le=FRAME_BITS - 1, description="the first bit")
    length: int = Field(ge=1, le=FRAME_BITS, description="[bit]")


class MultiplexerKeys(BitKeys):
    """Bits that say what else is in the frame."""

    byte_order: Literal["little", "big"] | None = Field(None, description="Intel or Motorola; left out, the signal's")
    value: int = Field(ge=0, description="of the multiplexer, 0 or more, with which the signal is in the frame")
