"""One simulated arm, three buses: the same model? `python -m studies.recording.three_wires` takes some minutes.

Designs a motion of 10 s that uses about a third of every velocity and acceleration limit, and serves a UR5e three
times: with RTDE, as CiA 402 drives on CANopen, and with proprietary CAN frames. `dynid record` plays the same motion on
each, `dynid identify` identifies each recording by itself. Prints, for each pair of wires, how far the base parameters
are apart in combined standard deviations: the share within 1.96, the largest; and the same of each wire against the
true values.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.robot.loader import load_robot
from daq.session.realtime import may_have_realtime
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.result.result_file import read_result
from ident.result.schema import BaseParameterResult

WIRES = ("rtde", "canopen", "can")
SYNC_RATE = 250
"""SYNC rate of the drives on CANopen [Hz]."""
SHARES = {"velocity": 0.35, "acceleration": 0.35, "torque": 0.5}
"""Shares of the limits that the motion may use; the rest is for commands that a busy computer sends late."""
REALTIME = ["--realtime"] if may_have_realtime() else []
"""Option of both ends where the system allows it."""
WITHIN = 1.96
ATTEMPTS = 5
"""At a recording; a busy computer that stalls for 50 ms ends a motion. Errors of all are printed."""
DYNID = str(Path(sys.executable).with_name("dynid"))
HOST = f"127.74.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
"""Loopback address of this process for RTDE."""
GROUP = f"239.74.{os.getpid() // 250 % 250 + 1}.{os.getpid() % 250 + 1}"
"""Multicast group of this process, so that arms of other programs are not received."""


def three_wire_arm(folder: Path) -> Path:
    """A UR5e with the AUBO i5's table of CAN frames beside its own connections; the robot file."""
    arm = yaml.safe_load(load_robot("ur5e").text)
    other = yaml.safe_load(load_robot("aubo_i5").text)
    names = {theirs["name"]: ours["name"] for theirs, ours in zip(other["joints"], arm["joints"], strict=True)}
    connections = arm["connections"]
    connections["can"] = renamed(other["connections"]["can"], names)
    for wire in ("canopen", "can"):
        connections[wire]["channel"] = GROUP
    connections["canopen"]["sync_rate"] = SYNC_RATE
    connections["rtde"]["host"] = HOST
    path = folder / "three_wires.yaml"
    path.write_text(yaml.safe_dump(arm, sort_keys=False), encoding="utf-8")
    return path


def renamed(content: Any, names: Mapping[str, str]) -> Any:
    """The same content with other names of joints."""
    if isinstance(content, dict):
        return {key: renamed(value, names) for key, value in content.items()}
    if isinstance(content, list):
        return [renamed(value, names) for value in content]
    return names.get(content, content) if isinstance(content, str) else content


def gentle(arm: Path) -> Path:
    """The same arm with a share of its limits, for the design of the motion; the robot file."""
    content = yaml.safe_load(arm.read_text(encoding="utf-8"))
    for joint in content["joints"]:
        joint |= {key: share * joint[key] for key, share in SHARES.items()}
    path = arm.with_name("gentle.yaml")
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def dynid(*arguments: object, left: int = 0) -> bool:
    """Run a command of dynid; whether it succeeded. An error ends the example where no attempts are `left`."""
    done = subprocess.run([DYNID, *map(str, arguments)], stdout=subprocess.DEVNULL)
    if done.returncode and not left:
        raise SystemExit(f"dynid {arguments[0]} ended with exit status {done.returncode}")
    return done.returncode == 0


def record(arm: Path, wire: str, motion: Path, out: Path) -> None:
    """Serve the arm on a bus and play the motion there."""
    sim = subprocess.Popen(
        [DYNID, "sim", str(arm), "--wire", wire, "--host", HOST, "--no-ui", *REALTIME],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert sim.stdout is not None
        if not json.loads(sim.stdout.readline() or "{}").get("ready"):
            raise SystemExit(f"the arm on {wire} was not served")
        for left in reversed(range(ATTEMPTS)):
            done = dynid(
                "record",
                arm,
                "--wire",
                wire,
                "--trajectory",
                motion,
                "-o",
                out,
                "--yes",
                "--no-ui",
                *REALTIME,
                "--force",
                left=left,
            )
            if done:
                return
    finally:
        sim.terminate()
        sim.wait(20.0)


def identified(arm: Path, recording: Path, out: Path) -> dict[str, BaseParameterResult]:
    """The base parameters of a recording, by name."""
    dynid("identify", recording, "--robot", arm, "-o", out, "--force")
    result = read_result(out / "result.json")
    print(
        f"  {recording.stem:8} {result.recordings[0].rate_hz:6.1f} Hz, {result.recordings[0].samples} samples", end=""
    )
    assert result.validation is not None
    print(f", held-out relative error {result.validation.relative_error:.4f}", flush=True)
    return {parameter.name: parameter for parameter in result.base_parameters if parameter.std is not None}


def compare(label: str, deviations: list[tuple[float, str]]) -> None:
    """Print how many deviations [combined standard deviations] lie within, and the largest."""
    within = sum(abs(deviation) <= WITHIN for deviation, _ in deviations)
    worst, name = max(deviations, key=lambda pair: abs(pair[0]))
    rms = float(np.sqrt(np.mean([deviation**2 for deviation, _ in deviations])))
    share = within / len(deviations)
    print(f"  {label:18} {within} of {len(deviations)} within {WITHIN} ({share:.0%}), rms {rms:.2f}, ", end="")
    print(f"largest {abs(worst):.2f} ({name})")


def apart(first: BaseParameterResult, second: BaseParameterResult) -> float:
    """The difference of two estimates over its standard deviation."""
    values = (first.value, second.value, first.std, second.std)
    a, b, std_a, std_b = (float("nan") if value is None else value for value in values)
    return (a - b) / float(np.hypot(std_a, std_b))


def main(periods: int = 2) -> None:
    """Record and identify on each bus, and compare."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arm, motion = three_wire_arm(folder), folder / "motion.yaml"
        dynid("excite", gentle(arm), "-o", motion, "--period", 10, "--periods", periods, "--starts", 1)
        models = {}
        for wire in WIRES:
            record(arm, wire, motion, folder / f"{wire}.h5")
            models[wire] = identified(arm, folder / f"{wire}.h5", folder / wire)
        robot_file = load_robot(str(arm))
        base = base_parameters(build_model(robot_file))
        truth = dict(zip(base.names, base.projection @ truth_vector(robot_file), strict=True))
    print("apart, in combined standard deviations:")
    for one, two in itertools.combinations(WIRES, 2):
        both = sorted(models[one].keys() & models[two].keys())
        compare(f"{one} - {two}", [(apart(models[one][key], models[two][key]), key) for key in both])
    for wire in WIRES:
        known = [(p.value - truth[key], p.std, key) for key, p in models[wire].items() if p.value is not None and p.std]
        compare(f"{wire} - truth", [(error / std, key) for error, std, key in known])


if __name__ == "__main__":
    main()
