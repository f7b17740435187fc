"""What the rules of the essential model keep and cost on public recordings (docs/measurements/methods.md).

    python -m studies.methods.essential_rule [NAME…]

Parameters kept, how many of them have a relative standard deviation of 15 % or more after the last elimination, the
largest one, and the relative error on held-out data (last 30 %; the recordings' folder in DYNID_DATA).
"""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ident.assessment.validation import fit_errors
from ident.identify.identification import Identification
from ident.identify.identify import identify
from ident.identify.preparation import compare_run
from ident.regression.least_squares import weighted_least_squares
from ident.regression.options import SIGNIFICANT_RSD, EssentialRule
from ident.regression.pruning import Pruned, prune, relative_std
from studies.friction.friction_models import choices_of
from studies.models.consistency import public

RULES: tuple[tuple[EssentialRule, float], ...] = (
    ("rsd", 5.0),
    ("rsd", 15.0),
    ("rsd", 30.0),
    ("rsd", 45.0),
    ("f-test", SIGNIFICANT_RSD),
)


def main(names: list[str]) -> None:
    """Print a row for each recording and rule."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    print(
        "| arm | rule | kept | of these RSD ≥ 15 % | largest RSD [%] | held-out error [%] |\n|---|---|---|---|---|---|"
    )
    for name in names or ["ur10", "tx40", "panda"]:
        recording, choices = public(folder, name)
        found = identify([recording], [], choices_of(choices, "coulomb-viscous"))
        print(_row(name, "all parameters", found, Pruned(found.solution, (), "")), flush=True)
        for rule, threshold in RULES:
            pruned = prune(
                found.solution,
                _inflation(found),
                found.corrected.effective_rows,
                partial(weighted_least_squares, found.estimation.reduction),
                rule,
                threshold,
            )
            words = f"`rsd`, {threshold:g} %" if rule == "rsd" else "`f-test`"
            print(_row(name, words, found, pruned), flush=True)


def _inflation(found: Identification) -> np.ndarray:
    inflation = np.ones(found.base.count)
    active = list(found.solution.active)
    random = found.corrected.random_std
    inflation[active] = (found.std[active] if random is None else random) / found.solution.std[active]
    return inflation


def _row(name: str, rule: str, found: Identification, pruned: Pruned) -> str:
    solution = pruned.solution
    rsd = relative_std(solution.parameters, solution.std * _inflation(found))[list(solution.active)]
    series = [
        part for run in found.validation_runs for part in compare_run(found.estimation.kernel, solution.parameters, run)
    ]
    error = 100.0 * fit_errors(series).relative_error
    high = int(np.sum(rsd >= SIGNIFICANT_RSD))
    return f"| {name} | {rule} | {len(rsd)} | {high} | {rsd.max():.1f} | {error:.2f} |"


if __name__ == "__main__":
    main(sys.argv[1:])
