"""Reading and writing the memory of servos on one line."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, DriverStateError
from drivers.serial_servos.dynamixel import DynamixelProtocol
from drivers.serial_servos.feetech import FeetechProtocol
from drivers.serial_servos.line import Heard, ServoLine
from drivers.serial_servos.packets import BROADCAST, Packet, ServoProtocol
from drivers.serial_servos.registers import Register
from drivers.serial_servos.settings import ServoMotor, ServoSettings

PROTOCOLS: Mapping[str, type[ServoProtocol]] = {"feetech": FeetechProtocol, "dynamixel": DynamixelProtocol}
ATTEMPTS = 3
"""So often a single register is asked for before its servo counts as silent."""


@dataclass(frozen=True)
class ServoFeedback:
    """What all servos said in one cycle."""

    answers: Mapping[int, Packet]  # id → its answer; a servo that did not answer is missing
    strange: int  # bytes that belonged to no answer
    others: Collection[int]  # ids that no joint has, or whose answers have another length
    time: float  # in the middle between the request and the last answer [s, host's monotonic clock]
    received: float  # when the last answer was complete


class ServoBus:
    """The servos of a connection; safe to use from several threads.

    Whatever exchanges bytes raises ConnectionLostError where the port is gone.

    Attributes:
        line: under it.
        fast: whether the servos answer in one packet; found out by `open`.
        block: first address and number of bytes of the feedback.
        gathered: whether each shows it side by side at its indirect data, behind whether its torque is on; by `open`.
    """

    def __init__(self, settings: ServoSettings, clock: Clock = SYSTEM_CLOCK) -> None:
        self._motors = settings.motors
        protocol = PROTOCOLS[settings.motors[0].table.protocol]()
        self.line = ServoLine(settings.url, settings.keys.baudrate, protocol, clock)
        self.fast = self.gathered = False
        self._may_gather = not settings.keys.read_only and all(
            m.table.indirect is not None and len(m.table.gathered_bytes) <= m.table.indirect.count
            for m in settings.motors
        )
        self._lock: AbstractContextManager[object] = clock.lock()
        self._ids = [motor.id for motor in settings.motors]
        self._sync = all(motor.table.sync_read for motor in settings.motors)
        self._may_be_fast = settings.keys.fast_sync_read and all(m.table.fast_sync_read for m in settings.motors)
        blocks = [motor.table.block for motor in settings.motors]
        first = min(start for start, _ in blocks)
        self.block = self._scattered = first, max(start + size for start, size in blocks) - first

    def open(self) -> None:
        """Open the port, see whether it returns what is sent, and whether the servos answer in one packet.

        Raises:
            ConnectionFailedError: no such port.
            UsageError: a URL or a baud rate that cannot be.
        """
        self.line.open()
        protocol = self.line.protocol
        for motor in self._motors:
            entry = motor.table.registers["model_number"]
            request = protocol.read(motor.id, entry.address, entry.size)
            with self._lock:
                heard = self.line.notice_echo(request, protocol.answer_size(entry.size))
            if heard.answers:
                break
        self._gather()
        if self._may_be_fast:
            self.fast = True
            self.fast = len(self.feedback().answers) == len(self._ids)

    def close(self) -> None:
        """Let go of the port; safe at any time."""
        self.line.close()

    def _gather(self) -> None:
        """Let all servos show their feedback side by side in their RAM; nothing where one refuses (torque on)."""
        self.gathered, self.block = False, self._scattered
        if not self._may_gather:
            return
        for motor in self._motors:
            protocol, indirect = self.line.protocol, motor.table.indirect
            assert indirect is not None
            words = b"".join(place.to_bytes(2, "little") for place in motor.table.gathered_bytes)
            try:
                if self.read_bytes(motor, indirect.address, len(words)) == words:
                    continue
                with self._lock:
                    written = protocol.write(motor.id, indirect.address, words)
                    self.line.exchange(written, protocol.answer_size(0), [motor.id], hurried=False)
                if self.read_bytes(motor, indirect.address, len(words)) != words:
                    return
            except ConnectionFailedError:  # older firmware; who is silent shows when each is asked who it is
                return
        self.gathered = True
        self.block = 0, max(len(motor.table.gathered_bytes) for motor in self._motors)

    def _request(self) -> bytes:
        """Return the request for the feedback of all servos."""
        protocol, (address, size) = self.line.protocol, self.block
        if not self.gathered:
            return protocol.sync_read(address, size, self._ids, fast=self.fast)
        places = {m.id: m.table.indirect.data for m in self._motors if m.table.indirect is not None}
        if len({*places.values()}) == 1:
            return protocol.sync_read(places[self._ids[0]], size, self._ids, fast=self.fast)
        return protocol.bulk_read(places, size, fast=self.fast)

    def read(self, motor: ServoMotor, name: str) -> int:
        """The counts of a register, with their sign.

        Raises:
            ConnectionFailedError: the servo does not answer, or refuses.
        """
        entry = motor.table.registers[name]
        return entry.decoded(self.read_bytes(motor, entry.address, entry.size))

    def read_bytes(self, motor: ServoMotor, address: int, size: int, *, hurried: bool = False) -> bytes:
        """Bytes of a servo's memory; asked for once and not waited for long where `hurried`; raises as `read`."""
        protocol = self.line.protocol
        answer = self._asked(motor, protocol.read(motor.id, address, size), size, hurried=hurried)
        if len(answer.data) < size:
            raise ConnectionFailedError(f"{called(motor)} does not report address {address}", where=self.line.url)
        return answer.data

    def write(self, motor: ServoMotor, name: str, counts: int, *, configure: bool = False) -> None:
        """Write signed counts into a register, and wait for the servo to confirm it.

        Registers of the EEPROM are written only where `configure`.

        Raises:
            DriverStateError: the register is of the EEPROM, and may not be written.
            ConnectionFailedError: the servo does not answer, or holds something else afterwards.
        """
        entry = motor.table.registers[name]
        if entry.eeprom and not configure:
            raise DriverStateError(f"{name} of {called(motor)} is in EEPROM", hint="only --configure writes there")
        protocol, data = self.line.protocol, entry.encoded(counts)
        with self._lock:
            written = protocol.write(motor.id, entry.address, data)
            self.line.exchange(written, protocol.answer_size(0), [motor.id], hurried=False)
        # Servos may be set not to answer writings: what counts is what they hold then.
        held = self.read(motor, name)
        if held != counts:
            raise ConnectionFailedError(
                f"{called(motor)} holds {held} as {name} after {counts} was written",
                where=self.line.url,
                hint="is it in fault, or write-protected?",
            )

    def write_all(self, name: str, counts: Mapping[int, int]) -> None:
        """Write signed counts, by id, into a register of the RAM with one request; no servo answers."""
        entries: dict[tuple[int, int], dict[int, bytes]] = {}
        for motor in self._motors:
            if motor.id in counts:
                entry = motor.table.registers[name]
                if entry.eeprom:
                    raise DriverStateError(f"{name} is in EEPROM", hint="only --configure writes there")
                entries.setdefault((entry.address, entry.size), {})[motor.id] = entry.encoded(counts[motor.id])
        for (address, _), rows in entries.items():
            with self._lock:
                self.line.send(self.line.protocol.sync_write(address, rows))

    def feedback(self) -> ServoFeedback:
        """Read the feedback of all servos."""
        address, size = self.block
        protocol, count = self.line.protocol, len(self._ids)
        with self._lock:
            if self.fast:
                heard = self.line.exchange(self._request(), protocol.fast_answer_size(size, count), [BROADCAST])
                packets = [answer for packet in heard.answers for answer in protocol.fast_answers(packet, size)]
                return _feedback(packets, [heard], self._ids, size)
            if self._sync:
                heard = self.line.exchange(self._request(), count * protocol.answer_size(size), self._ids)
                return _feedback(heard.answers, [heard], self._ids, size)
            each = [
                self.line.exchange(protocol.read(motor, address, size), protocol.answer_size(size), [motor])
                for motor in self._ids
            ]
        return _feedback([answer for heard in each for answer in heard.answers], each, self._ids, size)

    def value(self, motor: ServoMotor, name: str, answer: Packet) -> int:
        """The counts of a register of the feedback in a servo's answer."""
        entry: Register = motor.table.registers[name]
        start = motor.table.gathered[name] if self.gathered else entry.address - self.block[0]
        return entry.decoded(answer.data[start : start + entry.size])

    def position(self, motor: ServoMotor, answer: Packet) -> float:
        """The joint's position [rad] in a servo's answer to the request for the feedback."""
        return motor.scale.position(self.value(motor, motor.table.feedback["position"], answer))

    def _asked(self, motor: ServoMotor, request: bytes, size: int, *, hurried: bool = False) -> Packet:
        strange = others = 0
        for _ in range(1 if hurried else ATTEMPTS):
            with self._lock:
                heard = self.line.exchange(request, self.line.protocol.answer_size(size), [motor.id], hurried=hurried)
            for answer in heard.answers:
                if answer.motor == motor.id:
                    return answer
            strange += heard.strange
            others += len(heard.answers)
        if strange:
            said, hint = "answers garbled", "two servos with this id, another baud rate, or a bad cable"
        elif others:
            said, hint = "does not answer; another id answers instead", "is anything else on this bus?"
        else:
            said, hint = (
                "does not answer",
                "check power, cable, id and baud rate; a servo keeps its id when it is moved to another joint",
            )
        raise ConnectionFailedError(f"{called(motor)} {said}", where=self.line.url, hint=hint)


def called(motor: ServoMotor) -> str:
    """A servo in messages."""
    return f"{motor.joint} (id {motor.id})"


def _feedback(packets: Sequence[Packet], heard: Sequence[Heard], ids: Sequence[int], size: int) -> ServoFeedback:
    answers = {packet.motor: packet for packet in packets if packet.motor in ids and len(packet.data) == size}
    others = sorted({packet.motor for packet in packets} - answers.keys())
    sent = heard[0].sent if heard else math.nan
    received = heard[-1].received if heard else math.nan
    strange = sum(answer.strange for answer in heard)
    return ServoFeedback(answers, strange, others, 0.5 * (sent + received), received)
