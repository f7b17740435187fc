"""Held-out errors of the friction models on public recordings in DYNID_DATA (docs/measurements/friction.md).

    python -m studies.friction.friction_models [NAME…]

Relative error of the held-out torques [%]: all samples, joints above 0.1 rad/s, joints below it (reversals and their
neighbourhood). Then the steps that `--friction auto` tried. A few minutes.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ident.assessment.validation import LOW_SPEED
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from studies.models.consistency import public

MODELS = (
    "viscous",
    "coulomb-viscous",
    "coulomb-viscous+power",
    "coulomb-viscous+stribeck",
    "coulomb-viscous+load-linear",
    "coulomb-viscous+load",
    "coulomb-viscous+power+stribeck",
    "coulomb-viscous+power+stribeck+load",
    "auto",
)


def errors(found: Identification) -> list[float]:
    """Relative error of all held-out torques, of joints above `LOW_SPEED`, and of those below."""
    series = found.validation_series
    measured, residual, counted, speed = (
        np.concatenate([np.asarray(getattr(part, name)) for part in series], axis=1)
        for name in ("measured", "residual", "counted", "velocity")
    )
    fast = counted & (np.abs(speed) >= LOW_SPEED)
    masks = (counted, fast, counted & ~fast)
    return [100.0 * float(np.linalg.norm(residual[mask]) / np.linalg.norm(measured[mask])) for mask in masks]


def choices_of(choices: IdentifyChoices, friction: str) -> IdentifyChoices:
    """The choices with a friction model."""
    inertia = choices.model.motor_inertia
    return IdentifyChoices(model=ModelChoices(friction=friction, motor_inertia=inertia), preprocess=choices.preprocess)


def main(names: list[str]) -> None:
    """Print a table for each recording."""
    folder = Path(os.environ.get("DYNID_DATA", "../shared/data"))
    for name in names or ["ur10", "panda", "tx40"]:
        recording, choices = public(folder, name)
        print(f"\n{name:36} {'all':>7} {'fast':>7} {'slow':>7}")
        for friction in MODELS:
            found = identify([recording], [], choices_of(choices, friction))
            figures = errors(found)
            print(f"{friction:36} " + " ".join(f"{figure:7.3f}" for figure in figures), flush=True)
        for step in found.friction.steps:
            errors_text = f"{_number(step.error_before, '.4f')} → {_number(step.error_after, '.4f')}"
            test = f"F({step.freedom}) {_number(step.f_value, '8.1f')}  p {_number(step.p_value, '8.2g')}"
            print(f"  {step.joint:22} {step.term:18} {test}  held out {errors_text}  {'added' * step.accepted}")
        terms = found.model.terms
        for name, values in terms.shapes.items():
            print(f"  {name} {np.round(values, 4)}")


def _number(value: float | None, style: str) -> str:
    """A number; a dash where a term was not tried."""
    return "–" if value is None else format(value, style)


if __name__ == "__main__":
    main(sys.argv[1:])
