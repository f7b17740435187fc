"""`dynid demo` as a command in its own process, which starts `dynid record` in another: locks, real RTDE, files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from rtde_bench import ENVIRONMENT, LIMIT

from daq.recording.reader import read_recording
from daq.robot.loader import load_robot

QUICK = """
import functools, shutil, sys
import sim_drivers.rtde.demo as demo
from dynid.command import main
from ident.excite.search.search import SearchChoices

demo.RAMP = 0.5
search = SearchChoices(starts=None, time=1e-3, workers=1)
designed = functools.cache(lambda: design(*arguments, search))
design, recorded, arguments, taken = demo.design, demo._recorded, [], []

def quick(robot, prior, choices, search, progress):
    arguments[:] = arguments or [robot, prior, choices]
    return designed()

def once(served, trajectory, out, progress):
    if taken:
        shutil.copy(taken[1], out)
    else:
        taken[:] = [recorded(served, trajectory, out, progress), out]
    return taken[0]

def recorded_all(*_, **__):
    print(taken[0].samples, taken[0].lost)
    sys.exit(0)

demo.design, demo._recorded, demo.identify = quick, once, recorded_all
sys.exit(main())
"""
"""The command: its first feasible motion in place of a search, recorded once, and no identification."""


@pytest.mark.realtime
def test_the_demonstration_as_a_command_records_through_another_process(tmp_path: Path) -> None:
    robot = yaml.safe_load(load_robot("ur5e").text)
    robot["connections"] = {"rtde": {"driver": "rtde", "host": "127.0.0.1", "rate": 100, "timeout": 60}}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(robot, sort_keys=False))
    arguments = ["demo", "--robot", str(tmp_path / "arm.yaml"), "--duration", "2", "--out", str(tmp_path / "demo")]
    done = subprocess.run(
        [sys.executable, "-c", QUICK, *arguments], capture_output=True, text=True, env=ENVIRONMENT, timeout=3 * LIMIT
    )
    assert done.returncode == 0, done.stderr
    recording = read_recording(tmp_path / "demo" / "identification.h5")
    assert recording.complete
    assert done.stdout.split()[-2:] == [str(len(recording.streams["joints"].time)), "0"]
