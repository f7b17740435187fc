"""What does a crash of the recorder cost? `python -m studies.safety.kill_recorder 20` takes about two minutes.

Records a simulated UR5e, kills `dynid record` with SIGKILL 2 to 5 s after its file appeared, rescues the file with
`dynid recover` and compares its last sample with the controller's clock at the moment of the kill, which a second
connection watches, and that every channel is whole. Prints what was lost, at least, in the middle and at most.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from daq.output_files import unfinished_files
from daq.robot.loader import load_robot
from daq.session.session import load_driver
from drivers.base import Driver

HOST = "127.0.0.62"
ROBOT = "ur5e"
RATE = 500.0
DYNID = str(Path(sys.executable).with_name("dynid"))


def watch(driver: Driver, until: float) -> float:
    """Read until a moment of the host's clock [s]; the controller's clock then [s]."""
    latest = float("nan")
    while time.monotonic() < until:
        for block in driver.read(0.002):
            if block.stream == "joints":
                latest = float(block.time[-1])
    return latest


def kill_one(driver: Driver, out: Path, delay: float) -> dict[str, float]:
    """Record, kill `delay` [s] after the file was created, rescue; lost samples and seconds, and the rescued recording.

    Raises:
        RuntimeError: the recording ended by itself, the rescue failed, or the rescued recording has gaps.
    """
    command = [DYNID, "record", ROBOT, "--host", HOST, "--duration", "60", "-o", str(out), "--no-ui", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        limit = time.monotonic() + 20.0
        while not unfinished_files(out) and time.monotonic() < limit:
            watch(driver, time.monotonic() + 0.01)
        killed_at = watch(driver, time.monotonic() + delay)
        if process.poll() is not None or not unfinished_files(out):
            raise RuntimeError("dynid record ended before it was killed")
    finally:
        process.kill()
        process.wait()
    rescued = out.with_name(f"{out.stem}-rescued.h5")
    done = subprocess.run([DYNID, "recover", str(out), "-o", str(rescued)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"dynid recover: {done.stderr}")
    with h5py.File(rescued) as file:
        joints = {name: dataset[:] for name, dataset in file["streams/joints"].items()}
    stamps = joints["time"]
    if unwritten := [name for name, values in joints.items() if not np.all(np.isfinite(values))]:
        raise RuntimeError(f"rows that were not written were rescued: {', '.join(unwritten)}")
    if not len(stamps) or np.any(np.rint(np.diff(stamps) * RATE) != 1):
        raise RuntimeError(f"{len(stamps)} samples were rescued, with gaps")
    seconds = killed_at - float(stamps[-1])
    return {"seconds": seconds, "samples": round(seconds * RATE), "rescued": len(stamps)}


def measure(kills: int) -> dict[str, list[float]]:
    """Kill so many recordings; by figure, what each kill cost or left."""
    sim = subprocess.Popen(
        [DYNID, "sim", ROBOT, "--host", HOST, "--no-ui"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert sim.stdout is not None
        if not json.loads(sim.stdout.readline() or b"{}").get("ready"):
            raise SystemExit("the simulated arm did not start")
        driver = load_driver(load_robot(ROBOT).robot, host=HOST)
        driver.open()
        driver.start()
        moments = random.Random(1)
        with tempfile.TemporaryDirectory() as folder:
            figures = []
            for kill in range(kills):
                figures.append(kill_one(driver, Path(folder) / f"{kill}.h5", moments.uniform(2.0, 5.0)))
                driver.close()  # nobody read it during the rescue
                driver.open()
                driver.start()
        driver.close()
    finally:
        sim.terminate()
        sim.wait(10.0)
    return {name: [one[name] for one in figures] for name in ("seconds", "samples", "rescued")}


def main(kills: int) -> None:
    """Kill and print a table."""
    print(f"{kills} kills{'':<27}{'least':>8}{'median':>8}{'most':>8}")
    for name, figures in measure(kills).items():
        values = np.array(figures)
        print(f"{name:<34}{values.min():>8.4g}{np.median(values):>8.4g}{values.max():>8.4g}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
