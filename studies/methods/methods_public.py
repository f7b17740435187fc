"""Held-out errors of every method with every friction model on public recordings (docs/measurements/methods.md).

    python -m studies.methods.methods_public [METHODS, separated by commas [RECORDINGS [FRICTION]]]

Relative error of the held-out torques [%] (last 30 %; their folder in DYNID_DATA): all samples; joints above 0.1 rad/s;
joints below it (reversals and their neighbourhood); in brackets all samples by the physically consistent parameters.
Hours for everything.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from daq.recording.recording import Recording
from drivers.core.errors import DynidError
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from studies.friction.friction_models import choices_of, errors
from studies.models.consistency import public

NAMES = {"ur10": "UR10", "tx40": "TX40", "panda": "Panda"}
METHODS = ("wls", "ols", "tls", "iv", "irls", "iirls")
FRICTION = ("coulomb-viscous", "coulomb-viscous+power+load", "coulomb-viscous+power+stribeck+load", "auto")


def cell(recording: Recording, choices: IdentifyChoices) -> str:
    """The errors of one identification; why there are none where it fails."""
    try:
        found = identify([recording], [], choices)
    except DynidError as error:
        return error.message
    text = "; ".join(f"{error:.2f}" for error in errors(found))
    consistent = found.consistent
    return text if consistent is None else f"{text} ({100.0 * consistent.validation.relative_error:.2f})"


def main(
    methods: Sequence[str] = METHODS, names: Sequence[str] = tuple(NAMES), frictions: Sequence[str] = FRICTION
) -> None:
    """Print the table."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    runs = [public(folder, name) for name in names]
    print(f"| friction | method | {' | '.join(NAMES[name] for name in names)} |\n|---|---|{'---|' * len(names)}")
    for friction in frictions:
        for method in methods:
            cells = [
                cell(recording, replace(choices_of(choices, friction), method=method)) for recording, choices in runs
            ]
            print(f"| {friction} | `{method}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(*(argument.split(",") for argument in sys.argv[1:]))
