"""`python tests/soak SECONDS [SEED]`: damaged files against the commands, and the property tests with random examples.

For half of the time, files of every kind that a command reads are damaged and given to the commands, each in a process
of limited time and memory; for the rest, the suite's property tests, the drivers' decoders among them, run with new
examples (`random_mode.py`). What no command may do (a crash, a hang, a traceback, another exit status, an output left
behind, more than 20 s or 2 GB) is a found case: its file is written to tests/soak/found/ with what it did and the seed
that makes it again. Of a failed property, pytest's report with the example is written there.
Prints the counts as JSON; exit status 1 where something was found.
"""

from __future__ import annotations

import contextlib
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
SHARE_OF_FILES = 0.5
ENDS_WITHIN = 900.0
"""A property test that runs for so long [s] after the time is up hangs."""


def main() -> int:
    """Run both; the exit status."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(10**9)
    FOUND.mkdir(exist_ok=True)
    files = fuzz_files(SHARE_OF_FILES * seconds, seed)
    properties = try_properties((1.0 - SHARE_OF_FILES) * seconds, seed)
    print(json.dumps({"seed": seed, "files": files, "properties": properties}, indent=1))
    return 1 if files["found"] or properties["failed"] else 0


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


def try_properties(seconds: float, seed: int) -> Mapping[str, int]:
    """Run the property tests, round after round with new seeds, until the time is up; the counts."""
    end = time.monotonic() + seconds
    rounds = tests = failed = 0
    environment = os.environ | {"PYTHONPATH": str(HERE)}
    while (left := end - time.monotonic()) > 0:
        rounds += 1
        with tempfile.TemporaryDirectory() as folder:
            counts = Path(folder, "counts.json")
            options = ["--hypothesis-profile=soak", f"--hypothesis-seed={seed + rounds}"]
            options += [f"--soak={left}", f"--soak-counts={counts}"]
            report = Path(folder, "report.txt")
            with report.open("w") as output:
                command = [sys.executable, "-m", "pytest", "-q", "-p", "random_mode", *options]
                with contextlib.suppress(subprocess.TimeoutExpired):
                    subprocess.run(
                        command, cwd=ROOT, env=environment, stdout=output, stderr=output, timeout=left + ENDS_WITHIN
                    )
            told = json.loads(counts.read_text()) if counts.exists() else {"tests": 0, "failed": ["pytest itself"]}
            if told["failed"]:
                name = f"{seed}-properties-{rounds}.txt"
                shutil.copy(report, FOUND / name)
                print(f"{name}: {'; '.join(told['failed'])}", file=sys.stderr, flush=True)
        tests += told["tests"]
        failed += len(told["failed"])
    return {"rounds": rounds, "tests": tests, "failed": failed}


if __name__ == "__main__":
    sys.exit(main())
