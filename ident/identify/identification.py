"""What a user may choose of an identification, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from daq.robot.schema import Friction
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.assessment.delay.delay import DelaySearch
from ident.assessment.residual_tests import ResidualTests, filter_memory, residual_tests
from ident.assessment.validation import Fit
from ident.estimators.estimator import Estimation
from ident.estimators.feasible.consistent import ConsistentParameters
from ident.estimators.method_choice import MethodChoice, chosen_method
from ident.friction.choice import AUTO, check_friction, chosen_friction, friction_columns
from ident.friction.terms import friction_terms
from ident.identify.cutoff_search import LoweredCutoffs
from ident.identify.data_split import PreparedRun
from ident.identify.held_friction import HeldFriction, experiment_terms
from ident.identify.held_out import HeldOutRun
from ident.identify.options import ColumnOptions
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.regression.comparison import TorqueSeries
from ident.regression.estimate import Estimate, jackknifed_estimate
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment
from ident.regression.observation_matrix import Reduction
from ident.regression.options import REVERSAL_SHARE, EssentialOptions, ExperimentChoices, ReversalOptions
from ident.regression.pruning import Pruned
from ident.result.friction import FrictionStep
from ident.result.schema import Essential, Presliding, PreslidingTravel
from ident.signals.options import PreprocessChoices
from ident.verdict.check import Check, texts

if TYPE_CHECKING:
    from ident.result.friction_experiment import FrictionExperimentResult


@dataclass(frozen=True, kw_only=True)
class ModelChoices(ColumnOptions):
    """Departures from the robot file's columns."""

    # friction experiment whose terms and shapes hold, and what the recordings cannot tell
    experiment: FrictionExperimentResult | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.friction is not None:
            check_friction(self.friction)


@dataclass(frozen=True)
class IdentifyChoices(EssentialOptions, ReversalOptions):
    """What a user may choose."""

    method: str = "wls"  # estimator and its options, NAME[:OPTION=VALUE]…
    model: ModelChoices = field(default_factory=ModelChoices)  # departures from the robot file's columns
    # filters, window, delay; `preprocess.delay` is not used where `search_delay` is set
    preprocess: PreprocessChoices = field(default_factory=PreprocessChoices)
    search_delay: bool = True  # find the torque's delay from the data
    # end of the identification part of a single recording [s from its first stamp]; None takes the first 70 %
    split: float | None = None
    # joints that must be locked, and motors whose torques are used
    experiment: ExperimentChoices = field(default_factory=ExperimentChoices)

    def __post_init__(self) -> None:
        super().__post_init__()
        options = (("--reversals", self.reversals), ("--torques-of", self.experiment.torques_of))
        for option, given in options if self.estimator.equations == "energy" else ():
            if given:
                raise UsageError(
                    f"{option} has no meaning for --method {self.estimator.name}, whose equation is the whole arm's",
                    hint="use --method wls",
                )

    @property
    def estimator(self) -> MethodChoice:
        """The method with its options."""
        return chosen_method(self.method)

    def chooses_friction(self, stated: Friction) -> bool:
        """Whether the data choose the friction's terms: asked for, or where robot file and user state no model."""
        if self.model.friction is not None or self.model.experiment is not None:
            return self.model.friction == AUTO
        return stated.model == AUTO and self.estimator.equations == "torque"

    def finds_travels(self, model: DynamicModel) -> bool:
        """Whether pre-sliding travels are looked for; tanh(q̇/ε) in place of sign(q̇) is another model of the same."""
        return (
            self.presliding and self.estimator.equations == "torque" and model.smoothing == 0.0 and any(model.coulomb)
        )

    @property
    def reversal_share(self) -> float:
        """Share of its root mean square below which a motor's equation is left out."""
        if self.reversals is not None:
            return self.reversals
        return 0.0 if self.estimator.equations == "energy" else REVERSAL_SHARE


def apply_model_choices(model: DynamicModel, choices: ModelChoices, friction: Friction | None = None) -> DynamicModel:
    """The model with the user's columns, and the further friction terms of the user or of the robot file's section."""
    section = Friction() if friction is None else friction
    if choices.friction is not None:
        section = chosen_friction(section, choices.friction)
    model = replace(model, terms=friction_terms(section, model.joint_names))
    everywhere, nowhere = (True,) * model.dof, (False,) * model.dof
    changes: dict[str, tuple[bool, ...]] = {}
    if choices.experiment is not None:
        model = replace(model, terms=experiment_terms(choices.experiment, model.name, model.joint_names))
        changes |= {"viscous": everywhere, "coulomb": everywhere}
    if choices.friction is not None:
        for column in ("viscous", "coulomb"):
            changes[column] = everywhere if column in friction_columns(choices.friction) else nowhere
    if choices.offset is not None:
        changes["offset"] = everywhere if choices.offset else nowhere
    if choices.motor_inertia is not None:
        changes["motor_inertia"] = everywhere if choices.motor_inertia else nowhere
    model = replace(model, **changes)  # type: ignore[arg-type]
    if choices.smoothing is not None:
        model = replace(model, smoothing=choices.smoothing)
    return model


@dataclass(frozen=True)
class ConsistentFit:
    """The physically consistent model with its errors."""

    parameters: ConsistentParameters  # of the model
    # fit, validation: errors
    fit: Fit
    validation: Fit


@dataclass(frozen=True)
class FrictionFit:
    """What was found of the friction before the regression."""

    model: DynamicModel  # with all shapes and the load torque
    steps: tuple[FrictionStep, ...] = ()  # of complexity that were tried; empty without `--friction auto`
    rounds: int = 0  # that load torque and shapes took
    settled: bool = True  # whether they converged
    # root mean square error of the consistent model on held-out blocks without and with the chosen terms, each motor's
    # torque over its residual's standard deviation; None where none were chosen
    delivered: tuple[float, float] | None = None
    # the same on runs left out, without and with terms of the position; None where none were chosen
    by_run: tuple[float, float] | None = None
    travels: tuple[PreslidingTravel, ...] = ()  # of presliding


@dataclass(frozen=True)
class Identification:
    """The samples, series and matrices of an identification, which no file holds: `Identified` has the result."""

    # recordings, held_out_recordings: as given; without the latter, parts of the former were held out
    recordings: tuple[Recording, ...]
    held_out_recordings: tuple[Recording, ...]
    robot_file: RobotFile  # the robot it was done for
    model: DynamicModel  # the model
    experiment: Experiment  # joints that stood still, motors whose torques were used
    base: BaseParameters  # what such an experiment can identify of the arm
    choices: IdentifyChoices  # as given, with the cut-offs and the delay that were used
    # runs, validation_runs: prepared data
    runs: tuple[PreparedRun, ...]
    validation_runs: tuple[PreparedRun, ...]
    delay: DelaySearch | None  # the search, where one was made
    reduction: Reduction  # the plain equations, reduced
    estimation: Estimation  # the full model
    corrected: CorrectedCovariance  # its covariance for autocorrelated residuals
    pruned: Pruned  # the essential model
    consistent: ConsistentFit | None  # the physically consistent model; None where none was found
    # fit_series, validation_series: torques of the full model
    fit_series: tuple[TorqueSeries, ...]
    validation_series: tuple[TorqueSeries, ...]
    # fit, validation: errors of the full model
    fit: Fit
    validation: Fit
    essential: Essential  # model, with its errors
    validation_source: str  # what was held out, in words
    checks: tuple[Check, ...]  # that were raised
    friction: FrictionFit  # what was found of the friction before the regression
    shape_std: dict[tuple[str, int], float]  # σ of the friction's free shapes, by kind of their sensitivity and motor
    # friction held at an experiment's values, in no parameter above; None without an experiment
    held: HeldFriction | None = None
    presliding: Presliding | None = None  # pre-sliding travels; None where not asked for
    # cut-offs that were lowered because the positions jitter; None where they were not
    lowered: LoweredCutoffs | None = None
    held_out: tuple[HeldOutRun, ...] = ()  # the delivered model on each held-out run

    @property
    def delivered_fit(self) -> Fit:
        """Errors of the delivered model on the identification data."""
        return self.fit if self.consistent is None else self.consistent.fit

    @property
    def solution(self) -> LeastSquares:
        """The full model's."""
        return self.estimation.solution

    @property
    def warnings(self) -> list[str]:
        """Sentences of the checks, notes left out."""
        return texts(self.checks)

    @property
    def std(self) -> FloatArray:
        """Corrected standard deviations (b,) of the full model; inf where a parameter was not estimated."""
        deviations, corrected = np.full(self.base.count, np.inf), self.corrected
        further = 0.0 if corrected.curvature is None else corrected.curvature
        deviations[list(self.solution.active)] = np.hypot(np.sqrt(np.diag(corrected.covariance)), further)
        return deviations

    @property
    def repeatability(self) -> FloatArray | None:
        """Standard deviation (b,) of friction between runs, nan of what has none; None where it is unknown."""
        if self.corrected.repeatability is None:
            return None
        deviations = np.full(self.base.count, np.nan)
        deviations[list(self.solution.active)] = self.corrected.repeatability
        return deviations

    @property
    def estimate(self) -> Estimate:
        """Values and covariance, for merging."""
        return jackknifed_estimate(self.estimation.reduction, self.solution, self.corrected)

    @property
    def residual_tests(self) -> list[ResidualTests]:
        """The assumptions of least squares, tested per joint; none for a method that fits no torques."""
        if self.choices.estimator.equations == "energy":
            return []
        series = iter(self.fit_series)
        equations = []
        for run in self.runs:
            factor = run.prepared.parallel_filter.factor
            for segment in run.prepared.segments:
                counted = next(series).counted
                reversing = segment.reversing
                equations.append(counted if reversing is None else counted & ~reversing[:, ::factor])
        names = {joint: self.model.joint_names[joint] for joint in self.experiment.torques}
        memory = filter_memory(self.runs[0].prepared.parallel_filter)
        return residual_tests(self.fit_series, equations, memory, names)

    @property
    def joint_std(self) -> FloatArray:
        """Standard deviation (n,) of each joint's filtered torque residual [N·m]; nan where it was not used."""
        if self.choices.estimator.equations == "torque":
            rows = np.array([joint.rows for joint in self.reduction.joints])
            return np.where(rows > 0, self.solution.joint_std, np.nan)
        squares = sum(np.sum(torques.residual**2, axis=1) for torques in self.fit_series)
        counts = sum(np.sum(torque.counted, axis=1) for torque in self.fit_series)
        return np.asarray(np.sqrt(squares / np.maximum(1, counts)))
