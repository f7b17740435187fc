"""Simulated serial bus servos on a line, in the time of a clock: real frames, as fast as their baud rate allows.

One thread does everything. A pseudo-terminal carries any number of bytes at once; so an answer is handed over when its
last bit would have come, behind the request and the servos' return delays.
"""

from __future__ import annotations

import math
import os
import random
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.serial_port import BITS_A_BYTE
from drivers.serial_servos.bus import PROTOCOLS
from drivers.serial_servos.dynamixel import DynamixelProtocol
from drivers.serial_servos.packets import (
    BROADCAST,
    BULK_READ,
    FAST_BULK_READ,
    FAST_SYNC_READ,
    PING,
    READ,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Packet,
)
from drivers.serial_servos.settings import ServoSettings, parse_settings
from sim_drivers.faults import Fault
from sim_drivers.plant.clocked_arm import start_position
from sim_drivers.plant.plant import Plant
from sim_drivers.pseudo_terminal import PseudoTerminal
from sim_drivers.serial_servos.arm import NOMINAL_VOLTAGE, ServoPlant
from sim_drivers.serial_servos.motor import SimulatedServo
from sim_drivers.served import SimOptions
from sim_drivers.server import FaultyServer, stated_keys, with_troubles

REBOOT = 0x08
"""Instruction of the Dynamixel protocol."""
IDLE = 0.02
"""[s] between two advances of an arm that is not asked."""
VOLTAGE, HEAT = 0, 2
"""Bits of a servo's status, in both protocols."""
UNHEARD = 0.003
"""[s] between two looks whether a client has opened the port."""
CHUNK = 4096


class SerialServoServer(FaultyServer):
    """Servos on a line; `start` plugs the adapter in, `stop` pulls it out.

    The arm stands at `position` (n,) [rad] at first, in the middle of the ranges where None. `line_end` is the
    adapter's end of the line, a pseudo-terminal where None.

    Attributes:
        servos: in the joints' order.
        plant: the arm behind them; known once started.
        requests, answers: so far.

    Raises:
        RobotFileError: a joint's truth has no servo.
    """

    def __init__(
        self,
        file: RobotFile,
        settings: ServoSettings,
        position: FloatArray | None = None,
        seed: int = 0,
        line_end: PseudoTerminal | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        super().__init__("serial servos", file.robot.joint_names, clock)
        self.settings = settings
        supply = file.robot.truth.supply
        volts = NOMINAL_VOLTAGE if supply is None else supply.nominal
        self.servos = [SimulatedServo(motor, volts) for motor in settings.motors]
        start = start_position(file, position)
        for servo, angle in zip(self.servos, start.tolist(), strict=True):  # held, as a program before left it
            servo.put("goal_position", servo.motor.scale.steps(angle))
            servo.put("torque_enable", 1)
        self.plant = ServoPlant(file, self.servos, start, clock.now(), seed)
        self.requests = self.answers = 0
        self._protocol = PROTOCOLS[settings.motors[0].table.protocol]()
        self._indices = {servo.motor.id: index for index, servo in enumerate(self.servos)}
        self._line = PseudoTerminal.at(settings.url) if line_end is None else line_end
        self._random = random.Random(seed)
        self._outgoing: deque[tuple[float, bytes]] = deque()
        self._free = self._frozen_until = self._sag_until = -math.inf
        self._latency = 0.0
        self._echo = False
        self._twice: set[int] = set()
        self._drop = self._garbage = self._truncate = self._wrong = 0
        self._plugged = False

    @property
    def path(self) -> str:
        """Path of the port that a client opens."""
        return self._line.path

    def ready(self) -> dict[str, object]:
        """Address for clients."""
        return {"port": self.path, "baudrate": self.settings.keys.baudrate}

    def live_line(self) -> str:
        """Return its state in one line."""
        torque = sum(bool(servo.get("torque_enable")) for servo in self.servos)
        line = f"{self.path}: {self.requests} requests, {self.answers} answers, torque on in {torque} servos"
        return with_troubles(line, stalls=self.plant.stalls)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"servos": self._serve}

    def _open(self) -> None:
        self._line.plug_in()
        self._plugged = True

    def _close(self) -> None:
        if self._plugged:
            self._plugged = False
            self._line.pull_out()
        self._line.remove()

    def _serve(self) -> None:
        heard = bytearray()
        while not self._stopping.is_set():
            now = self._clock.now()
            self._pass_time(now)
            data = self._heard(now)
            if not data:
                continue
            heard += data
            if self._echo:
                self._write(data)
            requests, _ = self._protocol.requests(heard)
            if requests:
                now = self._clock.now()
                self.plant.advance(now)
                self.plant.report()
            for request in requests:
                self._obey(request, now)

    def _pass_time(self, now: float) -> None:
        """Faults, the arm, its watchdogs, and answers whose time has come."""
        for fault in self._new_faults():
            self._apply(fault, now)
        self.plant.advance(now)
        for servo in self.servos:
            servo.watch(now)
        if self.plant.sagging and now >= self._sag_until:
            for servo in self.servos:
                servo.errors &= ~(1 << VOLTAGE)
        self.plant.sagging = now < self._sag_until
        while self._outgoing and self._outgoing[0][0] <= now:
            self._write(self._outgoing.popleft()[1])

    def _heard(self, now: float) -> bytes:
        """Return what a client has sent, waiting for it until the next answer is due."""
        due = self._outgoing[0][0] - now if self._outgoing else IDLE
        if not self._plugged:
            self._stopping.wait(IDLE)
            return b""
        readable, _ = self._clock.select([self._line], [], min(due, IDLE))
        if not readable:
            return b""
        data = self._read()
        if not data:  # no client has the port open
            self._stopping.wait(UNHEARD)
        return data

    def _obey(self, request: Packet, now: float) -> None:
        self.requests += 1
        listening = [servo for servo in self.servos if not servo.dead and now >= servo.silent_until]
        for servo in listening:
            servo.asked = now
        if request.motor == BROADCAST:
            answer, delay = self._obeyed_by_all(request, listening, now)
        else:
            answer, delay = b"", 0.0
            for servo in listening:
                if servo.motor.id == request.motor:
                    answer, delay = self._obeyed(servo, request, now), self._delay(servo)
        begun = max(self._free, now)
        on_wire = (len(request.data) + self._protocol.answer_size(0) + len(answer)) * BITS_A_BYTE
        self._free = begun + on_wire / self.settings.keys.baudrate + delay
        if answer and (answer := self._spoilt(answer, now)):
            self.answers += 1
            when = self._free
            if self._latency:
                when = math.ceil(when / self._latency) * self._latency
            self._outgoing.append((when, answer))

    def _obeyed(self, servo: SimulatedServo, request: Packet, now: float) -> bytes:
        """Return what a servo answers to a request of its own."""
        word = self._protocol.word
        address, rest = int.from_bytes(request.data[:word], "little"), request.data[word:]
        data, error = b"", 0
        match request.code:
            case c if c == PING:
                if self._protocol.name == "dynamixel":
                    entry = servo.table.registers["model_number"]
                    data = servo.read(entry.address, entry.size) + bytes([servo.get("firmware")])
            case c if c == READ:
                data = servo.read(address, int.from_bytes(rest, "little"))
            case c if c == WRITE:
                error = self._written(servo, address, rest, now)
            case c if c == REBOOT and self._protocol.name == "dynamixel":
                servo.restart(now)
                self.plant.changed()
            case _:
                error = 2
        return self._answer(servo, error if self._protocol.name == "dynamixel" else 0, data)

    def _obeyed_by_all(self, request: Packet, listening: list[SimulatedServo], now: float) -> tuple[bytes, float]:
        """Return what the servos answer to a request to all of them, and how long they wait."""
        by_id = {servo.motor.id: servo for servo in listening}
        word = self._protocol.word
        address, size = (int.from_bytes(request.data[k : k + word], "little") for k in (0, word))
        rest = request.data[2 * word :]
        if request.code == SYNC_WRITE:
            for start in range(0, len(rest) - size, size + 1):
                if (servo := by_id.get(rest[start])) is not None:
                    self._written(servo, address, rest[start + 1 : start + 1 + size], now)
            return b"", 0.0
        if request.code == PING:
            ordered = sorted(listening, key=lambda servo: servo.motor.id)
            answers = [self._obeyed(servo, request, now) for servo in ordered]
            return b"".join(answers), sum(map(self._delay, ordered))
        asked = [(motor, address, size) for motor in rest]
        if request.code in (BULK_READ, FAST_BULK_READ):
            rest = request.data
            asked = [
                (rest[k], int.from_bytes(rest[k + 1 : k + 3], "little"), int.from_bytes(rest[k + 3 : k + 5], "little"))
                for k in range(0, len(rest) - 4, 5)
            ]
        dynamixel = isinstance(self._protocol, DynamixelProtocol)
        one_each = request.code == SYNC_READ and all(servo.table.sync_read for servo in listening)
        if listening and (one_each or (request.code == BULK_READ and dynamixel)):
            heard = [(by_id[motor], place, count) for motor, place, count in asked if motor in by_id]
            answers = [self._answer(servo, 0, servo.read(place, count)) for servo, place, count in heard]
            return b"".join(answers), sum(self._delay(servo) for servo, _, _ in heard)
        if request.code in (FAST_SYNC_READ, FAST_BULK_READ) and isinstance(self._protocol, DynamixelProtocol):
            rows = []
            for motor, place, count in asked:
                if (servo := by_id.get(motor)) is None:  # the next ones wait for it
                    break
                rows.append((motor, servo.answer_code, servo.read(place, count)))
            whole = self._protocol.fast_answer(rows) if rows else b""
            if self._twice & {motor for motor, _, _ in rows}:
                whole = _with_others(whole, self._protocol.fast_answer([(m, e, _other(d)) for m, e, d in rows]))
            return whole if len(rows) == len(asked) else whole[:-2], sum(self._delay(by_id[row[0]]) for row in rows)
        return b"", 0.0

    def _answer(self, servo: SimulatedServo, error: int, data: bytes) -> bytes:
        answer = self._protocol.answer(servo.motor.id, servo.answer_code | error, data)
        if servo.motor.id in self._twice:
            answer = _with_others(
                answer, self._protocol.answer(servo.motor.id, servo.answer_code | error, _other(data))
            )
        return answer

    def _written(self, servo: SimulatedServo, address: int, data: bytes, now: float) -> int:
        error = servo.write(address, data)
        goal = servo.table.registers["goal_position"]
        if not error and address <= goal.address < address + len(data):
            self.plant.take_goal(self._indices[servo.motor.id], now)
        self.plant.changed()
        return error

    def _delay(self, servo: SimulatedServo) -> float:
        return servo.get("return_delay") * servo.table.registers["return_delay"].scale

    def _spoilt(self, answer: bytes, now: float) -> bytes:
        """An answer as the faults leave it."""
        if self._drop > 0 or now < self._frozen_until:
            self._drop = max(0, self._drop - 1)
            return b""
        if self._garbage > 0:
            self._garbage -= 1
            return self._random.randbytes(self._random.randrange(1, len(answer) + 1))
        if self._truncate > 0:
            self._truncate -= 1
            return answer[:-2]
        if self._wrong > 0:
            self._wrong -= 1
            return answer[:-1] + bytes([answer[-1] ^ 1])
        return answer

    def _apply(self, fault: Fault, now: float) -> None:  # noqa: C901, PLR0912 — one case a fault
        match fault:
            case Fault("drop", (count,)):
                self._drop += count
            case Fault("freeze", (duration,)):
                self._frozen_until = now + duration
            case Fault("garbage", (count,)):
                self._garbage += count
            case Fault("truncate", (count,)):
                self._truncate += count
            case Fault("wrong-sum", (count,)):
                self._wrong += count
            case Fault("latency", (seconds,)):
                self._latency = seconds
            case Fault("echo", ()):
                self._echo = True
            case Fault("sag", (duration,)):
                self._sag_until = now + duration
                for servo in self.servos:
                    servo.errors |= 1 << VOLTAGE
            case Fault("heat", (joint, celsius)):
                self.plant.heat(joint, celsius)
            case Fault("block", (joint,)):
                self.plant.arm.block(joint)
            case Fault("die", (joint,)):
                self.servos[joint].dead = True
            case Fault("same-id", (joint,)):
                self._twice.add(self.servos[joint].motor.id)
            case Fault("power-cycle", (joint,)):
                self.servos[joint].restart(now)
            case Fault("over-temperature", (joint,)):
                self.servos[joint].protect(HEAT)
            case Fault("unplug", ()):
                self._plugged = False
                self._line.pull_out()
            case _:
                self._not_caused(fault)
        self.plant.changed()

    def _read(self) -> bytes:
        try:
            return os.read(self._line.fileno(), CHUNK)
        except OSError:  # no client has the port open, or nothing is there after all
            return b""

    def _write(self, data: bytes) -> None:
        try:
            os.write(self._line.fileno(), data)
        except OSError:  # no reader
            return


def _other(data: bytes) -> bytes:
    """Return what another servo with the same id tells: its encoder shows something else."""
    return bytes(value ^ 0x2A for value in data)


def _with_others(answer: bytes, other: bytes) -> bytes:
    """Two answers at once: both pull the line down, where either sends a 0."""
    return bytes(mine & its for mine, its in zip(answer, other, strict=False))


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock, driver: str) -> SerialServoServer:
    """Servos of a protocol as the robot file's connection has them; `--channel` is the path of their port."""
    robot = robot_file.robot
    keys = stated_keys(robot, driver, "there are no ids", "docs/serial-servos.md")
    if options.channel is not None:
        keys["url"] = options.channel
    settings = parse_settings(keys, robot.joint_names, robot_file.folder, driver)
    # Of the plant, whose drives are commanded torques, place and contacts are taken: servos have a plant of their own.
    server = SerialServoServer(robot_file, settings, plant.position.copy(), options.seed, clock=clock)
    server.plant.arm.contacts = plant.contacts
    return server


serve_feetech, serve_dynamixel = (partial(serve, driver=protocol) for protocol in PROTOCOLS)
