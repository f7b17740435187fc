"""The main job: recordings in, validated model out. Each step is a function of its own module; this is their order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daq.recording import Recording
from daq.robot import RobotFile
from drivers.errors import DataError, UsageError
from drivers.streams import FloatArray
from ident.base_parameters import BaseParameters
from ident.comparison import TorqueSeries, compare_torques, only_predicted
from ident.covariance import CorrectedCovariance, FilteredRun
from ident.data_split import Part, part_positions, split_data
from ident.delay import DelaySearch, search_delay
from ident.estimate import Estimate, estimate_of
from ident.estimator import estimable, estimator_of
from ident.excitation import excited_base_columns
from ident.experiment import Experiment, ExperimentChoices, experiment_base, find_experiment, predictable_torques
from ident.identify_warnings import identification_warnings
from ident.least_squares import ENERGY_METHODS, LeastSquares, Method
from ident.measured import MeasuredMotion
from ident.model import DynamicModel, build_model
from ident.observation import Reduction, only_torques
from ident.preprocess import Prepared, PreprocessChoices, prepare
from ident.pruning import SIGNIFICANT_RSD, Pruned, prune
from ident.regressor import RegressorKernel
from ident.reversals import check_share, leave_out_reversals, without_reversals
from ident.validation import FitFigures, fit_figures

FrictionModel = Literal["none", "viscous", "coulomb", "coulomb-viscous"]

Progress = Callable[[str], None]
"""Told what is done next, in words."""


@dataclass(frozen=True)
class ModelChoices:
    """Departures from the robot file's columns; None follows the file.

    Attributes:
        friction: which friction columns every joint has.
        offset: whether every joint has an offset torque.
        motor_inertia: whether every joint has a motor inertia.
        smoothing: ε [rad/s] of tanh(q̇/ε); 0 for sign(q̇).
    """

    friction: FrictionModel | None = None
    offset: bool | None = None
    motor_inertia: bool | None = None
    smoothing: float | None = None


@dataclass(frozen=True)
class IdentifyChoices:
    """What a user may choose.

    Attributes:
        method: estimator.
        model: departures from the robot file's columns.
        preprocess: filters, window, delay; `preprocess.delay` is not used where `search_delay` is set.
        search_delay: find the torque's delay from the data.
        split: end of the identification part of a single recording [s from its first stamp]; None takes the first 70 %.
        significant_rsd: threshold of significance [%].
        energy_window: mean duration of the energy method's windows [s]; None takes it from the parallel filter.
        experiment: joints that must be locked, and motors whose torques are used.
        reversals: equations of a motor slower than this share of its root mean square are left out; 0 keeps all.
    """

    method: Method = "wls"
    model: ModelChoices = field(default_factory=ModelChoices)
    preprocess: PreprocessChoices = field(default_factory=PreprocessChoices)
    search_delay: bool = True
    split: float | None = None
    significant_rsd: float = SIGNIFICANT_RSD
    energy_window: float | None = None
    experiment: ExperimentChoices = field(default_factory=ExperimentChoices)
    reversals: float = 0.0

    def __post_init__(self) -> None:
        check_share(self.reversals)
        if self.method in ENERGY_METHODS and self.reversals:
            raise UsageError(
                f"--leave-out-reversals has no meaning for --method {self.method}, whose equation is the whole arm's",
                hint="use --method wls",
            )
        if self.method in ENERGY_METHODS and self.experiment.torques_of:
            raise UsageError(
                f"--torques-of has no meaning for --method {self.method}, whose equation is the whole arm's",
                hint="use --method wls",
            )
        if self.energy_window is None:
            return
        if self.method != "energy":
            raise UsageError("energy windows belong to the method energy", where="energy_window")
        if not (np.isfinite(self.energy_window) and self.energy_window > 0):
            raise UsageError(f"windows of {self.energy_window:g} s hold nothing", where="energy_window")


@dataclass(frozen=True)
class PreparedRun:
    """A recording, or a part of one, ready for the estimator."""

    motion: MeasuredMotion
    choices: PreprocessChoices
    prepared: Prepared


@dataclass(frozen=True)
class Identification:
    """Everything that the run found; `ident.summary` turns it into a Result.

    Attributes:
        robot_file: the robot it was done for.
        model: the model.
        experiment: joints that stood still, motors whose torques were used.
        base: what such an experiment can show of the arm.
        choices: as given, with the cut-offs and the delay that were used.
        runs, validation_runs: prepared data.
        delay: the search, where one was made.
        reduction: the reduced system.
        solution: full model.
        corrected: its covariance for residuals that are not white.
        pruned: the essential model.
        fit_series, validation_series: torques of the full model.
        fit, validation, essential_fit, essential_validation: errors; validation is None where nothing was held out.
        validation_source: what was held out, in words.
        warnings: for the user.
    """

    robot_file: RobotFile
    model: DynamicModel
    experiment: Experiment
    base: BaseParameters
    choices: IdentifyChoices
    runs: tuple[PreparedRun, ...]
    validation_runs: tuple[PreparedRun, ...]
    delay: DelaySearch | None
    reduction: Reduction
    solution: LeastSquares
    corrected: CorrectedCovariance
    pruned: Pruned
    fit_series: tuple[TorqueSeries, ...]
    validation_series: tuple[TorqueSeries, ...]
    fit: FitFigures
    validation: FitFigures
    essential_fit: FitFigures
    essential_validation: FitFigures
    validation_source: str
    warnings: tuple[str, ...]

    @property
    def std(self) -> FloatArray:
        """Corrected standard deviations (b,) of the full model; inf where a parameter was not estimated."""
        deviations = np.full(self.base.count, np.inf)
        deviations[list(self.solution.active)] = np.sqrt(np.diag(self.corrected.covariance))
        return deviations

    @property
    def estimate(self) -> Estimate:
        """Values and covariance, for merging."""
        return estimate_of(self.reduction, self.solution, self.corrected.covariance, self.corrected.blocks)

    @property
    def joint_std(self) -> FloatArray:
        """Standard deviation (n,) of each joint's filtered torque residual [N·m]; nan where it was not used."""
        if self.choices.method not in ENERGY_METHODS:
            return np.where(self.solution.weights > 0, self.solution.joint_std, np.nan)
        squares = sum(np.sum(part.residual**2, axis=1) for part in self.fit_series)
        return np.asarray(np.sqrt(squares / max(1, sum(int(part.used.sum()) for part in self.fit_series))))


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


def _prepare(motion: MeasuredMotion, choices: PreprocessChoices) -> PreparedRun:
    try:
        prepared = prepare(motion.time, motion.position, motion.torque, choices, velocity=motion.velocity)
    except (DataError, UsageError) as error:
        where = f"{motion.label}: {error.where}" if error.where else motion.label
        raise type(error)(error.message, where=where, hint=error.hint) from error
    return PreparedRun(motion, choices, prepared)


def _prepare_window(part: Part, resolved: PreprocessChoices) -> PreparedRun:
    motion, window = part
    return _prepare(motion, replace(resolved, start=window.get("start"), stop=window.get("stop")))


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
