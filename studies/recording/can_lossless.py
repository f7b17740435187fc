"""Six CiA 402 drives at 400 Hz: which reader gets every frame? Five minutes:

    python -m studies.recording.can_lossless 300

Serves a simulated UR5e's drives over udp_multicast in a separate process. `dynid record` sends SYNC and records; two
more processes listen to the same bus in the usual ways: canopen's callbacks that read every variable with `.raw`, and
python-can's Notifier with one struct.unpack a frame. Prints the TPDOs that each of them saw between the same two
moments, how regular the SYNCs were, and each process's share of a core.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
import yaml

from daq.robot.loader import load_robot
from daq.session.realtime import may_have_realtime
from studies.recording.lossless import cpu_seconds

ROBOT = "ur5e"
SYNC_RATE = 400
NODES = range(1, 7)
TPDOS_A_CYCLE = 2 * len(NODES)
INTERFACE, CHANNEL = "udp_multicast", f"239.76.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
PORT = 20000 + os.getpid() % 30000
"""Port of this run only: python-can's own listeners receive every group of a port."""
MARGIN = 2.0
"""Seconds at both ends of the recording that are not counted."""
LISTEN = """
import json, signal, socket, struct, sys, time
import can
stamps, syncs = [], []
bus = can.Bus(interface="{interface}", channel="{channel}", port={port}, hop_limit=0)
ended = []
signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
{body}
print("ready", flush=True)
while not ended:
    time.sleep(0.1)
json.dump({{"frames": stamps, "syncs": syncs}}, open("{out}", "w"))
"""
NOTIFIER = """
def take(message):
    now = time.monotonic()
    if message.arbitration_id == 0x80:
        syncs.append(now)
    elif 0x181 <= message.arbitration_id <= 0x186:
        struct.unpack_from("<HbI", message.data)
        stamps.append(now)
    elif 0x281 <= message.arbitration_id <= 0x286:
        struct.unpack_from("<ihh", message.data)
        stamps.append(now)
notifier = can.Notifier(bus, [take])
"""
CANOPEN = """
import canopen
network = canopen.Network(bus)
def sync(_id, _data, _stamp):
    syncs.append(time.monotonic())
def take(mapping):
    stamps.append(time.monotonic())
    for variable in mapping:
        variable.raw
for identity in range(1, 7):
    node = network.add_node(identity, "{eds}")
    for number, names in ((1, (0x6041, 0x6061, 0x6064)), (2, (0x606C, 0x6077, 0x6078))):
        mapping = node.tpdo[number]
        mapping.clear()
        for index in names:
            mapping.add_variable(index)
        mapping.cob_id = 0x80 + 0x100 * number + identity
        mapping.enabled = True
        mapping.add_callback(take)
        mapping.subscribe()
network.subscribe(0x80, sync)
network.notifier = can.Notifier(bus, network.listeners, 1)
"""


def own_bus(folder: Path) -> Path:
    """The robot file with its drives on a bus of this run's own."""
    arm = yaml.safe_load(load_robot(ROBOT).text)
    arm["connections"]["canopen"] |= {
        "interface": INTERFACE,
        "channel": CHANNEL,
        "options": {"hop_limit": 0, "port": PORT},
        "sync_rate": SYNC_RATE,
    }
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(arm, sort_keys=False), encoding="utf-8")
    return path


def listener(body: str, out: Path, eds: Path) -> subprocess.Popen[str]:
    """A process that listens in one of the usual ways, ready."""
    names = {"interface": INTERFACE, "channel": CHANNEL, "port": PORT, "out": out, "eds": eds}
    code = LISTEN.format(body=body.replace("{eds}", str(eds)), **names)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def between(stamps: npt.NDArray[np.float64], start: float, end: float) -> int:
    """How many of the stamps lie in a span."""
    return int(np.count_nonzero((stamps >= start) & (stamps < end)))


def measure(seconds: float, folder: Path) -> dict[str, object]:
    """Record and listen for so long [s]; the figures by reader."""
    import sim_drivers

    eds = Path(sim_drivers.__path__[0]) / "canopen" / "dynid_drive.eds"
    dynid = str(Path(sys.executable).with_name("dynid"))
    arm = str(own_bus(folder))
    priority = ["--realtime"] if may_have_realtime() else []
    begun: list[subprocess.Popen[str]] = []
    sim = subprocess.Popen(
        [dynid, "sim", arm, "--wire", "canopen", "--no-ui", *priority],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    begun.append(sim)
    try:
        assert sim.stdout is not None
        if not json.loads(sim.stdout.readline() or "{}").get("ready"):
            raise SystemExit("the simulated drives did not start")
        outs = {"canopen callbacks": folder / "canopen.json", "Notifier + struct": folder / "notifier.json"}
        bodies = {"canopen callbacks": CANOPEN, "Notifier + struct": NOTIFIER}
        listeners = {name: listener(bodies[name], out, eds) for name, out in outs.items()}
        begun += listeners.values()
        ours = folder / "run.h5"
        record = subprocess.Popen(
            [dynid, "record", arm, "--wire", "canopen", "--duration", str(seconds), "-o", str(ours), "--no-ui"]
            + priority,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        begun.append(record)
        time.sleep(5.0)  # imports and configuration are over by then
        watched = {"simulator": sim, "dynid record": record} | listeners
        since, before = time.monotonic(), {name: cpu_seconds(p.pid) for name, p in watched.items()}
        shares: dict[str, float] = {}
        while record.poll() is None:
            time.sleep(0.5)
            if record.poll() is None:
                passed = time.monotonic() - since
                shares = {name: (cpu_seconds(p.pid) - before[name]) / passed for name, p in watched.items()}
        heard = {}
        for name, process in listeners.items():
            process.terminate()
            process.wait(60.0)
            heard[name] = {key: np.array(v) for key, v in json.loads(outs[name].read_text()).items()}
        with h5py.File(ours) as file:
            stamps, received = file["streams/joints/time"][:], file["streams/joints/host_time"][:]
            messages = [entry["message"].decode() for entry in file["events"][:]]
        start, end = received[0] + MARGIN, received[-1] - MARGIN
        inside = (received >= start) & (received < end)
        ticks = np.rint(stamps[inside] * SYNC_RATE).astype(np.int64)
        due = int(ticks[-1] - ticks[0] + 1)
        sent = between(heard["Notifier + struct"]["syncs"], start, end)
        late = [re.match(r"(\d+) SYNC\(s\) not sent", message) for message in messages]
        result: dict[str, object] = {
            "seconds counted": end - start,
            "real-time priority of recorder and simulator": bool(priority),
            "SYNCs due": due,
            "SYNCs seen": sent,
            "SYNCs not sent in the whole recording, the computer being late": sum(int(m[1]) for m in late if m),
            "TPDOs that the SYNCs seen ask for": sent * TPDOS_A_CYCLE,
            "dynid record": {"rows": len(ticks), "missing": sent - len(ticks), "exit_status": record.returncode},
        }
        for name, stamps in heard.items():
            frames = between(stamps["frames"], start, end)
            result[name] = {"TPDOs": frames, "missing": sent * TPDOS_A_CYCLE - frames}
        gaps = 1e3 * np.diff(heard["Notifier + struct"]["syncs"])
        result["SYNC interval at a listener [ms]"] = {
            "median": float(np.median(gaps)),
            "std": float(np.std(gaps)),
            "99 %": float(np.percentile(gaps, 99.0)),
            "longest": float(gaps.max()),
        }
        return result | {"share of a core": {name: round(share, 3) for name, share in shares.items()}}
    finally:
        for process in reversed(begun):
            if process.poll() is None:
                process.terminate()
                process.wait(20.0)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(json.dumps(measure(float(sys.argv[1]) if len(sys.argv) > 1 else 300.0, Path(name)), indent=2))
