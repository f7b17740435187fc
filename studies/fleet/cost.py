"""What an identification of a long recording costs, and what it stores: the figures of fleets on paper.

    python -m studies.fleet.cost [MINUTES…]

A simulated UR5e at 125 Hz, identified with the last 30 % held out and saved with its report. A CPU minute for 1 and 10.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dynid


def main() -> None:
    """Print a row per length."""
    print("| recording [min] | CPU time [s] | recording [MB] | result and report [MB] |\n|---|---|---|---|")
    for minutes in [float(word) for word in sys.argv[1:]] or [1.0, 10.0]:
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place)
            dynid.simulate("ur5e", duration=60 * minutes, seed=1, rate=125.0).save(folder / "run.h5")
            begun = time.process_time()
            dynid.identify(folder / "run.h5", friction="coulomb-viscous").save(folder / "model")
            seconds = time.process_time() - begun
            written = sum(path.stat().st_size for path in (folder / "model").iterdir())
            size = (folder / "run.h5").stat().st_size
            print(f"| {minutes:g} | {seconds:.1f} | {size / 1e6:.2f} | {written / 1e6:.2f} |", flush=True)


if __name__ == "__main__":
    main()
