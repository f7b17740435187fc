"""The first hour of three newcomers: a lab with a UR, a person with a table of numbers, an integrator with CANopen.

    python -m studies.recording.first_hour lab|table|canopen [--bin FOLDER] [--realtime]

Types the commands of README and docs, and the mistakes that people make on the way, and prints each command, its lines
(as a pipe gets them) and its seconds. FOLDER has the programs `dynid` and `python` of an environment; that of this
Python where absent. The arms are simulated. --realtime asks for real-time priority, on a busy computer.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

LAB = (
    "dynid",
    "dynid excite ur5 -o traj.yaml",
    "dynid record ur5e --trajectory traj.yaml -o run.h5",
    "dynid excite ur5e -o traj.yaml --page traj.html",
    "dynid record ur5e --trajectory traj.yaml -o run.h5",
    "dynid record ur5e --trajectory traj.yaml -o run.h5 --yes",
    "dynid record ur10e --duration 2 -o other.h5",
    "dynid info run.h5",
    "dynid identify run.h5",
    "dynid identify run.h5 -o model",
    "dynid export model --urdf ur5e.urdf --c ur5e",
)
CANOPEN = (
    "dynid robot new --joints 6 -o my_arm.yaml",
    "dynid check my_arm.yaml",
    "dynid check ur5e --connect --wire canopen",
    "dynid record ur5e --wire canopen --duration 6 -o rest.h5",
    "dynid identify rest.h5 -o model",
    "dynid excite ur5e -o traj.yaml",
    "dynid record ur5e --wire canopen --trajectory traj.yaml -o run.h5 --yes",
    "dynid info run.h5",
    "dynid identify run.h5 -o model",
    "dynid export model --c ur5e",
)
TABLE = (
    "dynid identify log.csv",
    "dynid import log.csv --robot ur5e -o run.h5",
    "dynid import log.csv --robot ur5e -o run.h5 --column q=joint{}",
    "dynid import log.csv --robot ur5e -o run.h5 --column q=joint{} --degrees --time-unit ms",
    "dynid info run.h5",
    "dynid identify run.h5 -o model",
)
LOG = """
import dynid
import numpy as np
run = dynid.simulate("ur5e", duration=60.0, seed=3)
table = np.column_stack([1e3 * run.time, np.degrees(run.position), run.current])
names = ["time", *(f"joint{n}" for n in range(1, 7)), *(f"current{n}" for n in range(1, 7))]
np.savetxt("log.csv", table, delimiter=",", fmt="%.6f", header=",".join(names), comments="")
"""
PYTHON = """
import dynid, pandas as pd
df = pd.read_csv("log.csv")
dynid.identify(df)
run = dynid.Recording.from_dataframe("ur5e", df)
run = dynid.Recording.from_dataframe("ur5e", df, columns={"q": "joint{}"}, degrees=True)
run = dynid.Recording.from_dataframe("ur5e", df, columns={"q": "joint{}"}, degrees=True, time_unit="ms")
run
run.velocity
result = dynid.identify(run, metod="wls")
result = dynid.identify(run)
result.verdict.headline
result.score(run)
result.friction
result.save("python-model")
result.save("python-model")
model = dynid.load_model("python-model")
model
model.torque([0.0] * 5)
model.gravity([0.0] * 6).round(1)
model.torque(run.position[:3], [0.0] * 6).shape
model.friction_curve().write_html("friction.html")
"""
"""What is typed at Python's prompt, a statement per line."""


def main(words: Sequence[str]) -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("who", choices=("lab", "table", "canopen"))
    options.add_argument("--bin", type=Path, default=Path(sys.executable).parent)
    options.add_argument("--realtime", action="store_true")
    given = options.parse_args(words)
    programs = given.bin.absolute()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        shell = _Shell(Path(folder), programs, realtime=given.realtime)
        version = shell.answer([str(programs / "python"), "-c", "import sys; print(sys.version.split()[0])"])
        print(f"Python {version.strip()}, {shell.answer(['dynid', '--version']).strip()}")
        if given.who == "table":
            shell.answer([str(programs / "python"), "-c", LOG])
            shell.type_all(TABLE)
            shell.at_the_prompt(PYTHON.strip().splitlines())
        else:
            wire = ["--wire", "canopen"] if given.who == "canopen" else []
            with shell.serving(["dynid", "sim", "ur5e", *wire]):
                shell.type_all(LAB if given.who == "lab" else CANOPEN)
    print(f"\nall of it: {(time.monotonic() - begun) / 60:.0f} minutes")


class _Shell:
    """Runs commands in a folder, and prints them with what they print."""

    def __init__(self, folder: Path, programs: Path, *, realtime: bool) -> None:
        self._folder = folder
        self._realtime = ["--realtime"] if realtime else []
        path = f"{programs}{os.pathsep}{os.environ['PATH']}"
        self._environment = {**os.environ, "PATH": path, "COLUMNS": "110", "NO_COLOR": "1"}

    def type_all(self, lines: Sequence[str]) -> None:
        for line in lines:
            words = line.split()
            print(f"\n$ {line}", flush=True)
            begun = time.monotonic()
            printed = self.answer([*words, *(self._realtime if "record" in words else [])])
            print(f"{_legible(printed)}[{time.monotonic() - begun:.0f} s]", flush=True)

    def answer(self, words: Sequence[str]) -> str:
        done = subprocess.run(
            words,
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return done.stdout

    def at_the_prompt(self, lines: Sequence[str]) -> None:
        """Return what `python -i` would show: values, and the last line of an error."""
        program = (
            "import sys, time, traceback\n"
            "for line in sys.argv[1:]:\n"
            "    print('\\n>>> ' + line, flush=True)\n"
            "    begun = time.monotonic()\n"
            "    try:\n"
            "        exec(compile(line, 'prompt', 'single'))\n"
            "    except Exception as error:\n"
            "        print(traceback.format_exception_only(error)[-1].strip())\n"
            "    if time.monotonic() - begun > 2:\n"
            "        print(f'[{time.monotonic() - begun:.0f} s]')\n"
        )
        print(_legible(self.answer(["python", "-c", program, *lines])), end="")

    @contextmanager
    def serving(self, words: Sequence[str]) -> Iterator[None]:
        """A simulated arm beside the commands."""
        print(f"\n$ {' '.join(words)} &")
        with subprocess.Popen(
            [*words, *self._realtime],
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as arm:
            assert arm.stdout is not None
            print(re.sub(r'"pid": \d+, ', "", arm.stdout.readline()), end="", flush=True)
            try:
                yield
            finally:
                arm.send_signal(signal.SIGTERM)


def _legible(text: str) -> str:
    """What was printed, without the spaces that fill tables up."""
    return "".join(f"{line.rstrip()}\n" for line in text.splitlines())


if __name__ == "__main__":
    main(sys.argv[1:])
