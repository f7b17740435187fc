"""Held-out errors of every method with every friction model on public recordings: a table of docs/aubo.md.

    python studies/methods_public.py [NAME…]

Relative error of the held-out torques [%] (last 30 %; their folder in DYNID_DATA): all samples, joints above 0.1 rad/s,
joints below it (reversals and their neighbourhood), and all samples by the physically consistent parameters; CPU time.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from consistency import public
from friction_models import choices_of, errors

from drivers.errors import DynidError
from ident.identify.identify import identify

METHODS = ("wls", "ols", "ridge", "tls", "iv", "ml", "energy", "power", "irls", "iirls", "didim")
FRICTION = ("coulomb-viscous", "coulomb-viscous+power+load", "coulomb-viscous+power+stribeck+load", "auto")


def main(names: list[str]) -> None:
    """Print a table for each recording."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    for name in names or ["ur10", "tx40", "panda"]:
        recording, choices = public(folder, name)
        print(f"\n| {name} | friction | all | fast | slow | consistent | CPU s |\n|---|---|---|---|---|---|---|")
        for friction in FRICTION:
            for method in METHODS:
                start = time.process_time()
                try:
                    found = identify([recording], [], replace(choices_of(choices, friction), method=method))
                except DynidError as error:
                    print(f"| `{method}` | {friction} | {error} |", flush=True)
                    continue
                consistent = found.consistent
                cells = [f"{error:.2f}" for error in errors(found)]
                cells.append("" if consistent is None else f"{100.0 * consistent.validation.relative_error:.2f}")
                spent = time.process_time() - start
                print(f"| `{method}` | {friction} | {' | '.join(cells)} | {spent:.1f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
