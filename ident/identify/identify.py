"""The main job: recordings in, validated model out, in the order of SR400 .4.3. Each step is a function of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from daq.recording.recording import Recording
from daq.recording.serial_numbers import warn_of_other_arms
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.reading_process import Progress
from ident.assessment.excitation import excited_base_columns
from ident.assessment.recording_checks import recording_checks
from ident.assessment.validation import Fit, fit_errors
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.feasible.armature import armature_vector
from ident.estimators.feasible.consistent import found_consistent
from ident.estimators.robust.reweighting import without_rejected
from ident.estimators.torque_estimator import reduce_torques
from ident.friction.terms import NO_TERMS
from ident.identify.checks.body_checks import refuse_denied
from ident.identify.checks.checks import identification_checks
from ident.identify.data_split import PreparedRun, check_motion, check_torques, split_data
from ident.identify.friction.extensions import low_speed_error
from ident.identify.friction.fit import fit_friction
from ident.identify.friction.shapes import with_curvature, with_free_shapes
from ident.identify.held_friction import hold_temperatures
from ident.identify.held_out import HeldOutRun, ParameterSets, held_out_run
from ident.identify.identification import ConsistentFit, Identification, IdentifyChoices, apply_model_choices
from ident.identify.preparation import PreparedData, compare_run, prepare_data
from ident.identify.summary import Identified
from ident.model.another_arm import check_arm
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries
from ident.regression.estimate import jackknifed_estimate
from ident.regression.jackknife import FilteredRun
from ident.regression.least_squares import LeastSquares, LinearMethod, inverse_deviations, residual_deviations
from ident.regression.observability import experiment_base, find_experiment, predictable_torques
from ident.regression.observation_matrix import Reduction
from ident.regression.pruning import prune
from ident.regression.repeatability import with_repeatability
from ident.regression.systematic_errors import with_systematic_errors
from ident.result.schema import Essential, Presliding

__all__ = ["Progress", "apply_model_choices", "identify"]


def identify(  # noqa: PLR0915 — the steps, in their order
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    choices: IdentifyChoices,
    robot_file: RobotFile | None = None,
    progress: Progress = lambda step: None,
) -> Identified:
    """Identify an arm from its recordings and validate the model on held-out data.

    Args:
        recordings: of one arm; they stack.
        validation: held-out recordings; without any, the last part of a single recording is held out.
        choices: the user's.
        robot_file: in place of the one that the first recording carries.
        progress: called before each step.

    Raises:
        DynidError: whatever is wrong with the data or the choices, and where.
    """
    if not recordings:
        raise UsageError("no recording to identify from")
    warn_of_other_arms([*recordings, *validation])
    if robot_file is None:
        robot_file = recordings[0].robot()
        check_arm([*recordings[1:], *validation], robot_file)
    model = apply_model_choices(build_model(robot_file), choices.model, robot_file.robot.friction)
    data = split_data(recordings, validation, robot_file.robot, choices.preprocess, choices.split)
    check_motion(data.identification, robot_file.robot.joint_names)
    if choices.model.experiment is not None:
        temperatures = [(run.signals.label, run.temperature) for run in data.identification]
        model, held = hold_temperatures(model, choices.model.experiment, temperatures)
        data = replace(data, held=held)

    progress("base parameters")
    positions = [(run.signals.label, run.position) for run in data.identification]
    experiment = find_experiment(model, positions, choices.experiment)
    check_torques(data.identification, experiment.torques, model.joint_names)
    tolerance = choices.experiment.rest_tolerance
    predictable = [
        predictable_torques(model, [experiment], run.signals.label, run.position, tolerance) for run in data.held_out
    ]
    for run in data.identification:
        heat = run.signals.temperature
        model.require_temperature(None if heat is None else heat.T, run.signals.label)

    progress("preprocessing")
    plain = replace(model, terms=NO_TERMS)
    kernel = RegressorKernel(plain, experiment_base(plain, [experiment]).columns)
    prepared = prepare_data(kernel, data, experiment.torques, predictable, choices, progress)
    friction = fit_friction(model, prepared, experiment, robot_file, choices, progress)
    model = friction.model
    base = experiment_base(model, [experiment])
    kernel = RegressorKernel(model, base.columns)
    if not model.terms.plain:  # friction that fits better shows the delay better
        prepared = prepare_data(kernel, data, experiment.torques, predictable, choices, progress)

    progress("regression")
    setup = Setup(kernel, base, experiment, robot_file, tuple(run.prepared for run in prepared.runs))
    estimator = choices.estimator.estimator(setup)
    runs = tuple(_with_notes(run, estimator) for run in prepared.runs)
    reduction, active = _observation(estimator, setup, choices)
    estimation = estimator.estimate(setup.runs, reduction, active)
    solution, kernel = estimation.solution, estimation.kernel
    model = kernel.model
    fit = [compare_run(kernel, solution.parameters, run) for run in runs]

    progress("error bars")
    filtered = list(_filtered_runs(runs, fit))
    counted = without_rejected(setup.runs, estimation.weights)
    corrected, free = with_free_shapes(
        estimator,
        estimation,
        experiment.torques,
        filtered,
        setup.runs,
        counted,
        estimator.covariance(filtered, estimation),
    )
    if choices.estimator.equations == "torque":
        equations = free.reduction
        if equations is None:
            equations = reduce_torques(kernel, counted, experiment.torques) if estimation.weights else reduction
        weights = _weights(equations, replace(solution, parameters=free.parameters))
        corrected = with_systematic_errors(
            corrected,
            free.kernel,
            counted,
            equations,
            weights,
            free.active,
            experiment.torques,
            _remaining_delay(prepared),
        )
    corrected, shape_std = free.split(corrected)
    if choices.estimator.equations == "torque":
        corrected = with_curvature(corrected, shape_std, free, kernel, counted, weights)
        corrected = with_repeatability(corrected, kernel, base, filtered, replace(solution, weights=weights))
    inflation = np.ones(base.count)
    random = np.sqrt(np.diag(corrected.covariance)) if corrected.random_std is None else corrected.random_std
    inflation[list(active)] = random / np.sqrt(np.diag(solution.covariance))
    pruned = prune(
        solution,
        inflation,
        corrected.effective_rows,
        lambda columns: estimator.restricted(estimation, columns),
        choices.essential,
        choices.significance,
    )

    progress("physical consistency")
    estimate = jackknifed_estimate(estimation.reduction, solution, corrected)
    held_out = prepared.validation_runs
    fresh = all(run.overlap == 0.0 for run in held_out)

    def errors(parameters: FloatArray) -> tuple[Fit, Fit]:
        """Errors of base parameters (b,) on the identification data and on those held out."""
        fitted = _flat(compare_run(kernel, parameters, run) for run in runs)
        return fit_errors(fitted), fit_errors(_flat(compare_run(kernel, parameters, run) for run in held_out), fresh)

    found = found_consistent(model, base, estimate, robot_file)
    consistent = None if found is None else ConsistentFit(found, *errors(found.base))

    progress("validation")
    fit_series = _flat(fit)
    if estimation.weights:
        weighted = zip(fit_series, estimation.weights, strict=True)
        fit_series = tuple(replace(part, weights=weights) for part, weights in weighted)
    validation_series = _flat(compare_run(kernel, solution.parameters, run) for run in held_out)
    identification = Identification(
        recordings=tuple(recordings),
        held_out_recordings=tuple(validation),
        robot_file=robot_file,
        model=model,
        experiment=experiment,
        base=base,
        choices=replace(
            choices, preprocess=replace(prepared.choices, start=choices.preprocess.start, stop=choices.preprocess.stop)
        ),
        runs=runs,
        validation_runs=held_out,
        delay=prepared.delay,
        reduction=reduction,
        estimation=estimation,
        corrected=corrected,
        pruned=pruned,
        consistent=consistent,
        fit_series=fit_series,
        validation_series=validation_series,
        fit=fit_errors(fit_series),
        validation=fit_errors(validation_series, fresh),
        essential=Essential.of(base.names, pruned, *errors(pruned.solution.parameters)),
        validation_source=data.validation_source,
        checks=(),
        friction=replace(friction, model=model),
        shape_std=shape_std,
        held=data.held,
        lowered=prepared.lowered,
    )

    if choices.finds_travels(model):
        identification = replace(identification, presliding=_presliding(identification))

    progress("plausibility")
    checks = identification_checks(identification)
    refuse_denied(identification, checks)

    progress("simulation")
    runs_held_out = held_out_runs(identification)
    checks += [check for run in runs_held_out for check in run.errors.checks]
    checks = list(dict.fromkeys(checks))
    return Identified(**vars(identification) | {"checks": tuple(checks), "held_out": runs_held_out})


def _weights(reduction: Reduction, solution: LeastSquares) -> FloatArray:
    """Weights (n,) of the motors' plain equations as the estimator had them, or by the solution's residuals."""
    if len(solution.weights) == len(reduction.joints) and solution.method in get_args(LinearMethod):
        return solution.weights
    return inverse_deviations(reduction, residual_deviations(reduction, solution.parameters, len(solution.active)))


def _remaining_delay(prepared: PreparedData) -> float:
    """Root mean square of the delay that was found and not taken out [s]; 0 where none was searched or found."""
    search = prepared.delay
    if search is None or search.best is None or search.std is None:
        return 0.0
    rest = 0.0 if search.used or search.joint_delays is not None else search.best
    return float(np.hypot(rest, search.std))


def _presliding(identification: Identification) -> Presliding:
    """The travels, and what they are worth near standstill on the held-out data."""
    found = identification
    static = RegressorKernel(replace(found.model, presliding=()), found.base.columns)
    without = _flat(compare_run(static, found.solution.parameters, run) for run in found.validation_runs)
    return Presliding(
        travels=list(found.friction.travels),
        static_error=low_speed_error(without),
        error=low_speed_error(found.validation_series),
    )


def held_out_runs(identification: Identification) -> tuple[HeldOutRun, ...]:
    """The delivered model on each held-out recording, or on what was held out of the others."""
    found, several = identification, len(identification.validation_runs) > 1
    validation = identification.held_out_recordings
    parameters = ParameterSets(
        robot=found.robot_file.robot,
        model=found.model,
        base=found.base,
        full=found.solution.parameters,
        consistent=None if found.consistent is None else found.consistent.parameters.base,
        armature=None
        if found.consistent is None
        else armature_vector(found.model, found.consistent.parameters.armatures),
    )
    apart: list[Recording | None] = [*validation] or [None] * len(found.validation_runs)
    return tuple(
        held_out_run(
            parameters,
            run,
            found.delivered_fit,
            run.signals.label if validation or several else found.validation_source,
            [] if recording is None else recording_checks(recording, label=recording.label),
        )
        for run, recording in zip(found.validation_runs, apart, strict=True)
    )


def _with_notes(run: PreparedRun, estimator: Estimator) -> PreparedRun:
    """The run with the estimator's own steps among the others."""
    steps = (*run.prepared.steps, *estimator.notes(run.prepared))
    return replace(run, prepared=replace(run.prepared, steps=steps))


def _observation(estimator: Estimator, setup: Setup, choices: IdentifyChoices) -> tuple[Reduction, tuple[int, ...]]:
    """The observation matrix, reduced, and its columns that the data excite and the equations can tell apart."""
    reduction = estimator.reduce(setup.runs)
    excited = excited_base_columns(reduction, setup.base, setup.runs)
    if choices.estimator.equations == "torque":
        return reduction, excited
    from ident.estimators.energy_model import estimable

    identifiable = estimable(setup.kernel.model, setup.base)
    return reduction, tuple(column for column in excited if column in identifiable)


def _filtered_runs(runs: Sequence[PreparedRun], series: Sequence[Sequence[TorqueSeries]]) -> Iterator[FilteredRun]:
    """What the jackknife looks at: torques that were not used leave no residual."""
    for run, of_run in zip(runs, series, strict=True):
        complete = tuple(
            replace(torque, predicted=np.where(np.isnan(torque.predicted), torque.measured, torque.predicted))
            for torque in of_run
        )
        yield FilteredRun(run.prepared.segments, run.prepared.parallel_filter, complete)


def _flat(series: Iterable[Sequence[TorqueSeries]]) -> tuple[TorqueSeries, ...]:
    return tuple(torque for of_run in series for torque in of_run)
