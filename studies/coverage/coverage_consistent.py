"""How often do the physically consistent model's 95 % intervals hold the truth? Simulated arms, many seeds.

Arms and motions as in `coverage.py`: every seed is another arm, its bodies and friction scaled at random, on a periodic
motion of 20 s. Shares of true values inside ±1.96 standard deviations, over all seeds, of

- the base parameters of the unconstrained model, and of the consistent one;
- of the latter those whose interval is that of the unconstrained model (`data`: at least 0.9 of it), and those that the
  conditions and the prior made narrower (`prior`);
- the standard parameters that get an interval: the data determine 99 % of them or more;
- the torque of the consistent model along another motion.

Standard parameters without an interval come from the prior; `by prior` is their share, `off` the median distance from
the truth in units of the prior's body. The SR400's Fv6 is left out: its truth (Table 4 of the paper) drives, which no
friction can, and no consistent model holds it. About 2 s of CPU time per arm and seed.

python -m studies.coverage.coverage_consistent [seeds [robots, as ur5e,panda]]
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers.core.arrays import BoolArray, FloatArray
from ident.estimators.feasible.prior import link_priors
from ident.estimators.feasible.problem import build_problem
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.models.model import Model
from studies.coverage.coverage import INSTANTS, another_arm, identified
from studies.synthetic.random_points import random_points_motion

ROBOTS = ("ur5e", "panda", "sr400", "rocr6")
COLUMNS = ("unconstrained", "consistent", "data", "prior", "standard", "torque")
NARROWED = 0.9


def deviations(robot: str, seed: int) -> tuple[list[FloatArray], FloatArray]:
    """Errors over standard deviations for each of `COLUMNS`; errors of what the prior decides, in its units."""
    arm = another_arm(robot, seed)
    found = identified(arm, "wls", "periodic", seed)
    if found.consistent is None:
        raise RuntimeError(f"no consistent model of {robot}, seed {seed}")
    consistent, truth = found.consistent.parameters, truth_vector(arm)
    system = found.estimate.root @ found.estimate.combinations(found.base.projection)
    priors = link_priors(found.model, arm, system, found.estimate.root @ found.estimate.values)
    units = build_problem(found.model, arm, found.base, found.estimate, priors).scale
    possible = np.array(
        [p.kind != "coupling" or v / u >= 0 for p, v, u in zip(found.model.parameters, truth, units, strict=True)]
    )
    active = [i for i in found.solution.active if possible[found.base.columns[i]]]
    base_truth = (found.base.projection @ truth)[active]
    std, own_std = found.std[active], np.sqrt(np.diag(consistent.base_covariance))[active]
    error = (consistent.base[active] - base_truth) / own_std
    narrowed = own_std < NARROWED * std
    shown = np.isfinite(consistent.std) & possible
    motion = random_points_motion(arm.robot, 1000 + seed, 8)
    samples = [signal.T for signal in motion.evaluate(np.linspace(0.0, motion.duration, INSTANTS + 2)[1:-1])]
    torque = model_torque(found.model, None, truth, samples[0].T, samples[1].T, samples[2].T).T
    if not found.model.transmission.direct:  # `Model.torque` is at the joints
        torque = torque @ found.model.transmission.coupling
    model = Model(found.result, "consistent")
    return [
        (found.solution.parameters[active] - base_truth) / std,
        error,
        error[~narrowed],
        error[narrowed],
        (consistent.values - truth)[shown] / consistent.std[shown],
        ((model.torque(*samples) - torque) / model.torque_std(*samples)).ravel(),
    ], ((consistent.values - truth) / units)[~shown & possible]


def line(robot: str, seeds: int) -> str:
    """The figures of one arm."""
    columns: list[list[BoolArray]] = [[] for _ in COLUMNS]
    of_prior = []
    for seed in range(seeds):
        figures, other = deviations(robot, seed)
        of_prior.append(np.abs(other))
        for column, figure in zip(columns, figures, strict=True):
            column.append(np.abs(figure) <= WITHIN_95_PERCENT)
    cells = []
    for column in columns:
        every = np.concatenate(column)
        cells.append(f"{every.mean():8.1%} of {len(every) / seeds:<5.0f}" if len(every) else f"{'–':>17}")
    without = np.concatenate(of_prior)
    share = len(without) / (len(without) + len(np.concatenate(columns[COLUMNS.index("standard")])))
    return f"{robot:8}" + "".join(cells) + f"{share:9.0%}{np.median(without):8.2f}"


def main(seeds: int = 20, robots: Sequence[str] = ROBOTS) -> None:
    """Print a line for each arm."""
    print(f"{seeds} seeds\n{'arm':8}" + "".join(f"{name:>17}" for name in COLUMNS) + f"{'by prior':>9}{'off':>8}")
    for robot in robots:
        print(line(robot, seeds), flush=True)


if __name__ == "__main__":
    main(
        seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 20,
        robots=sys.argv[2].split(",") if len(sys.argv) > 2 else ROBOTS,
    )
