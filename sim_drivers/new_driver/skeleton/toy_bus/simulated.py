"""The simulated back end: `dynid sim ARM --wire toy_bus`, and the other end of the tests."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

import can
import numpy as np

from daq.robot.loader import RobotFile
from daq.session.connections import keys_of_driver
from drivers.connection_settings import read_settings
from drivers.core.clock import Clock
from sim_drivers.can.bus_server import BusServer
from sim_drivers.faults import COUNT, SECONDS, FaultEntry
from sim_drivers.plant.plant import Plant
from sim_drivers.served import SimOptions
from toy_bus.driver import FOLLOW, FRAME, MODE, SAMPLE, TARGET, ToyBusSettings

KIND = "toy_bus drives"
FAULTS = (
    FaultEntry("drop", (COUNT,), (KIND,)),
    FaultEntry("freeze", (SECONDS,), (KIND,)),
    FaultEntry("garbage", (COUNT,), (KIND,)),
)


def serve(robot_file: RobotFile, plant: Plant, options: SimOptions, clock: Clock) -> ToyBusDrives:
    """The drives of the robot file's connection, not started yet."""
    keys = keys_of_driver(robot_file.robot, "toy_bus") or {}
    return ToyBusDrives(plant, read_settings(ToyBusSettings, keys, "toy_bus"), clock)


class ToyBusDrives(BusServer):
    """Drives on a plant; they hold where they are while no target comes."""

    def __init__(self, plant: Plant, settings: ToyBusSettings, clock: Clock) -> None:
        super().__init__(KIND, plant.robot.joint_names, settings, clock, faults=FAULTS)
        self._plant, self._settings, self._following = plant, settings, False
        self._targets = plant.position.copy()
        self._count = 0

    def live_line(self) -> str:
        """Return its state in one line."""
        return f"{self._count} periods, {'following' if self._following else 'holding'}"

    def _work(self) -> Mapping[str, Callable[[], None]]:
        return {"drives": self._run_on_bus}

    def _serve(self, bus: can.BusABC) -> None:
        period, begun = 1.0 / self._settings.rate, self._clock.now()
        while not self._stopping.wait(begun + (self._count + 1) * period - self._clock.now()):
            self._count += 1
            while (message := bus.recv(0.0)) is not None:
                self._hear(message)
            for fault in self._new_faults():
                self._cause(bus, fault, self._clock.now())
            self._plant.advance(period)
            if self._drop:
                self._drop -= 1
            elif self._clock.now() >= self._silent_until:
                self._speak(bus)

    def _speak(self, bus: can.BusABC) -> None:
        now = self._plant.measure()
        for joint, (position, velocity) in enumerate(zip(now.position, now.velocity, strict=True)):
            data = FRAME.pack(round(1e4 * position), round(1e3 * velocity), self._count % 0x10000)
            bus.send(can.Message(arbitration_id=SAMPLE + joint, data=data, is_extended_id=False))

    def _hear(self, message: can.Message) -> None:
        joint = message.arbitration_id - TARGET
        if message.arbitration_id == MODE:
            self._following = bytes(message.data) == FOLLOW
            self._targets = self._plant.position.copy()
            if not self._following:
                self._plant.halt(5.0)  # [rad/s²]
        elif self._following and 0 <= joint < len(self._targets):
            self._targets[joint] = 1e-4 * struct.unpack("<i", message.data)[0]
            if joint == len(self._targets) - 1:
                self._plant.set_target(np.array(self._targets))
