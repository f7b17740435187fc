"""The main job: recordings in, validated model out. Each step is a function of its own module; this is their order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from daq.recording import Recording
from daq.robot import RobotFile
from drivers.errors import UsageError
from drivers.streams import FloatArray
from ident.assessment.delay import search_delay
from ident.assessment.excitation import excited_base_columns
from ident.assessment.validation import fit_figures
from ident.estimators.estimator import estimable, estimator_of
from ident.identify.checks import identification_warnings
from ident.identify.data_split import Part, part_positions, split_data
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices, PreparedRun
from ident.model.base_parameters import BaseParameters
from ident.model.dynamics import DynamicModel, build_model
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques, only_predicted
from ident.regression.jackknife import FilteredRun
from ident.regression.least_squares import ENERGY_METHODS
from ident.regression.observability import (
    experiment_base,
    find_experiment,
    predictable_torques,
)
from ident.regression.observation_matrix import only_torques
from ident.regression.pruning import prune
from ident.regression.velocity_reversals import leave_out_reversals, without_reversals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare

Progress = Callable[[str], None]
"""Told what is done next, in words."""


def identify(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    choices: IdentifyChoices,
    robot_file: RobotFile | None = None,
    progress: Progress = lambda step: None,
) -> Identification:
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
    robot_file = recordings[0].robot() if robot_file is None else robot_file
    model = apply_model_choices(build_model(robot_file), choices.model)
    parts, held_out, validation_source = split_data(
        recordings, validation, robot_file.robot, choices.preprocess, choices.split
    )
    progress("base parameters")
    experiment = find_experiment(model, [part_positions(part) for part in parts], choices.experiment)
    held_out_torques = [predictable_torques(model, [experiment], *part_positions(part)) for part in held_out]
    base = experiment_base(model, [experiment])
    kernel = RegressorKernel(model, base.columns)

    progress("preprocessing")
    # Cut-offs and delay come from the first part, all data are then treated alike.
    first = _prepare_window(parts[0], choices.preprocess)
    resolved = first.prepared.choices
    delay = None
    if choices.search_delay:
        progress("delay")
        searched = without_reversals(kernel, first.prepared.segments)
        delay = search_delay(kernel, searched, first.prepared.parallel_filter, experiment.torques)
        resolved = replace(resolved, delay=delay.used)
    prepared_runs = (_prepare_window(part, resolved) for part in parts)
    runs = tuple(
        replace(run, prepared=leave_out_reversals(kernel, run.prepared, choices.reversals)) for run in prepared_runs
    )
    validation_runs = tuple(_prepare_window(part, resolved) for part in held_out)

    progress("regression")
    parts_used = [run.prepared for run in runs]
    estimator = estimator_of(choices.method, kernel, parts_used, choices.energy_window)
    runs = tuple(
        replace(run, prepared=replace(run.prepared, steps=(*run.prepared.steps, *estimator.notes(run.prepared))))
        for run in runs
    )
    reduction = estimator.reduce(parts_used)
    if choices.method not in ENERGY_METHODS:
        reduction = only_torques(reduction, experiment.torques)
    estimated = estimable(choices.method, model, base)
    active = tuple(column for column in excited_base_columns(reduction, base, parts_used) if column in estimated)
    solution = estimator.solve(reduction, active)

    def compared(parameters: FloatArray) -> tuple[TorqueSeries, ...]:
        return _compare(model, base, parameters, runs, [experiment.torques] * len(runs))

    def compared_held_out(parameters: FloatArray) -> tuple[TorqueSeries, ...]:
        return _compare(model, base, parameters, validation_runs, held_out_torques)

    fit_series = compared(solution.parameters)
    filtered = _filtered_runs(runs, fit_series)

    progress("error bars")
    corrected = estimator.covariance(filtered, solution)
    inflation = np.ones(base.count)
    inflation[list(active)] = np.sqrt(np.diag(corrected.covariance) / np.diag(solution.covariance))
    pruned = prune(
        solution,
        inflation,
        corrected.effective_rows,
        lambda columns: estimator.solve(reduction, columns),
        choices.significant_rsd,
    )

    progress("validation")
    validation_series = compared_held_out(solution.parameters)
    essential = pruned.solution.parameters
    identification = Identification(
        robot_file=robot_file,
        model=model,
        experiment=experiment,
        base=base,
        choices=replace(
            choices,
            preprocess=replace(resolved, start=choices.preprocess.start, stop=choices.preprocess.stop),
        ),
        runs=runs,
        validation_runs=validation_runs,
        delay=delay,
        reduction=reduction,
        solution=solution,
        corrected=corrected,
        pruned=pruned,
        fit_series=fit_series,
        validation_series=validation_series,
        fit=fit_figures(fit_series),
        validation=fit_figures(validation_series),
        essential_fit=fit_figures(compared(essential)),
        essential_validation=fit_figures(compared_held_out(essential)),
        validation_source=validation_source,
        warnings=(),
    )
    progress("plausibility")
    return replace(identification, warnings=tuple(identification_warnings(identification, recordings)))


def apply_model_choices(model: DynamicModel, choices: ModelChoices) -> DynamicModel:
    """The model with the user's columns."""
    everywhere, nowhere = (True,) * model.dof, (False,) * model.dof
    changes: dict[str, tuple[bool, ...]] = {}
    if choices.friction is not None:
        for column in ("viscous", "coulomb"):
            changes[column] = everywhere if column in choices.friction.split("-") else nowhere
    if choices.offset is not None:
        changes["offset"] = everywhere if choices.offset else nowhere
    if choices.motor_inertia is not None:
        changes["motor_inertia"] = everywhere if choices.motor_inertia else nowhere
    model = replace(model, **changes)  # type: ignore[arg-type]
    if choices.smoothing is not None:
        if not (np.isfinite(choices.smoothing) and choices.smoothing >= 0):
            raise UsageError(f"--smoothing {choices.smoothing} is not a speed", hint="give ε ≥ 0 in rad/s")
        model = replace(model, smoothing=choices.smoothing)
    return model


def _prepare_window(part: Part, resolved: PreprocessChoices) -> PreparedRun:
    motion, window = part
    choices = replace(resolved, start=window.get("start"), stop=window.get("stop"))
    return PreparedRun(motion, choices, prepare(motion, choices))


def _compare(
    model: DynamicModel,
    base: BaseParameters,
    parameters: FloatArray,
    runs: Sequence[PreparedRun],
    torques: Sequence[Sequence[int]],
) -> tuple[TorqueSeries, ...]:
    """Measured and predicted torques of all runs; of each run, only those of some motors are predicted."""
    return tuple(
        only_predicted(series, predicted)
        for run, predicted in zip(runs, torques, strict=True)
        for series in compare_torques(
            model, base.columns, parameters, run.prepared.segments, run.prepared.parallel_filter
        )
    )


def _filtered_runs(runs: Sequence[PreparedRun], series: Sequence[TorqueSeries]) -> list[FilteredRun]:
    """What the jackknife looks at: torques that were not used leave no residual."""
    series = [
        replace(part, predicted=np.where(np.isnan(part.predicted), part.measured, part.predicted)) for part in series
    ]
    filtered, position = [], 0
    for run in runs:
        count = len(run.prepared.segments)
        filtered.append(
            FilteredRun(run.prepared.segments, run.prepared.parallel_filter, tuple(series[position : position + count]))
        )
        position += count
    return filtered
