"""Real-Time Data Exchange, protocol version 2, as functions of bytes (Universal Robots, "RTDE Guide").

A package is a big-endian uint16 size, which counts itself, a uint8 type, and a payload. Data packages carry the
number of an output recipe and its variables one after the other without padding, so that many of them, joined, are an
array of one NumPy structured type.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from drivers.core.errors import ConnectionLostError

PORT = 30004
PROTOCOL_VERSION = 2

REQUEST_PROTOCOL_VERSION = ord("V")
GET_CONTROL_VERSION = ord("v")
TEXT_MESSAGE = ord("M")
DATA_PACKAGE = ord("U")
SETUP_OUTPUTS = ord("O")
SETUP_INPUTS = ord("I")
START = ord("S")
PAUSE = ord("P")

HEADER_SIZE = 3
_HEADER = struct.Struct(">HB")
_TYPES = frozenset(
    (
        REQUEST_PROTOCOL_VERSION,
        GET_CONTROL_VERSION,
        TEXT_MESSAGE,
        DATA_PACKAGE,
        SETUP_OUTPUTS,
        SETUP_INPUTS,
        START,
        PAUSE,
    )
)

NUMPY_TYPES: dict[str, tuple[str, int]] = {
    "BOOL": ("?", 1),
    "UINT8": ("u1", 1),
    "UINT32": (">u4", 1),
    "UINT64": (">u8", 1),
    "INT32": (">i4", 1),
    "DOUBLE": (">f8", 1),
    "VECTOR3D": (">f8", 3),
    "VECTOR6D": (">f8", 6),
    "VECTOR6INT32": (">i4", 6),
    "VECTOR6UINT32": (">u4", 6),
}
"""RTDE's types: NumPy type of an element, and how many."""

REFUSALS = ("NOT_FOUND", "IN_USE")
"""What stands in place of a type where the controller does not have a variable, or does not give it away."""

MESSAGE_LEVELS = ("exception", "error", "warning", "info")


@dataclass(frozen=True)
class Package:
    """One package: its type, and all of its bytes, header included."""

    kind: int
    raw: bytes

    @property
    def payload(self) -> bytes:
        """The bytes after the header."""
        return self.raw[HEADER_SIZE:]


@dataclass(frozen=True)
class Recipe:
    """An output recipe that the controller accepted: its number, and the type of every variable, in order."""

    number: int
    types: tuple[tuple[str, str], ...]

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names, in the order of the package."""
        return tuple(name for name, _ in self.types)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Structured type of a whole data package: `size`, `type`, `recipe`, then the variables by name."""
        fields: list[Any] = [("size", ">u2"), ("type", "u1"), ("recipe", "u1")]
        for name, kind in self.types:
            element, count = NUMPY_TYPES[kind]
            fields.append((name, element) if count == 1 else (name, element, (count,)))
        return np.dtype(fields)


@dataclass(frozen=True)
class RecipeAnswer:
    """What the controller said to a recipe: its number and one type, or refusal, a variable."""

    number: int
    types: tuple[str, ...]


@dataclass(frozen=True)
class TextMessage:
    """A message of the controller to its clients."""

    level: str
    source: str
    text: str


@dataclass(frozen=True)
class ControlVersion:
    """Version of the controller's software."""

    major: int
    minor: int
    bugfix: int = 0
    build: int = 0

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"

    @property
    def maximum_rate(self) -> float:
        """Fastest output [Hz]: 500 since the e-Series (version 5), 125 before."""
        return 500.0 if self.major >= 5 else 125.0


def encode_package(kind: int, payload: bytes = b"") -> bytes:
    """A package of a type with a payload.

    Raises:
        ValueError: the payload does not fit a 16-bit size.
    """
    size = HEADER_SIZE + len(payload)
    if size > 0xFFFF:
        raise ValueError(f"a package has at most 65535 bytes, not {size}")
    return _HEADER.pack(size, kind) + payload


def encode_protocol_request() -> bytes:
    """Ask for protocol version 2."""
    return encode_package(REQUEST_PROTOCOL_VERSION, struct.pack(">H", PROTOCOL_VERSION))


def encode_output_recipe(variables: Sequence[str], rate: float) -> bytes:
    """Ask for variables at a rate [Hz].

    Raises:
        ValueError: a name that would split the list, or none at all.
    """
    if not variables or any(not name or "," in name or not name.isascii() for name in variables):
        raise ValueError(f"not a list of variables: {list(variables)}")
    return encode_package(SETUP_OUTPUTS, struct.pack(">d", rate) + ",".join(variables).encode("ascii"))


def decode_accepted(payload: bytes) -> bool:
    """Return whether the controller agreed (answers to protocol request, start and pause)."""
    return bool(_unpack(">B", payload, "an answer")[0])


def decode_control_version(payload: bytes) -> ControlVersion:
    """The controller's version."""
    return ControlVersion(*_unpack(">IIII", payload, "the controller's version"))


def decode_recipe_answer(payload: bytes, variables: Sequence[str]) -> RecipeAnswer:
    """The answer to an output recipe of these variables.

    Raises:
        ConnectionLostError: it is not one, or names a type that RTDE does not have.
    """
    if not payload:
        raise _broken("the answer to the recipe is empty")
    # Controllers end the list with a comma.
    types = tuple(payload[1:].decode("ascii", errors="replace").removesuffix(",").split(","))
    if len(types) != len(variables):
        raise _broken(f"asked for {len(variables)} variables, got {len(types)} types")
    for name, kind in zip(variables, types, strict=True):
        if kind not in NUMPY_TYPES and kind not in REFUSALS:
            raise _broken(f"variable {name} has the unknown type {kind[:40]!r}")
    return RecipeAnswer(payload[0], types)


def decode_text_message(payload: bytes) -> TextMessage:
    """A text message: two texts with their lengths, and a level."""
    texts = []
    for _ in range(2):
        if not payload or len(payload) < 1 + payload[0]:
            raise _broken("a text message ends in the middle of a text")
        end = 1 + payload[0]
        texts.append(payload[1:end].decode("utf-8", errors="replace"))
        payload = payload[end:]
    level = int(_unpack(">B", payload, "a text message's level")[0])
    return TextMessage(MESSAGE_LEVELS[min(level, len(MESSAGE_LEVELS) - 1)], texts[1], texts[0])


def decode_data(recipe: Recipe, packages: bytes) -> npt.NDArray[np.void]:
    """Data packages (N,) of one recipe, joined, as a structured array without a copy.

    Raises:
        ConnectionLostError: the bytes are not whole packages of this recipe.
    """
    dtype = recipe.dtype
    if len(packages) % dtype.itemsize:
        raise _broken(f"data packages of {dtype.itemsize} bytes were expected")
    rows = np.frombuffer(packages, dtype=dtype)
    wrong = (rows["size"] != dtype.itemsize) | (rows["type"] != DATA_PACKAGE) | (rows["recipe"] != recipe.number)
    if wrong.any():
        raise _broken(f"package {int(np.argmax(wrong)) + 1} of {len(rows)} does not match the requested recipe")
    return rows


class PackageSplitter:
    """Cuts a byte stream into packages, however it was chopped up on its way."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def feed(self, chunk: bytes) -> Iterator[Package]:
        """Packages that are complete with this chunk, to be used up before the next.

        Raises:
            ConnectionLostError: the bytes are not RTDE; packages before them have been yielded, and every later call
                raises again.
        """
        pending = self._pending
        pending += chunk
        start = 0
        try:
            while len(pending) - start >= HEADER_SIZE:
                size, kind = _HEADER.unpack_from(pending, start)
                if size < HEADER_SIZE or kind not in _TYPES:
                    raise _broken(f"a package of type {kind} with {size} bytes does not exist")
                if len(pending) - start < size:
                    break
                package = Package(kind, bytes(pending[start : start + size]))
                start += size
                yield package
        finally:
            del pending[:start]


def _unpack(layout: str, payload: bytes, what: str) -> tuple[Any, ...]:
    expected = struct.calcsize(layout)
    if len(payload) != expected:
        raise _broken(f"{what} has {len(payload)} bytes instead of {expected}")
    return struct.unpack(layout, payload)


def _broken(message: str) -> ConnectionLostError:
    return ConnectionLostError(
        f"not RTDE version {PROTOCOL_VERSION}: {message}", hint="is this the arm's controller, and port 30004?"
    )


RECEIVE_BUFFER_BYTES = 4 << 20

Connect = Callable[[str, int, float], socket.socket]
"""Connects to a port of a host within so many seconds, or raises OSError."""


def connect_tcp(host: str, port: int, timeout: float) -> socket.socket:
    """A TCP connection that sends at once and holds seconds of samples for a reader that is late.

    Raises:
        OSError: no answer within `timeout` [s].
        UnicodeError: the host is no name.
    """
    connection = socket.create_connection((host, port), timeout=timeout)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    return connection
