"""Simulated CAN motors on a python-can bus, in the time of a clock.

One thread does everything. Frames pass a model of the bus, so that none is there earlier than on a real one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import can

from daq.robot.loader import RobotFile
from drivers.bus_budget import fd_frame_bits
from drivers.can.bus import EXTENDED, REMOTE, returns_own_frames
from drivers.can.receiver import ArrivalClock
from drivers.can_motors.settings import CODECS, CanMotorSettings, parse_settings
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.text import percent_text
from sim_drivers.can.bus_load import BusModel, Frame, Sent, exact_bits
from sim_drivers.can.bus_server import BusServer, frame_of, message_of, table_keys
from sim_drivers.can_motors.arm import MotorPlant
from sim_drivers.can_motors.motors import SIMULATED, SimulatedMotor
from sim_drivers.faults import Fault
from sim_drivers.plant.clocked_arm import start_position
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions
from sim_drivers.server import with_troubles

if TYPE_CHECKING:
    from collections.abc import Callable

ANSWERING = 50e-6
"""[s] that a motor takes for its answer: an assumption."""
IDLE = 0.005
"""[s] between two advances of an arm that is not asked."""
REMEMBERED = 256
"""Own frames by which those are known that a bus returns to their sender."""


class CanMotorServer(BusServer):
    """Motors that are switched on by `start` and off by `stop`.

    The arm stands at `position` (n,) [rad] at first, in the middle of the ranges where None; `held` there, as a program
    before left it, or limp.

    Attributes:
        settings: as given.
        motors: in the joints' order.
        plant: the arm behind them.
        requests, answers: so far.

    Raises:
        RobotFileError: a joint's truth has no servo.
    """

    def __init__(
        self,
        file: RobotFile,
        settings: CanMotorSettings,
        position: FloatArray | None = None,
        clock: Clock = SYSTEM_CLOCK,
        *,
        held: bool = False,
    ) -> None:
        super().__init__("CAN motors", file.robot.joint_names, settings.keys, clock)
        self.settings = settings
        start = start_position(file, position)
        self.plant = MotorPlant(file, settings.motors, start, clock.now())
        kind = SIMULATED[settings.family]
        self.motors: list[SimulatedMotor] = [
            kind(motor, index, self.plant) for index, motor in enumerate(settings.motors)
        ]
        for motor, angle in zip(self.motors if held else (), start.tolist(), strict=False):
            motor.hold(angle, clock.now())
        self.requests = self.answers = 0
        self._fd = CODECS[settings.family].fd
        keys = settings.keys
        speed_up = keys.data_bitrate / keys.bitrate
        length: Callable[[Frame], int] = exact_bits
        if self._fd:
            length = lambda frame: math.ceil(fd_frame_bits(len(frame.data), speed_up))  # noqa: E731
        self._model = BusModel(keys.bitrate, length)
        self._incoming: deque[tuple[Frame, float]] = deque()
        self._recent: deque[tuple[int, bytes]] = deque(maxlen=REMEMBERED)
        self._sag_until = self._sent_until = -math.inf
        self._twice: set[int] = set()
        self._begun = clock.now()

    def live_line(self) -> str:
        """Return its state in one line."""
        on = sum(motor.enabled for motor in self.motors)
        load = self._model.bits / self.settings.keys.bitrate / max(self._clock.now() - self._begun, 1e-9)
        line = f"{self.requests} requests, {self.answers} answers, {on} motors on, bus load {percent_text(load, 2)}"
        return with_troubles(line, stalls=self.plant.stalls)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"can-motors": self._run_on_bus}

    def _serve(self, bus: can.BusABC) -> None:
        stamps, returned = ArrivalClock(bus, self._clock), returns_own_frames(bus)
        self._begun = self._clock.now()
        while not self._stopping.is_set():
            end = self._model.peek()
            now = self._clock.now()
            message = self._received(bus, IDLE if end is None else min(max(end - now, 0.0), IDLE))
            while message is not None:
                self._take(message, stamps, returned=returned)
                message = self._received(bus, 0.0)
            for fault in self._new_faults():
                self._cause(bus, fault, self._clock.now())
            self._advance(bus, self._clock.now())

    def _take(self, message: can.Message, stamps: ArrivalClock, *, returned: bool) -> None:
        if (frame := frame_of(message, 64 if self._fd else 8)) is None:
            return
        if returned and (frame.id, frame.data) in self._recent:
            self._recent.remove((frame.id, frame.data))
            return
        self._incoming.append((frame, stamps.arrived(message)))
        if len(self._incoming) == 1:
            self._submit_next()

    def _submit_next(self) -> None:
        """The client's next frame: an adapter sends what it was given in its order, whatever the identifiers."""
        frame, arrived = self._incoming[0]
        # A thread that was late receives frames after the bus has gone on: they queue where it is.
        self._model.submit(frame, max(arrived, self._sent_until), own=False)

    def _advance(self, bus: can.BusABC, now: float) -> None:
        """Everything that is due by a time: frames that are over on the bus, time-outs, the arm."""
        while (end := self._model.peek()) is not None and end <= now:
            sent = self._model.pop()
            self._sent_until = sent.time
            if sent.own:
                self._transmit(bus, sent.frame)
                continue
            if sent.time >= self._silent_until:
                self._hear(sent)
            self._incoming.popleft()
            if self._incoming:
                self._submit_next()
        self._watch(now)

    def _watch(self, now: float) -> None:
        self.plant.advance(now)
        for motor in self.motors:
            motor.watch(now)
        if self.plant.sagging and now >= self._sag_until:
            self.plant.sagging = False

    def _hear(self, sent: Sent) -> None:
        frame = sent.frame
        identifier = frame.id | (EXTENDED if frame.extended else 0) | (REMOTE if frame.remote else 0)
        self._watch(sent.time)
        self.requests += 1
        for motor in self.motors:
            if motor.dead or sent.time < motor.silent_until:
                continue
            for target, data in motor.hear(identifier, frame.data, sent.time):
                self._submit(target, data, sent.time + ANSWERING)
                if motor.index in self._twice:
                    self._submit(target, motor.of_other(target, data), sent.time + ANSWERING)

    def _submit(self, identifier: int, data: bytes, ready: float) -> None:
        plain = identifier & ~EXTENDED
        self._model.submit(Frame(plain, data, bool(identifier & EXTENDED) or plain > 0x7FF), ready, own=True)

    def _transmit(self, bus: can.BusABC, frame: Frame) -> None:
        if (left := self._spoilt(frame)) is not None:
            self.answers += 1
            self._recent.append((left.id, left.data))
            bus.send(message_of(left, fd=self._fd))

    def _spread(self, bus: can.BusABC, frame: Frame, now: float) -> None:
        self._model.submit(frame, now, own=True)

    def _cause(self, bus: can.BusABC, fault: Fault, now: float) -> None:
        match fault:
            case Fault("sag", (duration,)):
                self._sag_until, self.plant.sagging = now + duration, True
                for motor in self.motors:
                    motor.protect(motor.under_voltage)
            case Fault("heat", (joint, celsius)):
                self.plant.heat(joint, celsius)
            case Fault("block", (joint,)):
                self.plant.arm.block(joint)
            case Fault("die", (joint,)):
                self.motors[joint].die()
            case Fault("same-id", (joint,)):
                self._twice.add(joint)
            case Fault("power-cycle", (joint,)):
                self.motors[joint].restart(now)
            case Fault("over-temperature", (joint,)):
                self.motors[joint].protect(self.motors[joint].over_temperature)
            case _:
                super()._cause(bus, fault, now)


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock, family: str) -> CanMotorServer:
    """Motors of a family as the robot file's connection has them."""
    robot = robot_file.robot
    keys = table_keys(robot, family, options, "there are no ids", "docs/can-motors.md")
    settings = parse_settings(keys, robot.joint_names, family)
    # Of the plant, whose drives are commanded torques, place and contacts are taken: motors have a plant of their own.
    server = CanMotorServer(robot_file, settings, plant.position.copy(), clock, held=True)
    server.plant.arm.contacts = plant.contacts
    return server


serve_damiao, serve_robstride, serve_cubemars, serve_moteus, serve_odrive = (
    partial(serve, family=family) for family in CODECS
)
