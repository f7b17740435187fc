"""Rows a second that six simulated serial servos give, in simulated time, against what their wire carries.

    python -m studies.servo.serial_rates [SECONDS [ARM HZ]]

With an arm, its goals at one rate alone. No computer is late in simulated time: what is lost is lost on the wire.
Servos without return delay, 1 Mbit/s.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from simulated_clock import simulated_time
from simulated_serial import simulated_line

from daq.robot.loader import RobotFile, load_robot
from daq.session.connections import driver_settings
from drivers.declaration import declared
from drivers.serial_servos.driver import SerialServoDriver
from drivers.serial_servos.settings import parse_settings
from sim_drivers.serial_servos.server import SerialServoServer

RATES = (100.0, 200.0)
"""[Hz] that are asked for."""
NEARLY_ALL = 0.92
"""Share of the wire that a third rate takes."""


def highest(file: RobotFile, wire: str, *, moves: bool) -> float:
    """The highest rate of the wire [Hz]."""
    keys = dict(file.robot.connections[wire].model_extra or {}) | {"read_only": not moves}
    budget = declared(wire).budget_of(driver_settings(file.robot, keys))
    return float("nan") if budget is None else budget.highest_rate()


def rows(file: RobotFile, wire: str, rate: float, seconds: float, *, moves: bool) -> tuple[float, int]:
    """Rows a second, and rows lost, of a session of so long [s]."""
    robot = file.robot
    with simulated_time() as clock, simulated_line(clock) as line:
        keys = dict(robot.connections[wire].model_extra or {}) | {
            "url": line.path,
            "rate": rate,
            "read_only": not moves,
        }
        start = np.array([0.5 * sum(joint.position) for joint in robot.joints])
        settings = replace(driver_settings(robot, keys), clock=clock)
        served = parse_settings(keys, robot.joint_names, None, wire)
        server = SerialServoServer(file, served, start, line_end=line, clock=clock)  # type: ignore[arg-type]
        for servo in server.servos:
            servo.put("return_delay", 0)
        driver = SerialServoDriver(settings, wire)
        taken = lost = 0
        with server:
            driver.open()
            driver.start()
            if moves:
                driver.read(0.1)
                driver.take_control()
            driver.read(0.0)
            begun = clock.now()
            while clock.now() < begun + seconds:
                if moves:
                    driver.command(start)
                for batch in driver.read(1.0 / rate):
                    taken += len(batch.time) * (batch.stream == "joints")
                    lost += batch.lost
            lasted = clock.now() - begun
            driver.close()
    return taken / lasted, lost


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
    print("| arm | asked [Hz] | | rows [Hz] | lost | wire without pauses [Hz] | reached of it |")
    print("|---|---|---|---|---|---|---|")
    alone = sys.argv[2:]
    for name, wire in (("so101", "feetech"), ("koch", "dynamixel")):
        if alone and name != alone[0]:
            continue
        file = load_robot(name)
        for moves in (True,) if alone else (False, True):
            most = highest(file, wire, moves=moves)
            for rate in (float(alone[1]),) if alone else (*RATES, float(int(NEARLY_ALL * most))):
                reached, lost = rows(file, wire, rate, seconds, moves=moves)
                said = "goals sent, too" if moves else "read only"
                print(f"| {name} | {rate:g} | {said} | {reached:.0f} | {lost} | {most:.0f} | {reached / most:.0%} |")


if __name__ == "__main__":
    main()
