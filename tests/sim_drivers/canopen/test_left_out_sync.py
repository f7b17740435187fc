"""SYNCs that a busy computer leaves out in mid motion: the torque of the arm hardly notices.

The driver's own targets, sent after every SYNC, to simulated drives that move a UR5e, in virtual time.
"""

from __future__ import annotations

import struct
from collections.abc import Collection

import numpy as np
import pytest
from drive_bench import Bench

from daq.robot.loader import load_robot
from drivers.canopen402.motion.target_path import TargetPath
from drivers.canopen402.settings import parse_settings
from drivers.core.arrays import FloatArray
from ident.model.dynamic_model import build_model
from sim_drivers.canopen.network import DriveNetwork
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion

RATE = 250
PERIOD = 1 / RATE
BEGIN, END = 200, 300
"""Numbers of the SYNC after which some are left out, and of the last."""
MOMENTS = np.arange(0.0, END * PERIOD, 1e-3)
"""[s] from the first SYNC on."""
COMMAND_PHASE = 0.3
"""When the player sends, in periods after SYNC."""

ROBOT_FILE = load_robot("ur5e")


def from_rest() -> FloatArray:
    """Positions (END, 6) [rad] at SYNC rate of a motion that is at full pace after half a second."""
    motion = random_fourier_motion(build_model(ROBOT_FILE), period=10.0, seed=1)
    time = np.arange(END) * PERIOD
    paced = np.where(time < 0.5, time**2, time - 0.25)
    return np.ascontiguousarray(motion.evaluate(paced)[0].T)


def torques(left_out: Collection[int], late: float) -> FloatArray:
    """Drive torques [N·m] at `MOMENTS`, (N, 6); commands from `BEGIN` on are sent up to `late` [s] too late."""
    positions = from_rest()
    robot = ROBOT_FILE.robot
    plant = Plant(ROBOT_FILE, position=positions[0])
    settings = parse_settings(dict(robot.connections["canopen"].model_extra or {}), robot.joint_names)
    bench = Bench.__new__(Bench)
    bench.arm, bench.network, bench.time, bench.heard = plant, DriveNetwork(plant, robot, settings), 0.0, []
    bench.pass_time(1.5)
    bench.map_pdos()
    radians = 2 * np.pi / 524288
    counts = np.rint(positions / radians).astype(int).tolist()
    for word in (0x06, 0x07, 0x0F):
        bench.cycle(word, counts[0], period=PERIOD)
    start = bench.time
    path = TargetPath(counts[0], PERIOD)

    def send_targets(number: int, left: int = 0) -> None:
        for node, target in enumerate(path.at(start + number * PERIOD, left), start=1):
            bench.send(0x200 + node, struct.pack("<Hbi", 0x0F, 8, target))

    commands = [(number, number + COMMAND_PHASE) for number in range(END)]
    held = BEGIN + COMMAND_PHASE + late / PERIOD
    events = [(max(due, held) if due > BEGIN else due, "command", number) for number, due in commands]
    events += [(float(number), "SYNC", number) for number in range(END) if number not in left_out]
    if left_out:
        events.append((max(left_out) + 0.6, "targets", max(left_out)))  # what the SYNC producer does when it wakes
    times, found = [], []
    for place, event, number in sorted(events):
        while bench.time < start + place * PERIOD - 1e-9:
            bench.pass_time(min(1e-3, start + place * PERIOD - bench.time))
            times.append(bench.time - start)
            found.append(plant.drive_torque.copy())
        if event == "command":
            path.put(start + commands[number][1] * PERIOD, counts[number])
        elif event == "targets":
            send_targets(number, len(left_out))
        else:
            bench.send(0x80)
            send_targets(number)
    assert all(drive.enabled for drive in bench.network.drives)
    return np.array([np.interp(MOMENTS, times, torque) for torque in np.array(found).T]).T


@pytest.fixture(scope="module")
def undisturbed() -> FloatArray:
    return torques((), late=0.0)


@pytest.mark.parametrize(("count", "late", "allowed"), [(0, 0.045, 1.0), (1, 0.0, 6.0), (2, 0.0, 8.0), (3, 0.03, 10.0)])
def test_late_commands_and_syncs_left_out_change_the_torque_little(
    undisturbed: FloatArray, count: int, late: float, allowed: float
) -> None:
    """`allowed` in N·m, of joints that may have 150."""
    found = torques(range(BEGIN, BEGIN + count), late)
    assert np.max(np.abs(found - undisturbed)) < allowed
