"""What the public recordings' verdicts are, and what the default friction buys. About 20 s an arm.

    python -m studies.checks.public_verdicts [DATA]

DATA is the folder of the public recordings (`DYNID_DATA`). Errors are those of the last 30 % of each recording, rest
left out: of the default (`friction: auto` with presliding) and of `coulomb-viscous` without presliding.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ident.identify.identification import Identification, ModelChoices
from ident.identify.identify import identify
from studies.models.consistency import public

ARMS = ("tx40", "ur10", "panda")


def errors(found: Identification) -> str:
    """Held-out errors of the unconstrained and the consistent model [%]."""
    consistent = found.consistent
    last = "none found" if consistent is None else f"{100 * consistent.validation.relative_error:.2f}"
    return f"{100 * found.validation.relative_error:.2f} / {last}"


def main() -> None:
    """Print a table of the errors and one of the verdicts."""
    data = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("DYNID_DATA", "../shared/data"))
    rows, grades = [], []
    for name in ARMS:
        recording, choices = public(data, name)
        model = replace(choices.model, friction=None)
        found = identify([recording], [], replace(choices, model=model))
        plain = replace(choices, model=ModelChoices(friction="coulomb-viscous"), presliding=False)
        result = found.result
        simulated = result.delivered.runs[0]
        soft = "–" if simulated.simulation is None else simulated.simulation.position_rmse
        soft = soft if isinstance(soft, str) else " ".join(f"{1e3 * error:.2g}" for error in soft)
        driven = "–"
        if simulated.open_loop is not None and simulated.open_loop.ratio is not None:
            worst = np.nanmax([np.nan if r is None else r for r in simulated.open_loop.joint_ratio])
            driven = f"{simulated.open_loop.ratio:.2f}, {worst:.2f}"
        rows.append(f"| {name} | {errors(identify([recording], [], plain))} | {errors(found)} | {soft} | {driven} |")
        for purpose, judged in result.verdict.purposes.items():
            grades.append(f"| {name} | {purpose} | {judged.grade} | {judged.because} |")
        print(f"{name} done", file=sys.stderr, flush=True)
    print(
        "| recording | coulomb-viscous, full / consistent [%] | default [%] | soft controller, joints [mrad] |", end=""
    )
    print(" open loop over constant velocity, arm and worst joint |")
    print(
        "\n".join(
            ["|---|---|---|---|---|", *rows, "", "| recording | purpose | grade | because |", "|---|---|---|---|"]
        )
    )
    print("\n".join(grades))


if __name__ == "__main__":
    main()
