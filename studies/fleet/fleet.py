"""A fleet of simulated arms: cost per result and per hour of recording, and what a killed worker or scheduler costs.

    python -m studies.fleet.fleet ARMS [SECONDS]

Two recordings per arm (up6, 100 Hz, SECONDS long). Once with two workers of which one is killed (SIGKILL), once with
one, once on a Dask cluster whose scheduler is killed half-way; each is called again until nothing is missing. The
results of all three have to be the same but for dates. About 0.5 CPU seconds per result and call, 0.2 per recording.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dynid
from drivers.core.errors import DynidError
from ident.fleet.plan import read_fleet

PORT = 8797
STARTING = 300
"""[s] that a scheduler may take to listen."""

CHANGING = {"created", "recordings", "files", "sha256", "verdict"}
"""Keys of a result that carry dates and paths, and the hash of it all."""


def recorded(folder: Path, arms: int, seconds: float) -> int:
    """Write recordings and the fleet file; their bytes."""
    lines = []
    for arm in range(arms):
        names = [f"{arm:04d}-{number}.h5" for number in range(2)]
        for number, name in enumerate(names):
            dynid.simulate("up6", duration=seconds, seed=2 * arm + number, rate=100.0).save(folder / name)
        lines.append(f"  - {{name: arm-{arm:04d}, recordings: [{', '.join(names)}]}}")
    (folder / "fleet.yaml").write_text("\n".join(["arms:", *lines, "options: {friction: coulomb-viscous}", ""]))
    return sum(path.stat().st_size for path in folder.glob("*.h5"))


def results(folder: Path) -> dict[str, Any]:
    """What each result says, without dates and paths."""
    found = {}
    for path in sorted(folder.rglob("result.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        found[str(path.relative_to(folder))] = {key: content[key] for key in content if key not in CHANGING}
    return found


def kill_a_worker(after: float) -> None:
    """Kill the youngest process of the fork server once it is `after` seconds old [s of wall time]."""
    while True:
        time.sleep(after)
        server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
        children = Path(f"/proc/{server}/task/{server}/children")
        processes = children.read_text().split() if server and children.exists() else []
        if processes:
            os.kill(int(processes[0]), signal.SIGKILL)
            return


def cluster() -> list[subprocess.Popen[bytes]]:
    """A scheduler and two workers, in this order."""
    module = [sys.executable, "-m"]
    quiet = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "start_new_session": True,
    }
    address = f"tcp://127.0.0.1:{PORT}"
    scheduler = [
        *module,
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        str(PORT),
        "--no-dashboard",
    ]
    worker = [*module, "distributed.cli.dask_worker", address, "--nthreads", "1", "--nworkers", "2", "--no-dashboard"]
    started = [subprocess.Popen(scheduler, **quiet)]  # type: ignore[call-overload]
    for _ in range(STARTING):
        try:
            socket.create_connection(("127.0.0.1", PORT), 1.0).close()
            break
        except OSError:
            time.sleep(1.0)
    return [*started, subprocess.Popen(worker, **quiet)]  # type: ignore[call-overload]


def main() -> None:
    """Print a row per call."""
    arms, seconds = int(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 6.0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        size = recorded(folder, arms, seconds)
        count, hours = 2 * arms, 2 * arms * seconds / 3600
        print(f"{arms} arms, {count} recordings of {seconds:g} s, {size / 1e6:.1f} MB\n", flush=True)
        print(
            "| call | done | failed | CPU time [s] | wall time [s] | largest worker [MB] |\n|---|---|---|---|---|---|",
            flush=True,
        )

        def call(what: str, out: str, **choices: Any) -> tuple[dynid.Fleet, float]:
            begun = time.monotonic()
            fleet = dynid.identify_fleet(folder / "fleet.yaml", folder / out, **choices)
            wall = time.monotonic() - begun
            cpu = sum(job.seconds for job in fleet.done)
            peak = max((job.peak_memory for job in fleet.done), default=0.0)
            row = [what, len(fleet.done), len(fleet.failures), f"{cpu:.1f}", f"{wall:.1f}", f"{peak:.0f}"]
            print(f"| {' | '.join(map(str, row))} |", flush=True)
            return fleet, wall

        threading.Thread(target=kill_a_worker, args=(2.0,), daemon=True).start()
        killed, wall_of_two = call("two workers, one killed", "two", workers=2)
        double, _ = call("the same again", "two", workers=2)
        single, wall_of_one = call("one worker", "one", workers=1)
        started = cluster()
        address = f"tcp://127.0.0.1:{PORT}"

        def killed_half_way(step: object) -> None:
            done, percent, _ = str(step).partition(" %")
            if percent and int(done) >= 50:
                started[0].kill()

        try:
            call("Dask, scheduler killed", "dask", scheduler=address, progress=killed_half_way)
        except DynidError as error:
            print(f"| Dask, scheduler killed | – | {error} | – | – | – |", flush=True)
        for process in started:
            process.kill()
        started = cluster()
        call("the same again", "dask", scheduler=address)
        for process in started:
            process.kill()
        cpu = [sum(job.seconds for job in fleet.done) for fleet in (single, double)]
        written = sum(path.stat().st_size for path in (folder / "one").rglob("*") if path.is_file())
        same = results(folder / "one") == results(folder / "two") == results(folder / "dask")
        job, outcome = read_fleet(folder / "fleet.yaml")[-1], single.done[-1]
        efficiency = len(killed.done) / wall_of_two / 2 * wall_of_one / count
        print(f"\nresults are the same: {'yes' if same else 'no'}")
        print(f"results per second of two workers over twice those of one: {100 * efficiency:.0f} %")
        print(f"CPU time of one worker over that of two: {100 * cpu[0] / cpu[1]:.0f} %")
        print(f"per result {cpu[0] / count:.2f} CPU s, per hour of recording {cpu[0] / hours:.0f} CPU s")
        print(f"per result {size / count / 1e3:.0f} kB read, {written / count / 1e3:.0f} kB written")
        sent, returned = len(pickle.dumps(job)), len(pickle.dumps(outcome))
        print(f"through the scheduler: {sent} bytes per job and {returned} per outcome")


if __name__ == "__main__":
    main()
