"""A simulated arm with a signal table on a python-can bus, in the time of a clock.

One thread does everything. Frames go out when they would have been over on a real bus of this bit rate; a value that
is overtaken by its successor before it was sent is lost, as in a CAN controller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import can

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from drivers.can.bus import EXTENDED
from drivers.can.receiver import Receiver
from drivers.can_signals.settings import parse_settings
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.text import percent_text
from sim_drivers.can.bus_load import BusModel, Frame, Sent, exact_bits
from sim_drivers.can.bus_server import BusServer, message_of, table_keys
from sim_drivers.can_signals.arm import TableArm
from sim_drivers.faults import Fault
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions
from sim_drivers.server import LONGEST_LAG, with_troubles


@dataclass
class TableStatus:
    """Counters of the arm."""

    time: float  # of the arm [s]
    enabled: bool = False  # whether it follows commands
    cycles: int = 0  # of frames
    frames: int = 0  # sent
    withheld: int = 0  # by faults on request
    lost: int = 0  # frames that the bus had no room for
    load: float = 0.0  # share of the time that the bus was busy since the start
    stalls: int = 0  # times when the arm's time fell behind the clock


class ProprietaryCanServer(BusServer):
    """An arm on a bus; `start` opens it, `stop` closes it.

    A relative `dbc` of the connection starts at `folder`, the current one where None.

    Raises:
        UsageError: the keys are wrong, or the table has a quantity that a simulated arm does not measure.
    """

    def __init__(
        self,
        arm: Plant,
        robot: Robot,
        connection: Mapping[str, object],
        folder: Path | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.settings = parse_settings(connection, robot.joint_names, folder)
        super().__init__("signal-table arm", robot.joint_names, self.settings.keys, clock)
        self._arm = TableArm(arm, robot.joints, self.settings)
        self.messages = self._arm.messages
        self._model = BusModel(self.settings.keys.bitrate)
        self._own = self.settings.identifiers
        self._muted: dict[int, float] = {}
        self._begun = self._arm_time = self._due = 0.0
        self._status = TableStatus(arm.time)

    def status(self) -> TableStatus:
        """Counters of the arm."""
        return replace(self._status)

    def ready(self) -> dict[str, object]:
        """Address for clients."""
        return super().ready() | {"rate_hz": self.settings.keys.rate}

    def live_line(self) -> str:
        """Return its state in one line."""
        status = self._status
        state = "enabled" if status.enabled else "not enabled"
        line = f"{status.time:8.1f} s  {state}, {status.frames} frames, bus load {percent_text(status.load, 2)}"
        return with_troubles(line, withheld=status.withheld, lost_on_the_bus=status.lost, stalls=status.stalls)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"table-arm": self._run_on_bus}

    def _serve(self, bus: can.BusABC) -> None:
        receiver = Receiver(bus, clock=self._clock)
        try:
            receiver.start()
            self._begun = self._arm_time = self._clock.now()
            self._due = self._begun + 1.0 / self.settings.keys.rate
            while not self._stopping.is_set():
                end = self._model.peek()
                wake = self._due if end is None else min(self._due, end)
                for arrived, identifier, data in receiver.take(max(0.0, wake - self._clock.now())):
                    if identifier in self._own:
                        continue  # udp_multicast gives a sender its own frames back
                    # Everything in the order of its own time, however late this thread is.
                    self._run_until(bus, arrived)
                    frame = Frame(identifier & ~EXTENDED, data, bool(identifier & EXTENDED))
                    if arrived < self._arm_time:
                        # Received late, by a thread that stalled: it was on the bus before all that waits there.
                        self._take(Sent(frame, False, arrived, exact_bits(frame), arrived))
                    else:
                        self._model.submit(frame, arrived, own=False)
                now = self._clock.now()
                if now - self._due > LONGEST_LAG:
                    self._due = self._arm_time = now
                    self._status.stalls += 1
                self._run_until(bus, now)
        finally:
            receiver.stop()

    def _run_until(self, bus: can.BusABC, moment: float) -> None:
        """Everything that is due by a time: periods of the controller, and frames that are over on the bus."""
        while (due := self._due) <= moment:
            self._carry_until(bus, due)
            self._period(bus, due)
            self._due += 1.0 / self.settings.keys.rate
        self._carry_until(bus, moment)

    def _carry_until(self, bus: can.BusABC, moment: float) -> None:
        while (end := self._model.peek()) is not None and end <= moment:
            sent = self._model.pop()
            if sent.own:
                self._transmit(bus, sent.frame)
            else:
                self._take(sent)

    def _period(self, bus: can.BusABC, now: float) -> None:
        for fault in self._new_faults():
            self._cause(bus, fault, now)
        self._advance_to(now)
        if self.settings.poll is None:
            self._speak(now)
        status = self._status
        status.time, status.enabled, status.lost = self._arm.arm.time, self._arm.enabled, self._model.lost
        status.load = self._model.bits / self.settings.keys.bitrate / max(now - self._begun, 1e-9)

    def _take(self, sent: Sent) -> None:
        if sent.time < self._silent_until:
            return
        frame = sent.frame
        identifier = frame.id | (EXTENDED if frame.extended else 0)
        self._advance_to(sent.time)
        if self._arm.is_poll(identifier, frame.data):
            self._speak(sent.time)
        else:
            # A computer that stalls receives frames after the arm's time has gone on; they came when they came.
            self._arm.obey(identifier, frame.data, max(0.0, self._arm_time - sent.ready))

    def _advance_to(self, now: float) -> None:
        if now > self._arm_time:
            self._arm.advance(now - self._arm_time)
            self._arm_time = now

    def _speak(self, now: float) -> None:
        multiplexed = {signal.identifier for signal in self.settings.signals if signal.multiplexer is not None}
        for frame in self._arm.cycle():
            identifier = frame.id | (EXTENDED if frame.extended else 0)
            # The layouts of a multiplexed frame share an identifier but do not follow each other.
            self._model.submit(frame, now, own=True, newest_wins=identifier not in multiplexed)
        self._status.cycles += 1

    def _transmit(self, bus: can.BusABC, frame: Frame) -> None:
        muted = self._clock.now() < self._muted.get(frame.id, -math.inf)
        if muted or (left := self._spoilt(frame)) is None:
            self._status.withheld += 1
            return
        bus.send(message_of(left))
        self._status.frames += 1

    def _spread(self, bus: can.BusABC, frame: Frame, now: float) -> None:
        self._model.submit(frame, now, own=True)

    def _cause(self, bus: can.BusABC, fault: Fault, now: float) -> None:
        match fault:
            case Fault("mute", (identifier, duration)):
                self._muted[identifier] = now + duration
            case Fault("clock-jump", (seconds,)):
                self._arm.clock_ahead += seconds
            case Fault("over-temperature", (joint,)):
                self._arm.fail(joint)
            case Fault("heat", (joint, celsius)):
                self._arm.arm.heat(joint, celsius)
            case Fault("block", (joint,)):
                self._arm.arm.block(joint)
            case Fault("stick", (quantity, joint)):
                self._arm.arm.stick(joint, quantity)
            case _:
                super()._cause(bus, fault, now)


DRIVER = "can_frames"


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> ProprietaryCanServer:
    """An arm with the signal table of the robot file's connection."""
    robot = robot_file.robot
    keys = table_keys(robot, DRIVER, options, "there is no signal table", "docs/can.md")
    return ProprietaryCanServer(plant, robot, keys, robot_file.folder, clock)
