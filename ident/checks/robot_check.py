"""Checks of a valid robot file for `dynid check`: gains, gravity, limits, drivers, bus budgets."""

from __future__ import annotations

from collections import Counter
from importlib.metadata import entry_points

import numpy as np

from daq.robot.loader import RobotFile
from daq.session.bus_room import bus_budget, tight_bus
from daq.session.session import load_driver
from drivers.base import DRIVERS_GROUP
from drivers.bus_budget import TIGHT_SHARE, Budget
from drivers.errors import UsageError
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model


def check_robot(robot_file: RobotFile) -> list[str]:
    """Warnings about a valid robot file, in words.

    Raises:
        RobotFileError: its kinematics cannot be used, or a connection asks more of its bus than fits.
        UsageError: the keys of a connection are wrong.
        IdentificationError: its base parameters cannot be decided.
    """
    robot = robot_file.robot
    base_parameters(build_model(robot_file))
    warnings = []
    unknown = [joint for joint in robot.joint_names if _needs_gain(robot_file, joint)]
    if unknown:
        warnings.append(
            f"the drive gain of {', '.join(unknown)} is unknown: recorded current cannot be turned into torque"
        )
    unsure = [drive.joint for drive in robot.drives if drive.gain is not None and drive.gain_std is None]
    if unsure:
        warnings.append(f"the drive gain of {', '.join(unsure)} has no standard deviation (gain_std)")
    length = float(np.linalg.norm(robot.model.gravity))
    if not 9.7 < length < 9.9:
        warnings.append(f"gravity is {length:.4g} m/s²; on Earth it is 9.78 to 9.83")
    without = [joint.name for joint in robot.joints if joint.torque is None]
    if without:
        warnings.append(f"no torque limit for {', '.join(without)}")
    installed = {entry.name for entry in entry_points(group=DRIVERS_GROUP)}
    for name, connection in robot.connections.items():
        if connection.driver not in installed:
            known = ", ".join(sorted(installed)) or "none in this version"
            warnings.append(
                f"connection '{name}' needs the driver '{connection.driver}', which is not installed ({known})"
            )
            continue
        try:
            load_driver(robot, name, folder=robot_file.folder)  # the driver checks its keys; nothing is opened
        except UsageError as error:
            error.where = error.where or f"{robot.name}: connections.{name}"
            raise
    for name, budget in bus_budgets(robot_file).items():
        if (warning := tight_bus(name, budget)) is not None:
            warnings.append(warning)
    return warnings


def bus_budgets(robot_file: RobotFile) -> dict[str, Budget]:
    """What each CAN connection asks of its bus, by the connection's name.

    Raises:
        UsageError: a connection's keys are wrong.
        RobotFileError: a connection asks more of its bus than fits.
    """
    budgets = {name: bus_budget(robot_file, name) for name in robot_file.robot.connections}
    return {name: budget for name, budget in budgets.items() if budget is not None}


def _needs_gain(robot_file: RobotFile, joint: str) -> bool:
    drive = robot_file.robot.drive(joint)
    return drive.gain is None and drive.signal != "torque"


def budget_object(budget: Budget) -> dict[str, float]:
    """The JSON object of a bus budget."""
    return {
        "bitrate": budget.bitrate,
        "rate_hz": budget.rate,
        "cycle_bits": budget.cycle_bits,
        "load_percent": 100.0 * budget.load,
        "highest_rate_hz": budget.highest_rate(),
        "highest_rate_at_80_percent_hz": budget.highest_rate(TIGHT_SHARE),
    }


def print_budget(name: str, budget: Budget) -> None:
    """The same for a person."""
    print(
        f"  connection {name}: bus load {100 * budget.load:.1f} % ({budget.bitrate / 1e3:g} kbit/s) at "
        f"{budget.rate:g} Hz with every stuffed bit; at most {budget.highest_rate():.0f} Hz, "
        f"{budget.highest_rate(TIGHT_SHARE):.0f} Hz for {100 * TIGHT_SHARE:.0f} %"
    )
    cycle = Counter[tuple[str, int]]()
    for group in budget.cycle:
        cycle[group.meaning, group.data_bytes] += group.count
    listed = ", ".join(f"{count} × {meaning} ({size} bytes)" for (meaning, size), count in cycle.items())
    print(f"    a cycle of {budget.cycle_bits} bits: {listed}")
    for group, rate in budget.beside:
        print(f"    beside it: {group.count} × {group.meaning} ({group.data_bytes} bytes) at {rate:g} Hz")
