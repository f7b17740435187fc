"""CPU of the whole command `dynid identify` on a minute of a UR5e at 500 Hz, against importing its libraries alone."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import dynid

COMPARED = """\
identify_vs_imports: CPU of the processes `dynid identify run.h5` over `python -c "import …"` of NumPy, SciPy (linalg,
  optimize, signal), h5py, Pinocchio and Plotly's figures. identify_vs_bare_imports: of `import numpy, scipy, h5py,
  pinocchio, plotly`, which loads no part of SciPy and no figure. A round has one of each."""

_PARTS = "import numpy, scipy.linalg, scipy.optimize, scipy.signal, h5py, pinocchio, plotly.graph_objects"
_BARE = "import numpy, scipy, h5py, pinocchio, plotly"


def run(rounds: int = 5) -> dict[str, float]:
    """CPU, user's and system's: ratios are medians over the rounds, seconds the least of all, since other work adds."""
    with TemporaryDirectory() as folder:
        recording, result = Path(folder, "run.h5"), str(Path(folder, "result"))
        dynid.simulate("ur5e", duration=60, seed=3).save(recording)
        command = str(Path(sys.executable).with_name("dynid"))
        sides = {
            "identify": [command, "identify", str(recording), "-o", result, "--force"],
            "help": [command, "--help"],
            "dynid": [sys.executable, "-c", "import dynid"],
            "parts": [sys.executable, "-c", _PARTS],
            "bare": [sys.executable, "-c", _BARE],
        }
        seconds: dict[str, list[float]] = {name: [] for name in sides}
        for _ in range(rounds + 1):
            for name, side in sides.items():
                seconds[name].append(_cpu(side))
    cpu = {name: min(values[1:]) for name, values in seconds.items()}
    ratios = {
        name: statistics.median(a / b for a, b in zip(seconds["identify"][1:], seconds[name][1:], strict=True))
        for name in ("parts", "bare")
    }
    return {
        "identify_vs_imports": ratios["parts"],
        "identify_vs_bare_imports": ratios["bare"],
        "identify_cpu_seconds": cpu["identify"],
        "imports_cpu_seconds": cpu["parts"],
        "bare_imports_cpu_seconds": cpu["bare"],
        "help_cpu_seconds": cpu["help"],
        "import_dynid_cpu_seconds": cpu["dynid"],
    }


def _cpu(command: list[str]) -> float:
    """CPU [s] of a process."""
    before = os.times()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"})
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system
