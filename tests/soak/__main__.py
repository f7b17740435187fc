"""`python tests/soak SECONDS [SEED]`: damaged files against the commands, hostile streams against the drivers.

For four fifths of the time, files of every kind that a command reads are damaged and given to the commands, each in a
process of limited time and memory; for the rest, the property tests of the drivers' decoders run with ever new seeds.
What no command may do (a crash, a hang, a traceback, another exit status, an output left behind, more than 20 s or
2 GB) is a found case: its file is written to tests/soak/found/ with what it did and the seed that makes it again.
Prints the counts as JSON; exit status 1 where something was found.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from fuzzing.judged_run import Outcome, load_all_modules, run_command  # noqa: E402  # after the paths
from fuzzing.mutations import damaged  # noqa: E402
from fuzzing.seed_files import COMMANDS, make_seeds  # noqa: E402

FOUND = HERE / "found"
SHARE_OF_FILES = 0.8
STREAM_TESTS = (
    "tests/drivers/can_signals/test_hostile_frames.py",
    "tests/drivers/canopen402/test_hostile_frames.py",
    "tests/drivers/rtde/test_wire.py",
    "tests/drivers/serial_thermometer/test_lines.py",
    "tests/drivers/can_signals/rows/test_assembly.py",
    "tests/sim_drivers/can/test_slcan_adapter.py",
)


def main() -> int:
    """Run both; the exit status."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(10**9)
    FOUND.mkdir(exist_ok=True)
    files = fuzz_files(SHARE_OF_FILES * seconds, seed)
    streams = fuzz_streams((1.0 - SHARE_OF_FILES) * seconds, seed)
    print(json.dumps({"seed": seed, "files": files, "streams": streams}, indent=1))
    return 1 if files["found"] or streams["failed"] else 0


def fuzz_files(seconds: float, seed: int) -> Mapping[str, object]:
    """Damage files and run the commands on them until the time is up; the counts."""
    load_all_modules()
    commands: Counter[str] = Counter()
    statuses: dict[str, Counter[int]] = {}
    worst = {"seconds": 0.0, "memory_gb": 0.0}
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        sound = Path(folder, "sound")
        sound.mkdir()
        seeds = make_seeds(sound)
        kinds = sorted(seeds.kinds)
        end = time.monotonic() + seconds
        number = 0
        while time.monotonic() < end:
            number += 1
            rng = random.Random(f"{seed} {number}")
            kind = kinds[number % len(kinds)]
            file = rng.choice(seeds.kinds[kind])
            content = damaged(sound / file, kind, rng)
            for arguments in COMMANDS[kind](file):
                work = Path(folder, "work")
                shutil.copytree(sound, work)
                (work / file).write_bytes(content)
                outcome = run_command(arguments, work)
                shutil.rmtree(work)
                commands[kind] += 1
                statuses.setdefault(kind, Counter())[outcome.status] += 1
                worst["seconds"] = max(worst["seconds"], round(outcome.seconds, 2))
                worst["memory_gb"] = max(worst["memory_gb"], round(outcome.memory / 1e9, 3))
                if outcome.problems:
                    found += 1
                    _keep(f"{seed}-{number}-{arguments[0]}", file, content, arguments, outcome)
    return {
        "files": number,
        "commands": dict(sorted(commands.items())),
        "exit_statuses": {kind: dict(sorted(counts.items())) for kind, counts in sorted(statuses.items())},
        "worst": worst,
        "found": found,
    }


def _keep(name: str, file: str, content: bytes, arguments: list[str], outcome: Outcome) -> None:
    folder = FOUND / name
    folder.mkdir(exist_ok=True)
    (folder / file).write_bytes(content)
    about = {
        "arguments": arguments,
        "problems": outcome.problems,
        "status": outcome.status,
        "seconds": outcome.seconds,
        "memory": outcome.memory,
        "errors": outcome.errors[-4000:],
    }
    (folder / "case.json").write_text(json.dumps(about, indent=1))
    print(f"{name}: {file}: {'; '.join(outcome.problems)}", file=sys.stderr, flush=True)


def fuzz_streams(seconds: float, seed: int) -> Mapping[str, int]:
    """Run the property tests of the decoders with ever new seeds until the time is up."""
    end = time.monotonic() + seconds
    rounds = failed = 0
    while time.monotonic() < end:
        rounds += 1
        tests = [sys.executable, "-m", "pytest", "-q", "-x", f"--hypothesis-seed={seed + rounds}", *STREAM_TESTS]
        ran = subprocess.run(tests, cwd=ROOT, capture_output=True, text=True)
        if ran.returncode != 0:
            failed += 1
            (FOUND / f"{seed}-streams-{rounds}.txt").write_text(ran.stdout)
            print(f"streams, seed {seed + rounds}: {ran.stdout.splitlines()[-1]}", file=sys.stderr, flush=True)
    return {"rounds": rounds, "failed": failed}


if __name__ == "__main__":
    sys.exit(main())
