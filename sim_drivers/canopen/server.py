"""Simulated CiA 402 drives on a python-can bus, in the time of a clock.

One thread does everything. Frames get the time of their arrival, run through the bus model together with
the drives' own, and those go out when they would have been over on a real bus. When the machine stalls, what was
missed is made up for: frames come late then, but are lost only where a real bus would have lost them.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import can

from daq.robot.loader import RobotFile
from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from daq.session.session import SWITCH_INTERVAL
from drivers.can.bus import open_bus
from drivers.can.receiver import ArrivalClock
from drivers.canopen402.protocol.objects import STATE_OPERATIONAL, TPDO1
from drivers.canopen402.settings import CanopenSettings, parse_settings
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import UsageError
from drivers.core.text import percent_text
from sim_drivers.can.bus_load import Frame, exact_bits, worst_case_bits
from sim_drivers.can.bus_server import BusServer, frame_of, message_of, with_options
from sim_drivers.can.slcan_adapter import SlcanAdapter
from sim_drivers.canopen.axis import OVER_TEMPERATURE
from sim_drivers.canopen.network import DriveNetwork, NetworkCounts
from sim_drivers.faults import Fault, joint_index
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions
from sim_drivers.server import with_troubles

LONGEST_WAIT = 0.005
"""Between two updates of the drives [s]; the arm moves without any frame, too."""
GRANULARITY = 0.25e-3
"""Frames that are over within so short a time [s] go out together, not one wake-up each."""
LOAD_WINDOW = 1.0
"""Window of the bus load in the status [s]."""
SAMPLE_IDENTIFIERS = range(TPDO1 + 1, 0x580)

DRIVER = "canopen402"
DEFAULT_BUS = {"interface": "udp_multicast", "channel": "239.74.163.2", "options": {"hop_limit": 0}}
"""Default channel of an arm without one in its robot file."""


@dataclass(frozen=True)
class CanopenStatus:
    """State of bus and drives."""

    counts: NetworkCounts  # of the bus
    load: float = 0.0  # share of the last second that the bus was busy
    # operational, enabled: drives that are
    operational: int = 0
    enabled: int = 0
    faulted: int = 0  # frames withheld or spoilt by faults on request


class CanopenServer(BusServer):
    """Drives that are switched on by `start` and off by `stop`.

    Drives of two `swapped` joints (from 0) have each other's node id; an `adapter` in front of the bus starts and stops
    with them.

    Attributes:
        network: the drives; not to be touched while they run.
    """

    def __init__(
        self,
        arm: Plant,
        robot: Robot,
        settings: CanopenSettings,
        *,
        swapped: tuple[int, int] | None = None,
        length: Callable[[Frame], int] = exact_bits,
        adapter: SlcanAdapter | None = None,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        beside = () if adapter is None else (adapter,)
        super().__init__("CANopen drives", robot.joint_names, settings, clock, beside)
        self.settings = settings
        self.network = DriveNetwork(arm, robot, settings, self._clock.now(), swapped=swapped, length=length)
        self.adapter = adapter
        self._arm = arm
        self._faulted = 0
        self._loads: deque[tuple[float, int]] = deque([(self._clock.now(), 0)])

    def status(self) -> CanopenStatus:
        """State of bus and drives."""
        counts, now = self.network.counts, self._clock.now()
        self._loads.append((now, counts.bits))
        while len(self._loads) > 2 and self._loads[1][0] < now - LOAD_WINDOW:
            self._loads.popleft()
        begun, bits = self._loads[0]
        drives = self.network.drives
        return CanopenStatus(
            counts,
            (counts.bits - bits) / self.settings.bitrate / max(now - begun, 1e-6),
            sum(drive.nmt == STATE_OPERATIONAL for drive in drives),
            sum(drive.enabled for drive in drives),
            self._faulted,
        )

    def ready(self) -> dict[str, object]:
        """Address for clients."""
        adapter = {} if self.adapter is None else {"interface": "slcan", "channel": self.adapter.path}
        nodes = {joint: drive.node for joint, drive in zip(self.joints, self.network.drives, strict=True)}
        return super().ready() | adapter | {"nodes": nodes}

    def live_line(self) -> str:
        """Return its state in one line."""
        status = self.status()
        counts = status.counts
        line = (
            f"{status.operational} drives operational, {status.enabled} enabled, {counts.syncs} SYNCs, "
            f"bus load {percent_text(status.load, 2)}"
        )
        return with_troubles(line, lost_on_the_bus=counts.lost, spoilt=status.faulted, stalls=counts.stalls)

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"canopen-nodes": self._run_on_bus}

    def _serve(self, bus: can.BusABC) -> None:
        self._stamps = ArrivalClock(bus, self._clock)
        while not self._stopping.is_set():
            now = self._clock.now()
            due = min(self.network.next_end() + GRANULARITY, now + LONGEST_WAIT)
            self._receive(bus, max(due - now, 0.0))
            for fault in self._new_faults():
                self._cause(bus, fault, self._clock.now())
            now = self._clock.now()
            silent = now < self._silent_until
            for sent in self.network.advance(now):
                if silent:
                    self._faulted += 1
                else:
                    self._transmit(bus, sent.frame)

    def _receive(self, bus: can.BusABC, timeout: float) -> None:
        """Receive all pending frames, waiting for the first."""
        message = self._received(bus, timeout)
        while message is not None:
            self._take(message)
            message = self._received(bus, 0.0)

    def _take(self, message: can.Message) -> None:
        frame = frame_of(message)
        if frame is None or message.is_fd or self._clock.now() < self._deaf_until:
            return
        if frame.id in self.network.own_identifiers and not frame.extended and not frame.remote:
            return  # udp_multicast gives a sender its own frames back
        self.network.arrive(frame, self._stamps.arrived(message))

    def _transmit(self, bus: can.BusABC, frame: Frame) -> None:
        if frame.id in SAMPLE_IDENTIFIERS and (self._drop or self._truncate):
            self._faulted += 1
            if (left := self._spoilt(frame)) is None:
                return
            frame = left
        bus.send(message_of(frame))

    def _spread(self, bus: can.BusABC, frame: Frame, now: float) -> None:
        self._transmit(bus, frame)

    def _cause(self, bus: can.BusABC, fault: Fault, now: float) -> None:
        match fault:
            case Fault("heat", (joint, celsius)):
                self._arm.heat(joint, celsius)
            case Fault("block", (joint,)):
                self._arm.block(joint)
            case Fault("stick", (quantity, joint)):
                self.network.stick(joint, quantity)
            case Fault("power-cycle", (joint,)):
                self.network.power_cycle(joint)
            case Fault("heartbeat-stop", (joint,)):
                self.network.drives[joint].error_control.muted = True
            case Fault("over-temperature", (joint,)):
                self.network.drives[joint].fault(OVER_TEMPERATURE)
            case Fault("truncate", (frames,)) if self.adapter is not None:
                self.adapter.truncate(frames)
            case Fault("garbage", (frames,)) if self.adapter is not None:
                self.adapter.garbage(frames)
            case Fault("unplug", ()) if self.adapter is not None:
                self.adapter.unplug()
            case Fault("unplug", ()):
                self.messages.append("there is no adapter to unplug; only --wire slcan has one")
            case _:
                super()._cause(bus, fault, now)


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> CanopenServer:
    """CiA 402 drives on the bus of the robot file's connection."""
    return _drives(robot_file, plant, options, _keys(robot_file.robot, options), None, clock)


def serve_behind_adapter(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> CanopenServer:
    """The same drives behind an adapter on a pseudo-terminal.

    Raises:
        UsageError: the connection's keys, or the options, are wrong.
        ConnectionFailedError: the bus behind the adapter cannot be opened.
    """
    if options.interface is not None or options.channel is not None:
        raise UsageError("--wire slcan makes its own port", hint="leave --interface and --channel out")
    keys = _keys(robot_file.robot, options)
    keys |= {"interface": "virtual", "channel": f"behind-slcan-{os.getpid()}", "options": {}}
    settings = parse_settings(keys, robot_file.robot.joint_names)
    # Drives and adapter are threads of this process; a frame must not wait 5 ms for the interpreter to change over.
    sys.setswitchinterval(SWITCH_INTERVAL)
    bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)
    return _drives(robot_file, plant, options, keys, SlcanAdapter(bus, settings.bitrate, clock=clock), clock)


def _drives(
    robot_file: RobotFile,
    plant: Plant,
    options: SimOptions,
    keys: dict[str, object],
    adapter: SlcanAdapter | None,
    clock: Clock,
) -> CanopenServer:
    robot = robot_file.robot
    length: Callable[[Frame], int] = worst_case_bits if options.worst_stuffing else exact_bits
    settings = parse_settings(keys, robot.joint_names)
    swapped = _pair(options.swap, robot) if options.swap is not None else None
    return CanopenServer(plant, robot, settings, swapped=swapped, length=length, adapter=adapter, clock=clock)


def _keys(robot: Robot, options: SimOptions) -> dict[str, object]:
    """The keys of the robot file's connection; default ones where it has none."""
    nodes = {name: {"id": node_id} for node_id, name in enumerate(robot.joint_names, start=1)}
    keys = keys_of_driver(robot, DRIVER)
    return with_options({**DEFAULT_BUS, "nodes": nodes} if keys is None else keys, options)


def _pair(text: str, robot: Robot) -> tuple[int, int]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or names[0] == names[1]:
        raise UsageError(f"--swap takes two joints, not '{text}'", hint="such as --swap 2,3")
    return joint_index(names[0], robot.joint_names), joint_index(names[1], robot.joint_names)
