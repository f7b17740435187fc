"""`dynid record` in a process of its own, with the driver `kinematic` of an arm that is not there."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

LIMIT = 60.0
"""How long [s] something that must happen in another process may take, however busy the computer is."""
SUPPORT = Path(__file__).parent
ROOT = SUPPORT.parents[1]
IN_SIMULATED_TIME = """
import resource
import drivers.core.clock
from kinematic_arm import KinematicArm
from simulated_clock import SimulatedClock
drivers.core.clock.SYSTEM_CLOCK = SimulatedClock()
arm = KinematicArm(rate=2000.0, clock=drivers.core.clock.SYSTEM_CLOCK)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
"""
IN_REAL_TIME = """
from pathlib import Path
from kinematic_arm import KinematicArm

class Arm(KinematicArm):
    def read(self, timeout):
        Path("begun").touch()
        return super().read(timeout)

arm = Arm()
"""
MAIN = """
import sys
from types import SimpleNamespace
from drivers import declaration
from dynid import command
entry = SimpleNamespace(name="kinematic", load=lambda: declaration.DriverDeclaration(lambda settings: arm))
declaration.entry_points = lambda group: [entry]
try:
    command.main()
finally:
    with open("arm.txt", "w") as told:
        print(len(arm.commands) > 0, arm.stopped_at is not None, arm.commands_after_stop, file=told)
"""


def in_a_process(code, folder, *arguments):
    """`dynid record` with the driver `kinematic` in a process of its own; `code` runs first and has `arm` to set."""
    return subprocess.Popen(
        [sys.executable, "-c", code + MAIN, "record", "robot.yaml", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)])},
    )


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    """Wait until something is true while a process runs."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
