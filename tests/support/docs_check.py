"""`make docs-check`: commands of the docs that meet a running arm, or take long, each in a process, on simulated arms.

What runs in one process within seconds is in test_docs_commands.py.
"""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from daq.commands.options import BUILTIN_FOLDER

DYNID = str(Path(sys.executable).with_name("dynid"))

CHANGED = (
    ("--host 192.168.0.10", ""),  # the simulated controller is on this computer
    ("/tmp/so101", "FOLDER/so101"),
    ("--speed-scale 0.5", "--speed-scale 0.9"),
    ("--duration 600", "--duration 3"),
    ("--duration 60", "--duration 3"),
    ("--duration 10", "--duration 3"),
    ("--length 60", "--length 15"),
    ("excite so101 --for servo -o", "excite so101 --for servo --length 15 -o"),
    ("excite ur5e", "excite ur5e --time 1 --period 4"),
    ("excite ur10e", "excite ur10e --time 1 --period 4"),
    ("excite moteus_rig", "excite moteus_rig --time 1 --period 4"),
    ("--solver sfla", "--solver sfla --time 1"),
    ("excite arm.yaml --for gravity", "excite arm.yaml --for gravity --poses 4"),
    ("sweep arm.yaml", "sweep arm.yaml --joints wrist_3_joint --speeds 2 --stroke 0.2 --slowest 0.4"),
    ("sweep ur5e", "sweep ur5e --joints wrist_3_joint --speeds 2 --stroke 0.2 --slowest 0.4"),
    ("--trajectory", "--yes --trajectory"),  # who watches the arm
)
"""What is put in place of a part of a command: addresses, and shorter searches and motions."""

READY = 60.0
"""Longest wait [s] for a simulated arm, or for a command that runs until Ctrl-C to have begun."""

SAMPLES = 200_000
"""Bytes of a recording that holds some seconds of samples."""

LONGEST = 300.0
"""Longest duration [s] of a command."""

BUSY = "end other programs"
"""What a recording says that a busy computer has spoilt: it has run, and ends with status 1."""

UNTIL_STOPPED = ("dynid monitor ur5e --model model", "dynid sim ")


@dataclass(frozen=True)
class Session:
    """Commands as they stand in the docs, one after the other in one folder."""

    commands: tuple[str, ...]
    before: Callable[[], object] = lambda: None  # makes the files that the first one presupposes
    arm: str = ""  # robot that is served meanwhile, where no command serves one


def arm_file(name: str) -> None:
    """A user's robot file: the built-in UR5e, with the poses that the docs name."""
    text = (BUILTIN_FOLDER / "ur5e.yaml").read_text(encoding="utf-8")
    more = "stretched: [0, -0.8, 0.3, -1.6, 0, 0], bent: [0, -1.6, 1.4, -1.4, 0, 0]}"
    Path(name).write_text(text.replace("-pi/2, 0, 0]}", f"-pi/2, 0, 0], {more}"), encoding="utf-8")


def killed_recording() -> None:
    """The file of a recording that was killed."""
    with subprocess.Popen([DYNID, "sim", "ur5e", "--json"], stdout=subprocess.PIPE, text=True) as arm:
        ready(arm)
        with subprocess.Popen([DYNID, "record", "ur5e", "--duration", "60", "-o", "run.h5", "--no-ui"]) as recorder:
            wait_for(lambda: any(file.stat().st_size > SAMPLES for file in Path().glob("run.unfinished*")))
            recorder.kill()
        arm.send_signal(signal.SIGINT)


def servo_recordings() -> None:
    """Two recordings of a servo arm."""
    designed = "excite so101 --for servo --length 15 -o played.yaml"
    for words in (
        designed,
        "sim so101 --play played.yaml -o run.h5",
        "sim so101 --play played.yaml -o other.h5 --seed 2",
    ):
        subprocess.run([DYNID, *words.split()], check=True, capture_output=True)


SESSIONS = (
    Session(
        (
            "dynid sim ur5e",
            "dynid excite ur5e -o traj.yaml --page traj.html",
            "dynid record ur5e --trajectory traj.yaml -o run.h5",
            "dynid identify run.h5 -o model",
            "dynid monitor ur5e --model model",
            "dynid monitor ur5e --model model --trajectory traj.yaml --record watched.h5 --stop-on-contact",
            "dynid record ur5e --host 192.168.0.10 --duration 60 -o run.h5",
            "dynid record my_ur5e.yaml --host 192.168.0.10 --trajectory traj.yaml -o run.h5",
            "dynid record ur5e --duration 600 --browser -o run.h5",
        ),
        lambda: arm_file("my_ur5e.yaml"),
    ),
    Session(("dynid recover run.h5",), killed_recording),
    Session(("dynid sim my_arm.yaml",), lambda: arm_file("my_arm.yaml")),
    Session(
        (
            "dynid sim ur5e --wire canopen",
            "dynid check ur5e --connect --wire canopen",
            "dynid check my_arm.yaml --connect --wire canopen",
            "dynid check my_arm.yaml --connect --wire canopen --reset-faults",
            "dynid record ur5e --wire canopen --duration 10 -o run.h5",
        ),
        lambda: arm_file("my_arm.yaml"),
    ),
    Session(
        (
            "dynid sim moteus_rig",
            "dynid check moteus_rig --connect",
            "dynid excite moteus_rig -o motion.yaml",
            "dynid record moteus_rig --trajectory motion.yaml -o run.h5",
            "dynid identify run.h5 -o model",
        )
    ),
    Session(
        (
            "dynid sim so101 --channel /tmp/so101",
            "dynid check so101 --connect --host /tmp/so101",
            "dynid excite so101 --for servo --length 60 -o motion.yaml",
            "dynid record so101 --host /tmp/so101 --trajectory motion.yaml -o run.h5",
        )
    ),
    Session(
        (
            "dynid excite so101 --for servo -o motion.yaml",
            "dynid identify run.h5 --method servo -o model",
            "dynid identify run.h5 --method servo --validate other.h5 -o model",
            "dynid excite so101 --for servo --after model --wanted 10 -o more.yaml --csv more.csv",
            "dynid export model --mjcf arm.xml --isaaclab arm_cfg.py --usd arm.usda --ranges ranges.json "
            "--replay run.h5",
        ),
        servo_recordings,
    ),
    Session(
        (
            "dynid sweep arm.yaml --pose stretched -o stretched.yaml",
            "dynid sweep arm.yaml --pose bent -o bent.yaml",
            "dynid record arm.yaml --trajectory stretched.yaml -o 1.h5",
            "dynid record arm.yaml --trajectory bent.yaml -o 2.h5",
            "dynid excite arm.yaml --for gravity -o gravity.yaml",
            "dynid record arm.yaml --trajectory gravity.yaml --speed-scale 0.5 -o first.h5",
            "dynid record arm.yaml --trajectory gravity.yaml -o gravity.h5",
        ),
        lambda: arm_file("arm.yaml"),
        arm="arm.yaml",
    ),
    Session(
        (
            "dynid sweep ur5e -o sweep.yaml --page sweep.html",
            "dynid excite up6 --kind sines --harmonics 3 --criterion motion-size --solver sfla -o traj.yaml",
        )
    ),
    Session(
        (
            "dynid excite ur10e --loaded -o traj.yaml --periods 4",
            "dynid record ur10e --trajectory traj.yaml -o free.h5",
            "dynid record ur10e --trajectory traj.yaml -o loaded.h5",
        ),
        arm="ur10e",
    ),
)

COMMANDS = {command for session in SESSIONS for command in session.commands}


def wait_for(happened: Callable[[], bool]) -> None:
    """Wait until something has happened."""
    end = time.monotonic() + READY
    while not happened():
        if time.monotonic() > end:
            raise TimeoutError(f"nothing within {READY:g} s")
        time.sleep(0.05)


def ready(arm: subprocess.Popen[str]) -> None:
    """Wait until a simulated arm says that it is ready."""
    assert arm.stdout is not None
    if not json.loads(arm.stdout.readline() or "{}").get("ready"):
        raise ChildProcessError(f"{shlex.join(map(str, arm.args))} is not ready")


def run(command: str, arms: list[subprocess.Popen[str]]) -> None:
    """Run a command to its end; a simulated arm to the session's, what runs until Ctrl-C for some seconds.

    Raises:
        ChildProcessError: it failed.
    """
    changed = command
    for part, other in CHANGED:
        changed = changed.replace(part, other.replace("FOLDER", os.getcwd()))
    words = [DYNID, *shlex.split(changed)[1:]]
    if command.startswith("dynid sim "):
        arms.append(subprocess.Popen([*words, "--json"], stdout=subprocess.PIPE, text=True))
        ready(arms[-1])
        return
    for option in ("-o", "--record"):  # each session writes some files again
        if option in words and Path(words[words.index(option) + 1]).suffix == ".h5":
            Path(words[words.index(option) + 1]).unlink(missing_ok=True)
    if command.startswith(("dynid identify", "dynid excite")):
        words.append("--force")
    with Path("output.txt").open("w+") as output:
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT)
        try:
            status = process.wait(5.0 if command in UNTIL_STOPPED else LONGEST)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            status = process.wait(READY)
        output.seek(0)
        said = output.read()
    if status == 1 and BUSY in said:
        print(said.splitlines()[-1])
    elif status not in ((0, 130) if command in UNTIL_STOPPED else (0,)):
        raise ChildProcessError(f"{command}: exit status {status}\n{said}")


def main() -> int:
    """Run the sessions, or those with a command that contains a word of the command line; 1 where something failed."""
    chosen = [one for one in SESSIONS if all(word in " ".join(one.commands) for word in sys.argv[1:])]
    if not chosen:
        print(f"no session has a command with {' and '.join(sys.argv[1:])}", file=sys.stderr)
    failed = int(not chosen)
    for session in chosen:
        with TemporaryDirectory() as folder:
            os.chdir(folder)
            arms: list[subprocess.Popen[str]] = []
            try:
                session.before()
                served = (f"dynid sim {session.arm}",) if session.arm else ()
                for command in (*served, *session.commands):
                    start = time.monotonic()
                    run(command, arms)
                    print(f"{time.monotonic() - start:6.1f} s  {command}", flush=True)
            except (OSError, subprocess.SubprocessError) as error:
                failed = 1
                print(f"FAILED: {error}", flush=True)
            finally:
                for arm in arms:
                    arm.send_signal(signal.SIGINT)
                    arm.wait(READY)
                os.chdir("/")
    return failed


if __name__ == "__main__":
    sys.exit(main())
