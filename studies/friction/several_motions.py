"""Whether `--friction auto` finds friction and torque over the position with three runs: docs/measurements/friction.md.

    python -m studies.friction.several_motions [SEEDS [ARM…]]

Simulated arms without and with a torque and a friction of one period per turn, a share of the joint's Coulomb friction;
three motions identify, a fourth is held out, with the terms of `coulomb-viscous` and with those of `auto`.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from dynid import simulate
from ident.friction.table import OPTIONS, POSITION_KINDS
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from studies.friction.ripple import rippled

SHARES = (0.0, 0.1, 0.3)
WORDS = tuple(option.word for option in OPTIONS if option.kinds[0] in POSITION_KINDS)


def identified(runs: list[Recording], other: Recording, friction: str) -> Identification:
    """Identify with this text of `--friction`, without the simulation behind the estimate's errors."""
    choices = IdentifyChoices(model=ModelChoices(friction=friction), search_delay=False)
    return identify(runs, [other], choices)


def error(found: Identification) -> float:
    """Held-out relative error of the consistent model [%], all samples."""
    return 100.0 * float(found.held_out[0].errors.all_samples.relative_error)


def main(seeds: int, arms: list[str]) -> None:
    """Print a row per arm and share."""
    print(
        "| arm | ripple | arms with terms of the position | joints with `position-n` | n = 1 | `ripple-m` | m = 1 "
        "| held-out error [%] of coulomb-viscous → auto |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for arm in arms:
        for share in SHARES:
            words: list[str] = []
            errors: list[tuple[float, float]] = []
            tried, kept, joints = seeds if share == 0.0 else max(1, seeds // 5), 0, 0
            for seed in range(tried):
                clean = [simulate(arm, duration=15.0, seed=100 * seed + number, rate=100.0) for number in range(1, 5)]
                *runs, other = clean if share == 0.0 else [rippled(run, share) for run in clean]
                auto = identified(runs, other, "auto")
                positional = any(auto.model.needs("position"))
                kept += positional
                joints += auto.model.dof
                words += [
                    step.term for step in auto.friction.steps if step.accepted and positional and step.term in WORDS
                ]
                if share > 0.0:
                    errors.append((error(identified(runs, other, "coulomb-viscous")), error(auto)))
            counts = [sum(word.startswith(start) for word in words) for start in ("position-", "ripple-")]
            first = [words.count("position-1"), words.count("ripple-1")]
            held_out = "{:.2f} → {:.2f}".format(*np.mean(errors, axis=0)) if errors else ""
            print(
                f"| {arm} | {100 * share:.0f} % | {kept} of {tried} | {counts[0]} of {joints} | {first[0]} "
                f"| {counts[1]} of {joints} | {first[1]} | {held_out} |",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10, sys.argv[2:] or ["ur10e", "panda"])
