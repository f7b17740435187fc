"""Does a recording lose samples on a busy computer? `python -m studies.recording.lossless 600` takes ten minutes.

Serves a simulated UR5e at 500 Hz and reads it three times at once, each reader a separate process: `dynid record`,
a loop around ur_rtde's RTDEReceiveInterface, and that interface's own file recording. Meanwhile two shell loops and a
Python thread that never releases its interpreter's lock keep the processors busy. Prints, for each reader, the
samples, those missing from the controller's clock and those read twice, all three between the same two moments of that
clock: from when the last of them has started to when the first has ended. Prints also what each process used of the
processors meanwhile, and the sum.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

RATE = 500.0
HOST = "127.0.0.61"
ROBOT = "ur5e"
OURS, POLLED, WRITTEN = "dynid record", "ur_rtde getTimestamp + waitPeriod", "ur_rtde startFileRecording"
GRACE = 20.0
"""Time [s] beyond the recording for which the load and the helpers may run."""
SHELL_LOOP = "ulimit -t {seconds}; while :; do :; done"
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


def common_span(readers: Iterable[npt.NDArray[np.float64]]) -> tuple[int, int]:
    """The first and the last tick of the controller's clock that every reader's stamps (N,) [s] lie around.

    Raises:
        SystemExit: there is none.
    """
    ticks = [np.rint(stamps[stamps > 0.0] * RATE).astype(np.int64) for stamps in readers]
    if any(len(one) == 0 for one in ticks):
        raise SystemExit("a reader read nothing")
    first, last = max(int(one[0]) for one in ticks), min(int(one[-1]) for one in ticks)
    if last <= first:
        raise SystemExit("the three did not read at the same time")
    return first, last


def count(stamps: npt.NDArray[np.float64], first: int, last: int) -> dict[str, int]:
    """Samples with a controller's clock (N,) [s] from one of its ticks to another: read, missing, there again."""
    ticks = np.rint(stamps * RATE).astype(np.int64)
    ticks = ticks[(ticks >= first) & (ticks <= last)]
    known = np.unique(ticks)
    gaps = np.diff(np.concatenate([[first - 1], known, [last + 1]])) - 1
    return {
        "expected": last - first + 1,
        "read": len(known),
        "lost": int(gaps.sum()),
        "gaps": int((gaps > 0).sum()),
        "longest_gap": int(gaps.max()),
        "twice": len(ticks) - len(known),
    }


def cpu_seconds(process: int) -> float:
    """Processor time of a process [s] (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def shares(before: Mapping[str, float], after: Mapping[str, float], elapsed: float) -> dict[str, float]:
    """Share of a core of every process between two readings of `cpu_seconds`, and the sum."""
    used = {name: (after[name] - before[name]) / elapsed for name in before}
    return {name: round(share, 3) for name, share in {**used, "sum": sum(used.values())}.items()}


def helper(code: str) -> subprocess.Popen[bytes]:
    """A Python process that runs some code."""
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.DEVNULL)


def measure(seconds: float, folder: Path) -> dict[str, object]:
    """Read the arm in three ways for so long [s]; the figures by reader."""
    dynid = [str(Path(sys.executable).with_name("dynid"))]
    begun: dict[str, subprocess.Popen[bytes]] = {}
    sim = subprocess.Popen(
        [*dynid, "sim", ROBOT, "--host", HOST, "--no-ui"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    begun["dynid sim"] = sim
    try:
        assert sim.stdout is not None
        if not json.loads(sim.stdout.readline() or b"{}").get("ready"):
            raise SystemExit("the simulated arm did not start")
        for number in (1, 2):
            loop = SHELL_LOOP.format(seconds=round(seconds + GRACE))
            begun[f"shell loop {number}"] = subprocess.Popen(["sh", "-c", loop])
        begun["Python thread"] = helper(PYTHON_LOOP.format(seconds=seconds + GRACE))
        polled, written, ours = folder / "polled.json", folder / "written.csv", folder / "run.h5"
        readers = {
            name: helper(code.format(host=HOST, rate=RATE, seconds=seconds, out=out))
            for name, code, out in ((POLLED, POLL, polled), (WRITTEN, FILE_RECORDING, written))
        }
        begun |= readers
        record = subprocess.Popen(
            [*dynid, "record", ROBOT, "--host", HOST, "--duration", str(seconds), "-o", str(ours), "--no-ui", "--json"],
            stdout=subprocess.DEVNULL,
        )
        begun[OURS] = record
        time.sleep(4.0)  # imports are over by then
        since, before = time.monotonic(), {name: cpu_seconds(process.pid) for name, process in begun.items()}
        used: dict[str, float] = {}
        while all(process.poll() is None for process in begun.values()):
            with suppress(OSError, ValueError):  # one of them has just ended
                after = {name: cpu_seconds(process.pid) for name, process in begun.items()}
                used = shares(before, after, time.monotonic() - since)
            time.sleep(0.5)
        for process in (record, *readers.values()):
            process.wait(seconds + GRACE)  # also where one of them ended early
        info = json.loads(subprocess.run([*dynid, "info", str(ours), "--json"], capture_output=True, check=True).stdout)
        with h5py.File(ours) as file:
            stamps, received = file["streams/joints/time"][:], file["streams/joints/host_time"][:]
        with written.open() as text:
            file_stamps = np.array([float(row["timestamp"]) for row in csv.DictReader(text)])
        read = {OURS: stamps, POLLED: np.array(json.loads(polled.read_text())), WRITTEN: file_stamps}
        first, last = common_span(read.values())
        return {
            "seconds": seconds,
            "span of the controller's clock [s]": [first / RATE, last / RATE],
            "readers": {name: count(clock, first, last) for name, clock in read.items()},
            "cores": os.cpu_count(),
            "load average": os.getloadavg()[0],
            "share of a core": used,
            "exit status of dynid record": record.returncode,
            "ended": [event["message"] for event in info["events"] if event["source"] == "session"],
            "longest silence [ms]": float(np.diff(received).max() * 1e3),
            "dynid info, whole recording": {
                name: {key: stream[key] for key in ("samples", "duration", "lost", "duplicates", "gaps")}
                for name, stream in info["streams"].items()
            },
        }
    finally:
        for process in reversed(begun.values()):
            if process.poll() is None:
                process.terminate()
                process.wait(10.0)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(json.dumps(measure(float(sys.argv[1]) if len(sys.argv) > 1 else 600.0, Path(name)), indent=2))
