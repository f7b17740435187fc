"""The result of an identification: result.json, schema version 1 (DESIGN.md "The result")."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, computed_field, model_validator

from daq.robot.section import within
from drivers.core.arrays import FloatArray
from drivers.core.units import common_unit
from ident.assessment.delay.delay import DelaySearch
from ident.assessment.residual_tests import ResidualTests
from ident.assessment.validation import Fit
from ident.estimators.estimator import EstimationLoop
from ident.friction.table import FURTHER_KINDS, SHAPES
from ident.friction.terms import NO_TERMS, FrictionTerms
from ident.ranges import PRESLIDING_TRAVEL, RESULT_VALUE, SMOOTHING
from ident.regression.least_squares import LeastSquares
from ident.regression.pruning import Pruned
from ident.result.consistent_model import ConsistentModel, LinkResult
from ident.result.delivered import Delivered
from ident.result.estimate import EstimateResult, ExperimentResult, Merge
from ident.result.friction import FrictionStep, JointFrictionResult, ParameterKind
from ident.result.graded import ModelResult, ParameterResult, UsedRecording
from ident.signals.prepared import Step
from ident.stored import Number, Real, Stored
from ident.verdict.acceptance import Acceptance
from ident.verdict.check import texts
from ident.verdict.verdict import Verdict

RESULT_SCHEMA = 1


class BaseParameterResult(ParameterResult):
    """One base parameter of the full model; the standard deviations are corrected for autocorrelated residuals."""

    kind: ParameterKind
    rsd_percent: Number
    f_value: Number = Field(
        default=None, description="partial F: loss of fit without this parameter, AUBO Table II; (value / std)²"
    )
    gain_std: Number = Field(
        default=None,
        description="σ by the drive gains' gain_std in the robot file, not part of std; null where the method has no "
        "equations of single joints",
    )
    classical_std: Number = Field(description="for white residuals, SR400 eq. 14")
    significant: bool = Field(description="relative standard deviation below the threshold")
    essential_value: Number = Field(description="of the essential model; null where the parameter was left out")
    essential_std: Number = Field(
        description="root of the full model's variance plus the square of what the pruning changed"
    )
    repeatability: Number = Field(
        default=None,
        description="σ of friction between runs, which std counts for the mean over them; null with one run",
    )
    origin: str = Field(default="", description="of a value that was held; empty where the recordings give it")


class DriveGainResult(Stored):
    """The gain that turned the recorded signal into torque."""

    joint: str
    signal: str
    gain: Number
    std: Number


class Essential(Stored):
    """The model with significant parameters only."""

    count: int
    dropped: list[str]
    stopped_by: str
    fit: Fit | None = None
    validation: Fit | None = None

    @classmethod
    def of(cls, names: Sequence[str], pruned: Pruned, fit: Fit | None = None, validation: Fit | None = None) -> Self:
        """The essential model of base parameters (b,) by their names."""
        return cls(
            count=len(pruned.solution.active),
            dropped=[names[column] for column in pruned.dropped],
            stopped_by=pruned.stopped_by,
            fit=fit,
            validation=validation,
        )


class Residuals(Stored):
    """Statistics of the residuals."""

    rows: int = Field(description="equations: torques of single joints, or energies of the whole arm")
    effective_rows: Number
    joint_std: list[Number] = Field(description="standard deviation per joint, of the filtered torque [N·m]")
    autocorrelation: list[Number] = Field(description="at lag one, per joint")
    block_length: int = Field(description="samples per block of the jackknife, after filtering")
    blocks: int = Field(description="number of its blocks")
    repetitions: float = Field(description="how often the motion was repeated, on average")
    correction: str = Field(description="how the standard deviations were corrected")
    assumptions: list[ResidualTests] = Field(
        default_factory=list, description="tested per joint; joints with few independent residuals are left out"
    )


class Excitation(Stored):
    """How well the recordings excite the parameters."""

    condition: Number = Field(description="of W, columns not normalised")
    scaled_condition: Number = Field(description="of W, column-normalised")
    singular_values: list[float] = Field(description="of the column-normalised W, falling")
    unexcited: list[str] = Field(description="base parameters that the recording does not excite")

    @classmethod
    def of(cls, names: Sequence[str], solution: LeastSquares, factor: FloatArray) -> Self:
        """The excitation of base parameters (b,) by their names; a triangular factor (·, a) of the estimated ones."""
        return cls(
            condition=solution.condition,
            scaled_condition=solution.scaled_condition,
            singular_values=np.linalg.svd(factor / np.linalg.norm(factor, axis=0), compute_uv=False).tolist(),
            unexcited=[name for column, name in enumerate(names) if column not in solution.active],
        )


class RecordingUse(UsedRecording):
    """A recording used in the identification or the validation, and which part of it."""

    window: tuple[float, float] = Field(description="[s], from the recording's first stamp")
    samples: int
    rate_hz: float
    events: list[str] = Field(description="of the recording: repairs, gaps, assumptions")
    torques_of: list[str] = Field(default=[], description="motors whose torques were used")
    sample_hashes: list[int] = Field(
        default=[], description="the smallest hashes of the window's samples (ident.signals.sample_hashes)"
    )


def _check_shapes(shapes: Mapping[str, Sequence[float]]) -> None:
    for name, values in shapes.items():
        if name not in SHAPES:
            raise ValueError(f"terms.shapes: no friction term has a shape called '{name}'")
        for value in values:
            if not SHAPES[name].allowed.holds(value):
                raise ValueError(f"terms.shapes.{name}: {value:g} is not within {SHAPES[name].allowed}")


class ModelOptions(Stored):
    """Columns of a `DynamicModel`, whose geometry the robot file has."""

    motor_inertia: list[bool]
    viscous: list[bool]
    coulomb: list[bool]
    offset: list[bool]
    smoothing: Annotated[float, AfterValidator(within(SMOOTHING))]
    terms: Annotated[FrictionTerms, BeforeValidator(lambda given: NO_TERMS if given is None else given)] = Field(
        default=NO_TERMS, description="further friction, its shapes and its load torque"
    )

    @model_validator(mode="after")
    def _possible_terms(self) -> Self:
        """Refuse shapes that no friction has, and lists whose length is not the number of joints."""
        terms, count = self.terms, len(self.viscous)
        _check_shapes(terms.shapes)
        for value in () if terms.load_torque is None else terms.load_torque.values:
            if not RESULT_VALUE.holds(value):
                raise ValueError(f"terms.load_torque: {value:g} is not within {RESULT_VALUE}")
        if terms.load_torque is not None and len(terms.load_torque.columns) != len(terms.load_torque.values):
            raise ValueError("terms.load_torque: columns and values differ in number")
        if unknown := {kind for kinds in terms.kinds for kind in kinds} - set(FURTHER_KINDS):
            raise ValueError(f"terms.kinds: no further friction term is called '{min(unknown)}'")
        lists: dict[str, tuple[object, ...]] = {"kinds": terms.kinds}
        lists |= {f"shapes.{name}": values for name, values in terms.shapes.items()}
        lists |= {f"free.{name}": values for name, values in terms.free.items()}
        for name, entries in lists.items():
            if len(entries) != count and (entries or name != "kinds"):
                raise ValueError(f"terms.{name} has {len(entries)} entries for {count} joints")
        if (terms.shapes or terms.free) and not terms.kinds:
            raise ValueError("terms.kinds is empty, and there are shapes")
        if terms.sensitivities:
            raise ValueError("terms.sensitivities belongs to a regression, not to a result")
        return self


class JointEquations(Stored):
    """How one joint's equations took part in a robust estimate."""

    joint: str
    equations: int
    rejected: int = Field(description="of weight 0")
    mean_weight: Number


class Convergence(Stored):
    """What an iterative estimator did."""

    passes: int = Field(description="over the data")
    loops: list[EstimationLoop] = Field(description="innermost first")
    equations: list[JointEquations] = Field(default=[], description="empty where all count alike")
    joint_correlation: list[list[Number]] = Field(
        default=[], description="of the joints' residuals, by which the equations were whitened; else empty"
    )


class PreslidingTravel(Stored):
    """The pre-sliding travel of one motion."""

    parameter: str = Field(description="name of the motion's Coulomb parameter")
    travel: Annotated[float, AfterValidator(within(PRESLIDING_TRAVEL))] = Field(description="rad or m")
    std: Real = Field(description="σ, other parameters held")


class Presliding(Stored):
    """Dahl's state in place of sign(q̇) along a motion in time: in fit, validation and prediction."""

    travels: list[PreslidingTravel] = Field(description="where presliding lowers the error")
    static_error: Real = Field(
        description="relative, of held-out torques of joints below 0.1 rad/s, the same parameters without it"
    )
    error: Real = Field(description="the same with it")

    @property
    def by_parameter(self) -> dict[str, float]:
        """Travels [rad or m] by the name of the Coulomb parameter."""
        return {travel.parameter: travel.travel for travel in self.travels}


_LISTS_OF_JOINTS = (
    "joint_relative_error",
    "rmse",
    "low_speed_rmse",
    "high_speed_rmse",
    "max_error",
    "joint_std",
    "autocorrelation",
    "motor_inertia",
    "viscous",
    "coulomb",
    "offset",
)


class Result(ModelResult):
    """The outcome of an identification."""

    kind: Literal["result"] = "result"
    method_options: dict[str, float | int | str | bool | None] = Field(default={}, description="of the method")
    options: dict[str, float | int | str | bool | list[float] | None]
    model_options: ModelOptions
    preprocessing: list[Step]
    delay: DelaySearch
    base_parameters: list[BaseParameterResult]
    friction: list[JointFrictionResult]
    friction_note: str = Field(default="", description="what the intervals of friction hold of changes between runs")
    friction_steps: list[FrictionStep] = Field(default=[], description="empty without --friction auto")
    standard_parameters: list[LinkResult] | None = Field(
        default=None, description="of the physically consistent model; null where none was found"
    )
    consistent: ConsistentModel | None = None
    delivered: Delivered
    drive_gains: list[DriveGainResult] = Field(description="those that turned a recorded signal into torque")
    fit: Fit | None = Field(description="null for merged models, which are not fitted to recordings")
    validation: Fit | None
    validation_source: str
    essential: Essential
    excitation: Excitation
    residuals: Residuals
    rank_margin: Number
    recordings: list[RecordingUse]
    verdict: Verdict
    acceptance: Acceptance | None = Field(default=None, description="null where no limits were declared")
    experiments: list[ExperimentResult] = Field(default=[], description="empty: all joints moved, all torques used")
    merge: Merge | None = None
    estimate: EstimateResult | None = None
    convergence: Convergence | None = Field(default=None, description="null for methods that solve in one step")
    presliding: Presliding | None = Field(
        default=None, description="null where it was not looked for (--no-presliding, energy methods, smoothed sign)"
    )

    @model_validator(mode="after")
    def _lists_of_joints(self) -> Self:
        """Refuse lists whose length is not the number of joints."""
        count = len(self.joints)
        delivered = self.delivered
        fits = [self.fit, self.validation, self.essential.fit, self.essential.validation]
        fits += [delivered.fit, delivered.validation, delivered.validation_all_samples]
        if self.consistent is not None:
            fits += [self.consistent.fit, self.consistent.validation]
        for run in delivered.runs:
            fits += [run.in_motion, run.all_samples, run.full_in_motion, run.full_all_samples]
        for section in (*fits, self.residuals, self.model_options):
            for name, values in () if section is None else section:
                if name not in _LISTS_OF_JOINTS or len(values) == count:
                    continue
                raise ValueError(f"'{name}' has {len(values)} entries for {count} joints")
        return self

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Return whether each joint slides."""
        kinds = {joint.joint: joint.sliding for joint in self.friction}
        return tuple(kinds.get(name, False) for name in self.joints)

    def unit(self, unit: str) -> str:
        """The unit of a column of all joints, given that of turning joints: "N·m or N" where some slide."""
        return common_unit(unit, self.sliding)

    @computed_field(description="that of `excitation`")  # type: ignore[prop-decorator]
    @property
    def condition(self) -> float | None:
        """Condition number of the observation matrix."""
        return self.excitation.condition

    @computed_field(description="texts of the verdict's checks that spoil a purpose")  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """Sentences of the verdict's checks, notes left out."""
        return texts(self.verdict.checks)
