"""The checks of an identification: what a user should know before trusting its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.recording.recording import Recording
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.text import percent_text
from ident.assessment.delay.delay import delay_checks
from ident.assessment.differing_runs import differing_run_checks
from ident.assessment.idle_joints import idle_joint_checks, one_way_checks
from ident.assessment.mistakes.checks import mistake_checks
from ident.assessment.model_errors import INDEPENDENT_PER_PARAMETER
from ident.assessment.plausibility import (
    POSES,
    bias_checks,
    indefinite_share,
    inertia_matrices,
    opposite_gravity,
    sign_checks,
)
from ident.assessment.recording_checks import recording_checks
from ident.assessment.residual_tests import residual_checks
from ident.assessment.torque_level import torque_level_checks, weight_checks
from ident.assessment.urdf_bodies import of_urdf, urdf_scale, urdf_scale_checks, urdf_zero_checks
from ident.estimators.estimator import Setup
from ident.estimators.feasible.consistent import ConsistentParameters, found_consistent
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.body_checks import body_checks, with_opposite_torques
from ident.identify.cutoff_search import cutoff_checks
from ident.identify.data_split import distinct
from ident.identify.extrapolation import extrapolation_checks
from ident.identify.friction.drift import friction_drift_checks
from ident.identify.identification import Identification
from ident.identify.residual_bursts import burst_checks
from ident.model.dynamics.inverse_dynamics import weights_in_offsets
from ident.model.regressor import RegressorKernel
from ident.regression.estimate import estimate_of
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import FEWEST_BLOCKS
from ident.regression.least_squares import LeastSquares, ordinary_least_squares, weighted_least_squares
from ident.regression.observability import experiment_states, moving_motors, whole_arm
from ident.regression.observation_matrix import Reduction
from ident.regression.pruning import relative_std
from ident.regression.velocity_reversals import STICKING_SHARE, leave_out_reversals
from ident.signals.prepared import Prepared
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


def identification_checks(identification: Identification, recordings: Sequence[Recording]) -> list[Check]:
    """All checks that the recordings and the identification raise."""
    several = len(recordings) > 1
    checks = [
        check
        for recording in recordings
        for check in recording_checks(recording, label=recording.label if several else "")
    ]
    # Data of another unit, or filled with zeros, fit other explanations by accident.
    unsound = any(check.severity == "serious" for check in checks)
    mistakes = [] if unsound else _mistake_checks(identification)
    torque = np.concatenate([run.signals.torque for run in identification.runs])
    levels = torque_level_checks(identification.robot_file, identification.model, torque)
    scale = _urdf_scale(identification)
    if of_urdf(scale):  # limits of a leg are for the whole animal, not for its own weight
        levels = [check for check in levels if check.name != "torque-far-below-limits"]
    # A torque beyond its limit that is another joint's, or in part, is explained.
    of_others = any(
        "exchanged" in mistake.name or mistake.name in ("motors-coupled", "sign-or-column") for mistake in mistakes
    )
    checks += [] if of_others else levels
    checks += cutoff_checks(identification.lowered)
    clipped = {joint for check in checks if check.name == "signal-clipped" for joint in check.joints}
    explained = any(mistake.severity == "serious" or mistake.name == "position-late" for mistake in mistakes)
    # A mistake of one joint moves the delay that fits the whole arm, and leaves bursts.
    checks += [] if explained else delay_checks(identification.delay)
    named_already = unsound or bool(clipped) or explained
    checks += [] if named_already else [*burst_checks(identification), *friction_drift_checks(identification)]
    checks += _size_checks(identification)
    checks += _convergence_checks(identification)
    checks += _experiment_checks(identification)
    checks += _excitation_checks(identification)
    checks += _extrapolation_checks(identification)
    checks += sign_checks(identification.base, identification.solution.parameters, identification.std)
    idle = _idle_joint_checks(identification)
    # Static friction of resting joints, or a torque that is cut off, looks like a number of the robot file that is off.
    of_gains, of_lengths = ("inconsistent-gain", "wrong-gain"), ("inconsistent-length", "other-size")
    model_errors = (*of_gains, *of_lengths, "joint-zero", "gravity-direction", "position-late")
    checks += idle
    resting = {joint for check in idle for joint in check.joints}
    checks += [
        mistake
        for mistake in mistakes
        if mistake.name not in model_errors
        or (
            not clipped.intersection(mistake.joints)
            and not (resting.intersection(mistake.joints) if mistake.name == "position-late" else idle)
        )
    ]
    checks += _reversal_checks(identification)
    share = _indefinite_share(identification)
    if share > 0:
        text = (
            f"the inertia matrix of the unconstrained parameters is not positive definite at {percent_text(share, 2)} "
            "of random poses; that of the physically consistent ones always is"
        )
        checks.append(raised("indefinite-inertia", text))
    checks += _differing_run_checks(identification)
    # Wrong data have a wrong weight, too.
    named = any(check.severity == "serious" for check in checks if check not in levels)
    consistent = identification.consistent
    checks += consistency_checks(
        identification.model.link_names,
        None if consistent is None else consistent.parameters,
        None if consistent is None else (identification.fit.relative_error, consistent.fit.relative_error),
    )
    # Bodies that the robot file states against the data have a wrong weight and place, too.
    denied = any(check.name == "known-contradicts-data" for check in checks)
    if not (named or levels):
        weight = [] if of_urdf(scale) else _weight_checks(identification)
        checks += weight or urdf_scale_checks(scale)
        checks += _urdf_zero_checks(identification) if of_urdf(scale) and not mistakes else []
    if not named:
        values, std = identification.solution.parameters, identification.std
        torques = [run.signals.torque for run in identification.runs]
        checks += bias_checks(identification.model, identification.base, values, std, np.concatenate(torques))
    checks += _weight_split_checks(identification)
    if consistent is not None:
        whole = identification.experiment == whole_arm(identification.model)
        bodies = body_checks(
            identification.model,
            identification.robot_file,
            identification.base,
            identification.estimate,
            consistent.parameters,
            whole=whole,
        )
        follow = {"implausible-mass"} if named or any(check.name == "implausible-mass" for check in checks) else set()
        follow |= {"implausible-link", "implausible-centre"} if denied else set()
        checks += [check for check in bodies if check.name not in follow]
    return checks + residual_checks(identification.residual_tests)


def _weight_split_checks(identification: Identification) -> list[Check]:
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


def _size_checks(identification: Identification) -> list[Check]:
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


def _weight_checks(identification: Identification) -> list[Check]:
    """Check whether gravity's torque is that of a mass that no arm of this size has."""
    consistent, solution = identification.consistent, identification.solution
    parameters = solution.parameters
    if consistent is not None:
        stated, without = consistent.parameters.base, consistent.parameters.without
        parameters = without if consistent.parameters.contradicted and without is not None else stated
    return weight_checks(
        identification.robot_file.robot,
        identification.model,
        identification.base,
        parameters,
        _positions(identification),
        None if consistent is None else consistent.parameters.apparent_mass,
        np.concatenate([run.signals.torque for run in identification.runs]),
    )


def _urdf_scale(identification: Identification) -> tuple[float, float] | None:
    return urdf_scale(
        identification.robot_file,
        identification.model,
        identification.base,
        identification.solution.parameters,
        _positions(identification),
        identification.experiment.torques,
    )


def _urdf_zero_checks(identification: Identification) -> list[Check]:
    return urdf_zero_checks(
        identification.robot_file,
        identification.model,
        identification.base,
        identification.solution.parameters,
        identification.corrected.covariance,
        identification.solution.active,
        _positions(identification),
    )


def _positions(identification: Identification) -> FloatArray:
    """(n, N) of all samples that count [rad or m]."""
    segments = [segment for run in identification.runs for segment in run.prepared.segments]
    return np.concatenate([segment.position[:, segment.used] for segment in segments], axis=1)


def _mistake_checks(identification: Identification) -> list[Check]:
    """Gravity, signs, columns, gains, lengths and zeros that fit the data better than those believed."""
    if identification.choices.estimator.equations == "torque":
        of_mistakes = mistake_checks(
            identification.model,
            identification.experiment,
            identification.base,
            [run.prepared for run in identification.runs],
            _by_joint(identification, identification.reduction),
            identification.corrected.effective_rows,
            _whole_recording(identification),
        )
        return [
            with_opposite_torques(identification, check) if check.name == "torques-opposite" else check
            for check in of_mistakes
        ]
    opposite = np.any(identification.model.gravity) and _fits_opposite_gravity(identification)
    return [opposite_gravity()] if opposite else []


def _whole_recording(identification: Identification) -> list[Prepared]:
    """All parts of the recording in the order of time; none where there are several recordings."""
    runs = [*identification.runs, *identification.validation_runs]
    if len({id(run.signals) for run in runs}) > 1:
        return []
    filled = [run.prepared for run in runs if run.prepared.segments]
    return sorted(filled, key=lambda run: float(run.segments[0].time[0]))


def _differing_run_checks(identification: Identification) -> list[Check]:
    """Check whether recordings, held-out ones among them, show the same bodies; parts of one recording do."""
    if identification.choices.estimator.equations != "torque":
        return []
    runs = list({id(run.signals): run for run in (*identification.validation_runs, *identification.runs)}.values())
    if len(runs) < 2:
        return []
    labels = distinct([run.signals.label for run in runs])
    kernel, torques = identification.estimation.kernel, identification.experiment.torques
    reductions = [reduce_torques(kernel, [run.prepared], torques) for run in runs]
    return differing_run_checks(
        labels,
        reductions,
        identification.base,
        identification.solution,
        [min(1.0, 2.0 * run.prepared.cutoffs.torque / run.prepared.filtered_rate) for run in runs],
    )


def _idle_joint_checks(identification: Identification) -> list[Check]:
    """Joints that rest most of the time under dry friction."""
    base, model = identification.base, identification.model
    coulomb, deviation = np.zeros(model.dof), np.full(model.dof, np.inf)
    # Static friction of rests differs from run to run: that it does is no reason to doubt that there is friction.
    corrected = identification.corrected
    std = np.sqrt(np.diag(corrected.covariance if corrected.within is None else corrected.within))
    within = dict(zip(identification.solution.active, std.tolist(), strict=True))
    for i, (kind, joint) in enumerate(zip(base.kinds, base.joints, strict=True)):
        if kind == "coulomb" and joint in model.active and i in identification.solution.active:
            row = model.active.index(joint)
            coulomb[row], deviation[row] = identification.solution.parameters[i], within[i]
    joints = [joint for joint in identification.experiment.torques if joint not in identification.experiment.locked]
    rest_velocity, series = identification.runs[0].prepared.rest_velocity, identification.fit_series
    kinds = set(zip(base.kinds, base.joints, strict=True))
    both = [joint for joint in joints if {(kind, model.active[joint]) for kind in ("coulomb", "offset")} <= kinds]
    return one_way_checks(model.joint_names, series, rest_velocity, both) + idle_joint_checks(
        model.joint_names, model.sliding, series, rest_velocity, coulomb, deviation, joints
    )


def _convergence_checks(identification: Identification) -> list[Check]:
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


def _excitation_checks(identification: Identification) -> list[Check]:
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


def _extrapolation_checks(identification: Identification) -> list[Check]:
    """Motion within the robot file's limits for which the delivered model is uncertain."""
    found, consistent, solution = identification.corrected, identification.consistent, identification.solution
    return extrapolation_checks(
        identification.model,
        identification.base,
        solution.parameters if consistent is None else consistent.parameters.base,
        found.covariance if found.within is None else found.within,
        solution.active,
        None if consistent is None else consistent.parameters.base_moves,
        np.max([np.max(np.abs(part.velocity), axis=1) for part in identification.fit_series], axis=0),
    )


def _experiment_checks(identification: Identification) -> list[Check]:
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


def _reversal_checks(identification: Identification) -> list[Check]:
    """Friction of the delivered model that changes without more of the equations near velocity reversals."""
    choices, base = identification.choices, identification.base
    if choices.estimator.equations == "energy" or choices.reversal_share >= STICKING_SHARE:
        return []
    before = _by_joint(identification, identification.reduction)
    kernel = RegressorKernel(identification.model, base.columns)
    parts = [leave_out_reversals(kernel, run.prepared, STICKING_SHARE) for run in identification.runs]
    try:
        left = reduce_torques(kernel, parts, identification.experiment.torques)
        after = _by_joint(identification, left)
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


def _by_joint(identification: Identification, reduction: Reduction) -> LeastSquares:
    """A system's solution with a weight per joint: the method's own for `ols` and `wls`, that of `wls` for others."""
    solve = ordinary_least_squares if identification.solution.method == "ols" else weighted_least_squares
    return solve(reduction, identification.solution.active)


def _indefinite_share(identification: Identification) -> float:
    """Share of random poses at which the inertia matrix of the joints that moved is not positive definite."""
    model, experiment, parameters = identification.model, identification.experiment, identification.solution.parameters
    if experiment == whole_arm(model):
        return indefinite_share(model, identification.base, parameters)
    moving = [joint for joint in range(model.dof) if joint not in experiment.locked]
    rows = [joint for joint in moving if joint in experiment.torques]
    if not model.transmission.direct and rows != moving:  # a coupled motor's row belongs to several joints
        return 0.0
    position = np.concatenate([state[0] for state in experiment_states(model, experiment)], axis=1)
    few = position[:, :: max(1, position.shape[1] // POSES)]
    matrices = inertia_matrices(model, identification.base, parameters, few)[:, rows][:, :, rows]
    smallest = np.linalg.eigvalsh(0.5 * (matrices + matrices.transpose(0, 2, 1)))[:, 0]
    return float(np.mean(smallest <= 0.0))


def _fits_opposite_gravity(identification: Identification) -> bool:
    """Return whether the energy's equations with gravity of the opposite sign fit clearly better, both by OLS."""
    from ident.estimators.energy_model import fits_energy_better

    active, model, method = identification.solution.active, identification.model, identification.choices.estimator
    base = identification.base
    residual_sum = ordinary_least_squares(identification.reduction, active).residual_sum
    data = [run.prepared for run in identification.runs]
    kernel = RegressorKernel(replace(model, gravity=-model.gravity), base.columns)
    turned = method.estimator(Setup(kernel, base, identification.experiment, identification.robot_file, tuple(data)))
    independent = identification.corrected.effective_rows * identification.corrected.repetitions
    return fits_energy_better(turned, data, active, residual_sum, independent)
