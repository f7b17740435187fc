"""What an arm of simulated motors or servos does when something fails in a motion, and what the file says.

    python -m studies.motors.fault_table [FAMILY …]

Simulated time; CAN motors where no family is named, serial servos are `feetech` and `dynamixel`. The fault comes
half-way through a short motion. `on_stop: hold`; `when_lost: limp` where motors have a time-out. A killed program
sends nothing more and stops nothing; what it had flushed is rescued by `dynid recover`. A CPU minute.
"""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

import motor_bench
import servo_bench
from motor_bench import JOINTS, WIRES, MotorBench, motors
from servo_bench import ServoBench, servos
from simulated_clock import SimulatedClock, simulated_time

from daq.recording.reader import read_recording
from drivers.can_motors.settings import CODECS
from sim_drivers.faults import parse_fault

WAY = np.array([0.8, -0.6])
"""[rad]"""
CUT = "bus-off 5"
FAULTS = {
    "cable cut": CUT,
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


def served(clock: SimulatedClock, family: str) -> AbstractContextManager[MotorBench | ServoBench]:
    """The arm of a family."""
    if family in servo_bench.WIRES:
        return servos(clock, family)
    return motors(clock, family, when_lost="limp" if CODECS[family].times_out else "hold")


def start(bench: MotorBench | ServoBench) -> np.ndarray:
    """Where the arm stands at first [rad]."""
    return servo_bench.START if isinstance(bench, ServoBench) else motor_bench.START


def state(bench: MotorBench | ServoBench) -> str:
    """What the arm does a second after it."""
    bench.clock.sleep(1.0)
    if isinstance(bench, ServoBench):
        on = sum(bool(servo.get("torque_enable")) for servo in bench.server.servos)
    else:
        on = sum(motor.enabled for motor in bench.server.motors)
    speed = float(np.max(np.abs(bench.server.plant.arm.velocity)))
    said = {len(JOINTS): "holds", 0: "limp"}.get(on, f"{on} of {len(JOINTS)} motors hold")
    return said if speed < 0.05 else f"{said}, still moves at {speed:.2f} rad/s"


def faulty(family: str, line: str) -> tuple[str, str]:
    """What the arm did, and what the file says of a fault."""
    with TemporaryDirectory() as folder, simulated_time() as clock:
        with served(clock, family) as bench:
            kind = "serial servos" if isinstance(bench, ServoBench) else "CAN motors"
            fault = parse_fault("unplug" if line == CUT and kind == "serial servos" else line, kind, JOINTS)
            clock.call_at(clock.now() + HALFWAY, lambda: bench.server.cause(fault))
            report = bench.session(Path(folder) / "run.h5", start(bench) + WAY)
            did = state(bench)
        assert report.file is not None
        run = read_recording(report.file)
        rows = len(run.streams["joints"].time)
        return did, report.error.message if report.error else f"complete, {report.lost['joints']} of {rows} rows lost"


def killed(family: str) -> str:
    """What the arm does whose program was killed in a motion."""
    with simulated_time() as clock, served(clock, family) as bench, bench.opened() as driver:
        driver.start()
        driver.read(0.1)
        driver.take_control()
        for share in np.linspace(0.0, 1.0, 40):
            driver.command(start(bench) + share * WAY / 2.0)
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
