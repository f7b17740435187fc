"""True friction parameters of a simulated AUBO i5 within their 95 % intervals (docs/measurements/error-bars.md).

    python -m studies.papers.aubo_coverage [seeds, as 8 or 20:27 [methods, as wls,iirls [Stribeck term, as 0 or 0.15]]]

Another excitation and other noise for each seed, played cold, in between and warm (`aubo_session`), without the
Stribeck term, which the model does not have, or with it; another motion validates. Then, per method, the errors in σ
in root mean square, and the correlation of those of α and its neighbours over the seeds, largest of the joints.
A seed takes half a minute with both methods.
"""

from __future__ import annotations

import os
import sys
from functools import cache, lru_cache

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from studies.papers.aubo_session import COLD, WARM, aubo, excitation, played

FRICTION = "coulomb-viscous+power+load+temperature"
SHOWN = {
    "coulomb": "Fs",
    "viscous": "Fv",
    "exponent": "α",
    "load": "Fl",
    "temperature": "Ft",
    "temperature_slope": "Fts",
    "temperature_curvature": "Ftc",
    "offset": "Fo",
    "bodies": "base parameters of bodies and motors",
}
"""Kinds and the names of their rows; `bodies` are all others."""
CORRELATED = (
    ("exponent", "viscous"),
    ("exponent", "coulomb"),
    ("exponent", "temperature"),
    ("viscous", "temperature"),
    ("temperature_slope", "temperature_curvature"),
)
Errors = dict[tuple[str, int], tuple[float, float]]


def found_errors(found: Identification) -> Errors:
    """Estimate minus truth and σ by kind and joint; inertial parameters are numbered."""
    robot = found.robot_file.robot
    truth = found.base.projection @ truth_vector(found.robot_file, found.model)
    errors: Errors = {}
    for index in found.solution.active:
        kind = found.base.kinds[index]
        place = found.base.joints[index] if kind in SHOWN else index
        errors[kind if kind in SHOWN else "bodies", place] = (
            float(found.solution.parameters[index] - truth[index]),
            float(found.std[index]),
        )
    for (kind, motor), sigma in found.shape_std.items():
        alpha = robot.truth.joints[found.model.joint_names[motor]].alpha
        errors[kind, motor] = (found.model.terms.shape("exponent", motor) - alpha, sigma)
    return errors


def identified(seed: int, stribeck: float, method: str) -> Errors:
    """Errors of one seed's model."""
    runs = recorded(seed, stribeck)
    choices = IdentifyChoices(method=method, model=ModelChoices(friction=FRICTION), search_delay=False)
    return found_errors(identify(list(runs), [held_out(stribeck)], choices))


@lru_cache(maxsize=1)
def recorded(seed: int, stribeck: float) -> tuple[Recording, ...]:
    """A motion played cold, in between and warm."""
    arm = aubo(stribeck)
    motion = excitation(arm, 1000 + seed, candidates=10)
    heat = (COLD, 0.5 * (COLD + WARM), WARM)
    return tuple(played(arm, motion, celsius, 10 * seed + k) for k, celsius in enumerate(heat))


@cache
def held_out(stribeck: float) -> Recording:
    """Another motion, half warm."""
    arm = aubo(stribeck)
    return played(arm, excitation(arm, 999, candidates=1), 0.5 * (COLD + WARM), 9999)


def correlation(errors: list[Errors], first: str, second: str) -> float:
    """Correlation of two kinds' errors over the seeds, the joint's whose is the largest."""
    values = []
    for joint in range(6):
        both = [
            (one[first, joint][0], one[second, joint][0])
            for one in errors
            if {(first, joint), (second, joint)} <= one.keys()
        ]
        if len(both) > 2:
            values.append(float(np.corrcoef(np.array(both).T)[0, 1]))
    return max(values, key=abs, default=float("nan"))


def coverage(errors: list[Errors], kind: str) -> tuple[float, float, float]:
    """Share [%] of a kind's truths within their intervals, median σ, and errors in σ in root mean square."""
    deviation, sigma = np.array([value for one in errors for (name, _), value in one.items() if name == kind]).T
    inside = 100.0 * float(np.mean(np.abs(deviation) <= WITHIN_95_PERCENT * sigma))
    return inside, float(np.median(sigma)), float(np.sqrt(np.mean((deviation / sigma) ** 2)))


def main(seeds: str = "20", methods: str = "wls,iirls", stribeck: str = "0") -> None:
    """Print the table, then a line for each method and kind, and the correlations."""
    names = methods.split(",")
    found: dict[str, list[Errors]] = {name: [] for name in names}
    for seed in range(*map(int, seeds.split(":"))):
        for name in names:
            found[name].append(identified(seed, float(stribeck), name))
        print(f"# seed {seed}", file=sys.stderr, flush=True)
    headings = [cell for name in names for cell in (f"`{name}`: inside", "median σ")]
    print(f"| parameter | {' | '.join(headings)} |\n|---|{'---|' * len(headings)}")
    rows = {kind: [coverage(found[name], kind) for name in names] for kind in SHOWN}
    for kind, of_methods in rows.items():
        print(f"| {SHOWN[kind]} | {' | '.join(f'{inside:.0f} % | {sigma:.3g}' for inside, sigma, _ in of_methods)} |")
    for place, name in enumerate(names):
        print(f"\n{name}: errors in σ, root mean square")
        print(", ".join(f"{SHOWN[kind]} {of_methods[place][2]:.2f}" for kind, of_methods in rows.items()))
        for first, second in CORRELATED:
            print(f"correlation of {first} and {second}: {correlation(found[name], first, second):+.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:4])
