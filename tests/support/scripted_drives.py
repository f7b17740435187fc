"""CiA 402 drives on a virtual CAN bus that a test scripts, written without drivers.canopen402."""

from __future__ import annotations

import itertools
import os
import struct
from dataclasses import dataclass, field

import can
from simulated_clock import SimulatedClock

_channels = itertools.count()
SIZES = {
    0x1000: 4,
    0x1001: 1,
    0x100C: 2,
    0x100D: 1,
    0x1017: 2,
    0x1018: 4,
    0x6007: 2,
    0x603F: 2,
    0x6040: 2,
    0x6041: 2,
    0x605A: 2,
    0x6060: 1,
    0x6061: 1,
    0x6064: 4,
    0x6065: 4,
    0x6072: 2,
    0x607C: 4,
    0x607D: 4,
    0x607F: 4,
    0x6085: 4,
    0x606C: 4,
    0x6075: 4,
    0x6076: 4,
    0x6077: 2,
    0x6078: 2,
    0x607A: 4,
    0x6081: 4,
    0x6083: 4,
    0x6084: 4,
    0x608F: 4,
    0x6091: 4,
    0x6502: 4,
    0x2031: 2,
    0x1006: 4,
    0x60C2: 1,
}
SIGNED = {0x6007, 0x605A, 0x607C, 0x607D, 0x6060, 0x6061, 0x6064, 0x606C, 0x6077, 0x6078, 0x607A, 0x2031}
STATUS = {
    "not ready": 0x0000,
    "disabled": 0x0240,
    "ready": 0x0221,
    "switched on": 0x0233,
    "enabled": 0x0237,
    "quick stop": 0x0217,
    "reaction": 0x021F,
    "fault": 0x0218,
}
RAMP = 0.05
"""Duration of a quick stop [s]."""
FRAME_TIME = 1e-4
"""Duration of a drive's frame on the bus [s]."""
LOOK = 0.005
"""Between two checks of what a test may have changed [s]."""


def channel() -> str:
    """A virtual bus that no other test uses."""
    return f"drives-{os.getpid()}-{next(_channels)}"


@dataclass
class ScriptedDrive:
    """One drive; attributes may be changed while it runs."""

    node: int
    present: bool = True
    state: str = "disabled"
    bits: int = 0
    """Further bits of the statusword."""
    stuck: set[str] = field(default_factory=set)
    """States that it never enters."""
    quick_stop_stays: bool = False
    """Whether it stays in quick stop active (option code 6) instead of switching itself off (2)."""
    ignores_quick_stop: bool = False
    ramp: float = RAMP
    """Duration of its quick stop [s]."""
    clears_faults: bool = True
    mode_accepted: bool = True
    drop: dict[int, set[int]] = field(default_factory=dict)
    """SYNC number → TPDO numbers that it does not send."""
    repeat: dict[int, set[int]] = field(default_factory=dict)
    """SYNC number → TPDO numbers that it sends twice."""
    aborts: dict[tuple[int, int], int] = field(default_factory=dict)
    """(index, subindex) → abort code of any access."""
    beats: bool = True
    """Whether it sends heartbeats and answers guarding."""
    alternates: bool = True
    """Whether the toggle bit of its answers to guarding alternates."""
    slowness: float = 0.0
    """Delay of the answer to an SDO request [s]."""
    short_tpdo: bool = False
    nmt: int = 0x7F
    controlwords: list[int] = field(default_factory=list)
    """Those received by RPDO or SDO that differ from the one before."""
    states: list[str] = field(default_factory=list)
    targets: list[int] = field(default_factory=list)
    objects: dict[tuple[int, int], int | bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.states.append(self.state)
        self.objects = {
            (0x1000, 0): 0x00020192,
            (0x1008, 0): b"scripted drive",
            (0x100A, 0): b"test 1.0",
            (0x100C, 0): 0,
            (0x100D, 0): 0,
            (0x1016, 0): 2,
            (0x1016, 1): 0,
            (0x1016, 2): 0,
            (0x1017, 0): 0,
            (0x1018, 1): 0xABC,
            (0x1018, 2): 402,
            (0x1018, 3): 7,
            (0x1018, 4): 1000 + self.node,
            (0x6007, 0): 1,
            (0x603F, 0): 0,
            (0x6060, 0): 0,
            (0x6064, 0): 1000 * self.node,
            (0x606C, 0): 0,
            (0x6075, 0): 5000,
            (0x6076, 0): 50000,
            (0x6077, 0): 0,
            (0x6078, 0): 0,
            (0x607A, 0): 0,
            (0x6081, 0): 0,
            (0x6083, 0): 0,
            (0x6084, 0): 0,
            (0x608F, 1): 4096,
            (0x608F, 2): 1,
            (0x6091, 1): 100,
            (0x6091, 2): 1,
            (0x6502, 0): 0x81,
            (0x2031, 1): 312,
            **{(0x1800 + n, 1): 0x80000180 + 0x100 * n + self.node for n in range(4)},
            **{(0x1800 + n, 2): 255 for n in range(4)},
            (0x1400, 1): 0x80000200 + self.node,
            (0x1400, 2): 255,
            **{(0x1A00 + n, 0): 0 for n in range(2)},
            (0x1600, 0): 0,
        } | self.objects
        self._received: bytes | None = None
        self._pending: tuple[int, bytes] | None = None
        self._controlword = 0
        self._acknowledged = False
        self._ramp_until = 0.0
        self._next_beat = 0.0
        self._toggle = 0

    def number(self, index: int, subindex: int = 0) -> int:
        value = self.objects[index, subindex]
        assert isinstance(value, int)
        return value

    @property
    def statusword(self) -> int:
        return STATUS[self.state] | self.bits | (0x1000 if self._acknowledged else 0)

    def enter(self, state: str) -> None:
        if state in self.stuck or state == self.state:
            return
        self.state = state
        self.states.append(state)

    def fail(self, code: int = 0x4310, register: int = 0x09) -> bytes:
        """Fall into fault; the EMCY to send."""
        self.objects[0x603F, 0] = code
        self.enter("fault")
        return struct.pack("<HB5x", code, register)

    def control(self, word: int, now: float) -> None:  # noqa: C901, PLR0912 — a branch per request
        before, self._controlword = self._controlword, word
        if word != before or not self.controlwords:
            self.controlwords.append(word)
        command = word & 0x8F
        if self.state == "fault":
            if word & 0x80 and not before & 0x80 and self.clears_faults:
                self.enter("disabled")
        elif command & 0x02 == 0:
            self.enter("disabled")
        elif command & 0x06 == 0x02:
            if self.state == "enabled" and not self.ignores_quick_stop:
                self.enter("quick stop")
                self._ramp_until = now + self.ramp
                self.objects[0x606C, 0] = 50000
            elif self.state in ("ready", "switched on"):
                self.enter("disabled")
        elif command & 0x07 == 0x06:
            if self.state in ("disabled", "switched on", "enabled"):
                self.enter("ready")
        elif command & 0x0F == 0x07:
            if self.state in ("ready", "enabled"):
                self.enter("switched on")
        elif command & 0x0F == 0x0F and self.state == "switched on":
            self.enter("enabled")
        if self.mode_accepted:
            self.objects[0x6061, 0] = self.number(0x6060)

    def guard_answer(self) -> bytes:
        answer = bytes([self.nmt | self._toggle])
        self._toggle ^= 0x80 if self.alternates else 0
        return answer

    def due(self, now: float) -> float:
        """When something happens by itself [s]."""
        beat = max(self._next_beat, now) if self.beats and self.present and self.number(0x1017) else now + LOOK
        return min(now + LOOK, beat, self._ramp_until if self.state == "quick stop" else now + LOOK)

    def tick(self, now: float) -> bool:
        """Timed behaviour; whether it sends a heartbeat."""
        if self.state == "quick stop" and now >= self._ramp_until:
            self.objects[0x606C, 0] = 0
            self._ramp_until = now + RAMP
            if not self.quick_stop_stays:
                self.enter("disabled")
        period = 1e-3 * self.number(0x1017)
        if not (self.present and self.beats and period) or now < self._next_beat:
            return False
        self._next_beat = now + period
        return True

    def apply(self, now: float) -> None:
        """SYNC: the RPDO counts now."""
        data, self._received = self._received, None
        if data is None:
            return
        word, mode, target = struct.unpack("<Hbi", data)
        self.objects[0x6060, 0] = mode
        self.control(word, now)
        if self.state != "enabled":
            return
        if mode == 8 or (word & 0x10 and not self._acknowledged):
            self.objects[0x607A, 0] = self.objects[0x6064, 0] = target
            if not self.targets or self.targets[-1] != target:
                self.targets.append(target)
        self._acknowledged = mode == 1 and bool(word & 0x10)

    def tpdo(self, number: int) -> bytes:
        data = b""
        for entry in range(1, self.number(0x1A00 + number) + 1):
            mapped = self.number(0x1A00 + number, entry)
            index, bits = mapped >> 16, mapped & 0xFF
            assert bits == 8 * SIZES[index], hex(mapped)
            value = self.statusword if index == 0x6041 else self.number(index) if index != 0x6061 else self._display
            data += value.to_bytes(SIZES[index], "little", signed=index in SIGNED)
        return data[:-1] if self.short_tpdo else data

    @property
    def _display(self) -> int:
        value = self.objects.get((0x6061, 0), 0)
        assert isinstance(value, int)
        return value

    def answer(self, request: bytes, now: float) -> bytes | None:
        command, index, subindex = request[0], int.from_bytes(request[1:3], "little"), request[3]
        if command == 0x80:
            return None
        head = request[1:4]
        if command in (0x60, 0x70):  # segment of a text
            assert self._pending is not None
            toggle, rest = self._pending
            part, rest = rest[:7], rest[7:]
            self._pending = (toggle ^ 0x10, rest)
            return bytes([toggle | (7 - len(part)) << 1 | (not rest)]) + part.ljust(7, b"\0")

        def abort(code: int) -> bytes:
            return b"\x80" + head + struct.pack("<L", code)

        if (index, subindex) in self.aborts:
            return abort(self.aborts[index, subindex])
        if command == 0x40:
            if index == 0x6041:
                value: int | bytes = self.statusword
            elif (index, subindex) in self.objects:
                value = self.objects[index, subindex]
            else:
                return abort(0x06020000)
            if isinstance(value, bytes):
                self._pending = (0, value)
                return b"\x41" + head + struct.pack("<L", len(value))
            size = SIZES.get(index, 1 if (0x1400 <= index < 0x1A00 and subindex == 2) or subindex == 0 else 4)
            data = value.to_bytes(size, "little", signed=index in SIGNED)
            return bytes([0x43 | (4 - size) << 2]) + head + data.ljust(4, b"\0")
        size = 4 - (command >> 2 & 3)
        value = int.from_bytes(request[4 : 4 + size], "little", signed=index in SIGNED)
        writable = (index, subindex) in self.objects or 0x1600 <= index <= 0x1A01 or index == 0x6040
        if not writable:
            return abort(0x06020000)
        if index in (0x1A00, 0x1A01) and not self.number(index - 0x200, 1) & 0x80000000:
            return abort(0x08000022)  # the mapping of an enabled PDO
        self.objects[index, subindex] = value
        if index == 0x6040:
            self.control(value, now)
        return b"\x60" + head + bytes(4)


class ScriptedBus:
    """Serves drives on a virtual bus in a thread, in simulated time."""

    def __init__(self, drives: list[ScriptedDrive], clock: SimulatedClock, name: str | None = None) -> None:
        self.drives = drives
        self.clock = clock
        self.channel = name or channel()
        self.syncs = 0
        self.seen: list[tuple[int, bytes]] = []
        """Every data frame of the master: identifier, data."""
        self.times: list[float] = []
        """When each of them came [s]."""
        self.requests: list[tuple[float, int]] = []
        """Every remote frame: time, requested node."""
        self.bus = can.Bus(interface="virtual", channel=self.channel, ignore_config=True)
        self._ending = False
        self._thread = clock.thread(self._serve, "scripted drives")
        self._thread.start()

    def close(self) -> None:
        self._ending = True
        self._thread.join()
        self.bus.shutdown()

    def send(self, identifier: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def _answer(self, identifier: int, data: bytes) -> None:
        self.clock.sleep(FRAME_TIME)
        self.send(identifier, data)

    def fail(self, node: int, code: int = 0x4310) -> None:
        """A drive goes into fault and reports it."""
        drive = next(one for one in self.drives if one.node == node)
        self.send(0x80 + node, drive.fail(code))

    def restart(self, node: int) -> None:
        """A drive was without power for a moment."""
        index = next(i for i, one in enumerate(self.drives) if one.node == node)
        self.drives[index] = ScriptedDrive(node)
        self.send(0x700 + node, b"\0")

    def _serve(self) -> None:
        while not self._ending:
            now = self.clock.now()
            message = self.bus.recv(min(drive.due(now) for drive in self.drives) - now)
            for drive in self.drives:
                if drive.tick(self.clock.now()):
                    self.send(0x700 + drive.node, bytes([drive.nmt]))
            if message is not None and message.is_remote_frame:
                self._take_request(message)
            elif message is not None and not message.is_extended_id:
                self._take(message.arbitration_id, bytes(message.data))

    def _take_request(self, message: can.Message) -> None:
        assert message.dlc == 1
        self.requests.append((self.clock.now(), message.arbitration_id - 0x700))
        for drive in self.drives:
            if drive.present and drive.beats and message.arbitration_id == 0x700 + drive.node:
                assert not drive.number(0x1017)
                self._answer(message.arbitration_id, drive.guard_answer())

    def _take(self, identifier: int, data: bytes) -> None:  # noqa: C901, PLR0912 — a branch per request
        self.seen.append((identifier, data))
        self.times.append(self.clock.now())
        present = [drive for drive in self.drives if drive.present]
        if identifier == 0x80:
            number, self.syncs = self.syncs, self.syncs + 1
            for drive in present:
                if drive.nmt == 5:
                    drive.apply(self.times[-1])
                    for tpdo in (0, 1):
                        entry = drive.number(0x1800 + tpdo, 1)
                        if entry & 0x80000000 or drive.number(0x1800 + tpdo, 2) != 1:
                            continue
                        if tpdo in drive.drop.get(number, ()):
                            continue
                        for _ in range(2 if tpdo in drive.repeat.get(number, ()) else 1):
                            self._answer(entry & 0x7FF, drive.tpdo(tpdo))
        elif identifier == 0x000:
            for drive in present:
                if data[1] in (0, drive.node):
                    drive.nmt = {1: 0x05, 2: 0x04, 0x80: 0x7F}.get(data[0], drive.nmt)
        else:
            for drive in present:
                if identifier == 0x600 + drive.node:
                    reply = drive.answer(data, self.times[-1])
                    if reply is not None:
                        self.clock.sleep(drive.slowness)
                        self._answer(0x580 + drive.node, reply)
                elif identifier == drive.number(0x1400, 1) and drive.nmt == 5:
                    drive._received = data
