"""Simulated CiA 402 drives on a python-can bus, in the time of a clock.

One thread does everything. Frames get the time of their arrival, run through the bus model together with
the drives' own, and those go out when they would have been over on a real bus. When the machine stalls, what was
missed is made up for: frames come late then, but are lost only where a real bus would have lost them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import can

from daq.robot.schema import Robot
from drivers.can.receiver import ArrivalClock
from drivers.canopen402.protocol.objects import STATE_OPERATIONAL, TPDO1
from drivers.canopen402.settings import CanopenSettings
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.text import percent_text
from sim_drivers.can.bus_load import Frame, exact_bits
from sim_drivers.can.bus_server import BusServer, send_error_frame
from sim_drivers.can.slcan_adapter import SlcanAdapter
from sim_drivers.canopen.axis import OVER_TEMPERATURE
from sim_drivers.canopen.network import DrivenArm, DriveNetwork, NetworkCounts
from sim_drivers.faults import (
    BlockJoint,
    BusOff,
    Drop,
    Fault,
    Freeze,
    Garbage,
    HeartbeatStop,
    Heat,
    OverTemperature,
    PowerCycle,
    Stick,
    Truncate,
    Unplug,
)

LONGEST_WAIT = 0.005
"""Between two updates of the drives [s]; the arm moves without any frame, too."""
GRANULARITY = 0.25e-3
"""Frames that are over within so short a time [s] go out together, not one wake-up each."""
LOAD_WINDOW = 1.0
"""Window of the bus load in the status [s]."""
SAMPLE_IDENTIFIERS = range(TPDO1 + 1, 0x580)


@dataclass(frozen=True)
class CanopenStatus:
    """State of bus and drives.

    Attributes:
        counts: of the bus.
        load: share of the last second that the bus was busy.
        operational, enabled: drives that are.
        faulted: frames withheld or spoilt by faults on request.
    """

    counts: NetworkCounts
    load: float = 0.0
    operational: int = 0
    enabled: int = 0
    faulted: int = 0


class CanopenServer(BusServer):
    """Drives that are switched on by `start` and off by `stop`.

    Args:
        arm: the plant.
        robot: its joints, limits and gains.
        settings: of the canopen402 connection: the bus, and the drives on it.
        swapped: two joints (from 0) whose drives have each other's node id.
        length: of a frame on the bus [bit].
        adapter: in front of the bus, if there is one; started and stopped with the drives.
        clock: the host's.

    Attributes:
        network: the drives; not to be touched while they run.
    """

    def __init__(
        self,
        arm: DrivenArm,
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
        self._silent_until = self._deaf_until = 0.0
        self._drop = self._truncate = self._faulted = 0
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
        settings = self.settings
        place: dict[str, object] = {"interface": settings.interface, "channel": settings.channel}
        if self.adapter is not None:
            place = {"interface": "slcan", "channel": self.adapter.path}
        return place | {"bitrate": settings.bitrate, "nodes": self._nodes()}

    def live_line(self) -> str:
        """Its state in one line."""
        status = self.status()
        counts = status.counts
        line = (
            f"{status.operational} drives operational, {status.enabled} enabled, {counts.syncs} SYNCs, "
            f"bus load {percent_text(status.load, 2)}"
        )
        troubles = {"lost on the bus": counts.lost, "spoilt": status.faulted, "stalls": counts.stalls}
        return line + "".join(f", {count} {word}" for word, count in troubles.items() if count)

    def _nodes(self) -> dict[str, int]:
        return {joint: drive.node for joint, drive in zip(self.joints, self.network.drives, strict=True)}

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"canopen-nodes": self._run_on_bus}

    def _serve(self, bus: can.BusABC) -> None:
        self._stamps = ArrivalClock(bus, self._clock)
        while not self._stopping.is_set():
            now = self._clock.now()
            due = min(self.network.next_end() + GRANULARITY, now + LONGEST_WAIT)
            self._receive(bus, max(due - now, 0.0))
            for fault in self._faults.requested():
                self._cause(bus, fault)
            now = self._clock.now()
            silent = now < self._silent_until
            for sent in self.network.advance(now):
                if silent:
                    self._faulted += 1
                else:
                    self._transmit(bus, sent.frame)

    def _receive(self, bus: can.BusABC, timeout: float) -> None:
        """Receive all pending frames, waiting for the first."""
        message = self._next_message(bus, timeout)
        while message is not None:
            self._take(message)
            message = self._next_message(bus, 0.0)

    def _next_message(self, bus: can.BusABC, timeout: float) -> can.Message | None:
        try:
            return bus.recv(timeout)
        except (can.CanOperationError, ValueError, IndexError, TypeError):
            # Something on the bus that is no frame; a bus that is gone shows when the drives send.
            self._stopping.wait(LONGEST_WAIT)
            return None

    def _take(self, message: can.Message) -> None:
        identifier = message.arbitration_id
        remote = message.is_remote_frame
        if identifier in self.network.own_identifiers and not message.is_extended_id and not remote:
            return  # udp_multicast gives a sender its own frames back
        if message.is_error_frame or message.is_fd or message.dlc > 8:
            return
        content = bytes(message.dlc) if remote else bytes(message.data)
        if message.dlc != len(content):
            return
        if self._clock.now() < self._deaf_until:
            return
        frame = Frame(identifier, content, message.is_extended_id, remote)
        self.network.arrive(frame, self._stamps.arrived(message))

    def _transmit(self, bus: can.BusABC, frame: Frame) -> None:
        content, length = frame.data, len(frame.data)
        if frame.id in SAMPLE_IDENTIFIERS and (self._drop or self._truncate):
            self._faulted += 1
            if self._drop:
                self._drop -= 1
                return
            self._truncate -= 1
            length = len(content) - 1
            content = content[:length]
        bus.send(
            can.Message(
                arbitration_id=frame.id,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                dlc=length,
                data=content,
                check=False,
            )
        )

    def _cause(self, bus: can.BusABC, fault: Fault) -> None:  # noqa: C901, PLR0912 — a branch per kind of fault
        now = self._clock.now()
        match fault:
            case Drop(frames):
                self._drop += frames
            case Freeze(duration):
                self._silent_until = now + duration
            case BusOff(duration):
                send_error_frame(bus)
                self._silent_until = self._deaf_until = now + duration
            case Heat(joint, celsius):
                self._arm.heat(joint, celsius)
            case BlockJoint(joint):
                self._arm.block(joint)
            case Stick(quantity, joint):
                self.network.stick(joint, quantity)
            case PowerCycle(joint):
                self.network.power_cycle(joint)
            case HeartbeatStop(joint):
                self.network.drives[joint].error_control.muted = True
            case OverTemperature(joint):
                self.network.drives[joint].fault(OVER_TEMPERATURE)
            case Truncate(frames) if self.adapter is not None:
                self.adapter.truncate(frames)
            case Truncate(frames):
                self._truncate += frames
            case Garbage(frames) if self.adapter is not None:
                self.adapter.garbage(frames)
            case Garbage(frames):
                for _ in range(frames):
                    self._transmit(bus, self._random_frame())
            case Unplug() if self.adapter is not None:
                self.adapter.unplug()
            case Unplug():
                self.messages.append("there is no adapter to unplug; only --wire slcan has one")
