"""The driver of arms whose CAN frames are described by a signal table or a DBC file."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import can

from drivers.base import SILENCE_LIMIT, DriverSettings, Notice, require_state
from drivers.can.bus import RETURNED, Sender, close_bus, confirms_sending, open_bus
from drivers.can.receiver import Receiver
from drivers.can_signals.polling import Poller
from drivers.can_signals.rows.assembly import CycleOrder, Order
from drivers.can_signals.settings import CanFramesSettings, CommandTable, parse_settings
from drivers.can_signals.streams import FrameStreams
from drivers.can_signals.table.signals import FixedFrame, Signal, batches, encode, identifier_text
from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT, SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.core.text import counted
from drivers.first_step import check_first_step, finite_position
from drivers.life_cycle import LifeCycle
from drivers.polled_arm import SILENT_PERIODS, STOP_LIMIT
from drivers.standstill import REST_WINDOW, StandstillWatch
from drivers.streams import Batch, StreamLayout

STOP_INTERVAL = 0.01
"""The stop frames are sent every so many seconds until the arm is at rest: it may have missed the first ones."""
STOP_ATTEMPTS = 3
"""So many sendings in a row may fail before a stop is given up."""
LONGEST_WATCHDOG = 1.0
"""A watchdog that takes longer than this [s] is worth a word before a motion."""

GAP_PERIODS = 2.5
"""After so many periods without a row, and half a window of rest, the arm may have moved."""


class CanFramesDriver(LifeCycle):
    """An arm on a CAN bus with a proprietary protocol; implements `drivers.base.Driver`.

    The connection's keys are those of `drivers.can_signals.settings.CanFramesSettings`.

    Raises:
        UsageError: the connection's keys are wrong, or the DBC file cannot be used.
    """

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self._settings = parse_settings(settings.connection, settings.joints, settings.folder)
        self._bus: can.BusABC | None = None
        self._receiver: Receiver | None = None
        self._sender: Sender | None = None
        self._poller: Poller | None = None
        self._commander: Commander | None = None
        self._command_lock = self._clock.lock()
        self._streams = FrameStreams(
            self._settings, self._joints, settings.gains, settings.coupling, self._notices, self._clock
        )

    def _connect(self) -> None:
        """Open the bus and hear every frame of the joints once, within the connection's `timeout`."""
        settings = self._settings
        confirms = confirms_sending(settings.keys.interface, settings.keys.options)
        options = {**settings.keys.options, **(RETURNED if confirms else {})}
        self._bus = open_bus(settings.keys.interface, settings.keys.channel, settings.keys.bitrate, options)
        self._sender = Sender(self._bus, self._clock)
        own = self._sender.confirm if confirms else None
        self._receiver = Receiver(self._bus, settings.identifiers, clock=self._clock, own=own)
        self._receiver.start()
        self._send(settings.begin)
        if settings.poll is not None:
            self._poller = Poller(self._sender, settings.poll, self._clock)
            self._poller.start()
        order = hear_all(settings, self._receiver, self._clock)
        self._streams.joints.expect(order, 1.0 / settings.keys.rate, self._streams.clock)
        if order.first and settings.keys.marker is None:
            label = settings.frame_layouts("joints")[order.first].label
            self._tell("info", f"a cycle begins with {label}: the longest pause precedes it")

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the nominal rate, and as the table has them `thermal`, `status` and streams of its own."""
        self._require_open("list its streams")
        return self._streams.layouts()

    def start(self) -> None:
        """Make samples flow."""
        require_state(self._state, "open", "start")
        self._opened_receiver().take()
        self._streams.forget()
        self._halted = False
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Blocks that have arrived, waiting at most `timeout` [s] for the first; empty where none came."""
        require_state(self._state, "running", "read")
        receiver = self._opened_receiver()
        end = self._clock.now() + timeout
        while True:
            if self._poller is not None and self._poller.failure is not None:
                raise self._poller.failure
            left = max(0.0, end - self._clock.now())
            frames = receiver.take(left, at_least=self._streams.joints.wanted)
            blocks = self._streams.take(frames, self._poller)
            now = self._clock.now()
            if blocks or now >= end:
                self._clock.late(end)
                self._require_sound(now)
                return blocks

    def notices(self) -> Sequence[Notice]:
        """Faults of the arm, lost frames, errors of the bus, since the last call."""
        return [*(self._receiver.notices() if self._receiver is not None else ()), *super().notices()]

    def command_rate(self) -> float:
        """Rate of the commands [Hz], that of the joints' rows; 0 where the table has no command frames."""
        return 0.0 if self._settings.command is None else self._settings.keys.rate

    def holds(self) -> bool:
        """No: what an arm does without commands is its controller's choice."""
        return False

    def cautions(self) -> tuple[str, ...]:
        """Return what happens to the arm where nothing commands it any more."""
        watchdog = self._settings.keys.watchdog
        if watchdog is None:
            said = "the arm is not known to have a watchdog (key 'watchdog')"
            return (f"{said}: if this computer dies or the bus is cut during a motion, it may not stop by itself",)
        if watchdog > LONGEST_WATCHDOG:
            return (f"if this computer dies during a motion, the arm stops by itself only after {watchdog:g} s",)
        return ()

    def take_control(self) -> None:
        """Check that the arm can be moved from where it is; the drives are enabled with the first command."""
        with self._command_lock:
            table = self._require_movable()
            if (here := self._streams.latest_position) is None:
                raise DriverStateError("no position of the arm is known yet", hint="read samples before")
            Commander(table, self._joints).frames(here)

    def command(self, position: FloatArray) -> None:
        """Send a joint position (n,) [rad] to be reached within one period; the first enables the drives before."""
        target = finite_position(position, self._joints)
        with self._command_lock:
            table = self._require_movable()
            if self._commander is None:
                check_first_step(target, self._streams.latest_position, self._joints, self._sliding)
                commander = Commander(table, self._joints)
                frames = commander.frames(target)  # fits, before anything is enabled
                self._commander = commander
                self._send(self._settings.start)
            else:
                frames = self._commander.frames(target)
            if self._sender is not None:
                self._sender.send_all(frames)

    def stop(self) -> None:
        """Halt the arm where this driver moves it, then the samples; safe in every state, never raises.

        The stop frames go out at once, and again until the joints' own positions say that the arm is at rest.
        """
        self._halted = True
        with self._command_lock:
            commander, self._commander = self._commander, None
        if commander is not None and (trouble := self._halt()):
            self._tell("error", trouble)
        if self._state == "running":
            self._state = "open"

    def silence(self, stream: str, limit: float) -> str:
        """Return which frames do not come, in words; empty of another stream than `joints` (see `drivers.base`)."""
        receiver = self._receiver
        if stream != "joints" or self._state != "running" or receiver is None:
            return ""
        if self._poller is not None and self._clock.now() - self._poller.latest > max(limit, 2 * self._poller.period):
            return "no poll was sent"
        if (unread := self._clock.now() - receiver.drained) > 0.5 * limit:
            return f"the bus was not read for {unread:.2f} s"
        since = receiver.drained - 0.5 * limit
        silent = [
            layout.label
            for layout in self._settings.frame_layouts("joints")
            if receiver.latest.get(layout.identifier, (-math.inf,))[0] < since
        ]
        return f"no {', '.join(silent)}" if silent else ""

    def losses(self, stream: str) -> str:
        """Return why rows of `joints` were lost, in words; empty where the cause is unknown (see `drivers.base`)."""
        dropped = self._receiver.overflow if self._receiver is not None else 0
        late = counted(dropped, "frame(s) dropped: this computer was late to read them") if dropped else ""
        return "; ".join(words for words in (late, self._streams.losses()) if words) if stream == "joints" else ""

    def _take_leave(self) -> None:
        with contextlib.suppress(ConnectionLostError):
            self._send(self._settings.end)

    def _require_movable(self) -> CommandTable:
        self._require_running()
        if self._settings.command is None:
            raise DriverStateError(
                "this connection cannot move the arm", hint="its table has no 'command'; recording works"
            )
        return self._settings.command

    def _opened_receiver(self) -> Receiver:
        if self._receiver is None:
            raise DriverStateError("cannot receive while closed", hint="open the driver first")
        return self._receiver

    def _require_sound(self, now: float) -> None:
        sent = self._sender.unconfirmed if self._sender is not None else None
        if sent is not None and self._opened_receiver().drained - sent > STALL_LIMIT:
            raise ConnectionLostError(
                f"nothing that was sent for {STALL_LIMIT:g} s came back from the adapter: the bus does not carry it",
                where=f"{self._settings.keys.interface} {self._settings.keys.channel}",
                hint="is the bus terminated, and another device on it, at this bit rate?",
            )
        limit = max(SILENCE_LIMIT, SILENT_PERIODS / self._settings.keys.rate)
        if now - self._streams.last_row - self._clock.stalled(self._streams.last_row) <= limit:
            return
        missing = self._streams.missing
        what = f": {missing} is missing" if missing else ""
        raise ConnectionLostError(
            f"no complete row of the joints for {limit:g} s{what}",
            where=f"{self._settings.keys.interface} {self._settings.keys.channel}",
        )

    def _send(self, frames: Sequence[FixedFrame]) -> None:
        if frames and self._sender is not None:
            self._sender.send_all([(frame.identifier, frame.data) for frame in frames])

    def _halt(self) -> str:
        """Send the stop frames until the arm is at rest; what is wrong, in words, or nothing."""
        standstill = StandstillWatch(max(0.5 * REST_WINDOW, GAP_PERIODS / self._settings.keys.rate))
        joints = self._streams.joints
        positions = [index for index, signal in enumerate(joints.signals) if signal.quantity == "position"]
        failed, due = 0, self._clock.now()
        end = due + STOP_LIMIT
        while self._clock.now() < end:
            if self._clock.now() >= due:
                due += STOP_INTERVAL
                try:
                    self._send(self._settings.stop)
                    failed = 0
                except Exception:  # whatever the adapter's library raises, the next attempt may succeed
                    failed += 1
                if failed == STOP_ATTEMPTS:
                    return "the stop frames could not be sent; the arm may still move"
            try:
                frames = self._opened_receiver().take(due - self._clock.now())
            except (ConnectionLostError, DriverStateError):
                self._clock.sleep(due - self._clock.now())
                continue
            rows = joints.take(frames, dict(batches(frames)))
            for host_time, row in zip(rows.host_time.tolist(), rows.values[:, positions], strict=True):
                standstill.add(host_time, row)
            if standstill.at_rest:
                return ""
        return f"the arm did not show within {STOP_LIMIT:g} s of the stop frames that it is at rest"

    def _disconnect(self) -> None:
        if self._poller is not None:
            self._poller.stop()
        if self._receiver is not None:
            self._receiver.report_rest()
            self._notices.extend(self._receiver.notices())
            self._receiver.stop()
        if self._bus is not None:
            close_bus(self._bus)
        self._poller = self._receiver = self._sender = self._bus = None


class Commander:
    """Encodes one position after the other; counts them where the table has a counter."""

    def __init__(self, table: CommandTable, joints: Sequence[str]) -> None:
        self._table = table
        self._index = {joint: index for index, joint in enumerate(joints)}
        self._count = 0

    def frames(self, position: FloatArray) -> list[tuple[int, bytes]]:
        """The frames (identifier, data) of a joint position (n,) [rad].

        Raises:
            DriverStateError: a joint's position does not fit into its bits.
        """
        frames = []
        for layout in self._table.layouts:
            values = [self._value(signal, position) for signal in layout.signals]
            try:
                data = encode(layout, values, self._table.templates.get(layout.identifier, b""))
            except ValueError as error:
                raise DriverStateError(str(error), hint="the command table cannot express this motion") from error
            frames.append((layout.identifier, data))
        self._count += 1
        return frames

    def _value(self, signal: Signal, position: FloatArray) -> float:
        if signal.quantity == "position":
            return float(position[self._index[signal.joint]])
        low, high = signal.field.range
        return signal.gain * (low + self._count % (high - low + 1.0)) + signal.bias


def hear_all(settings: CanFramesSettings, receiver: Receiver, clock: Clock = SYSTEM_CLOCK) -> Order:
    """Wait until every frame of the joints has come, and see which begins a cycle.

    Raises:
        ConnectionFailedError: names what did not come.
        ConnectionLostError: the adapter is gone.
    """
    layouts, marker = settings.frame_layouts("joints"), settings.keys.marker
    order = CycleOrder(layouts)
    end = clock.now() + settings.keys.timeout
    heard: set[int] = set()
    while not order.enough or (marker is not None and marker not in heard):
        if (left := end - clock.now()) <= 0:
            break
        frames = receiver.take(left, at_least=len(layouts))
        heard.update(identifier for _, identifier, _ in frames)
        order.take(frames)
    missing = [layout.label for layout in order.never_seen()]
    if marker is not None and marker not in heard:
        missing.append(f"frame {identifier_text(marker)} that begins a cycle")
    if missing:
        only = ", ".join(identifier_text(identifier) for identifier in sorted(heard)) or "none of the table's frames"
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ConnectionFailedError(
            f"no {missing[0]}{more} within {settings.keys.timeout:g} s; heard: {only}",
            where=f"{settings.keys.interface} {settings.keys.channel}",
            hint="is the arm on, and are bit rate, identifiers, lengths and 'poll' right?",
        )
    return order.result()
