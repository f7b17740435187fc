"""Recordings of a simulated UR5e with drives on CANopen, in one process and in simulated time.

Plant, drives, bus, driver, session, player, supervisor and recorder are those of production.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import can
import numpy as np
import yaml
from recorded_session import record_session
from simulated_clock import DAY, SimulatedClock, VirtualBus, simulated_time
from unchecked import unchecked_play

from daq.motion.trajectories import Motion
from daq.motion.trajectory_file import load_trajectory
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.session.session import SessionReport, load_driver
from drivers.canopen402.driver import Canopen402Driver
from drivers.canopen402.settings import parse_settings
from drivers.core.arrays import FloatArray
from sim_drivers.canopen import network
from sim_drivers.canopen.server import CanopenServer
from sim_drivers.canopen.setup import DriveFeedback
from sim_drivers.plant.plant import Plant, PlantSettings

RADIANS = 2 * np.pi / 524288
"""Angle of a count [rad]."""
CHANNEL = "recorded"
NODES = (1, 2, 3)
"""Node ids of the drives; six take twice as long to simulate."""
LOOP_PERIOD = 5e-3
"""Period of the drives' control loops [s], in which they take their references; a fifth as often as usual."""


@dataclass(frozen=True)
class Measured:
    """Measurement and state of a drive at a SYNC."""

    feedback: DriveFeedback
    enabled: bool


@dataclass
class Bench:
    """An arm that can be recorded."""

    clock: SimulatedClock
    robot_file: RobotFile  # of the arm
    plant: Plant  # the arm itself
    server: CanopenServer  # its drives
    driver: Canopen402Driver  # open
    rate: float  # of SYNC [Hz]
    wire: VirtualBus  # receives all frames
    measured: list[list[Measured]]  # of every SYNC, of every drive
    begun: float = float("nan")  # when the recording began [s]
    _frames: list[can.Message] = field(default_factory=list)

    def frames(self) -> list[can.Message]:
        """All frames so far, of both sides."""
        waiting = self.wire.queue.queue
        self._frames += waiting
        waiting.clear()
        return self._frames

    def times(self, *identifiers: int, data: bytes = b"") -> list[float]:
        """When frames that begin with such data came [s, clock of the samples]."""
        begun = DAY + self.begun
        return [
            frame.timestamp - begun
            for frame in self.frames()
            if frame.arbitration_id in identifiers and bytes(frame.data).startswith(data)
        ]

    def rests(self) -> bool:
        """Whether all drives are off, and the arm stays where their brakes hold it, but for what it still settles."""
        drives = self.server.network.drives
        held, before = [drive.axis.reference for drive in drives], self.plant.position.copy()
        self.clock.sleep(0.5)
        settled = bool(np.max(np.abs(self.plant.position - before)) < 5e-3)
        return settled and held == [drive.axis.reference for drive in drives] and not any(d.enabled for d in drives)

    def record(self, folder: Path, duration: float | None = None, motion: Motion | None = None) -> Run:
        """Record for so long, or while a motion is played."""
        path, self.begun = folder / "run.h5", self.clock.now()
        play = None if motion is None else unchecked_play(motion, self.robot_file.robot)
        report = record_session(path, self.robot_file, self.driver, play, duration, clock=self.clock)
        ended = self.clock.now() - self.begun
        return Run(report, read_recording(path), ended, self.rate)

    def at(self, seconds: float, action: Callable[[], object] | str) -> None:
        """Do something, or cause a fault as it is typed, so long after the recording began."""
        obey = functools.partial(self.server.obey, action) if isinstance(action, str) else action
        self.clock.call_at(self.clock.now() + seconds, obey)

    def sent(self) -> list[int]:
        """Slots of the SYNCs that went out."""
        return [round(time * self.rate) for time in self.times(0x80)]

    def expected(self, slots: Sequence[int]) -> dict[str, FloatArray]:
        """What the drives measured at these SYNCs, in their own numbers, by quantity (N, n)."""
        axes = [drive.axis for drive in self.server.network.drives]
        quantities: dict[str, list[list[int]]] = {"position": [], "velocity": [], "torque": [], "current": []}
        heard = dict(zip(self.sent(), self.measured, strict=False))  # off the bus they hear none
        for slot in slots:
            rows = list(zip(axes, heard[slot], strict=True))
            quantities["position"].append([axis.counts_of(one.feedback.position) for axis, one in rows])
            quantities["velocity"].append([round(one.feedback.velocity / RADIANS) for _, one in rows])
            for name in ("torque", "current"):
                quantities[name].append(
                    [
                        round(1e3 * getattr(one.feedback, name) / getattr(axis.setup, f"rated_{name}")) * one.enabled
                        for axis, one in rows
                    ]
                )
        return {name: np.array(values) for name, values in quantities.items()}


@dataclass(frozen=True)
class Run:
    """Outcome of a recording."""

    report: SessionReport  # of the session
    recording: Recording  # the file
    seconds: float  # from its begin to the end of the session
    rate: float  # of SYNC [Hz]

    @property
    def slots(self) -> list[int]:
        """Numbers of the SYNCs of the rows."""
        joints = self.recording.streams["joints"]
        schedule = joints.time - joints.channels["sync_lateness"].values[:, 0]
        return [round(slot) for slot in (schedule * self.rate).tolist()]

    def counts(self, bench: Bench) -> dict[str, FloatArray]:
        """The rows in the drives' own numbers, by quantity (N, n)."""
        setups = [drive.axis.setup for drive in bench.server.network.drives]
        units: dict[str, float | FloatArray] = {
            "position": RADIANS,
            "velocity": RADIANS,
            "torque": 1e-3 * np.array([setup.rated_torque for setup in setups]),
            "current": 1e-3 * np.array([setup.rated_current for setup in setups]),
        }
        channels = self.recording.streams["joints"].channels
        return {name: np.rint(channels[name].values / unit).astype(int) for name, unit in units.items()}

    def events(self) -> list[str]:
        """All events of the file but the summary of what was lost, as level: message."""
        said = [event for event in self.recording.events if event.message != self.report.heavy_loss]
        return [f"{event.level}: {event.message}" for event in said]

    def when(self, words: str) -> float:
        """When the first event with these words was [s, clock of the samples]."""
        return next(event.time for event in self.recording.events if words in event.message)


@functools.cache
def _robot_on_virtual_bus(keys: str, serials: bool, coupling: str, drives: int) -> RobotFile:
    """The first joints of a UR5e, whose canopen402 connection is on a virtual bus."""
    arm = yaml.safe_load(load_robot("ur5e").text)
    arm["model"]["coupling"] = yaml.safe_load(coupling) or {}
    del arm["poses"]
    arm = _without(arm, {joint["name"] for joint in arm["joints"][drives:]})
    place = {"interface": "virtual", "channel": CHANNEL, "options": {}, "sync_rate": 100}
    arm["connections"] = {"canopen": arm["connections"]["canopen"] | place | (yaml.safe_load(keys) or {})}
    for node in arm["connections"]["canopen"]["nodes"].values() if serials else ():
        node["serial"] = node["id"]
    return parse_robot(yaml.safe_dump(arm, sort_keys=False), where="arm", folder=None)


def _without(content: Any, names: set[str]) -> Any:
    """The same content of a robot file without some joints."""
    if isinstance(content, dict):
        return {key: _without(value, names) for key, value in content.items() if key not in names}
    if isinstance(content, list):
        entries = (entry if isinstance(entry, dict) else {} for entry in content)
        kept = [not names & {str(entry.get(key)) for key in ("joint", "name")} for entry in entries]
        return [_without(entry, names) for entry, keep in zip(content, kept, strict=True) if keep]
    return content


@functools.cache
def swing() -> Motion:
    """A second of a gentle motion around the simulated arm's first pose."""
    count = len(NODES)
    sines = {"amplitude": [[0.1]] * count, "frequency": [[1.5]] * count, "offset": [0.0] * count}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "swing.yaml"
        path.write_text(yaml.safe_dump({"robot": "ur5e", "kind": "sines", "duration": 1.0, "ramp": 0.5, **sines}))
        return load_trajectory(path, _robot_on_virtual_bus("", False, "", count).robot).motion


@contextmanager
def arm_on_bus(
    keys: str = "",
    swapped: tuple[int, int] | None = None,
    *,
    serials: bool = False,
    opened: bool = True,
    coupling: str = "",
    drives: int = len(NODES),
) -> Iterator[Bench]:
    """The first joints of a simulated UR5e and their driver.

    Args:
        keys: further ones of the connection, as YAML.
        swapped: two joints (from 0) whose drives have each other's node id.
        serials: whether the robot file has the drives' serial numbers.
        opened: whether the driver is.
        coupling: of the motors, as YAML.
        drives: how many.
    """
    with simulated_time() as clock, patch.object(network, "LOOP_PERIOD", LOOP_PERIOD):
        robot_file = _robot_on_virtual_bus(keys, serials, coupling, drives)
        robot = robot_file.robot
        settings = parse_settings(dict(robot.connections["canopen"].model_extra or {}), robot.joint_names)
        plant = Plant(robot_file, PlantSettings(step=LOOP_PERIOD / 2))
        measured: list[list[Measured]] = []
        with CanopenServer(plant, robot, settings, swapped=swapped, clock=clock) as server:
            _note(server, measured)
            clock.sleep(0.1)
            wire = can.Bus(CHANNEL, "virtual")
            assert isinstance(wire, VirtualBus)
            driver = load_driver(robot, "canopen", clock=clock)
            assert isinstance(driver, Canopen402Driver)
            try:
                if opened:
                    driver.open()
                yield Bench(clock, robot_file, plant, server, driver, settings.sync_rate, wire, measured)
            finally:
                driver.close()
                wire.shutdown()
        assert server.failure is None


def _note(server: CanopenServer, measured: list[list[Measured]]) -> None:
    """Note the drives' measurement at every SYNC that they receive."""
    for place, drive in enumerate(server.network.drives):

        def heard(time: float, cycle: float, drive=drive, place=place, sync=drive.sync) -> None:  # type: ignore[no-untyped-def]
            sync(time, cycle)
            if place == 0:
                measured.append([])
            measured[-1].append(Measured(drive.axis.feedback, drive.enabled))

        drive.sync = heard  # type: ignore[method-assign]
