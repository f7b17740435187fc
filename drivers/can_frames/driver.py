"""The driver of arms whose CAN frames are told by a table or a DBC file."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Sequence

import can
import numpy as np

from drivers.base import DriverSettings, Notice, State, require_state
from drivers.can_bus import Frame, Receiver, Sender, close_bus, open_bus
from drivers.can_frames.clock import SourceClock
from drivers.can_frames.commanding import Commander
from drivers.can_frames.order import CycleOrder
from drivers.can_frames.polling import PollAnswers, Poller
from drivers.can_frames.rest import REST_LIMIT, comes_to_rest
from drivers.can_frames.rows import Assembler, Rows
from drivers.can_frames.settings import FixedFrame, parse_settings
from drivers.can_frames.signal_keys import WHOLE_ARM
from drivers.can_frames.table import batches, identifier_text
from drivers.can_frames.watch import FaultWatch, RateWatch, Troubles
from drivers.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.gains import joint_torque
from drivers.streams import Block, ChannelLayout, FloatArray, StreamLayout

SILENCE_LIMIT = 0.5
"""Without a row for so long [s], or for `SILENT_PERIODS`, the connection counts as lost."""
SILENT_PERIODS = 20
FIRST_STEP_LIMIT = 0.1
"""How far [rad] a first command may be from where the arm stands; it would be reached within one period."""
STOP_REPEATS = 3
"""How often the stop frames are sent: a frame that an arm misses is not sent again by anybody else."""
STOP_INTERVAL = 0.01


class CanFramesDriver:
    """An arm on a CAN bus of its maker's own making; implements `drivers.base.Driver`.

    Args:
        settings: joints, the connection's keys (see `drivers.can_frames.settings.CanFramesSettings`), the gains, and
            the folder that a DBC file is looked for in.

    Raises:
        UsageError: the connection's keys are wrong, or the DBC file cannot be used.
    """

    def __init__(self, settings: DriverSettings) -> None:
        self._joints = settings.joints
        self._gains = settings.gains
        self._settings = parse_settings(settings.connection, settings.joints, settings.folder)
        self._state: State = "closed"
        self._bus: can.BusABC | None = None
        self._receiver: Receiver | None = None
        self._sender: Sender | None = None
        self._poller: Poller | None = None
        self._commander: Commander | None = None
        self._command_lock = threading.Lock()
        self._halted = False
        rate = self._settings.rate
        self._assemblers = {
            name: Assembler(self._settings.parts(name), self._settings.cycle if name == "joints" else None, 0.5 / rate)
            for name in self._settings.streams
        }
        clock = next((signal for signal in self._settings.signals if signal.quantity in WHOLE_ARM), None)
        self._clock_signal = clock
        self._clock = SourceClock(clock, rate) if clock is not None else None
        self._notices: deque[Notice] = deque()
        self._troubles = Troubles(self._notices)
        self._faults = FaultWatch(self._notices)
        self._rate_watch = RateWatch(self._notices, rate)
        self._forget()

    def open(self) -> None:
        """Open the bus and hear every frame of the joints once, within the connection's `timeout`.

        Raises:
            ConnectionFailedError: no such bus, or frames of the table that do not come.
            DriverStateError: it is open already.
        """
        require_state(self._state, "closed", "open")
        settings = self._settings
        self._bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)
        try:
            self._sender = Sender(self._bus)
            self._receiver = Receiver(self._bus, settings.identifiers)
            self._receiver.start()
            self._send(settings.begin)
            if settings.poll is not None:
                self._poller = Poller(self._sender, settings.poll)
                self._poller.start()
            self._hear_all(self._receiver)
        except ConnectionLostError as error:
            self._let_go()
            raise ConnectionFailedError(error.message, where=error.where, hint=error.hint) from error
        except BaseException:
            self._let_go()
            raise
        self._state = "open"

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the nominal rate, and as the table has them `thermal`, `status` and streams of its own.

        Raises:
            DriverStateError: it is closed.
        """
        if self._state == "closed":
            require_state(self._state, "open", "list its streams")
        layouts = []
        for name, assembler in self._assemblers.items():
            channels = []
            for quantity, members in self._columns(assembler).items():
                unit = "1" if quantity == "fault" else ""
                columns = tuple(assembler.signals[index].joint for index in members)
                channels.append(ChannelLayout(quantity, columns, unit, self._description(name, quantity)))
            if name == "joints" and self._knows_torque:
                channels.append(ChannelLayout("torque", self._joints, "", "current times the robot file's drive gains"))
            layouts.append(StreamLayout(name, tuple(channels), self._settings.rate if name == "joints" else 0.0))
        return tuple(layouts)

    def start(self) -> None:
        """Make samples flow.

        Raises:
            DriverStateError: it is not open.
            ConnectionLostError: the adapter is gone.
        """
        require_state(self._state, "open", "start")
        self._opened_receiver().take()
        self._forget()
        self._halted = False
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Block]:
        """Blocks that have arrived, waiting at most `timeout` [s] for the first; empty where none came.

        Raises:
            DriverStateError: it is not running.
            ConnectionLostError: the adapter is gone, or no complete row came for half a second (20 periods of arms
                slower than 40 Hz).
        """
        require_state(self._state, "running", "read")
        receiver = self._opened_receiver()
        end = time.monotonic() + timeout
        while True:
            if self._poller is not None and self._poller.failure is not None:
                raise self._poller.failure
            left = max(0.0, end - time.monotonic())
            blocks = self._blocks(receiver.take(left, at_least=len(self._settings.parts("joints"))))
            now = time.monotonic()
            if blocks or now >= end:
                self._require_sound(now)
                return blocks

    def notices(self) -> Sequence[Notice]:
        """What there was to tell since the last call: faults of the arm, lost frames, errors of the bus."""
        found = list(self._receiver.notices()) if self._receiver is not None else []
        while self._notices:
            found.append(self._notices.popleft())
        return found

    def command(self, position: FloatArray) -> None:
        """Send a joint position (n,) [rad] to be reached within one period; the first enables the drives before.

        Raises:
            DriverStateError: it is not running, the table has no command frames, the position does not fit into them,
                or a first position is too far from where the arm stands.
            ConnectionLostError: the adapter is gone.
            ValueError: not n finite numbers.
        """
        target = np.asarray(position, dtype=np.float64)
        if target.shape != (len(self._joints),) or not np.all(np.isfinite(target)):
            raise ValueError(f"a position must be {len(self._joints)} finite numbers, not {position!r}")
        with self._command_lock:
            require_state(self._state, "running", "move")
            if self._halted:
                raise DriverStateError("the arm is being stopped", hint="start again before the next motion")
            table, sender = self._settings.command, self._sender
            if table is None or sender is None:
                raise DriverStateError(
                    "this connection cannot move the arm", hint="its table has no 'command'; recording works"
                )
            if self._commander is None:
                self._check_first(target)
                commander = Commander(table, self._joints)
                frames = commander.frames(target)  # fits, before anything is enabled
                self._commander = commander
                self._send(self._settings.start)
            else:
                frames = self._commander.frames(target)
            sender.send_all(frames)

    def stop(self) -> None:
        """Halt the arm where this driver moves it, then the samples; safe in every state, never raises.

        The stop frames go out at once, then the joints' own positions must say that the arm has come to rest.
        """
        self._halted = True
        with self._command_lock:
            commander, self._commander = self._commander, None
            sent = commander is None or self._send_stop()
        if commander is not None:
            if not sent:
                said = "the stop frames could not be sent; the arm may still move"
                self._notices.append(Notice(math.nan, "error", said))
            elif not comes_to_rest(self._receiver, self._assemblers["joints"]):
                said = f"the arm did not show within {REST_LIMIT:g} s of the stop frames that it stands still"
                self._notices.append(Notice(math.nan, "error", said))
        if self._state == "running":
            self._state = "open"

    def close(self) -> None:
        """Let go of the connection; safe in every state."""
        self.stop()
        with contextlib.suppress(ConnectionLostError):
            self._send(self._settings.end)
        self._let_go()
        self._state = "closed"

    @property
    def _knows_torque(self) -> bool:
        quantities = self._columns(self._assemblers["joints"])
        return (
            "current" in quantities
            and "torque" not in quantities
            and len(self._gains) == len(self._joints)
            and all(gain.gain is not None and gain.signal == "current" for gain in self._gains)
        )

    def _columns(self, assembler: Assembler) -> dict[str, list[int]]:
        """Quantity → columns of the assembler's values in the joints' order."""
        found: dict[str, list[int]] = {}
        for index, signal in enumerate(assembler.signals):
            if signal.quantity not in WHOLE_ARM:
                found.setdefault(signal.quantity, []).append(index)
        order = {joint: number for number, joint in enumerate(self._joints)}
        for members in found.values():
            members.sort(key=lambda index: order[assembler.signals[index].joint])
        return found

    def _description(self, stream: str, quantity: str) -> str:
        what = f"{quantity} as the arm's CAN frames say it"
        if self._clock_signal is None:
            return f"{what}; time is the arrival of the cycle's first frame at this computer"
        if stream == "joints":
            return f"{what}; time is the arm's own {self._clock_signal.quantity}"
        return f"{what}; time is the arrival of its first frame, brought to the clock of the joints"

    def _forget(self) -> None:
        for assembler in self._assemblers.values():
            assembler.forget()
        if self._clock is not None:
            self._clock.forget()
        self._offset = 0.0
        self._lost = 0
        self._latest_position: FloatArray | None = None
        self._latest_time: dict[str, float] = {}
        self._last_row = time.monotonic()
        self._answers = PollAnswers()
        self._rate_watch.forget()
        self._faults.forget()

    def _opened_receiver(self) -> Receiver:
        if self._receiver is None:
            raise DriverStateError("cannot receive while closed", hint="open the driver first")
        return self._receiver

    def _hear_all(self, receiver: Receiver) -> None:
        """Wait until every part of the joints has come, and see which begins a cycle.

        Raises:
            ConnectionFailedError: names what did not come.
            ConnectionLostError: the adapter is gone.
        """
        parts, marker = self._settings.parts("joints"), self._settings.cycle
        order = CycleOrder(parts)
        end = time.monotonic() + self._settings.timeout
        heard: set[int] = set()
        while not order.enough or (marker is not None and marker not in heard):
            if (left := end - time.monotonic()) <= 0:
                break
            frames = receiver.take(left, at_least=len(parts))
            heard.update(identifier for _, identifier, _ in frames)
            order.take(frames)
        missing = [part.label for part in order.never_seen()]
        if marker is not None and marker not in heard:
            missing.append(f"frame {identifier_text(marker)} that begins a cycle")
        if missing:
            only = (
                ", ".join(identifier_text(identifier) for identifier in sorted(heard)) or "none of the table's frames"
            )
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise ConnectionFailedError(
                f"no {missing[0]}{more} within {self._settings.timeout:g} s; heard: {only}",
                where=f"{self._settings.interface} {self._settings.channel}",
                hint="is the arm on, and are bit rate, identifiers, lengths and 'poll' right?",
            )
        told = order.told()
        self._assemblers["joints"].expect(told, 1.0 / self._settings.rate, self._clock)
        if told.first and marker is None:
            said = f"a cycle begins with {parts[told.first].label}: before it is the longest pause"
            self._notices.append(Notice(math.nan, "info", said))

    def _blocks(self, frames: Sequence[Frame]) -> list[Block]:
        grouped = dict(batches(frames))
        blocks = []
        for name, assembler in self._assemblers.items():
            rows = assembler.take(frames, grouped)
            self._troubles.note(rows)
            self._faults.note(assembler.signals, rows, self._offset)
            block = (
                self._joints_block(rows, assembler) if name == "joints" else self._other_block(name, rows, assembler)
            )
            if len(block.time):
                blocks.append(block)
        return blocks

    def _joints_block(self, rows: Rows, assembler: Assembler) -> Block:
        self._lost += rows.incomplete if self._clock is None else 0
        values, host_time, times = rows.values, rows.host_time, rows.host_time
        if self._clock is not None and self._clock_signal is not None:
            told = self._clock.take(values[:, assembler.signals.index(self._clock_signal)], host_time)
            values, host_time, times = values[told.kept], host_time[told.kept], told.time
            self._lost += told.lost
            self._troubles.note_clock(int(np.sum(~told.kept)), told.restarted)
        elif self._poller is not None:
            self._lost += self._answers.unanswered(self._poller, rows)
        if not len(times):
            return Block("joints", times, host_time)
        self._offset = float(times[-1] - host_time[-1])
        self._last_row = time.monotonic()
        self._rate_watch.note(host_time, self._lost)
        values_of = self._values(values, assembler)
        if self._knows_torque:
            values_of["torque"] = joint_torque(values_of["current"], self._gains)
        self._latest_position = values_of["position"][-1]
        lost, self._lost = self._lost, 0
        return Block("joints", times, host_time, values_of, lost)

    def _other_block(self, name: str, rows: Rows, assembler: Assembler) -> Block:
        if not len(rows.host_time):
            return Block(name, rows.host_time, rows.host_time)
        # Arrivals jitter, and so does the way from one clock to the other; the stream's own time must not run back.
        times = np.maximum.accumulate(rows.host_time + self._offset)
        before = self._latest_time.get(name, -math.inf)
        times = np.maximum(times, before + 1e-6 * np.arange(1, len(times) + 1)) if math.isfinite(before) else times
        self._latest_time[name] = float(times[-1])
        return Block(name, times, rows.host_time, self._values(rows.values, assembler), rows.incomplete)

    def _values(self, values: FloatArray, assembler: Assembler) -> dict[str, FloatArray]:
        return {
            quantity: np.ascontiguousarray(values[:, members]) for quantity, members in self._columns(assembler).items()
        }

    def _require_sound(self, now: float) -> None:
        limit = max(SILENCE_LIMIT, SILENT_PERIODS / self._settings.rate)
        if now - self._last_row <= limit:
            return
        missing = self._troubles.missing
        what = f": {missing} is missing" if missing else ""
        raise ConnectionLostError(
            f"no complete row of the joints for {limit:g} s{what}",
            where=f"{self._settings.interface} {self._settings.channel}",
        )

    def _check_first(self, target: FloatArray) -> None:
        if self._latest_position is None:
            raise DriverStateError("nobody knows where the arm stands", hint="read samples before the first command")
        away = np.abs(target - self._latest_position)
        if not np.all(away <= FIRST_STEP_LIMIT):
            worst = int(np.argmax(np.where(np.isnan(away), np.inf, away)))
            raise DriverStateError(
                f"the first position is {away[worst]:.3f} rad away from where the joint stands",
                where=f"joint {self._joints[worst]}",
                hint=f"begin within {FIRST_STEP_LIMIT:g} rad of the present position",
            )

    def _send(self, frames: Sequence[FixedFrame]) -> None:
        if frames and self._sender is not None:
            self._sender.send_all([(frame.identifier, frame.data) for frame in frames])

    def _send_stop(self) -> bool:
        sent = False
        for repeat in range(STOP_REPEATS):
            if repeat:
                time.sleep(STOP_INTERVAL)
            with contextlib.suppress(Exception):
                self._send(self._settings.stop)
                sent = True
        return sent

    def _let_go(self) -> None:
        if self._poller is not None:
            self._poller.stop()
        if self._receiver is not None:
            self._notices.extend(self._receiver.notices())
            self._receiver.stop()
        if self._bus is not None:
            close_bus(self._bus)
        self._poller = self._receiver = self._sender = self._bus = None
