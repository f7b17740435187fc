"""Rows a second that six simulated CAN motors give, in simulated time, against what their bus carries.

    python -m studies.motors.can_rates [SECONDS [FAMILY HZ]]

With a family, its goals at one rate alone. No computer is late in simulated time: what is lost is lost on the bus.
1 Mbit/s; moteus' data at 5 Mbit/s.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from simulated_clock import simulated_time

from daq.robot.loader import RobotFile, parse_robot
from daq.session.connections import driver_settings
from drivers.can_motors.driver import CanMotorDriver
from drivers.can_motors.settings import parse_settings
from drivers.declaration import declared
from sim_drivers.can_motors.server import CanMotorServer

JOINTS = tuple(f"j{number}" for number in range(1, 7))
MODELS = {"damiao": "dm4310", "robstride": "rs-01", "cubemars": "ak80-9", "moteus": "moteus", "odrive": "odrive"}
MOST = 2000.0
"""[Hz] that are asked for at most."""


def arm() -> RobotFile:
    """Six joints with parallel axes, each of which bears little."""
    rows = [
        {"joint": name, "antecedent": before, "alpha": 0, "d": 0.1, "theta0": 0, "r": 0}
        for name, before in zip(JOINTS, ("base", *JOINTS), strict=False)
    ]
    servo = {"stiffness": 40, "gain_d": 1, "torque_limit": 10}
    content = {
        "name": "six",
        "model": {"mdh": rows, "gravity": [0, 0, -9.81]},
        "joints": [{"name": name, "position": [-2, 2], "velocity": 6} for name in JOINTS],
        "drives": [{"joint": name, "signal": "torque"} for name in JOINTS],
        "truth": {
            "links": {
                name: {"mass": 0.1, "com": [0.05, 0, 0], "inertia": [1e-4, 0, 0, 1e-4, 0, 1e-4]} for name in JOINTS
            },
            "joints": {name: {"motor_inertia": 0.01, "viscous": 0.1, "servo": servo} for name in JOINTS},
        },
    }
    return parse_robot(yaml.safe_dump(content), where="six", folder=None)


def rows(file: RobotFile, family: str, rate: float, seconds: float, *, moves: bool) -> tuple[float, int, float]:
    """Rows a second, rows lost, and the highest rate of the bus [Hz] of a session of so long [s]."""
    keys = {
        "interface": "virtual",
        "channel": f"{family}-{rate}-{moves}",
        "rate": rate,
        "model": MODELS[family],
        "kp": 40.0,
        "kd": 1.0,
        "read_only": not moves,
        "motors": {name: {"id": number} for number, name in enumerate(JOINTS, start=1)},
    }
    with simulated_time() as clock:
        settings = replace(driver_settings(file.robot, keys), clock=clock)
        server = CanMotorServer(file, parse_settings(keys, JOINTS, family), np.zeros(len(JOINTS)), clock)
        driver = CanMotorDriver(settings, family)
        taken = lost = 0
        with server:
            driver.open()
            driver.start()
            if moves:
                driver.read(0.2)
                driver.take_control()
            clock.sleep(0.05)
            driver.read(0.1)
            begun = clock.now()
            due = begun
            while clock.now() < begun + seconds:
                if moves:
                    driver.command(np.zeros(len(JOINTS)))
                due = max(due + 1.0 / rate, clock.now())
                for batch in driver.read(0.0):
                    taken += len(batch.time) * (batch.stream == "joints")
                    lost += batch.lost
                clock.sleep_until(due)
            lasted = clock.now() - begun
            driver.close()
    budget = declared(family).budget_of(settings)
    return taken / lasted, lost, float("nan") if budget is None else budget.highest_rate()


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    file = arm()
    print("| motors | asked [Hz] | | rows [Hz] | lost | bus at worst [Hz] | reached of it |")
    print("|---|---|---|---|---|---|---|")
    for family in sys.argv[2:3] or MODELS:
        for moves in (False, True) if len(sys.argv) < 4 else (True,):
            if family == "cubemars" and not moves:
                continue  # they tell nothing unless they are commanded
            most = rows(file, family, 50.0, 0.05, moves=moves)[2]
            rates = (min(200.0, 0.92 * most), min(MOST, 0.92 * most))
            for asked in dict.fromkeys(rates) if len(sys.argv) < 4 else (float(sys.argv[3]),):
                reached, lost, most = rows(file, family, asked, seconds, moves=moves)
                said = "goals" if moves else "read only"
                print(
                    f"| {family} | {asked:.0f} | {said} | {reached:.0f} | {lost} | {most:.0f} | {reached / most:.0%} |"
                )


if __name__ == "__main__":
    main()
