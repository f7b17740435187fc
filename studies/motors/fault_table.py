"""What an arm of simulated CAN motors does when something fails in a motion, and what the file says; simulated time.

    python -m studies.motors.fault_table [FAMILY …]

The fault comes half-way through a short motion. `on_stop: hold`; `when_lost: limp` where motors have a time-out. A
killed program sends nothing more and stops nothing; what it had flushed is rescued by `dynid recover`. A CPU minute.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from motor_bench import JOINTS, START, WIRES, MotorBench, motors
from simulated_clock import simulated_time

from daq.recording.reader import read_recording
from drivers.can_motors.settings import CODECS
from sim_drivers.faults import parse_fault

GOAL = START + [0.8, -0.6]
FAULTS = {
    "cable cut": "bus-off 5",
    "brown-out": "sag 1",
    "power of a motor interrupted": "power-cycle bend",
    "dead motor": "die bend",
    "id twice": "same-id bend",
    "garbage, 20 frames": "garbage 20",
    "over-temperature": "over-temperature bend",
    "jammed joint": "block swing",
}
HALFWAY = 1.1
"""[s] from the start of a session to the fault."""


def state(bench: MotorBench) -> str:
    """What the arm does a second after it."""
    bench.clock.sleep(1.0)
    on = sum(motor.enabled for motor in bench.server.motors)
    speed = float(np.max(np.abs(bench.server.plant.arm.velocity)))
    said = {len(JOINTS): "holds", 0: "limp"}.get(on, f"{on} of {len(JOINTS)} motors hold")
    return said if speed < 0.05 else f"{said}, still moves at {speed:.2f} rad/s"


def faulty(family: str, line: str) -> tuple[str, str]:
    """What the arm did, and what the file says of a fault."""
    with TemporaryDirectory() as folder, simulated_time() as clock:
        with motors(clock, family, when_lost="limp" if CODECS[family].times_out else "hold") as bench:
            fault = parse_fault(line, "CAN motors", JOINTS)
            clock.call_at(clock.now() + HALFWAY, lambda: bench.server.cause(fault))
            report = bench.session(Path(folder) / "run.h5", GOAL)
            did = state(bench)
        assert report.file is not None
        run = read_recording(report.file)
        rows = len(run.streams["joints"].time)
        return did, report.error.message if report.error else f"complete, {report.lost['joints']} of {rows} rows lost"


def killed(family: str) -> str:
    """What the arm does whose program was killed in a motion."""
    lost = "limp" if CODECS[family].times_out else "hold"
    with simulated_time() as clock, motors(clock, family, when_lost=lost) as bench, bench.opened() as driver:
        driver.start()
        driver.read(0.1)
        driver.take_control()
        for share in np.linspace(0.0, 1.0, 40):
            driver.command(START + share * (GOAL - START) / 2.0)
            clock.sleep(0.01)
        assert driver._cycle is not None
        driver._cycle.stop()
        did = state(bench)
        driver._cycle.failure = None
    return did


def main() -> None:
    """Print the table."""
    print("| motors | what fails | a second later the arm | the recording says |")
    print("|---|---|---|---|")
    for family in sys.argv[1:] or WIRES:
        print(f"| {family} | kill -9 | {killed(family)} | unfinished, rescued by `dynid recover` |", flush=True)
        for words, line in FAULTS.items():
            did, said = faulty(family, line)
            print(f"| {family} | {words} | {did} | {said} |", flush=True)


if __name__ == "__main__":
    main()
