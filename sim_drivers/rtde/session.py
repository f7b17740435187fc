"""One RTDE client of a simulated controller, without its socket."""

from __future__ import annotations

import math
import socket
import struct
from abc import ABC, abstractmethod
from collections import deque

from drivers.core.errors import ConnectionLostError
from drivers.rtde import protocol as wire
from sim_drivers.rtde.controller import Controller
from sim_drivers.rtde.variables import (
    IN_USE,
    NOT_FOUND,
    PackageRecipe,
    Value,
    encode_recipe_answer,
    encode_text_message,
    input_variables,
    output_variables,
    split_names,
)

CHUNK_BYTES = 65536

OUTPUT_RECIPE = 1
MAXIMUM_RECIPES = 255
MAXIMUM_PACKAGE = 0xFFFF


class Session(ABC):
    """The protocol between one client and the server, without the socket."""

    def __init__(self, controller: Controller) -> None:
        self.closing = False
        self._controller = controller

    def greeting(self) -> bytes:
        """Greeting of the server; it waits for the client's first words where empty."""
        return b""

    @abstractmethod
    def receive(self, chunk: bytes) -> bytes:
        """Process received data and return the answer.

        Raises:
            ConnectionLostError: the client does not follow this protocol.
        """

    def close(self) -> None:  # noqa: B027
        """The client has disconnected."""


class ClientConnection:
    """One client's socket, made non-blocking here, and the bytes that it has not yet read, so many at most."""

    def __init__(self, sock: socket.socket, session: Session, limit: int) -> None:
        sock.setblocking(False)
        self.sock = sock
        self.session = session
        self.open = True
        self.overflowed = False
        self._limit = limit
        self._waiting = bytearray()

    @property
    def has_waiting(self) -> bool:
        """Return whether bytes wait for the client to read."""
        return bool(self._waiting)

    def send(self, content: bytes) -> None:
        """Send as much as the socket accepts and keep the rest; too much of it closes the connection."""
        if not self.open or not content:
            return
        self._waiting += content
        self.flush()
        if len(self._waiting) > self._limit:
            self.overflowed = True
            self.close()

    def flush(self) -> None:
        """Send queued data, as far as the socket accepts them."""
        while self.open and self._waiting:
            try:
                sent = self.sock.send(self._waiting)
            except BlockingIOError:
                return
            except OSError:
                self.close()
                return
            del self._waiting[:sent]

    def read(self) -> bytes:
        """Received data; a client that has disconnected is closed."""
        try:
            chunk = self.sock.recv(CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            chunk = b""
        if not chunk:
            self.close()
        return chunk

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        if self.open:
            self.open = False
            self._waiting.clear()
            self.sock.close()
            self.session.close()


class RtdeSession(Session):
    """Set-up of one client, and its data.

    `owners`, input variable → the session that writes it, is shared by all sessions.

    Attributes:
        closing: whether to hang up.
        running: whether the client wants data packages now.
        withhold: data packages still to be lost, a fault.
    """

    def __init__(self, controller: Controller, owners: dict[str, RtdeSession]) -> None:
        super().__init__(controller)
        self.running = False
        self.withhold = 0
        self._owners = owners
        self._splitter = wire.PackageSplitter()
        self._negotiated = False
        self._outputs = output_variables(controller.version)
        self._inputs = input_variables(controller.version)
        self._recipe: PackageRecipe | None = None
        self._input_recipes: dict[int, PackageRecipe] = {}
        self._waiting: deque[dict[str, Value]] = deque()
        self._share = 1.0
        self._ticks = 0

    def close(self) -> None:
        """Free the inputs that this client wrote."""
        self.running = False
        for name in [name for name, owner in self._owners.items() if owner is self]:
            del self._owners[name]

    def receive(self, chunk: bytes) -> bytes:
        """Process received data and return the answer."""
        answer = b""
        for package in self._splitter.feed(chunk):
            answer += self._answer(package.kind, package.payload)
        return answer

    def apply_inputs(self, *, behind: bool) -> None:
        """Pass received packages to the controller for its next period.

        While virtual time makes up for a stall, packages that came a period apart must not act all at once: then one a
        period is handed on.
        """
        while self._waiting:
            self._controller.write_inputs(self._waiting.popleft())
            if behind:
                return

    def data_package(self) -> bytes:
        """This period's data package; nothing where the client wants a lower rate, or none."""
        recipe = self._recipe
        if not self.running or recipe is None:
            return b""
        self._ticks += 1
        due = math.floor(self._ticks * self._share) > math.floor((self._ticks - 1) * self._share)
        return recipe.encode(self._controller.values) if due else b""

    def _answer(self, kind: int, payload: bytes) -> bytes:
        if kind == wire.REQUEST_PROTOCOL_VERSION:
            accepted = payload == struct.pack(">H", wire.PROTOCOL_VERSION)
            self._negotiated = self._negotiated or accepted
            return wire.encode_package(kind, bytes([accepted]))
        if kind == wire.GET_CONTROL_VERSION:
            version = self._controller.version
            return wire.encode_package(
                kind, struct.pack(">IIII", version.major, version.minor, version.bugfix, version.build)
            )
        if not self._negotiated:
            raise ConnectionLostError("the client did not agree on protocol version 2")
        if kind == wire.SETUP_OUTPUTS:
            return self._set_up_outputs(payload)
        if kind == wire.SETUP_INPUTS:
            return self._set_up_inputs(payload)
        if kind in (wire.START, wire.PAUSE):
            accepted = kind == wire.PAUSE or self._recipe is not None or bool(self._input_recipes)
            self.running = kind == wire.START and accepted
            return wire.encode_package(kind, bytes([accepted]))
        if kind == wire.DATA_PACKAGE:
            return self._write_inputs(payload)
        return b""  # a text message of the client

    def _set_up_outputs(self, payload: bytes) -> bytes:
        if len(payload) < 9:
            return encode_text_message("an output recipe needs a frequency and a variable")
        (frequency,) = struct.unpack_from(">d", payload)
        names, trailing = split_names(payload[8:])
        offered = {name: kind for name, kind in self._outputs.items() if name not in self._controller.refused}
        types = [offered.get(name, NOT_FOUND) for name in names]
        self.running, self._recipe = False, None
        if NOT_FOUND not in types:
            recipe = PackageRecipe(OUTPUT_RECIPE, list(zip(names, types, strict=True)))
            if recipe.size > MAXIMUM_PACKAGE:
                return encode_text_message("an output recipe with too many variables")
            rate = 1.0 / self._controller.period
            share = frequency / rate if math.isfinite(frequency) else 1.0
            self._recipe, self._share, self._ticks = recipe, min(max(share, 1.0 / rate), 1.0), 0
        recipe_id = 0 if self._recipe is None else OUTPUT_RECIPE
        return _recipe_answer(wire.SETUP_OUTPUTS, recipe_id, types, trailing)

    def _set_up_inputs(self, payload: bytes) -> bytes:
        names, trailing = split_names(payload)
        types = []
        for name in names:
            kind = self._inputs.get(name, NOT_FOUND)
            types.append(IN_USE if kind != NOT_FOUND and self._owners.get(name, self) is not self else kind)
        recipe_id = 0
        if NOT_FOUND not in types and IN_USE not in types and len(self._input_recipes) < MAXIMUM_RECIPES:
            recipe_id = len(self._input_recipes) + 1
            self._input_recipes[recipe_id] = PackageRecipe(recipe_id, list(zip(names, types, strict=True)))
            self._owners.update(dict.fromkeys(names, self))
        return _recipe_answer(wire.SETUP_INPUTS, recipe_id, types, trailing)

    def _write_inputs(self, payload: bytes) -> bytes:
        recipe = self._input_recipes.get(payload[0]) if payload else None
        if recipe is None:
            return encode_text_message("a data package for an input recipe that does not exist")
        received = recipe.decode(payload)
        if received is None:
            return encode_text_message(f"a data package of a wrong length for input recipe {recipe.recipe_id}")
        self._waiting.append(received)
        return b""


def _recipe_answer(kind: int, recipe_id: int, types: list[str], trailing_comma: bool) -> bytes:
    try:
        return encode_recipe_answer(kind, recipe_id, types, trailing_comma)
    except ValueError:  # more types than a package holds
        return encode_text_message("a recipe with too many variables")
