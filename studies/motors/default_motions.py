"""Arms of CAN motors from their default motion to a verdict, in simulated time.

    python -m studies.motors.default_motions [ARM...]

`dynid excite` with its defaults but for the time of its search, `record` of that motion, `identify` with its defaults.
No computer is late. ARM: a built-in robot, or a family of motors, which then move the arm of the tests. About a CPU
minute for each.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from motor_bench import WIRES, robot_file
from recorded_session import opened, record_session
from simulated_clock import simulated_time
from unchecked import unchecked_play

import dynid
from daq.motion.trajectories import Motion
from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from daq.session.connections import driver_settings
from drivers.can_motors.driver import CanMotorDriver
from drivers.can_motors.settings import parse_settings
from sim_drivers.can_motors.server import CanMotorServer

ARMS = ("moteus_rig", "openarm", *WIRES)


def recorded(file: RobotFile, wire: str, motion: Motion, folder: Path) -> Recording:
    """A motion of the simulated arm, from its start pose, recorded in a folder.

    Raises:
        RuntimeError: the motion was stopped.
    """
    robot = file.robot
    connection = robot.connections[wire]
    keys = dict(connection.model_extra or {}) | {"interface": "virtual", "channel": "default", "options": {}}
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    with simulated_time() as clock:
        settings = parse_settings(keys, robot.joint_names, connection.driver)
        driver = CanMotorDriver(replace(driver_settings(robot, keys), clock=clock), connection.driver)
        with CanMotorServer(file, settings, start, clock, held=True), opened(driver):
            path, play = folder / "run.h5", unchecked_play(motion, robot)
            report = record_session(path, file, driver, play, trajectory="default", clock=clock)
        if report.stopped_by is not None or report.file is None:
            raise RuntimeError(f"{robot.name}: {report.stopped_by}")
        return read_recording(report.file)


def lag(run: Recording) -> float:
    """How far a joint was behind its goals at most [rad]."""
    joints, goals = run.streams["joints"], run.streams["commands"]
    target, position = goals.channels["target_position"].values, joints.channels["position"].values
    aimed = np.column_stack([np.interp(joints.time, goals.time, column) for column in target.T])
    return float(np.max(np.abs(aimed - position)))


def main() -> None:
    """Print the table."""
    print("| arm | rows | lag of a joint at most [rad] | torque prediction | held-out torque error [%] | simulation |")
    print("|---|---|---|---|---|---|")
    for arm in sys.argv[1:] or ARMS:
        file = robot_file() if arm in WIRES else load_robot(arm)
        wire = arm if arm in WIRES else next(iter(file.robot.connections))
        motion = dynid.design_excitation(file, starts=1, workers=1).motion
        with TemporaryDirectory() as folder:
            run = recorded(file, wire, motion, Path(folder))
            result = dynid.identify(run)
        grades = {name: judged.grade for name, judged in result.verdict.purposes.items()}
        assert result.validation is not None
        rows, error = len(run.streams["joints"].time), 100.0 * result.validation.relative_error
        graded = f"{grades['torque_prediction']} | {error:.2g} | {grades['simulation']}"
        print(f"| {arm} | {rows} | {lag(run):.3f} | {graded} |", flush=True)


if __name__ == "__main__":
    main()
