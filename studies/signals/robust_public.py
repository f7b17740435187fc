"""Robust methods on public recordings (their folder in DYNID_DATA) (docs/measurements/signals.md).

    python -m studies.signals.robust_public [NAME…]

Relative error of the held-out torques [%], all samples, joints above 0.1 rad/s and joints below it, the share of
rejected equations, passes over the data and CPU time. A few minutes.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.core.errors import DynidError
from ident.identify.identify import identify
from studies.friction.friction_models import choices_of, errors
from studies.models.consistency import public

CASES = (
    ("ols", "coulomb-viscous"),
    ("wls", "coulomb-viscous"),
    ("irls", "coulomb-viscous"),
    ("irls:weights=huber", "coulomb-viscous"),
    ("irls:weights=tukey", "coulomb-viscous"),
    ("irls:consistent=true", "coulomb-viscous"),
    ("wls", "coulomb-viscous+power+load"),
    ("irls", "coulomb-viscous+power+load"),
    ("iirls", "coulomb-viscous+power+load"),
    ("iirls:decoupled=true", "coulomb-viscous+power+load"),
)


def main(names: list[str]) -> None:
    """Print a table for each recording."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    for name in names or ["ur10", "panda", "tx40"]:
        recording, choices = public(folder, name)
        print()
        print(f"| {name} | friction | all | fast | slow | rejected | passes | CPU s |")
        print("|---|---|---|---|---|---|---|---|")
        for method, friction in CASES:
            start = time.process_time()
            try:
                found = identify([recording], [], replace(choices_of(choices, friction), method=method))
            except DynidError as error:
                print(f"| `{method}` | {friction} | {error} |")
                continue
            spent = time.process_time() - start
            weights = found.estimation.weights
            rejected = f"{np.nanmean(np.concatenate(weights, axis=1) == 0):.1%}" if weights else ""
            parts = " | ".join(f"{error:.2f}" for error in errors(found))
            settled = "" if found.solution.settled else " (not settled)"
            count = f"{found.estimation.passes}{settled}"
            print(f"| `{method}` | {friction} | {parts} | {rejected} | {count} | {spent:.1f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
