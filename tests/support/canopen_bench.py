"""A canopen402 driver and scripted drives on one virtual bus, in simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from scripted_drives import ScriptedBus, ScriptedDrive
from simulated_clock import SimulatedClock, simulated_time

from drivers.base import DriverSettings, Notice
from drivers.canopen402.driver import Canopen402Driver
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from drivers.streams import Batch

JOINTS = ("pan", "lift", "elbow")
RATE = 100.0
READ = 0.02
"""How long [s] one reading waits."""


@dataclass
class Bench:
    """Both ends of the bus, and the batches read."""

    clock: SimulatedClock
    bus: ScriptedBus
    driver: Canopen402Driver
    begun: float
    """When it was started, where that was done here [s]."""
    blocks: dict[str, list[Batch]] = field(default_factory=lambda: {"joints": [], "thermal": []})
    notices: list[Notice] = field(default_factory=list)

    @property
    def drives(self) -> list[ScriptedDrive]:
        return self.bus.drives

    def read(self, until: Callable[[], object], seconds: float = 3.0) -> None:
        """Read until a condition holds."""
        end = self.clock.now() + seconds
        while not until():
            for block in self.driver.read(READ):
                self.blocks[block.stream].append(block)
            self.notices += self.driver.notices()
            assert self.clock.now() < end, (self.notices, [drive.states for drive in self.drives])

    def read_rows(self, count: int) -> None:
        """Read so many more rows."""
        wanted = len(self.slots) + count
        self.read(lambda: len(self.slots) >= wanted)

    @property
    def slots(self) -> list[int]:
        """SYNC numbers of the rows."""
        schedule = [block.time - block.values["sync_lateness"][:, 0] for block in self.blocks["joints"]]
        return [round(slot) for times in schedule for slot in (times * RATE).tolist()]

    @property
    def lost(self) -> int:
        return sum(block.lost for block in self.blocks["joints"])

    def joined(self, quantity: str) -> FloatArray:
        return np.concatenate([block.values[quantity] for block in self.blocks["joints"]])

    @property
    def position(self) -> FloatArray:
        """The arm's last position."""
        return np.array(self.blocks["joints"][-1].values["position"][-1])

    def said(self, level: str) -> list[str]:
        self.notices += self.driver.notices()
        return [notice.message for notice in self.notices if notice.level == level]

    def enable(self) -> None:
        """Enable the drives, reading meanwhile as a session does."""
        self.read_rows(2)
        error: list[DynidError] = []

        def command() -> None:
            try:
                self.driver.command(self.position)
            except DynidError as caught:
                error.append(caught)

        thread = self.clock.thread(command, "command")
        thread.start()
        self.read(lambda: not thread.is_alive(), 5.0)
        if error:
            raise error[0]


@contextmanager
def bench(
    drives: Sequence[ScriptedDrive] | None = None,
    *,
    joints: Sequence[str] = JOINTS,
    nodes: dict[str, dict[str, object]] | None = None,
    begin: str = "running",
    **keys: object,
) -> Iterator[Bench]:
    """Drives with ids 1, 2, …; the driver is begun as far as "closed", "open" or "running"."""
    with simulated_time() as clock:
        present = list(drives) if drives is not None else [ScriptedDrive(n + 1) for n in range(len(joints))]
        bus = ScriptedBus(present, clock)
        try:
            yield from _served(bus, clock, joints, nodes, begin, keys)
        finally:
            bus.close()


def _served(
    bus: ScriptedBus,
    clock: SimulatedClock,
    joints: Sequence[str],
    nodes: dict[str, dict[str, object]] | None,
    begin: str,
    keys: dict[str, object],
) -> Iterator[Bench]:
    node_keys = {joint: {"id": n + 1, **(nodes or {}).get(joint, {})} for n, joint in enumerate(joints)}
    connection: dict[str, object] = {
        "interface": "virtual",
        "channel": bus.channel,
        "sync_rate": RATE,
        "timeout": 3.0,
        "nodes": node_keys,
    }
    driver = Canopen402Driver(DriverSettings(tuple(joints), connection | keys, (), clock=clock))
    try:
        if begin != "closed":
            driver.open()
        if begin == "running":
            driver.start()
        yield Bench(clock, bus, driver, clock.now())
    finally:
        driver.close()
