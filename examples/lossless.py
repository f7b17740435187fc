"""Does a recording lose samples on a busy computer? `python examples/lossless.py 600` takes ten minutes.

Serves a simulated UR5e at 500 Hz and reads it three times at once, each reader a process of its own: `dynid record`,
a loop around ur_rtde's RTDEReceiveInterface, and that interface's own file recording. Meanwhile two shell loops and a
Python thread that never lets go of its interpreter's lock keep the processors busy. Prints, for each reader, the
samples, those missing from the controller's clock, those read twice, and the recorder's share of a core.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

RATE = 500.0
HOST = "127.0.0.61"
ROBOT = "ur5e"
GRACE = 20.0
"""How long [s] beyond the recording the load and the helpers may live."""
SHELL_LOOP = "while :; do :; done"
PYTHON_LOOP = """
import threading, time
end = time.monotonic() + {seconds}
def spin():
    while time.monotonic() < end:
        pass
threading.Thread(target=spin).start()
"""
POLL = """
import json, sys, time
from rtde_receive import RTDEReceiveInterface
receive = RTDEReceiveInterface("{host}", {rate})
stamps, end = [], time.monotonic() + {seconds}
while time.monotonic() < end:
    began = receive.initPeriod()
    stamps.append(receive.getTimestamp())
    receive.waitPeriod(began)
receive.disconnect()
json.dump(stamps, open("{out}", "w"))
"""
FILE_RECORDING = """
import time
from rtde_receive import RTDEReceiveInterface
receive = RTDEReceiveInterface("{host}", {rate})
receive.startFileRecording("{out}", ["timestamp", "actual_q", "actual_qd", "actual_current"])
time.sleep({seconds})
receive.stopFileRecording()
receive.disconnect()
"""


def count(stamps: npt.NDArray[np.float64]) -> dict[str, int]:
    """Samples of a controller's clock (N,) [s]: how many there are, are missing, and are there twice."""
    ticks = np.rint(stamps * RATE).astype(np.int64)
    steps = np.diff(ticks)
    return {
        "read": len(ticks),
        "lost": int(np.maximum(steps - 1, 0).sum()),
        "gaps": int((steps > 1).sum()),
        "longest_gap": int(steps.max() - 1),
        "twice": int((steps == 0).sum()),
    }


def cpu_seconds(process: int) -> float:
    """What a process has used of the processors so far [s] (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def helper(code: str) -> subprocess.Popen[bytes]:
    """A Python process that runs some code."""
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)


def measure(seconds: float, folder: Path) -> dict[str, object]:
    """Read the arm in three ways for so long [s]; the figures by reader."""
    dynid = [str(Path(sys.executable).with_name("dynid"))]
    begun: list[subprocess.Popen[bytes]] = []
    sim = subprocess.Popen(
        [*dynid, "sim", ROBOT, "--host", HOST, "--no-ui"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    begun.append(sim)
    try:
        assert sim.stdout is not None
        if not json.loads(sim.stdout.readline() or b"{}").get("ready"):
            raise SystemExit("the simulated arm did not start")
        for _ in range(2):
            begun.append(subprocess.Popen(["timeout", str(seconds + GRACE), "sh", "-c", SHELL_LOOP]))
        begun.append(helper(PYTHON_LOOP.format(seconds=seconds + GRACE)))
        polled, written, ours = folder / "polled.json", folder / "written.csv", folder / "run.h5"
        readers = [
            helper(code.format(host=HOST, rate=RATE, seconds=seconds, out=out))
            for code, out in ((POLL, polled), (FILE_RECORDING, written))
        ]
        begun += readers
        record = subprocess.Popen(
            [*dynid, "record", ROBOT, "--host", HOST, "--duration", str(seconds), "-o", str(ours), "--no-ui", "--json"],
            stdout=subprocess.DEVNULL,
        )
        begun.append(record)
        time.sleep(4.0)  # imports are over by then
        since, before = time.monotonic(), cpu_seconds(record.pid)
        share = float("nan")
        while record.poll() is None:
            time.sleep(0.5)
            if Path(f"/proc/{record.pid}").exists() and record.poll() is None:
                share = (cpu_seconds(record.pid) - before) / (time.monotonic() - since)
        for reader in readers:
            reader.wait(seconds + GRACE)  # also where the recorder ended early
        info = json.loads(subprocess.run([*dynid, "info", str(ours), "--json"], capture_output=True, check=True).stdout)
        with h5py.File(ours) as file:
            stamps, received = file["streams/joints/time"][:], file["streams/joints/host_time"][:]
        with written.open() as text:
            file_stamps = [float(row["timestamp"]) for row in csv.DictReader(text)]
        return {
            "seconds": seconds,
            "load average": os.getloadavg()[0],
            "dynid record": count(stamps) | {"exit_status": record.returncode, "share_of_a_core": round(share, 3)},
            "ended": [event["message"] for event in info["events"] if event["source"] == "session"],
            "longest silence [ms]": float(np.diff(received).max() * 1e3),
            "dynid info": {
                name: {key: stream[key] for key in ("samples", "duration", "lost", "duplicates", "gaps")}
                for name, stream in info["streams"].items()
            },
            "ur_rtde getTimestamp + waitPeriod": count(np.array(json.loads(polled.read_text()))),
            "ur_rtde startFileRecording": count(np.array(file_stamps)),
        }
    finally:
        for process in reversed(begun):
            if process.poll() is None:
                process.terminate()
                process.wait(10.0)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(json.dumps(measure(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0, Path(name)), indent=2))
