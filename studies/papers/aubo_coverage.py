"""True friction parameters of a simulated AUBO i5 within their 95 % intervals (docs/measurements/error-bars.md).

    python -m studies.papers.aubo_coverage [seeds, as 8 or 20:27 [methods, as wls,iirls [Stribeck terms, as 0,0.15]]]

Another excitation and other noise for each seed, played cold, in between and warm (`aubo_session`), without the
Stribeck term, which the model does not have, and with it; another motion validates. Then the correlation of the errors
of α and its neighbours over the seeds, largest of the joints.
"""

from __future__ import annotations

import os
import sys
from functools import cache

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from drivers.core.arrays import FloatArray
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from studies.papers.aubo_session import COLD, STRIBECK, WARM, aubo, excitation, played

FRICTION = "coulomb-viscous+power+load+temperature"
SHOWN = (
    "coulomb",
    "viscous",
    "exponent",
    "load",
    "temperature",
    "temperature_slope",
    "temperature_curvature",
    "offset",
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


@cache
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


def shares(errors: list[Errors]) -> FloatArray:
    """Share inside and median σ of the kinds of `SHOWN` and of the bodies."""
    rows = []
    for kind in (*SHOWN, "bodies"):
        of_kind = np.array([value for one in errors for (name, _), value in one.items() if name == kind])
        inside = np.abs(of_kind[:, 0]) <= WITHIN_95_PERCENT * of_kind[:, 1]
        rows.append((100.0 * float(np.mean(inside)), float(np.median(of_kind[:, 1]))))
    return np.array(rows)


def main(seeds: str = "20", methods: str = "wls,iirls", plants: str = f"0,{STRIBECK}") -> None:
    """Print a table for each method and plant."""
    numbers = range(*map(int, seeds.split(":")))
    for method in methods.split(","):
        for stribeck in map(float, plants.split(",")):
            errors = []
            for seed in numbers:
                errors.append(identified(seed, stribeck, method))
                print(f"# {method}, {stribeck:g}, seed {seed}", file=sys.stderr, flush=True)
            print(f"\n{method}, Stribeck term {stribeck:g} of Coulomb friction, {len(numbers)} seeds")
            for kind, (inside, sigma) in zip((*SHOWN, "bodies"), shares(errors), strict=True):
                print(f"{kind:24}{inside:7.1f} %   median σ {sigma:.3g}")
            for first, second in (
                ("exponent", "viscous"),
                ("exponent", "coulomb"),
                ("exponent", "temperature"),
                ("viscous", "temperature"),
                ("temperature_slope", "temperature_curvature"),
            ):
                print(f"correlation of {first} and {second}: {correlation(errors, first, second):+.3f}")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:4])
