"""A long recording in parts: CPU time per sample against ten minutes, memory, and what SIGKILL and Ctrl-C cost.

    python -m studies.fleet.long HOURS

A Panda at 500 Hz, simulated in pieces of ten minutes of one motion with noise of their own, 231 MB per hour; identified
in parts of ten minutes by two workers. The process is killed (SIGKILL) when a third of the parts is done, interrupted
(Ctrl-C) after two thirds, and called again. About 15 CPU seconds per part on a quiet computer.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py

import dynid
from ident.fleet.job import JOB_FILE

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

PART = 600.0
RATE = 500.0


def recorded(path: Path, parts: int) -> None:
    """Write the recording, a piece at a time."""
    for number in range(parts):
        piece = path if number == 0 else path.with_name("piece.h5")
        dynid.simulate("panda", duration=PART, seed=number, rate=RATE).save(piece, overwrite=True)
        if number == 0:
            continue
        with h5py.File(path, "a") as whole, h5py.File(piece) as added:
            for name, values in added["streams/joints"].items():
                stream = whole["streams/joints"][name]
                stream.resize(len(stream) + len(values), axis=0)
                stream[-len(values) :] = values[:] + (PART * number if name in ("time", "host_time") else 0.0)
        piece.unlink()


def outcomes(out: Path) -> list[dict[str, Any]]:
    """What each job has left."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.rglob(JOB_FILE))]


def call(folder: Path, recording: str, *, stop: int = 0, by: signal.Signals = signal.SIGKILL) -> None:
    """Identify in parts, and print a row; stopped by a signal once `stop` jobs have ended, where that is not 0."""
    file, out = folder / f"{recording}.yaml", folder / recording
    file.write_text(f"arms: [{{name: arm, recordings: [{recording}.h5], parts: {PART:g}}}]\n")
    before, begun = len(list(out.rglob(JOB_FILE))), time.monotonic()
    command = [sys.executable, "-m", "dynid", "fleet", str(file), "-o", str(out), "--workers", "2", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None:
        time.sleep(0.5)
        if stop and len(list(out.rglob(JOB_FILE))) >= stop:
            os.killpg(process.pid, by)
            break
    status = process.wait()
    ended = outcomes(out)
    what = f"{recording}{f', {by.name} after {stop}' if stop else ''}"
    row = [what, status, before, len(ended), f"{time.monotonic() - begun:.0f}"]
    print(f"| {' | '.join(map(str, row))} |", flush=True)


def main() -> None:
    """Print a row per call, then time per sample and memory."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in what it starts in the background
    parts = round(float(sys.argv[1]) * 3600 / PART)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        recorded(folder / "ten-minutes.h5", 1)
        recorded(folder / "long.h5", parts)
        print(f"{parts} parts, {(folder / 'long.h5').stat().st_size / 1e6:.0f} MB\n")
        print(
            "| call | exit status | results before | results after | wall time [s] |\n|---|---|---|---|---|", flush=True
        )
        call(folder, "ten-minutes")
        call(folder, "long", stop=parts // 3, by=signal.SIGKILL)
        call(folder, "long", stop=2 * parts // 3, by=signal.SIGINT)
        call(folder, "long")
        samples = PART * RATE
        print("\n| recording | CPU time per sample [µs] | largest worker [MB] | merge [CPU s] |\n|---|---|---|---|")
        for recording in ("ten-minutes", "long"):
            jobs = outcomes(folder / recording)
            of_parts = [job["seconds"] for job in jobs if "merged" not in job["name"]]
            peak = max(job["peak_memory"] for job in jobs)
            merge = sum(job["seconds"] for job in jobs) - sum(of_parts)
            print(f"| {recording} | {1e6 * sum(of_parts) / samples / len(of_parts):.1f} | {peak:.0f} | {merge:.1f} |")
        failed = [f"{job['name']}: {job['failure']}" for job in outcomes(folder / "long") if job["failure"]]
        merged = next((job for job in outcomes(folder / "long") if "/merged/" in job["name"]), None)
        print("", *failed, merged["headline"] if merged else "no merged result", sep="\n")
        print(f"largest calling process {resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
