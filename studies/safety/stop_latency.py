"""CPU per command of the gate, and the time, in real time, from a sample beyond its limit to the stop at the arm.

python -m studies.safety.stop_latency
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.trajectories import Motion, PointToPoint, slow_move
from daq.recording.recorder import Recorder
from daq.robot.loader import load_robot
from daq.robot.schema import JointLimits, Robot
from daq.session.command_gate import CommandGate, GateLimits
from daq.session.play import Play
from daq.session.session import record
from daq.session.supervisor import Limits, Supervisor
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.streams import Batch, ChannelLayout, StreamLayout

COMMANDS, BREACHES = 20_000, 60
LISTENER = socket.socket()
"""Listening socket of the loopback arms."""


class LoopbackArm:
    """A driver of an arm that is where it was told to be; at a time it reports a velocity beyond its limit.

    Args:
        robot: whose joints it has.
        breach_after: commands.
    """

    def __init__(self, robot: Robot, breach_after: int) -> None:
        self._names, self._clock, self._left = robot.joint_names, Clock(), breach_after
        self._near, self._far = socket.create_connection(LISTENER.getsockname()), LISTENER.accept()[0]
        self._position = np.zeros(robot.dof)
        self._count, self._begun = 0, 0.0
        self.breached = self.heard = 0.0
        self._ear = threading.Thread(target=self._hear)

    def _hear(self) -> None:
        self._far.recv(1)
        self.heard = self._clock.now()

    def open(self) -> None: ...

    def streams(self) -> tuple[StreamLayout, ...]:
        channels = tuple(ChannelLayout(quantity, self._names) for quantity in ("position", "velocity"))
        return (StreamLayout("joints", channels, 500.0),)

    def start(self) -> None:
        self._begun = self._clock.now()
        self._ear.start()

    def read(self, timeout: float) -> Sequence[Batch]:
        self._count += 1
        self._clock.sleep_until(self._begun + 0.002 * self._count)
        now, velocity = self._clock.now(), np.zeros((1, len(self._names)))
        if self._left <= 0:
            velocity[0, 2] = 99.0
            self.breached = self.breached or now
        values = {"position": self._position[np.newaxis], "velocity": velocity}
        return (Batch("joints", np.array([0.002 * self._count]), np.array([now]), values),)

    def notices(self) -> tuple[()]:
        return ()

    def command_rate(self) -> float:
        return 500.0

    def take_control(self) -> None: ...

    def command(self, position: FloatArray) -> None:
        self._position, self._left = position.copy(), self._left - 1

    def stop(self) -> None:
        with suppress(OSError):
            self._near.send(b"s")

    def close(self) -> None:
        self._ear.join(5.0)
        self._near.close()
        self._far.close()


class Granted:
    """A permission without questions."""

    def __init__(self, start: FloatArray, limits: Sequence[JointLimits]) -> None:
        self._start, self._limits = start, limits

    def approach(self, position: FloatArray) -> Motion:
        return slow_move(position, self._start, self._limits)

    def ask(self) -> None: ...

    def answer(self) -> bool:
        return True


class Moment(Clock):
    """A clock that stands until it is set."""

    time = 0.0

    def now(self) -> float:
        return self.time


def main() -> None:
    """Measure CPU of a command, and real time from a sample beyond its limit to the stop at the far end of a socket."""
    LISTENER.bind(("127.0.0.1", 0))
    LISTENER.listen()
    robot_file = load_robot("ur5e")
    robot, clock = robot_file.robot, Moment()
    gate = CommandGate(lambda *_: None, lambda *_: None, GateLimits.of_joints(robot.joints), 0.002, clock)
    spent = []
    for tick in range(COMMANDS):
        clock.time = 0.002 * tick
        position = np.full(robot.dof, 0.3 * (1.0 - np.cos(2.0 * clock.time)))
        gate.measured(clock.time, position)
        before = time.thread_time_ns()
        gate.command(position, clock.time)
        spent.append(1e-3 * (time.thread_time_ns() - before))
    late = []
    goal = np.full(robot.dof, 0.2)
    motion = PointToPoint(np.array([np.zeros(robot.dof), goal, np.zeros(robot.dof)]), np.array([2.0, 2.0]))
    for number in range(BREACHES):
        arm = LoopbackArm(robot, 150 + number)
        supervisor = Supervisor(Limits.of_robot(robot), arm.streams())
        with tempfile.TemporaryDirectory() as folder:
            recorder = Recorder(Path(folder) / "run.h5", robot_file, arm.streams())
            report = record(arm, recorder, supervisor, Play(motion, robot, Granted(np.zeros(robot.dof), robot.joints)))
        arm.close()
        if not str(report.stopped_by).startswith("velocity of "):
            print(f"left out: {report.stopped_by}", file=sys.stderr)
            continue
        late.append(1e3 * (arm.heard - arm.breached))
    print("| what | p50 | p99 | most |", "|---|---|---|---|", sep="\n")
    for what, values in (
        (f"gate: CPU per command, six joints, {COMMANDS} commands [µs]", spent),
        (f"sample beyond its limit → stop at the other end, {len(late)} motions at 500 Hz [ms]", late),
    ):
        print(f"| {what} | {np.percentile(values, 50):.3g} | {np.percentile(values, 99):.3g} | {max(values):.3g} |")


if __name__ == "__main__":
    main()
