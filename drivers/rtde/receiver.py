"""Receives RTDE data packages without losing any: a waiting thread keeps raw bytes, decoding happens in batches.

Polling readers lose samples as soon as the process has anything else to do; a thread that sleeps until bytes come and
only appends them does not, and whatever the network itself loses shows in the controller's own clock.
"""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from drivers.base import SILENCE_LIMIT, Level, Notice, drained
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, UsageError
from drivers.core.text import counted
from drivers.rtde import protocol as wire
from drivers.rtde.protocol import Connect, connect_tcp

BUFFER_SECONDS = 60.0
"""How long [s] `take` may stay away before the oldest packages are dropped."""
CHUNK_BYTES = 1 << 18
"""More than a second of samples: what came during a stall is to be handed out together."""
TOGETHER, UNMOVED = 0.006, 0.016
"""Samples are handed out so long [s] at a time, or one by one where they come slower; `UNMOVED` where dynid does not
move the arm, so that nothing is to be stopped."""
LOOK = 0.05
"""[s] that one wait for data lasts at most."""
TIMESTAMP = "timestamp"
_TIMESTAMP_AT = struct.Struct(">d")
_TIMESTAMP_OFFSET = wire.HEADER_SIZE + 1

_Decoded = TypeVar("_Decoded")


@dataclass(frozen=True)
class Samples:
    """Consecutive data packages."""

    rows: npt.NDArray[np.void]  # (N,) structured, the variables by name
    host_time: FloatArray  # (N,) the host's monotonic clock at reception [s]
    lost: int  # packages that the controller's clock says are missing before or within these


class RtdeReceiver:
    """One RTDE connection.

    Args:
        host: name or address of the controller.
        port: its RTDE port.
        required: variable → RTDE type, without which the connection is of no use; `timestamp` is added.
        optional: variable → RTDE type, left out with a notice where the controller refuses one.
        rate: of the data packages [Hz]; None for the controller's maximum.
        timeout: for connecting and negotiating, together [s].
        connect: reaches the controller.
        clock: the host's.

    Attributes:
        overflow: packages dropped because `take` stayed away.
    """

    version: wire.ControlVersion  # of the controller, once connected
    recipe: wire.Recipe  # what it delivers, once connected
    rate: float  # at which [Hz], once connected

    def __init__(
        self,
        host: str,
        port: int,
        required: Mapping[str, str],
        optional: Mapping[str, str],
        rate: float | None,
        timeout: float,
        connect: Connect = connect_tcp,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._host, self._port = host, port
        self._connect = connect
        self._clock = clock
        self._required = {TIMESTAMP: "DOUBLE"} | dict(required)
        self._optional = dict(optional)
        self._asked_rate = rate
        self._timeout = timeout
        self.overflow = 0
        self._socket: socket.socket | None = None
        self._splitter = wire.PackageSplitter()
        self._chunk = memoryview(bytearray(CHUNK_BYTES))
        self._early: deque[wire.Package] = deque()
        self._thread: threading.Thread | None = None
        self._arrival = clock.condition()
        self._ring: deque[tuple[bytes, float]] = deque()
        self._failure: tuple[str, str] | None = ("not connected", "")
        self._last_stored = -math.inf
        self._last_taken = math.nan
        self._repeated = 0
        self._pausing = False
        self._together = 1
        self._notices: deque[Notice] = deque()

    @property
    def where(self) -> str:
        """The other end, for messages."""
        return f"{self._host}:{self._port}"

    @property
    def connected(self) -> bool:
        """Return whether there is a connection, as far as known."""
        return self._socket is not None

    def connect(self) -> None:
        """Connect and agree on a recipe, within the time limit.

        Raises:
            ConnectionFailedError: no answer, not from a UR controller, or a required variable is refused.
            UsageError: the controller does not reach the rate.
        """
        self.close()
        deadline = self._clock.now() + self._timeout
        try:
            self._socket = self._connect(self._host, self._port, self._timeout)
            self._socket.setblocking(False)
            self._negotiate(deadline)
        except ConnectionLostError as error:
            self.close()
            raise ConnectionFailedError(error.message, where=self.where, hint=error.hint) from error
        except (OSError, UnicodeError) as error:  # a name that cannot be one raises UnicodeError
            self.close()
            if isinstance(error, TimeoutError):
                message = f"no answer within {self._timeout:g} s"
            else:
                message = f"cannot connect: {getattr(error, 'strerror', None) or error}"
            hint = "check that the arm is on, and its address"
            raise ConnectionFailedError(message, where=self.where, hint=hint) from error
        except BaseException:
            self.close()
            raise

    def start(self) -> None:
        """Make data packages flow.

        Raises:
            ConnectionLostError: the controller does not start, or is gone.
        """
        try:
            accepted = self._ask(
                wire.encode_package(wire.START), wire.START, wire.decode_accepted, self._clock.now() + self._timeout
            )
        except OSError as error:
            raise ConnectionLostError(f"the controller did not start: {error}", where=self.where) from error
        if not accepted:
            raise ConnectionLostError("the controller refused to start its data packages", where=self.where)
        with self._arrival:
            self._ring.clear()
            self._failure = None
        self._last_stored, self._pausing = -math.inf, False
        self._thread = self._clock.thread(self._receive, f"rtde {self.where}")
        self._thread.start()

    def take(self, timeout: float, together: float = TOGETHER) -> Samples | None:
        """Return what has arrived since the last call; None where nothing has.

        It waits at most `timeout` [s] for the first, and unless that is 0, for all of `together` [s]: handling each by
        itself takes most of a core.

        Raises:
            ConnectionLostError: nothing is left and the connection broke, fell silent or spoke something else.
        """
        with self._arrival:
            self._together = max(1, round(together * self.rate))
            if not self._arrival.wait_for(self._complete, timeout) and self._ring and 0.0 < timeout < together:
                self._arrival.wait_for(self._complete, together - timeout)
            batch = list(self._ring)
            self._ring.clear()
            failure = self._failure
            repeated, self._repeated = self._repeated, 0
        if repeated:
            self._report("warning", counted(repeated, "repeated data package(s) dropped"))
        if not batch:
            if failure is not None:
                raise ConnectionLostError(failure[0], where=self.where, hint=failure[1])
            return None
        rows = wire.decode_data(self.recipe, b"".join([raw for raw, _ in batch]))
        host_time = np.array([arrived for _, arrived in batch], dtype=np.float64)
        return Samples(rows, host_time, self._count_lost(rows[TIMESTAMP]))

    def _complete(self) -> bool:
        return len(self._ring) >= self._together or self._failure is not None

    def notices(self) -> list[Notice]:
        """Notices since the last call."""
        return drained(self._notices)

    def pause(self) -> None:
        """End the flow of data packages; a controller that does not answer is disconnected."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._pausing = True
        with contextlib.suppress(OSError):
            if self._socket is not None:
                self._socket.sendall(wire.encode_package(wire.PAUSE))
        thread.join(SILENCE_LIMIT)
        if thread.is_alive() or self._failure is not None:
            self._thread = thread
            self.close()
        self._last_taken = math.nan  # a pause is not a gap

    def reconnect(self) -> None:
        """Drop everything and connect anew; packages missed on the way count as lost where the clock went on.

        Raises:
            ConnectionFailedError: as `connect` does, or another recipe is offered now.
        """
        before = self.recipe
        self.connect()
        if self.recipe.types != before.types:
            self.close()
            raise ConnectionFailedError("after reconnecting, the controller offers other variables", where=self.where)
        self.start()
        self._report("warning", f"connected again to {self.where}")

    def close(self) -> None:
        """Disconnect; safe at any time."""
        connection, self._socket = self._socket, None
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)  # wakes the thread, which close alone would not
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()
        if connection is not None:
            connection.close()
        with self._arrival:
            self._ring.clear()
            self._failure = ("not connected", "")
        self._early.clear()
        self._splitter = wire.PackageSplitter()

    def _negotiate(self, deadline: float) -> None:
        accepted = self._ask(
            wire.encode_protocol_request(), wire.REQUEST_PROTOCOL_VERSION, wire.decode_accepted, deadline
        )
        if not accepted:
            raise ConnectionLostError(
                "the controller does not support RTDE version 2", hint="it needs software 3.4 (CB3) or 5.0 or later"
            )
        self.version = self._ask(
            wire.encode_package(wire.GET_CONTROL_VERSION),
            wire.GET_CONTROL_VERSION,
            wire.decode_control_version,
            deadline,
        )
        maximum = self.version.maximum_rate
        self.rate = maximum if self._asked_rate is None else self._asked_rate
        if self.rate > maximum or not (maximum / self.rate).is_integer():
            raise UsageError(
                f"'rate' is {self.rate:g} Hz, but controller software {self.version} sends at {maximum:g} Hz "
                "or a whole fraction of it",
                where=self.where,
                hint="leave 'rate' out for the maximum",
            )
        wanted = self._required | self._optional
        answer = self._ask_recipe(tuple(wanted), deadline)
        refused = {name: kind for name, kind in zip(wanted, answer.types, strict=True) if kind in wire.REFUSALS}
        self._check_refused(refused)
        if refused:
            wanted = {name: kind for name, kind in wanted.items() if name not in refused}
            answer = self._ask_recipe(tuple(wanted), deadline)
        for (name, kind), actual in zip(wanted.items(), answer.types, strict=True):
            if actual != kind:
                raise ConnectionLostError(f"variable {name} is a {actual}, but RTDE's guide says {kind}")
        self.recipe = wire.Recipe(answer.number, tuple(wanted.items()))

    def _check_refused(self, refused: Mapping[str, str]) -> None:
        needed = [name for name in refused if name in self._required]
        if needed:
            raise ConnectionLostError(
                f"the controller (software {self.version}) refuses {', '.join(needed)}, without which nothing can be "
                "recorded"
            )
        for name, reason in refused.items():
            self._report("info", f"the controller does not deliver {name} ({reason}); it is left out")

    def _ask_recipe(self, variables: tuple[str, ...], deadline: float) -> wire.RecipeAnswer:
        return self._ask(
            wire.encode_output_recipe(variables, self.rate),
            wire.SETUP_OUTPUTS,
            lambda payload: wire.decode_recipe_answer(payload, variables),
            deadline,
        )

    def _ask(self, request: bytes, kind: int, decode: Callable[[bytes], _Decoded], deadline: float) -> _Decoded:
        if self._socket is None:
            raise ConnectionLostError("not connected", where=self.where)
        self._socket.sendall(request)  # a request is far smaller than what the socket holds
        while True:
            while self._early:
                package = self._early.popleft()
                if package.kind == kind:
                    return decode(package.payload)
                if package.kind == wire.TEXT_MESSAGE:
                    self._report_text(package.payload)
            chunk = self._wait_for_bytes(self._socket, deadline)
            if not chunk:
                raise ConnectionLostError("the other end closed the connection instead of answering")
            if self._clock.now() >= deadline:
                raise TimeoutError
            try:
                self._early.extend(self._splitter.feed(chunk))
            except ConnectionLostError:
                if all(package.kind != kind for package in self._early):
                    raise  # otherwise the answer counts, and the error surfaces on the next read

    def _wait_for_bytes(self, connection: socket.socket, deadline: float) -> bytes:
        """What has come, nothing where the other end has closed; TimeoutError where nothing comes until `deadline`."""
        readable, _ = self._clock.select([connection], [], deadline - self._clock.now())
        if not readable:
            raise TimeoutError
        return connection.recv(CHUNK_BYTES)

    def _next_bytes(self, connection: socket.socket, fresh: float) -> bytes:
        """Wait like `_wait_for_bytes`, until this process has run for `SILENCE_LIMIT` since the newest sample."""
        while True:
            left = fresh + SILENCE_LIMIT - self._clock.now()
            if left <= 0.0 and (left := left + self._clock.stalled(fresh)) <= 0.0:
                raise TimeoutError
            readable, _ = self._clock.select([connection], [], min(left, LOOK))
            if readable:  # `recv` would ask the system for so much memory each time
                return bytes(self._chunk[: connection.recv_into(self._chunk)])

    def _receive(self) -> None:
        failure: tuple[str, str] | None
        try:
            failure = self._receive_until_pause()
        except ConnectionLostError as error:
            failure = (error.message, error.hint)
        except TimeoutError:
            failure = (f"no data for {SILENCE_LIMIT:g} s", "check the arm's power and the cable")
        except OSError as error:
            failure = (f"the connection broke: {error.strerror or error}", "")
        with self._arrival:
            self._failure = failure
            self._arrival.notify_all()

    def _receive_until_pause(self) -> tuple[str, str] | None:
        connection = self._socket
        if connection is None:
            return ("not connected", "")
        fresh = self._clock.now()
        with self._arrival:
            while self._early:
                if self._keep(self._early.popleft(), fresh) is None:
                    return None
        for _ in self._splitter.feed(b""):  # raises where the fault came together with the answer
            pass
        while True:
            chunk = self._next_bytes(connection, fresh)
            arrived = self._clock.now()
            if not chunk:
                return ("the controller closed the connection", "")
            # All at once: the first samples after a stall must not look like silence of the rest.
            with self._arrival:
                for package in self._splitter.feed(chunk):
                    kept = self._keep(package, arrived)
                    if kept is None:
                        return None
                    if kept:
                        fresh = arrived
                if len(self._ring) >= self._together:
                    self._arrival.notify_all()

    def _keep(self, package: wire.Package, arrived: float) -> bool | None:
        """Whether the package brought a new sample; None where it ends the flow. To be called with `_arrival` held."""
        if package.kind == wire.PAUSE and self._pausing:
            return None
        if package.kind == wire.TEXT_MESSAGE:
            self._report_text(package.payload)
            return False
        raw = package.raw
        if package.kind != wire.DATA_PACKAGE or len(raw) != self.recipe.dtype.itemsize or raw[3] != self.recipe.number:
            raise ConnectionLostError("a package arrived that does not match the requested recipe")
        (clock,) = _TIMESTAMP_AT.unpack_from(raw, _TIMESTAMP_OFFSET)
        if clock == self._last_stored:
            self._repeated += 1
            return False
        if not (clock > self._last_stored and math.isfinite(clock)):
            raise ConnectionLostError(f"the controller's clock jumped from {self._last_stored:.3f} s to {clock:.3f} s")
        self._last_stored = clock
        if len(self._ring) >= BUFFER_SECONDS * self.rate:
            self._ring.popleft()
            if not self.overflow:
                self._report("warning", f"not read for {BUFFER_SECONDS:g} s: the oldest samples were dropped")
            self.overflow += 1
        self._ring.append((raw, arrived))
        return True

    def _count_lost(self, clock: FloatArray) -> int:
        before, self._last_taken = self._last_taken, float(clock[-1])
        if clock[0] < before:
            self._report("warning", "the controller's clock started again; the loss in between is unknown")
            before = math.nan
        steps = np.diff(clock, prepend=clock[:1] if math.isnan(before) else before)
        return int(np.maximum(np.rint(steps * self.rate) - 1, 0).sum())

    def _report_text(self, payload: bytes) -> None:
        message = wire.decode_text_message(payload)
        level: Level = "info" if message.level == "info" else "warning" if message.level == "warning" else "error"
        self._report(level, f"{message.source}: {message.text}" if message.source else message.text)

    def _report(self, level: Level, message: str) -> None:
        self._notices.append(Notice(math.nan, level, message))
