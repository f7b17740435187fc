"""A gravity motion, recorded over buses and identified; in simulated time, 2 minutes of CPU per bus.

    python -m studies.gravity.over_buses [rtde] [cia402] [table]

Plant, bus, driver, session, player, command gate, supervisor and recorder are those of production. The approach to the
motion is not checked for collisions.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import canopen_recording
import numpy as np
import table_arm_bench
from recorded_session import record_session
from rtde_in_process import NOWHERE, opened, serving
from simulated_clock import simulated_time
from unchecked import unchecked_play

import dynid
from daq.robot.loader import RobotFile, load_robot
from daq.session.session import SessionReport
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer

POSES = 8


def designed(robot_file: RobotFile) -> dynid.ExcitationTrajectory:
    return dynid.design_gravity_motion(robot_file, poses=POSES)[0]


def over_rtde(folder: Path) -> SessionReport:
    """A UR5e at 500 Hz."""
    robot_file = load_robot("ur5e")
    robot, motion = robot_file.robot, designed(robot_file).motion
    with simulated_time() as clock:
        server = RtdeServer(Plant(robot_file, seed=1), ports=NOWHERE, joints=robot.joints, clock=clock)
        with serving(server) as network, opened(robot, network.connect, clock) as driver:
            play = unchecked_play(motion, robot)
            return record_session(folder / "run.h5", robot_file, driver, play, clock=clock)


def over_cia402(folder: Path) -> SessionReport:
    """A UR5e with CiA 402 drives at 200 Hz."""
    with canopen_recording.arm_on_bus("{sync_rate: 200}", drives=6) as bench:
        return bench.record(folder, motion=designed(bench.robot_file).motion).report


def over_a_signal_table(folder: Path) -> SessionReport:
    """An AUBO i5 at 200 Hz."""
    robot, motion = table_arm_bench.ROBOT, designed(table_arm_bench.ROBOT_FILE).motion
    with simulated_time() as clock, table_arm_bench.served(clock) as server:
        connection = table_arm_bench.connection_of(server)
        with table_arm_bench.opened(connection, clock) as driver:
            return table_arm_bench.session(folder / "run.h5", driver, clock, unchecked_play(motion, robot))


OVER = {"rtde": ("RTDE", over_rtde), "cia402": ("CiA 402", over_cia402), "table": ("signal table", over_a_signal_table)}


def main(buses: list[str]) -> None:
    """Print the table."""
    print("| bus | recorded [s] | lost samples | ended by | worst held-out error [% of gravity] | verdict |")
    print("|---|---|---|---|---|---|")
    for name, over in (OVER[bus] for bus in buses or OVER):
        with tempfile.TemporaryDirectory() as folder:
            print(row(name, over(Path(folder)), Path(folder, "run.h5")), flush=True)


def row(name: str, report: SessionReport, path: Path) -> str:
    """A bus's row; the error is that of the worst joint with a tenth of the largest gravity."""
    joints = dynid.read_recording(path).streams["joints"]
    found = dynid.identify_gravity(path)
    gravity, error = (np.array(found.errors.to_frame()[key], float) for key in ("gravity", "held_out_error"))
    loaded = gravity > 0.1 * gravity.max()
    worst = float(np.max(100.0 * error[loaded] / gravity[loaded]))
    verdict = re.split(r"[,.]", found.verdict)[0]
    ended, lost = report.stopped_by or "its end", report.lost["joints"]
    return f"| {name} | {joints.time[-1] - joints.time[0]:.0f} | {lost} | {ended} | {worst:.2f} | {verdict} |"


if __name__ == "__main__":
    main(sys.argv[1:])
