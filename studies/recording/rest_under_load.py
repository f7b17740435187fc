"""What is lost at rest beside two busy processes? A minute and a half:

    python -m studies.recording.rest_under_load 10 3

Serves a simulated UR5e, once as six CiA 402 drives at 400 Hz over udp_multicast and once over RTDE at 500 Hz, and
records it for so many seconds without a motion, so many times, while two processes compute. Prints rows and losses.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from daq.robot.loader import load_robot

BUSY = 2
DYNID = str(Path(sys.executable).with_name("dynid"))
HOST = f"127.77.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
GROUP = f"239.77.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
"""Addresses of this process alone."""


def measure(wire: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Rows, losses and exit status of one recording."""
    robot = folder / "ur5e.yaml"
    robot.write_text(load_robot("ur5e").text.replace("239.74.163.2", GROUP))
    out = folder / "run.h5"
    simulator = subprocess.Popen(
        [DYNID, "sim", str(robot), "--wire", wire, "--host", HOST, "--json"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    )
    busy: list[subprocess.Popen[bytes]] = []
    try:
        if simulator.stdout is None or not simulator.stdout.readline():
            raise SystemExit("the simulated arm did not start")
        busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
        address = ["--host", HOST] if wire == "rtde" else []
        arguments = ["--wire", wire, *address, "--duration", str(seconds), "-o", str(out), "--force", "--json"]
        done = subprocess.run([DYNID, "record", str(robot), *arguments], capture_output=True, text=True, check=False)
    finally:
        processes: list[subprocess.Popen[Any]] = [*busy, simulator]
        for process in processes:
            process.terminate()
            process.wait(20.0)
    report = json.loads(done.stdout)
    joints = report.get("streams", {}).get("joints", {})
    return {
        "wire": wire,
        "exit_status": done.returncode,
        "samples": joints.get("samples"),
        "lost": joints.get("lost"),
        "said": report.get("heavy_loss") or report.get("stopped_by") or report.get("error"),
        "load": os.getloadavg()[0],
    }


if __name__ == "__main__":
    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    with tempfile.TemporaryDirectory() as scratch:
        for _ in range(int(sys.argv[2]) if len(sys.argv) > 2 else 3):
            for bus in ("canopen", "rtde"):
                print(json.dumps(measure(bus, duration, Path(scratch))), flush=True)
