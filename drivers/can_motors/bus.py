"""Exchanging frames with the motors of a connection: readings, goals, registers that are written and read back."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import can

from drivers.base import Notice
from drivers.can.bus import RETURNED, Sender, close_bus, confirms_sending, open_bus, returns_own_frames
from drivers.can.receiver import Receiver
from drivers.can_motors.codec import Answer, CanFrame
from drivers.can_motors.settings import CanMotor, CanMotorSettings
from drivers.core.clock import STALL_LIMIT, SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

ATTEMPTS = 3
"""So often a motor is asked before it counts as silent."""
PATIENCE = 0.1
"""[s] that an answer to a single question is waited for."""
LOOK = 0.005
"""[s] that one look for frames lasts at most."""
LOOKING_AGAIN = 0.001
"""[s] that frames are waited for which have arrived at the adapter."""
ALIKE = 1e-3
"""How far a register may be from what was written, as a share: floating-point numbers of 32 bits."""


MOST_AWAITED = 100
"""Answers that may come late, all at once, from a bus or a computer that stalled; more are lost."""
RETURNED_FRAMES = 256
"""Frames of this program's own by which those are known that a bus returns to their sender."""
CALLING = 1.0
"""[s] between two roll calls of motors whose answers cannot be counted."""
Commands = Sequence[Sequence[CanFrame]]
"""Frames to every motor."""
FAULT = "fault"
"""Beside quantities, what a frame says."""


@dataclass(frozen=True)
class MotorState:
    """What a motor said in one cycle."""

    values: Mapping[str, float]  # quantity → value in the motor's own direction, from its own zero
    fault: int  # code; 0 without
    enabled: bool | None  # whether it drives; None where its family does not say
    time: float  # when its last frame came [s, host's monotonic clock]
    surplus: int  # answers that came so far beyond one for each request
    serials: int  # different serial numbers that came so far from its id


@dataclass(frozen=True)
class Feedback:
    """What the motors said in one cycle."""

    states: Mapping[int, MotorState]  # index of a motor → its state; a motor that did not tell everything is missing
    strange: int  # frames that were no motor's
    time: float  # in the middle between sending and the last answer [s, host's monotonic clock]
    received: float  # when the last answer came
    overdue: int = 0  # motors whose answers to an earlier request came after they had been given up
    # index of a motor → how long before its answer it obeyed the command in force [s]; inf before the first
    ages: Mapping[int, float] = field(default_factory=dict)


class MotorBus:
    """The motors of a connection; safe to use from several threads.

    Whatever sends or awaits frames raises ConnectionLostError where the adapter is gone, or carries nothing.

    Attributes:
        codecs: one a motor; they may be replaced while nothing is exchanged.
    """

    def __init__(self, settings: CanMotorSettings, clock: Clock = SYSTEM_CLOCK) -> None:
        self._settings, self._motors, self._clock = settings, settings.motors, clock
        self.codecs = settings.codecs()
        self._lock = clock.lock()
        self._bus: can.BusABC | None = None
        self._sender: Sender | None = None
        self._receiver: Receiver | None = None
        self._turn = 0
        self._surplus = [0 for _ in self._motors]
        self._serials: list[set[bytes]] = [set() for _ in self._motors]
        self._called = -math.inf
        self._obeyed = [-math.inf for _ in self._motors]
        self._returned: deque[CanFrame] | None = None
        self._told: list[dict[str, float]] = [{} for _ in self._motors]
        self._state: list[tuple[int, bool | None]] = [(0, None) for _ in self._motors]

    def open(self) -> None:
        """Open the bus.

        Raises:
            ConnectionFailedError: no such bus.
        """
        self._told = [{} for _ in self._motors]
        self._state = [(0, None) for _ in self._motors]
        self._surplus = [0 for _ in self._motors]
        self._serials = [set() for _ in self._motors]
        self._obeyed = [-math.inf for _ in self._motors]
        keys, fd = self._settings.keys, self.codecs[0].fd
        options = {**keys.options}
        if confirms := confirms_sending(keys.interface, keys.options):
            options |= RETURNED
        if fd and keys.interface == "socketcan":
            options |= {"fd": True}
        elif fd and keys.interface not in ("virtual", "udp_multicast"):
            options |= {"fd": True, "data_bitrate": keys.data_bitrate}
        self._bus = open_bus(keys.interface, keys.channel, keys.bitrate, options)
        self._sender = Sender(self._bus, self._clock, fd=fd)
        own = self._sender.confirm if confirms else None
        self._returned = deque(maxlen=RETURNED_FRAMES) if returns_own_frames(self._bus) else None
        self._receiver = Receiver(self._bus, clock=self._clock, own=own, fd=fd)
        self._receiver.start()

    def close(self) -> None:
        """Let go of the bus; safe at any time."""
        if self._receiver is not None:
            self._receiver.stop()
        if self._bus is not None:
            close_bus(self._bus)
        self._bus = self._sender = self._receiver = None

    def notices(self) -> list[Notice]:
        """Return what the bus had to say since the last call."""
        return self._receiver.notices() if self._receiver is not None else []

    def send(self, frames: Sequence[CanFrame]) -> float:
        """Send frames, of which nothing is awaited; when."""
        sender, _ = self._opened()
        return self._send(sender, frames)

    def cycle(self, commands: Commands | None = None, patience: float = PATIENCE) -> Feedback:
        """Read all motors, and command them, if so: by their answers, else just before.

        Either way a reading is of the time before its command acts, and one exchange a cycle does for both.
        """
        read_only = self._settings.keys.read_only
        frames: list[CanFrame] = []
        for index, codec in enumerate(self.codecs):
            frames += codec.poll(read_only=read_only) if commands is None or not codec.answers_goals else ()
            frames += commands[index] if commands is not None else ()
        self._turn = (self._turn + 1) % len(self.codecs)
        frames += self.codecs[self._turn].slow_poll()
        if self.codecs[0].unasked and self._clock.now() - self._called >= CALLING:
            self._called = self._clock.now()
            frames += self.codecs[0].roll_call(read_only=read_only)
        before = self._obeyed.copy()
        feedback = self.exchange(frames, patience)
        if commands is not None:
            self._obeyed = [
                feedback.states[k].time if k in feedback.states else feedback.time for k in range(len(before))
            ]
        ages = {index: said.time - before[index] for index, said in feedback.states.items()}
        return replace(feedback, ages=ages)

    def forget_surplus(self) -> None:
        """Count answers anew: frames that were not counted were answered, too. What is still awaited may come later."""
        self._surplus = [min(surplus, 0) for surplus in self._surplus]

    def exchange(self, frames: Sequence[CanFrame], patience: float, of: int | None = None) -> Feedback:
        """Send frames and receive answers until all motors have answered in full, `patience` [s] at most.

        Time in which this process did not run is none of waiting. Where an index is given (`of`), only that motor is
        waited for, also for what it tells slowly.
        """
        sender, receiver = self._opened()
        with self._lock:
            heard: list[set[str]] = [set() for _ in self._motors]
            late: list[set[str]] = [set() for _ in self._motors]
            for _, identifier, data in receiver.take():  # too late for its row, but not for a fault
                self._hear(identifier, data, late)
            overdue = sum("position" in quantities for quantities in late)
            for asked in range(len(self._motors)) if of is None else (of,):
                self._surplus[asked] = max(self._surplus[asked] - 1, -MOST_AWAITED)
            sent = self._send(sender, frames)
            end, received, strange = sent + patience, sent, 0
            when = [-math.inf] * len(self._motors)
            everyone = range(len(self._motors))
            wanted = [self._fast(k) if of is None else self._all(k) if of == k else set() for k in everyone]
            while any(need - got for need, got in zip(wanted, heard, strict=True)):
                now = self._clock.now()
                left = end - now
                came = receiver.take(max(min(left, LOOK), 0.0))
                end += self._clock.late(now + max(min(left, LOOK), 0.0))
                if not came and left <= 0.0:
                    # What has arrived is no motor's fault: the thread that takes it from the adapter is late.
                    if left < -patience or not receiver.pending():
                        break
                    came = receiver.take(LOOKING_AGAIN)
                for arrived, identifier, data in came:
                    index = self._hear(identifier, data, late if arrived < sent else heard)
                    if index is None and not self._is_own((identifier, data)):
                        strange += 1
                    elif index is not None and arrived >= sent:
                        when[index] = received = arrived
        self._require_carried(sender, receiver)
        states = {
            index: MotorState(
                dict(self._told[index]),
                *self._state[index],
                when[index],
                self._surplus[index],
                len(self._serials[index]),
            )
            for index in range(len(self._motors))
            if heard[index] and not wanted[index] - heard[index] | self._wanted(index) - self._told[index].keys()
        }
        return Feedback(states, strange, 0.5 * (sent + received), received, overdue)

    def doubled(self) -> list[int]:
        """Indices of motors whose ids others have, too; an answer to an earlier question does not come three times."""
        sender, receiver = self._opened()
        calls = [codec.roll_call(read_only=self._settings.keys.read_only) for codec in self.codecs]
        calling = list(dict.fromkeys(frame for frames in calls for frame in frames))
        doubled = [index for index, frames in enumerate(calls) if frames]
        for _ in range(ATTEMPTS):
            if not doubled:
                break
            with self._lock:
                receiver.take()
                end = self._send(sender, calling) + self.codecs[0].roll_call_time
                heard: list[CanFrame] = []
                while (left := end - self._clock.now()) > 0.0:
                    heard += [(identifier, data) for _, identifier, data in receiver.take(left)]
            doubled = [index for index in doubled if self.codecs[index].present(heard) > 1]
        return doubled

    def state(self, index: int) -> MotorState:
        """Ask one motor for its state.

        Raises:
            ConnectionFailedError: it does not answer.
        """
        read_only = self._settings.keys.read_only
        codec = self.codecs[index]
        for _ in range(ATTEMPTS):
            feedback = self.exchange((*codec.poll(read_only=read_only), *codec.slow_poll()), PATIENCE, index)
            if (said := feedback.states.get(index)) is not None:
                return said
        raise self._silent(self._motors[index])

    def read(self, index: int, register: str) -> float:
        """A register of a motor.

        Raises:
            ConnectionFailedError: it does not answer.
        """
        sender, receiver = self._opened()
        codec, number = self.codecs[index], self.codecs[index].registers[register]
        for _ in range(ATTEMPTS):
            with self._lock:
                receiver.take()
                end = self._send(sender, (codec.read(register),)) + PATIENCE
                while (left := end - self._clock.now()) > 0.0:
                    for _, identifier, data in receiver.take(left):
                        answer = codec.parse(identifier, data, number)
                        if answer is not None and answer.register is not None and answer.register[0] == number:
                            return answer.register[1]
        raise self._silent(self._motors[index])

    def write(self, index: int, register: str, value: float) -> None:
        """Write a register of a motor's volatile memory, and read it back.

        Raises:
            ConnectionFailedError: it does not answer, or holds something else afterwards.
        """
        self.send((self.codecs[index].write(register, value),))
        held = self.read(index, register)
        if abs(held - value) > ALIKE * abs(value):
            raise ConnectionFailedError(
                f"{self._motors[index].name} holds {held:g} as {register} after {value:g} was written",
                where=self._settings.where,
                hint="is it in fault, or is its firmware too old for it?",
            )

    def _send(self, sender: Sender, frames: Sequence[CanFrame]) -> float:
        """Send frames; when."""
        if self._returned is not None:
            self._returned += frames
        return sender.send_all(frames)

    def _hear(self, identifier: int, data: bytes, heard: list[set[str]]) -> int | None:
        """The motor whose frame it is; None where it is none's."""
        index, answer = self._owner(identifier, data)
        if index is None or answer is None:
            return None
        if "position" in heard[index] and "position" in answer.values:
            return index
        if answer.serial is not None:
            self._serials[index].add(answer.serial)
        heard[index] |= answer.values.keys() | ({FAULT} if answer.fault is not None else set())
        self._told[index] |= answer.values
        fault, enabled = self._state[index]
        self._state[index] = (
            fault if answer.fault is None else answer.fault,
            enabled if answer.enabled is None else answer.enabled,
        )
        return index

    def _owner(self, identifier: int, data: bytes) -> tuple[int | None, Answer | None]:
        """The motor whose frame it is, and what it says."""
        for index, codec in enumerate(self.codecs):
            if (answer := codec.parse(identifier, data)) is not None:
                self._surplus[index] += "position" in answer.values
                return index, answer
        return None, None

    def _is_own(self, frame: CanFrame) -> bool:
        """Return whether a bus that returns what is sent returned this frame."""
        if self._returned is None or frame not in self._returned:
            return False
        self._returned.remove(frame)
        return True

    def _wanted(self, index: int) -> set[str]:
        return set(self.codecs[index].quantities(read_only=self._settings.keys.read_only))

    def _fast(self, index: int) -> set[str]:
        """Return what a motor tells in each cycle."""
        wanted = self._wanted(index)
        return wanted - {"temperature", "drive_temperature"} if self.codecs[index].slow_poll() else wanted

    def _all(self, index: int) -> set[str]:
        """What a motor tells when it is asked for everything; its fault, too, where that is a frame of its own."""
        return self._wanted(index) | ({FAULT} if self.codecs[index].slow_poll() else set())

    def _opened(self) -> tuple[Sender, Receiver]:
        if self._sender is None or self._receiver is None:
            raise ConnectionLostError("the bus is closed", where=self._settings.where)
        return self._sender, self._receiver

    def _require_carried(self, sender: Sender, receiver: Receiver) -> None:
        if receiver.failure is not None:
            raise receiver.failure
        if sender.unconfirmed is not None and receiver.drained - sender.unconfirmed > STALL_LIMIT:
            raise ConnectionLostError(
                f"nothing that was sent for {STALL_LIMIT:g} s came back from the adapter: the bus does not carry it",
                where=self._settings.where,
                hint="is the bus terminated, and another device on it, at this bit rate?",
            )

    def _silent(self, motor: CanMotor) -> ConnectionFailedError:
        return ConnectionFailedError(
            f"{motor.name} does not answer",
            where=self._settings.where,
            hint="power, cables, termination, bit rate, and its id; no other program may command it",
        )
