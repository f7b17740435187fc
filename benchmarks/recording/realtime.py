"""What no test may assert, since a busy computer changes it: `python -m benchmarks.recording.realtime 60`, 6 minutes.

How punctual positions and SYNCs are sent, how old samples are when the recorder gets them, and what is lost over RTDE
and CAN while other programs keep the processors busy. Everything runs for so many seconds in real time, one after the
other. Prints a JSON object and writes it to realtime.json beside this file; nothing is judged.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from daq.motion.player import MotionSequence, Player
from daq.motion.trajectories import PointToPoint
from daq.recording.recorder import Recorder
from daq.robot.loader import load_robot
from daq.session.session import load_driver, record
from daq.session.supervisor import Limits, Supervisor
from drivers.can.bus import Sender, close_bus, open_bus
from drivers.canopen402.samples.sync import SyncProducer
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK
from drivers.streams import Batch
from sim_drivers.simulated_arm import simulated_arm
from studies.recording import can_lossless, lossless
from studies.safety import kill_recorder

RESULTS = Path(__file__).parents[1] / "realtime.json"
PLAYER_RATE = 500.0
SYNC_RATE = 400.0
SECONDS_A_KILL = 10.0
"""What a kill and its rescue take, about [s]."""

Figures = Mapping[str, object]


def punctuality_of_the_player(seconds: float) -> Figures:
    """Positions to an arm that takes no time at all."""
    path = MotionSequence([PointToPoint(np.array([np.zeros(6), np.ones(6)]), np.array([seconds]))], PLAYER_RATE)
    player = Player(lambda *_: None, path, np.full(6, 10.0), SYSTEM_CLOCK)
    player.start()
    while not player.done and player.failure is None:
        SYSTEM_CLOCK.sleep(0.1)
    player.stop(1.0)
    return {"rate_hz": PLAYER_RATE, **asdict(player.punctuality())}


def punctuality_of_sync(seconds: float) -> Figures:
    """SYNCs on a bus within this process."""
    bus = open_bus("virtual", "realtime", 1_000_000, {})
    producer = SyncProducer(Sender(bus), SYNC_RATE, lambda *_: ())
    producer.start()
    sent: list[tuple[int, float]] = []
    end = SYSTEM_CLOCK.now() + seconds
    while SYSTEM_CLOCK.now() < end:
        SYSTEM_CLOCK.sleep(0.1)
        sent += producer.take()
    producer.stop()
    close_bus(bus)
    slots, moments = np.array([slot for slot, _ in sent]), np.array([moment for _, moment in sent])
    late = producer.clock(moments) - slots / SYNC_RATE
    return {"rate_hz": SYNC_RATE, "sent": producer.count, "skipped": producer.skipped, "late": milliseconds(late)}


class _Ages:
    """A view of a session that notes how old samples are when the recorder has them [s]."""

    def __init__(self) -> None:
        self.ages: list[FloatArray] = []

    def add(self, batch: Batch) -> None:
        self.ages.append(SYSTEM_CLOCK.now() - batch.host_time)

    def show(self, state: str, elapsed: float, total: float) -> None:
        pass


def latency(seconds: float) -> Figures:
    """Time from a sample's arrival at the socket until the recorder has it, over RTDE at 500 Hz."""
    robot_file = load_robot("ur5e")
    ages = _Ages()
    with simulated_arm("ur5e", seed=1) as host, tempfile.TemporaryDirectory() as folder:
        driver = load_driver(robot_file.robot, host=host)
        try:
            driver.open()
            layouts = driver.streams()
            recorder = Recorder(Path(folder) / "run.h5", robot_file, layouts)
            supervisor = Supervisor(Limits.of_robot(robot_file.robot), layouts)
            report = record(driver, recorder, supervisor, duration=seconds, view=ages)
        finally:
            driver.close()
    return {
        "samples": dict(report.samples),
        "lost": dict(report.lost),
        "stopped_by": report.stopped_by,
        "age": milliseconds(np.concatenate(ages.ages)),
    }


def lossless_rtde(seconds: float) -> Figures:
    """Three readers beside two shell loops and a Python thread: studies/recording/lossless.py."""
    with tempfile.TemporaryDirectory() as folder:
        return lossless.measure(seconds, Path(folder))


def lossless_can(seconds: float) -> Figures:
    """Six drives and two more listeners: studies/recording/can_lossless.py."""
    with tempfile.TemporaryDirectory() as folder:
        return can_lossless.measure(seconds, Path(folder))


def cost_of_a_kill(seconds: float) -> Figures:
    """What SIGKILL of the recorder loses: studies/safety/kill_recorder.py."""
    return kill_recorder.measure(max(2, round(seconds / SECONDS_A_KILL)))


def milliseconds(values: FloatArray) -> dict[str, float]:
    """Median, 99 % and the most of times (N,) [s], in ms."""
    p50, p99 = np.percentile(values, [50.0, 99.0])
    return {"p50_ms": 1e3 * float(p50), "p99_ms": 1e3 * float(p99), "max_ms": 1e3 * float(values.max())}


RUNS: tuple[Callable[[float], Figures], ...] = (
    punctuality_of_the_player,
    punctuality_of_sync,
    latency,
    lossless_rtde,
    lossless_can,
    cost_of_a_kill,
)


def main(seconds: float) -> None:
    """Measure, print, write."""
    results: dict[str, object] = {
        "machine": f"{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}",
        "seconds": seconds,
        "date": time.strftime("%Y-%m-%d"),
    }
    for run in RUNS:
        print(f"{run.__name__} …", file=sys.stderr, flush=True)
        results[run.__name__] = run(seconds)
    text = json.dumps(results, indent=2)
    RESULTS.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
