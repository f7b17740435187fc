"""The checks of an identification: what a user should know before trusting its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.assessment.delay.delay import delay_checks
from ident.assessment.differing_runs import differing_run_checks
from ident.assessment.idle_joints import idle_joint_checks, one_way_checks
from ident.assessment.mistakes.checks import mistake_checks
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
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.checks.body_checks import body_checks, with_opposite_torques
from ident.identify.checks.estimate_checks import (
    by_joint,
    consistency_checks,
    convergence_checks,
    excitation_checks,
    experiment_checks,
    reversal_checks,
    size_checks,
    weight_split_checks,
)
from ident.identify.checks.extrapolation import extrapolation_checks
from ident.identify.checks.residual_bursts import burst_checks
from ident.identify.checks.stated_values import stated_value_checks
from ident.identify.cutoff_search import cutoff_checks
from ident.identify.data_split import distinct
from ident.identify.friction.drift import friction_drift_checks
from ident.identify.identification import Identification
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import ordinary_least_squares
from ident.regression.observability import experiment_states, whole_arm
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

MODEL_ERRORS = (
    *("inconsistent-gain", "wrong-gain", "inconsistent-length", "other-size"),
    *("joint-zero", "gravity-direction", "position-late"),
)
"""Checks of single numbers of the robot file."""


def identification_checks(identification: Identification) -> list[Check]:
    """All checks that the recordings and the identification raise."""
    several = len(identification.recordings) > 1
    checks = [
        check
        for recording in identification.recordings
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
    of_position = ("position-late", "position-ripple")
    explained = any(mistake.severity == "serious" or mistake.name in of_position for mistake in mistakes)
    # A mistake of one joint moves the delay that fits the whole arm, and leaves bursts.
    checks += [] if explained else delay_checks(identification.delay)
    named_already = unsound or bool(clipped) or explained
    checks += [] if named_already else [*burst_checks(identification), *friction_drift_checks(identification)]
    checks += size_checks(identification)
    checks += convergence_checks(identification)
    checks += experiment_checks(identification)
    checks += excitation_checks(identification)
    checks += _extrapolation_checks(identification)
    checks += sign_checks(identification.base, identification.solution.parameters, identification.std)
    idle = _idle_joint_checks(identification)
    # Static friction of resting joints, or a torque that is cut off, looks like a number of the robot file that is off.
    checks += idle
    resting = {joint for check in idle for joint in check.joints}
    checks += [
        mistake
        for mistake in mistakes
        if not (
            mistake.name in (*MODEL_ERRORS, "recording-changes", "torque-shifted")
            and clipped.intersection(mistake.joints)
        )
        and not (mistake.name == "position-late" and (resting.intersection(mistake.joints) or _rows_missing(checks)))
        and not (mistake.name in MODEL_ERRORS and mistake.name != "position-late" and idle)
    ]
    checks += reversal_checks(identification)
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
    if not (named or levels):
        weight = [] if of_urdf(scale) else _weight_checks(identification)
        checks += weight or urdf_scale_checks(scale)
        blamed = any(mistake.severity != "note" for mistake in mistakes)
        checks += _urdf_zero_checks(identification) if of_urdf(scale) and not blamed else []
    if not named:
        values, std = identification.solution.parameters, identification.std
        torques = [run.signals.torque for run in identification.runs]
        checks += bias_checks(identification.model, identification.base, values, std, np.concatenate(torques))
    checks += weight_split_checks(identification)
    checks += _body_checks(identification, checks, named=named)
    return checks + residual_checks(identification.residual_tests)


def _body_checks(identification: Identification, checks: Sequence[Check], *, named: bool) -> list[Check]:
    """Bodies that no arm has, or that its file states, less those that follow from `checks`; `named`: by a mistake."""
    if identification.consistent is None:
        return []
    model, robot_file, base = identification.model, identification.robot_file, identification.base
    consistent, estimate = identification.consistent.parameters, identification.estimate
    bodies = body_checks(
        model, robot_file, base, estimate, consistent, whole=identification.experiment == whole_arm(model)
    )
    stated = [] if named else stated_value_checks(model, robot_file, base, estimate, consistent.contradicted)
    follow = {"implausible-mass"} if named or any(check.name == "implausible-mass" for check in checks) else set()
    # Bodies that the robot file states against the data, or the arm's size, have a wrong weight and place, too.
    follow |= {"implausible-link", "implausible-centre"} if consistent.contradicted or stated else set()
    return [*stated, *(check for check in bodies if check.name not in follow)]


def _rows_missing(checks: Sequence[Check]) -> bool:
    """Whether rows are missing, so that a segment may fit at another time than its own."""
    return any(check.name == "rows-missing" for check in checks)


def _weight_checks(found: Identification) -> list[Check]:
    """Check whether gravity's torque is that of a mass that no arm of this size has."""
    consistent, parameters, apparent = found.consistent, found.solution.parameters, None
    if consistent is not None:
        stated, without = consistent.parameters.base, consistent.parameters.without
        parameters = without if consistent.parameters.contradicted and without is not None else stated
        apparent = consistent.parameters.apparent_mass
    torque = np.concatenate([run.signals.torque for run in found.runs])
    robot = found.robot_file.robot
    return weight_checks(robot, found.model, found.base, parameters, _positions(found), apparent, torque)


def _urdf_scale(found: Identification) -> tuple[float, float] | None:
    values, torques = found.solution.parameters, found.experiment.torques
    return urdf_scale(found.robot_file, found.model, found.base, values, _positions(found), torques)


def _urdf_zero_checks(found: Identification) -> list[Check]:
    solution, covariance = found.solution, found.corrected.covariance
    values, used, positions = solution.parameters, solution.active, _positions(found)
    return urdf_zero_checks(found.robot_file, found.model, found.base, values, covariance, used, positions)


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
            by_joint(identification, identification.reduction),
            identification.corrected.effective_rows,
            _whole_recording(identification),
        )
        delay = identification.delay
        by_delay = (*MODEL_ERRORS, "torque-shifted") if delay and (delay.explains_error or delay.drifts) else ()
        return [
            with_opposite_torques(identification, check) if check.name == "torques-opposite" else check
            for check in of_mistakes
            if check.name not in by_delay
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
