"""How far a released arm drifts whose weight an identified model carries; simulated arms in simulated time.

    python -m studies.motors.hand_guiding [SECONDS] [ARM…]

The model is identified from a simulated recording of 20 s. The arm is held at a pose, compared with the model, let go
for so many seconds while nobody touches it, and then holds; and an arm without dry friction, which hides errors of the
model. About a CPU minute for each arm. The
UR5e has CiA 402 drives.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from recorded_session import record_session
from simulated_clock import SimulatedClock, simulated_time

import dynid
from daq.recording.reader import read_recording
from daq.recording.recording import HAND_GUIDED
from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.session.connections import driver_settings
from daq.session.guiding import Guiding, load_compensation
from drivers.base import Driver
from drivers.can_motors.driver import CanMotorDriver
from drivers.can_motors.settings import parse_settings
from drivers.canopen402.driver import Canopen402Driver
from drivers.canopen402.settings import parse_settings as drives_settings
from sim_drivers.can_motors.server import CanMotorServer
from sim_drivers.canopen.server import CanopenServer
from sim_drivers.plant.plant import Plant

ARMS = {"moteus_rig": ([-1.0, 0.5], [-0.3, -1.0]), "openarm": ([0.4, 0.3, 0.2, 0.8, 0.1, 0.2, 0.1],)} | {
    "ur5e": ([0.0, -1.57, 1.2, 0.0, 1.0, 0.0], [0.0, -0.6, 0.8, -1.0, 0.5, 0.0])
}
"""Poses [rad]."""


class Nobody:
    """Says yes, holds the key for so many seconds, and does not touch the arm."""

    def __init__(self, clock: SimulatedClock, seconds: float) -> None:
        self._clock, self._seconds = clock, seconds
        self._begun = -1.0

    def mind(self, cautions: Sequence[str]) -> None:
        """Nothing is said to it."""

    def ask(self) -> None:
        """It is not asked."""

    def answer(self) -> bool | None:
        """Yes."""
        return True

    def held(self) -> bool:
        """Return whether the key is held, which it is for so many seconds."""
        self._begun = self._clock.now() if self._begun < 0.0 else self._begun
        return self._clock.now() - self._begun < self._seconds


def slippery(file: RobotFile) -> RobotFile:
    """The arm without dry friction."""
    content = yaml.safe_load(file.text)
    for joint in content["truth"]["joints"].values():
        joint["coulomb"] = 0.0
    return parse_robot(yaml.safe_dump(content), where=file.where, folder=file.folder)


def drift(file: RobotFile, model: Path, pose: Sequence[float], seconds: float) -> tuple[str, np.ndarray]:
    """How it ended, and the largest way of each joint from where it was let go [rad]."""
    robot, start = file.robot, np.array(pose)
    connection = robot.connections.get("canopen", next(iter(robot.connections.values())))
    keys = dict(connection.model_extra or {}) | {"interface": "virtual", "channel": f"led-{robot.name}", "options": {}}
    with TemporaryDirectory() as folder, simulated_time() as clock:
        path = Path(folder) / "led.h5"
        settings = replace(driver_settings(robot, keys), clock=clock)
        server: CanopenServer | CanMotorServer
        driver: Driver
        if connection.driver == "canopen402":
            own = drives_settings(keys, robot.joint_names)
            server = CanopenServer(Plant(file, position=start), robot, own, clock=clock)
            driver = Canopen402Driver(settings)
        else:
            served = parse_settings(keys, robot.joint_names, connection.driver)
            server = CanMotorServer(file, served, start, clock, held=True)
            driver = CanMotorDriver(settings, connection.driver)
        with server:
            clock.sleep(1.5)  # drives boot
            driver.open()
            guiding = Guiding(robot, Nobody(clock, seconds), load_compensation(file, model))
            report = record_session(path, file, driver, clock=clock, guiding=guiding)
            driver.close()
        if report.file is None:
            return str(report.stopped_by), np.full(robot.dof, np.nan)
        run = read_recording(report.file)
        begun = next(event.time for event in run.events if event.message.startswith(HAND_GUIDED))
        stream = run.streams["joints"]
        led = stream.channels["position"].values[stream.time >= begun]
        return report.stopped_by or "the key was released", np.max(np.abs(led - led[0]), axis=0)


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    print("| arm | pose [rad] | released for [s] | largest drift of a joint [rad] | with dry friction | it ended by |")
    print("|---|---|---|---|---|---|")
    for name in sys.argv[2:] or ("moteus_rig", "openarm"):
        poses = ARMS[name]
        real = load_robot(name)
        for file, words in ((real, "yes"), (slippery(real), "no")):
            with TemporaryDirectory() as folder:
                dynid.identify(dynid.simulate(file, duration=20.0, seed=1)).save(folder)
                for pose in poses:
                    ended, way = drift(file, Path(folder), pose, seconds)
                    said = ", ".join(f"{angle:g}" for angle in pose)
                    print(f"| {name} | {said} | {seconds:g} | {np.max(way):.3f} | {words} | {ended} |", flush=True)


if __name__ == "__main__":
    main()
