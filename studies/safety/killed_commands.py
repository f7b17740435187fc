"""What does `kill -9` leave of a command's files? `python -m studies.safety.killed_commands 50`: about ten minutes.

Kills `dynid import`, `identify`, `merge` and `recover` so many times each: half of the moments spread over a whole run,
half over its last quarter, in which files are written; every other one with --force over older files. Every file found
then must be the old one to the byte, or one that reads as the new one; what else lies there must say by its name that
it is unfinished. Prints, per command, what was found.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

import dynid
from daq.output_files import unfinished_files
from daq.recording.reader import read_recording
from dynid import command
from ident.result.result_file import read_result

BAD = ("LOST", "HALF", "MIXED", "STRANGE")
HALF_WRITTEN = """
import os, signal, sys
from pathlib import Path
from daq.recording.reader import read_recording
from daq.recording.writer import RecordingWriter
from drivers.streams import ChannelLayout, StreamLayout
run = read_recording(sys.argv[1])
joints = run.streams["joints"]
channels = tuple(ChannelLayout(c.quantity, c.columns, c.unit, c.description) for c in joints.channels.values())
writer = RecordingWriter(Path(sys.argv[2]), run.robot(), [StreamLayout("joints", channels, 500.0)])
writer.allow_readers()
writer.append("joints", joints.time, joints.host_time, {name: c.values for name, c in joints.channels.items()})
writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


@dataclass(frozen=True)
class Case:
    """A command: its arguments, what it writes (files, of which several are in one folder), and older ones of these."""

    name: str
    arguments: tuple[str, ...]
    out: str
    files: tuple[str, ...]
    older: Path


def is_new(file: Path, samples: int) -> bool:
    """Whether a file reads as what the command writes."""
    if file.suffix == ".h5":
        return len(read_recording(file).streams["joints"].time) == samples
    if file.suffix == ".json":
        return len(read_result(file).base_parameters) > 0
    return file.read_text().rstrip().endswith("</html>")


def run_here(*arguments: str) -> None:
    """Run a command to its end in this process."""
    sys.argv = ["dynid", *arguments]
    with suppress(SystemExit), redirect_stdout(StringIO()):
        command.main()


def killed_at(moment: float, arguments: Sequence[str], told: Path) -> int:
    """Exit status of a command in a process group of its own, which is killed at a moment [s] unless it has ended.

    A fork, so that no moment falls into the import of libraries.
    """
    process = os.fork()
    if process == 0:
        os.setpgid(0, 0)
        descriptor = os.open(told, os.O_WRONLY | os.O_CREAT)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.argv = ["dynid", *arguments]
        status = 70
        try:
            command.main()
            status = 0
        except SystemExit as left:
            status = int(left.code or 0)
        finally:
            os._exit(status)
    end = time.monotonic() + moment
    while time.monotonic() < end:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process, signal.SIGKILL)
    os.kill(process, signal.SIGKILL)  # it may not have its group yet
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def kill_one(case: Case, folder: Path, moment: float, samples: int, *, over: bool) -> str:
    """Run a command in a new folder and kill it at a moment [s]; what was found then."""
    folder.mkdir()
    paths = [folder / case.out / name if name else folder / case.out for name in case.files]
    before = {}
    if over:
        for path, name in zip(paths, case.files, strict=True):
            path.parent.mkdir(exist_ok=True)
            path.write_bytes((case.older / name if name else case.older).read_bytes())
            before[path] = path.read_bytes()
    arguments = [*case.arguments, "-o", str(folder / case.out), *(["--force"] if over else [])]
    status = killed_at(moment, arguments, folder.with_name(f"{folder.name}.txt"))
    if status not in (0, -signal.SIGKILL):
        raise RuntimeError(f"{case.name}: exit status {status}: {folder.with_name(f'{folder.name}.txt').read_text()}")
    kinds = []
    for path in paths:
        if not path.exists():
            kinds.append("LOST" if over else "none")
        elif path.read_bytes() == before.get(path):
            kinds.append("old")
        else:
            kinds.append("new" if is_new(path, samples) else "HALF")
    known = {*paths, *(path.parent for path in paths)}
    known |= {file for path in {*paths, folder / case.out} for file in unfinished_files(path)}
    inside = {file for other in unfinished_files(folder / case.out) if other.is_dir() for file in other.iterdir()}
    strange = [path for path in folder.rglob("*") if path not in known | inside]
    left = sum(len(unfinished_files(path)) for path in {*paths, folder / case.out})
    mixed = " MIXED" if len(set(kinds)) > 1 else ""
    ended = "ended before" if status == 0 else "killed"
    beside = ", unfinished beside" if left else ""
    return f"{ended}, {'over old' if over else 'new'}: {'+'.join(kinds)}{mixed}{beside}{', STRANGE' if strange else ''}"


def prepare(folder: Path) -> tuple[list[Case], int]:
    """The inputs; the commands, and the samples of the recordings that they write."""
    run = dynid.simulate("ur5e", duration=10.0, seed=1)
    other = dynid.simulate("ur5e", duration=10.0, seed=2)
    dynid.write_recording(folder / "run.h5", run)
    dynid.write_recording(folder / "other.h5", other)
    dynid.write_recording(folder / "older.h5", dynid.simulate("ur5e", duration=4.0, seed=3))
    joints = run.streams["joints"]
    names = [name for name in ("position", "current") if name in joints.channels]
    short = {"position": "q", "current": "current"}
    header = ["t", *(f"{short[name]}{joint}" for name in names for joint in range(1, 7))]
    rows = np.column_stack([joints.time, *(joints.channels[name].values for name in names)])
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=",".join(header), comments="")
    for name in ("run", "other"):
        run_here("identify", f"{folder}/{name}.h5", "-o", f"{folder}/{name}")
    subprocess.run([sys.executable, "-c", HALF_WRITTEN, folder / "run.h5", folder / "killed.h5"])
    pair = ("result.json", "report.html")
    recording = ("",)
    return [
        Case("import", ("import", f"{folder}/run.csv", "--robot", "ur5e"), "out.h5", recording, folder / "older.h5"),
        Case("recover", ("recover", f"{folder}/killed.h5"), "out.h5", recording, folder / "older.h5"),
        Case("merge", ("merge", f"{folder}/run", f"{folder}/other"), "model", pair, folder / "other"),
        Case("identify", ("identify", f"{folder}/run.h5"), "model", pair, folder / "other"),
    ], len(joints.time)


def main(kills: int, names: Sequence[str]) -> None:
    """Kill the commands of these names, or all, and print."""
    moments = random.Random(1)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        cases, samples = prepare(folder)
        for case in cases:
            if names and case.name not in names:
                continue
            run_here(*case.arguments, "-o", str(folder / f"{case.name}-first"))  # libraries are imported within it
            duration = 0.0
            found: Counter[str] = Counter()
            killed = runs = 0
            while killed < kills:
                # The first run goes to its end; later ones show how long one takes by now.
                share = moments.uniform(0.0, 1.0) if killed % 4 < 2 else moments.uniform(0.75, 1.0)
                moment = share * duration if runs else 600.0
                begun = time.monotonic()
                what = kill_one(case, folder / f"{case.name}-{runs}", moment, samples, over=killed % 2 == 1)
                if what.startswith("killed"):
                    killed += 1
                else:
                    took = time.monotonic() - begun
                    duration = 0.5 * (duration + took) if runs else took
                runs += 1
                found[what] += 1
            bad = sum(count for what, count in found.items() if any(word in what for word in BAD))
            print(f"{case.name}: {duration:.1f} s; {killed} kills in {runs} runs, {bad} bad")
            for what, count in sorted(found.items()):
                print(f"    {count:>4}  {what}", flush=True)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(int(arguments[0]) if arguments else 50, arguments[1:])
