"""Simulated drives, the bus between them and their master, and the arm that they move, in any time that runs forward.

No clock and no sockets here: frames arrive with their time, and `advance` returns those sent by then.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from daq.robot.loops import coupling_matrix
from daq.robot.schema import Robot
from drivers.canopen402.protocol.objects import EMCY, HEARTBEAT, NMT, SDO_ANSWER, SDO_REQUEST, SYNC
from drivers.canopen402.settings import CanopenSettings
from drivers.core.errors import UsageError
from sim_drivers.can.bus_load import BusModel, Frame, Sent, exact_bits
from sim_drivers.canopen.drive import SimulatedDrive
from sim_drivers.canopen.error_control import HIGHEST_NODE
from sim_drivers.canopen.motion import SyncClock
from sim_drivers.canopen.setup import DriveFeedback, DriveSetup
from sim_drivers.plant.plant import Plant
from sim_drivers.server import LONGEST_LAG

LOOP_PERIOD = 1e-3
"""Period of the drives' control loops [s]."""
TICKS_PER_CHORE = 5
"""Control periods between two checks of heartbeats and event timers."""
PDO_IDENTIFIERS = range(0x181, 0x580)
"""Identifiers of the predefined connection set (CiA 301, 7.3.5)."""
HEARTBEAT_IDENTIFIERS = range(HEARTBEAT + 1, HEARTBEAT + HIGHEST_NODE + 1)
LONGEST_QUEUE = 100_000
"""Most queued frames of the master."""
PEAK_FACTOR = 3.0
"""Torque limit of a joint over the rated torque of its drive, where the robot file does not state it: an assumption."""


def drive_setups(robot: Robot, settings: CanopenSettings) -> tuple[DriveSetup, ...]:
    """Set-up of a connection's drives: from the robot file, or of the usual size.

    Raises:
        UsageError: counts per turn that are not an integer.
    """
    setups = []
    for joint, node in zip(robot.joints, settings.nodes, strict=True):
        counts = node.counts_per_turn
        if counts is not None and counts != round(counts):
            raise UsageError(
                f"a simulated drive has an integer number of counts per turn, not {counts:g}",
                where=f"{robot.name}: {joint.name}",
            )
        torque = node.rated_torque or (joint.torque or 100.0) / PEAK_FACTOR
        gain = abs(robot.drive(joint.name).gain or 10.0)
        setup = DriveSetup(
            serial=node.id if node.serial is None else node.serial,
            direction=node.direction,
            zero=node.zero,
            rated_torque=torque,
            rated_current=node.rated_current or torque / gain,
            velocity=0.25 * joint.velocity,
            acceleration=joint.acceleration,
        )
        if not robot.model.coupling:  # else the limits of a joint are none of a motor
            largest = torque * PEAK_FACTOR if joint.torque is None else joint.torque
            lowest, highest = joint.position
            setup = replace(
                setup, lowest=lowest, highest=highest, largest_velocity=joint.velocity, largest_torque=largest
            )
        setups.append(setup if counts is None else replace(setup, increments=round(counts), gear=1))
    return tuple(setups)


@dataclass(frozen=True)
class NetworkCounts:
    """Counters of the network."""

    syncs: int = 0  # SYNCs on the bus
    sent: int = 0  # frames that drives have sent
    lost: int = 0  # frames that found no room on the bus
    bits: int = 0  # on the bus
    stalls: int = 0  # how often the arm's time was halted


class DriveNetwork:
    """One drive a joint on one bus.

    Args:
        arm: the plant.
        robot: its joints, limits and gains.
        settings: of the canopen402 connection.
        start: when it is switched on [s].
        swapped: two joints (from 0) whose drives have each other's node id.
        length: of a frame [bit].

    Attributes:
        drives: in the joints' order.
        own_identifiers: that the drives send at present.
    """

    def __init__(
        self,
        arm: Plant,
        robot: Robot,
        settings: CanopenSettings,
        start: float = 0.0,
        *,
        swapped: tuple[int, int] | None = None,
        length: Callable[[Frame], int] = exact_bits,
    ) -> None:
        self._arm = arm
        coupled = bool(robot.model.coupling)
        self._coupling = coupling_matrix(robot.model.coupling, robot.joint_names) if coupled else None
        self._bus = BusModel(settings.bitrate, length)
        self._stuck: dict[tuple[int, str], float] = {}
        self._arrivals: deque[tuple[float, Frame]] = deque(maxlen=LONGEST_QUEUE)
        nodes = [node.id for node in settings.nodes]
        if swapped is not None:
            first, second = swapped
            nodes[first], nodes[second] = nodes[second], nodes[first]
        self.drives = tuple(
            SimulatedDrive(node, setup, feedback, self._send)
            for node, setup, feedback in zip(nodes, drive_setups(robot, settings), self._feedback(0.0), strict=True)
        )
        self._by_request = {SDO_REQUEST + drive.node: drive for drive in self.drives}
        self._by_heartbeat = {HEARTBEAT + drive.node: drive for drive in self.drives}
        self.own_identifiers = self._identifiers()
        self._torque_limits: list[float] = []
        self._pushed: list[float | None] = [None] * len(self.drives)
        self._sync_clock = SyncClock()
        self._now = self._tick_time = start
        self._ticks, self._clock_shift = 0, start
        self._syncs = self._sent = self._stalls = 0

    @property
    def counts(self) -> NetworkCounts:
        """Counters of the network."""
        return NetworkCounts(self._syncs, self._sent, self._bus.lost, self._bus.bits, self._stalls)

    def arrive(self, frame: Frame, time: float) -> None:
        """A frame of the master, or of another node, that came at a time [s]; times must not fall."""
        self._arrivals.append((time, frame))  # earlier than now where this computer was late to receive it

    def next_end(self) -> float:
        """When the frame that is on the bus will be over [s]; infinity where there is none."""
        end = self._bus.peek()
        return math.inf if end is None else end

    def power_cycle(self, joint: int) -> None:
        """Cycle a drive's power."""
        self.drives[joint].power_cycle(self._now)

    def stick(self, joint: int, quantity: str) -> None:
        """Let a sensor of a drive hang: what it measures as `quantity` stays what it is."""
        self._stuck[joint, quantity] = getattr(self.drives[joint].axis.feedback, quantity)

    def advance(self, now: float) -> list[Sent]:
        """Advance to `now` [s]; returns the drives' frames that end by then, in order."""
        if now - self._tick_time > LONGEST_LAG:
            skipped = now - self._tick_time
            self._tick_time += skipped
            self._clock_shift += skipped
            self._stalls += 1
        done: list[Sent] = []
        while True:
            arrival = self._arrivals[0][0] if self._arrivals else math.inf
            end, tick = self.next_end(), self._tick_time + LOOP_PERIOD
            first = min(arrival, end, tick)
            if first > now:
                return done
            self._now = max(first, self._now)
            if first == tick:
                self._tick()
            elif first == arrival:
                _, frame = self._arrivals.popleft()
                cyclic = not frame.extended and frame.id in PDO_IDENTIFIERS
                self._bus.submit(frame, arrival, own=False, newest_wins=cyclic)
            else:
                sent = self._bus.pop()
                if sent.own:
                    self._sent += 1
                    done.append(sent)
                else:
                    self._deliver(sent.frame, sent.time)

    def _identifiers(self) -> frozenset[int]:
        fixed = {base + drive.node for drive in self.drives for base in (EMCY, SDO_ANSWER, HEARTBEAT)}
        mapped = {pdo.identifier for drive in self.drives for pdo in drive.transmitted if pdo.identifier is not None}
        return frozenset(fixed | mapped)

    def _send(self, identifier: int, content: bytes, newest_wins: bool) -> None:
        self._bus.submit(Frame(identifier, content), self._now, own=True, newest_wins=newest_wins)

    def _deliver(self, frame: Frame, time: float) -> None:
        if frame.extended:
            return
        if frame.remote:
            if (guarded := self._by_heartbeat.get(frame.id)) is not None:
                guarded.guard_request(time)
        elif frame.id == SYNC:
            self._syncs += 1
            self._latch(time)
            smoothed = self._sync_clock.tick(time) - self._clock_shift
            for drive in self.drives:
                drive.sync(smoothed, self._sync_clock.cycle)
        elif frame.id == NMT:
            for drive in self.drives:
                drive.network_command(frame.data)
        elif (asked := self._by_request.get(frame.id)) is not None:
            asked.receive(frame.id, frame.data)
            self.own_identifiers = self._identifiers()
        elif frame.id in HEARTBEAT_IDENTIFIERS:
            for drive in self.drives:
                drive.heartbeat(frame.id - HEARTBEAT, time)
        else:
            for drive in self.drives:
                drive.receive(frame.id, frame.data)

    def _tick(self) -> None:
        """One period of the control loops."""
        self._tick_time += LOOP_PERIOD
        self._ticks += 1
        references = [
            drive.step(LOOP_PERIOD, actual)
            for drive, actual in zip(self.drives, self._arm.position.tolist(), strict=True)
        ]
        motion = np.array([(r.position, r.velocity, r.acceleration) for r in references])
        position, velocity, acceleration = (
            motion if self._coupling is None else np.linalg.solve(self._coupling, motion)
        ).T
        torque_limits = [drive.axis.largest_torque for drive in self.drives]
        if torque_limits != self._torque_limits:
            self._torque_limits = torque_limits
            self._arm.limit_torque(np.array(torque_limits))
        self._arm.set_target(position, velocity, acceleration)
        pushed = [drive.axis.pushed for drive in self.drives]
        if pushed != self._pushed:
            self._pushed = pushed
            self._arm.push(np.array(pushed, dtype=np.float64))
        self._arm.advance(LOOP_PERIOD)
        if self._ticks % TICKS_PER_CHORE == 0:
            if self._sync_clock.age(self._tick_time) > TICKS_PER_CHORE * LOOP_PERIOD:
                self._latch(self._tick_time)
            for drive in self.drives:
                drive.tick(self._tick_time)

    def _latch(self, time: float) -> None:
        """Let every drive measure."""
        for drive, feedback in zip(self.drives, self._feedback(time - self._tick_time), strict=True):
            drive.axis.feedback = feedback

    def _feedback(self, ahead: float) -> list[DriveFeedback]:
        """The drives' measurement `ahead` [s] of the plant's last step."""
        measured = self._arm.measure()
        position = self._arm.position + ahead * self._arm.velocity
        velocity, torque = measured.velocity, measured.torque
        if self._coupling is not None:  # a drive measures its motor
            velocity, torque = self._coupling @ velocity, np.linalg.solve(self._coupling.T, torque)
        columns = (position, velocity, torque, measured.current, measured.temperature)
        feedback = [DriveFeedback(*row) for row in np.array(columns).T.tolist()]
        for (joint, quantity), value in self._stuck.items():
            feedback[joint] = replace(feedback[joint], **{quantity: value})
        return feedback
