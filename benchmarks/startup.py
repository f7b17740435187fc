"""How long `dynid --help` and `import dynid` keep a user waiting, against the import of NumPy alone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.timing import medians

COMPARED = """\
help_vs_import_numpy: the command `dynid --help` of this environment over `python -c "import numpy"`, both whole
  processes.
import_vs_import_numpy: `python -c "import dynid"` over `python -c "import numpy"`, less the interpreter's start."""


def run(rounds: int = 11) -> dict[str, float]:
    """Against the import.

    Raises:
        FileNotFoundError: dynid is not installed in this environment.
        subprocess.CalledProcessError: one of the two fails.
    """
    command = Path(sys.executable).with_name("dynid")
    if not command.exists():
        raise FileNotFoundError(f"{command}: dynid is not installed in this environment; run make bench")
    sides: dict[str, Callable[[], object]] = {
        "help": lambda: _process([str(command), "--help"]),
        "numpy": lambda: _process([sys.executable, "-c", "import numpy"]),
        "dynid": lambda: _process([sys.executable, "-c", "import dynid"]),
        "nothing": lambda: _process([sys.executable, "-c", "pass"]),
    }
    seconds = medians(sides, rounds)
    numpy, dynid = (seconds[name] - seconds["nothing"] for name in ("numpy", "dynid"))
    return {
        "help_vs_import_numpy": seconds["help"] / seconds["numpy"],
        "help_seconds": seconds["help"],
        "import_vs_import_numpy": dynid / numpy,
        "import_dynid_ms": 1e3 * dynid,
        "import_numpy_ms": 1e3 * numpy,
    }


def _process(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
