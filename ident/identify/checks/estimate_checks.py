"""Checks of an estimate: enough data, a search that ended, parameters that the motion shows, bodies that can exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.text import percent_text
from ident.assessment.file_errors.model_errors import INDEPENDENT_PER_PARAMETER
from ident.estimators.feasible.consistent import ConsistentParameters, found_consistent
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.identification import Identification
from ident.model.dynamics.inverse_dynamics import weights_in_offsets
from ident.regression.estimate import estimate_of
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import FEWEST_BLOCKS
from ident.regression.least_squares import LeastSquares, ordinary_least_squares, weighted_least_squares
from ident.regression.observability import moving_motors
from ident.regression.observation_matrix import Reduction
from ident.regression.pruning import relative_std
from ident.regression.velocity_reversals import STICKING_SHARE, leave_out_reversals
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

ROWS_PER_PARAMETER = 50
"""Equations per parameter below which a warning is given (SR400 .4.3 point 6)."""

MOST_OVERSAMPLED = 6.0
"""Rate of the filtered torques over their cut-off up to which consecutive residuals are worth looking at; the default
decimation leaves 4.5 to 5."""

FRICTION_CHANGE = 3.0
"""A friction estimate that changes by more σ than this without reversals (`STICKING_SHARE`) gives a warning; on motions
that were followed exactly it changes by up to 2.4 σ, since data are left out."""

REJECTED, REJECTED_RISE = 1e-3, 1.02
"""p-value of the F-test of consistent against unconstrained parameters below which a note says so, where the torque
error rises by this factor: the prior's pull alone is significant in enough data. A warning follows from the errors'
difference alone (`consistency-costs`), since any model is rejected by enough data."""

SEARCH_GAP = 0.01
"""Cost of a search above its optimum that gives a warning, also where no single parameter is far from its value there:
correlated parameters may be wrong together."""

NEGLIGIBLE = 1e-3
"""Share of a value that does not matter, however small its standard deviation."""


def size_checks(identification: Identification) -> list[Check]:
    """Enough equations for the parameters, and enough data for the error bars."""
    solution, corrected = identification.solution, identification.corrected
    count = len(solution.active)
    checks = []
    if solution.rows < ROWS_PER_PARAMETER * count:
        checks.append(raised("few-equations", _few_equations(identification, ROWS_PER_PARAMETER * count)))
    prepared = identification.runs[0].prepared
    # The lag-one autocorrelation of a residual sampled far above its band says nothing about its memory.
    sampled_for_its_band = prepared.filtered_rate <= MOST_OVERSAMPLED * prepared.cutoffs.torque
    if sampled_for_its_band and corrected.effective_rows < INDEPENDENT_PER_PARAMETER * count:
        text = (
            f"the residuals amount to {corrected.effective_rows:.0f} independent equations for {count} parameters; "
            f"error bars need {INDEPENDENT_PER_PARAMETER} per parameter: record longer, preferably different motions"
        )
        checks.append(raised("few-independent-samples", text))
    if corrected.blocks < FEWEST_BLOCKS:
        uncertain = 1.0 / np.sqrt(2.0 * max(1, corrected.blocks - 1))
        text = (
            f"the standard deviations are based on {corrected.blocks} blocks of data, at least {FEWEST_BLOCKS} are "
            f"advised; they are uncertain by {percent_text(uncertain, 2)}: record longer"
        )
        checks.append(raised("few-blocks", text))
    return checks


def _few_equations(identification: Identification, advised: int) -> str:
    """Return how much motion gives the equations that are advised."""
    solution, first = identification.solution, identification.runs[0].prepared
    seconds = sum(
        int(segment.used.sum()) / segment.rate for run in identification.runs for segment in run.prepared.segments
    )
    needed = seconds * advised / solution.rows
    if identification.choices.estimator.name == "energy":
        more = "or take shorter windows (--method energy:window=…)"
    elif identification.choices.preprocess.decimate is not None:
        more = f"or decimate by less than {first.parallel_filter.factor} (--decimate)"
    else:
        more = (
            f"or a faster motion: the parallel filter ({first.cutoffs.torque:.3g} Hz, from the motion's band) leaves "
            f"{first.filtered_rate:.3g} equations per second and joint"
        )
    return (
        f"only {solution.rows} equations for {len(solution.active)} parameters; {ROWS_PER_PARAMETER} per parameter are "
        f"advised: identify from {needed:.0f} s of motion instead of {seconds:.0f} s, {more}"
    )


def convergence_checks(identification: Identification) -> list[Check]:
    """A search that did not reach its optimum; loops of an iterative method that do not settle."""
    solution, optimum = identification.solution, identification.estimation.optimum
    loops = identification.estimation.loops
    if optimum is not None:
        used = list(solution.active)
        distance = np.abs(solution.parameters - optimum.parameters)[used] / identification.std[used]
        beyond = int(np.sum(distance > WITHIN_95_PERCENT))
        reduction = identification.reduction
        costs = [
            float(np.sqrt(np.sum(optimum.weights**2 * reduction.residual_sums(estimate.parameters))))
            for estimate in (solution, optimum)
        ]
        above = costs[0] / max(costs[1], np.finfo(float).tiny) - 1.0
        if not beyond and above <= SEARCH_GAP:
            return []
        worst = int(np.argmax(distance))
        text = (
            f"the search ended {percent_text(above, 3)} above the optimum of its cost, which is least squares: "
            f"{beyond} of {len(used)} parameters differ from it by more than their ±, the most "
            f"{identification.base.names[used[worst]]}, by {distance[worst]:.3g} σ; use --method wls"
        )
        return [raised("search-gap", text)]
    if solution.settled:
        return []
    if loops:
        names = ", ".join(loop.name for loop in loops if not loop.settled)
        text = (
            f"the method {identification.choices.method} did not converge ({names}), the last iterate is used: compare "
            "--method wls, or record longer"
        )
        return [raised("weights-not-settled", text)]
    text = (
        f"the joints' weights did not converge in {solution.iterations - 1} iterations, the last ones are used: values "
        "and error bars depend on where they stopped; compare --method ols, or record longer"
    )
    return [raised("weights-not-settled", text)]


def experiment_checks(identification: Identification) -> list[Check]:
    """Joints at rest that --locked does not name; torques of motors at rest."""
    experiment, names = identification.experiment, identification.model.joint_names
    checks = []
    declared = identification.choices.experiment.locked
    unnamed = [names[joint] for joint in experiment.locked if names[joint] not in declared]
    if unnamed:
        text = (
            f"{', '.join(unnamed)} did not move: the base parameters are those of the arm with "
            f"{'this joint' if len(unnamed) == 1 else 'these joints'} fixed, and valid for no other position of "
            f"{'it' if len(unnamed) == 1 else 'them'}; confirm locked joints with --locked"
        )
        checks.append(raised("joints-locked", text, unnamed))
    moving = moving_motors(identification.model, experiment.locked)
    held = [names[motor] for motor in experiment.torques if motor not in moving]
    if held:
        text = (
            f"the motor of {', '.join(held)} is at rest, and its torque is used: static friction or a brake may "
            "carry any part of it"
        )
        checks.append(raised("resting-motor-torque", text, held))
    return checks


def excitation_checks(identification: Identification) -> list[Check]:
    """Parameters that the motion or the method does not show."""
    base, solution = identification.base, identification.solution
    checks = []
    unexcited = [base.names[i] for i in range(base.count) if i not in solution.active]
    if unexcited:
        text = (
            f"the motion does not excite {', '.join(unexcited)}: they get no value, and other parameters may have "
            "absorbed them"
        )
        checks.append(raised("unexcited-parameters", text))
    insignificant = [
        base.names[i]
        for i in solution.active
        if relative_std(solution.parameters, identification.std)[i] >= 100.0 and i in identification.pruned.dropped
    ]
    if len(insignificant) > base.count / 3:
        text = (
            f"{len(insignificant)} of {base.count} base parameters are smaller than their standard deviation: "
            "record a more exciting motion"
        )
        checks.append(raised("insignificant-parameters", text))
        if identification.choices.estimator.equations == "energy":
            text = (
                "the energy model has one equation for all joints together: record many different moves rather than a "
                "periodic motion, or use --method wls"
            )
            checks.append(raised("few-moves-for-energy", text))
    return checks


def reversal_checks(identification: Identification) -> list[Check]:
    """Friction of the delivered model that changes without more of the equations near velocity reversals."""
    choices, base = identification.choices, identification.base
    if choices.estimator.equations == "energy" or choices.reversal_share >= STICKING_SHARE:
        return []
    before = by_joint(identification, identification.reduction)
    kernel = identification.estimation.kernel
    parts = [leave_out_reversals(kernel, run.prepared, STICKING_SHARE) for run in identification.runs]
    try:
        left = reduce_torques(kernel, parts, identification.experiment.torques)
        after = by_joint(identification, left)
    except IdentificationError:  # too little is left
        return []
    random = identification.corrected.random_std
    std = identification.std
    if random is not None:
        std[list(identification.solution.active)] = random
    # The variance of the difference is that of what is left, less that of all (Hausman 1978).
    ratio = np.divide(after.std, before.std, out=np.ones(len(std)), where=np.isfinite(before.std) & (before.std > 0.0))
    std = std * np.sqrt(np.maximum(1.0, ratio**2 - 1.0))
    changed = _friction_changes(identification, before.parameters, after.parameters, std)
    if changed and identification.consistent is not None:
        again = found_consistent(
            identification.model,
            base,
            estimate_of(left, after, identification.corrected.covariance, identification.corrected.blocks),
            identification.robot_file,
        )
        if again is not None:
            changed = _friction_changes(identification, identification.consistent.parameters.base, again.base, std)
    largest = sorted(changed, key=lambda i: -abs(changed[i]))[:3]
    if not largest:
        return []
    changes = ", ".join(f"{base.names[i]} by {changed[i]:+.1f} σ" for i in largest)
    text = (
        "Coulomb friction is not well defined near velocity reversals: leaving out more of those equations changes "
        f"the delivered friction significantly ({changes} of the jackknife); compare --reversals {STICKING_SHARE:g}"
    )
    return [raised("friction-near-reversals", text)]


def _friction_changes(
    identification: Identification, before: FloatArray, after: FloatArray, std: FloatArray
) -> dict[int, float]:
    """Base parameters of friction that change by more than `FRICTION_CHANGE` [σ], and by how much."""
    kinds = [identification.model.parameters[column].kind for column in identification.base.columns]
    changes = {
        i: (after[i] - before[i]) / std[i]
        for i in identification.solution.active
        if kinds[i] in ("viscous", "coulomb") and abs(after[i] - before[i]) > NEGLIGIBLE * abs(before[i])
    }
    return {i: float(change) for i, change in changes.items() if abs(change) > FRICTION_CHANGE}


def weight_split_checks(identification: Identification) -> list[Check]:
    """How the consistent model splits the sums of weight and constant friction that no motion separates."""
    base = identification.base
    sliding = weights_in_offsets(identification.model, base)
    if identification.consistent is None or not sliding:
        return []
    parameters = identification.consistent.parameters
    constant = {name: float(parameters.values[base.columns[row]]) for name, row in sliding.items()}
    split = ", ".join(
        f"{name} {float(parameters.base[row]) - constant[name]:.3g} N of weight and {constant[name]:.2g} N of friction"
        for name, row in sliding.items()
    )
    text = (
        f"the data show only the sum of weight and constant friction of {', '.join(sliding)}; the physically "
        f"consistent model splits it by its masses and Coulomb friction: {split}"
    )
    return [raised("weight-not-separate", text)]


def consistency_checks(
    link_names: Sequence[str], consistent: ConsistentParameters | None, errors: tuple[float, float] | None = None
) -> list[Check]:
    """Checks of physical consistency.

    Args:
        link_names: of the arm.
        consistent: the physically consistent parameters; None where none were found.
        errors: relative errors of the unconstrained and the consistent model on the identification data.
    """
    if consistent is None:
        return [raised("no-consistent-model", "no physically consistent parameters were found for this estimate")]
    checks = []
    if consistent.boundary:
        names = [link_names[link] for link in consistent.boundary]
        text = f"the links of {', '.join(names)} lie on the boundary of physical consistency"
        checks.append(raised("links-on-boundary", text))
    rises = errors is None or errors[1] > REJECTED_RISE * errors[0]
    if rises and consistent.cost is not None and consistent.cost.p_value < REJECTED:
        rise = "" if errors is None else f", {percent_text(errors[1])} of error for {percent_text(errors[0])}"
        text = (
            "no bodies explain the data as well as the unconstrained parameters (p = "
            f"{consistent.cost.p_value:.1g}{rise}): missing effects also cause this, as do a wrong length, gain or sign"
        )
        checks.append(raised("consistency-rejected", text))
    if consistent.contradicted:
        text = f"the data contradict the robot file, and the fit is clearly worse: {', '.join(consistent.contradicted)}"
        checks.append(raised("known-contradicts-data", text))
    if consistent.limits_hit:
        text = f"{', '.join(consistent.limits_hit)} of the robot file bound a parameter"
        checks.append(raised("range-hit", text))
    return checks


def by_joint(identification: Identification, reduction: Reduction) -> LeastSquares:
    """A system's solution with a weight per joint: the method's own for `ols` and `wls`, that of `wls` for others."""
    solve = ordinary_least_squares if identification.solution.method == "ols" else weighted_least_squares
    return solve(reduction, identification.solution.active)
