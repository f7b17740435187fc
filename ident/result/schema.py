"""The result of an identification: result.json, schema version 1 (DESIGN.md "The result")."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    computed_field,
    field_validator,
    model_validator,
)

from daq.output_files import replace_files, strange_files
from daq.robot.section import within
from drivers.core.errors import DynidWarning, ResultFileError
from drivers.core.files import RESULT_FILE, read_text
from drivers.core.units import common_unit, joint_unit
from ident.assessment.delay.delay import JointDelay
from ident.assessment.residual_tests import ResidualTests
from ident.assessment.validation import Fit
from ident.estimators.estimator import Loop
from ident.estimators.feasible.armature import Armature
from ident.friction.table import FURTHER_KINDS, SHAPES, TERM, TERMS
from ident.friction.terms import NO_TERMS, FrictionTerms
from ident.model.parameters import KINDS
from ident.ranges import PRESLIDING_TRAVEL, RESULT_VALUE, SMOOTHING
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.delivered import DeliveredParameters
from ident.signals.prepared import Step
from ident.simulation.open_loop import OpenLoop
from ident.simulation.tracking import TrackingError
from ident.stored import Number, Real, Stored, Value
from ident.verdict.acceptance import Acceptance
from ident.verdict.check import PURPOSES, Check, texts
from ident.verdict.verdict import Verdict

RESULT_SCHEMA = 1
UNITS: dict[str, str] = {
    **dict.fromkeys(("XX", "XY", "XZ", "YY", "YZ", "ZZ", "Ia", "Iac"), "kg·m²"),
    **dict.fromkeys(("MX", "MY", "MZ"), "kg·m"),
    "M": "kg",
    **{term.symbol: term.unit(1.0) for term in TERMS},
    "Fvm": "N·m·s/rad",
    "Fsm": "N·m",
}
"""Units by symbol, for revolute joints; of friction with a shape where that is 1."""


_NUMBERS = re.compile(r"\[\n[-+.0-9eEnul,\s]+\]")
"""A list of nothing but numbers, which stands in one line."""


def _known_kind(value: str) -> str:
    if value not in KINDS:
        raise ValueError(f"no parameter is of the kind '{value}'")
    return value


ParameterKind = Annotated[str, AfterValidator(_known_kind)]
"""Kind of a standard parameter, as `ident.model.parameters` names them."""


class BaseParameterResult(Stored):
    """One base parameter; the standard deviations are corrected for autocorrelated residuals."""

    name: str
    expression: str
    kind: ParameterKind
    joint: str
    unit: str
    value: Number = Field(description="of the full model; null where the recording does not excite it")
    std: Number
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


class FurtherFriction(Stored):
    """One friction term of a joint that has no fields of its own in `JointFrictionResult`."""

    kind: ParameterKind
    value: Number
    std: Number
    shape: Number = Field(default=None, description="null where the term has none")
    shape_std: Number = Field(default=None, description="null where it was not estimated")


class JointFrictionResult(Stored):
    """Friction of one joint; null where the model has no such column.

    F = sign(q̇)·(coulomb + viscous·|q̇|^exponent + stribeck·exp(−(q̇/stribeck_velocity)²) + load·|τ_L|^load_power
    + √|q̇|·(β1 + β2·T + β3·T⁻³)) + offset, T in kelvin, τ_L the load torque (`model_options.terms`).
    """

    joint: str
    sliding: bool = Field(default=False, description="whether the joint slides: N and m for N·m and rad")
    viscous: Number
    viscous_std: Number
    coulomb: Number
    coulomb_std: Number
    offset: Number = Field(description="of a joint that slides along gravity with its weight [N·m or N]")
    offset_std: Number
    exponent: Number = Field(default=None, description="α; null where friction is linear in the velocity")
    exponent_std: Number = Field(default=None, description="null where it was not estimated")
    stribeck: Number = Field(default=None, description="[N·m]")
    stribeck_std: Number = None
    stribeck_velocity: Number = Field(default=None, description="v_s [rad/s or m/s]")
    stribeck_velocity_std: Number = Field(default=None, description="null where it was not estimated")
    load: Number = Field(default=None, description="[(N·m)^(1 − load_power)]")
    load_std: Number = None
    load_power: Number = Field(default=None, description="1 (linear) or 2 (quadratic)")
    temperature: list[Value] | None = Field(default=None, description="β1, β2, β3 of AUBO eq. 5, T in kelvin")
    temperature_std: list[Number] | None = None
    further: list[FurtherFriction] = Field(default=[], description="terms beside those above")
    temperature_origin: str = Field(default="", description="of values that were held; empty otherwise")
    viscous_repeatability: Number = Field(default=None, description="σ between runs, as of the base parameter")
    coulomb_repeatability: Number = None
    offset_repeatability: Number = None

    def coefficient(self, kind: str) -> float | None:
        """Value of a term that depends on the velocity alone, or on the load; None where the joint has none."""
        named: float | None = getattr(self, kind, None)
        return next((one.value for one in self.further if one.kind == kind), named)

    def shape_value(self, name: str) -> float | None:
        """The shape of this name; None where the joint has none but the plain one."""
        named: float | None = getattr(self, name, None)
        kinds = [term.kind for term in TERMS if term.shape is not None and term.shape.name == name]
        return next((one.shape for one in self.further if one.kind in kinds), named)

    @property
    def repeatability_text(self) -> str:
        """σ between runs in print; empty where it is not known."""
        values = (self.viscous_repeatability, self.coulomb_repeatability, self.offset_repeatability)
        return (
            ", ".join("–" if value is None else f"{value:.2g}" for value in values)
            if any(value is not None for value in values)
            else ""
        )

    @property
    def terms_text(self) -> str:
        """The further terms in print; empty where there are none."""
        parts = []
        if self.exponent is not None:
            parts.append(f"α {_with_interval(self.exponent, self.exponent_std)}")
        if self.stribeck is not None:
            torque, speed = (joint_unit(unit, sliding=self.sliding) for unit in ("N·m", "rad/s"))
            velocity = _with_interval(self.stribeck_velocity, self.stribeck_velocity_std)
            parts.append(
                f"Stribeck {_with_interval(self.stribeck, self.stribeck_std)} {torque}, v_s {velocity} {speed}"
            )
        if self.load is not None:
            power = "²" if self.load_power == 2.0 else ""
            parts.append(f"load {_with_interval(self.load, self.load_std)} ·|τ_L|{power}")
        if self.temperature is not None:
            held = f" (held, {self.temperature_origin})" if self.temperature_origin else ""
            deviations = self.temperature_std or [None] * len(self.temperature)
            beta = (_with_interval(*pair) for pair in zip(self.temperature, deviations, strict=True))
            parts.append(f"β {', '.join(beta)}{held}")
        for one in self.further:
            shape = "" if one.shape is None else f", shape {_with_interval(one.shape, one.shape_std)}"
            unit = joint_unit(TERM[one.kind].unit(one.shape or 1.0), sliding=self.sliding)
            parts.append(f"{TERM[one.kind].words} {_with_interval(one.value, one.std)} {unit}{shape}")
        return "; ".join(parts)


def _with_interval(value: float | None, std: float | None) -> str:
    """A value, and half of its 95 % interval where it is known."""
    text = "–" if value is None else f"{value:.3g}"
    return text if std is None else f"{text} ± {WITHIN_95_PERCENT * std:.2g}"


class FrictionStep(Stored):
    """One step of complexity that `--friction auto` tried for a joint: the best one at that point."""

    joint: str
    term: str
    shape: Number = Field(description="α or v_s on the grid where the term has one")
    f_value: float = Field(description="partial F statistic, for the number of independent equations")
    freedom: int
    p_value: float
    error_before: float = Field(
        description="held-out error on blocks of the identification data, in the residuals' standard deviations"
    )
    error_after: Number
    accepted: bool


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
    fit: Fit | None
    validation: Fit | None


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


class ExperimentResult(Stored):
    """What the recordings make identifiable: joints that were locked, motors whose torques were used."""

    locked: dict[str, list[Value]] = Field(description="positions of a joint at rest, one per pose [rad or m]")
    torques_of: list[str]


class LinkResult(Stored):
    """A link of the physically consistent model, in the frame of its joint."""

    link: str = Field(description="name of the joint that moves it")
    mass: Value = Field(description="[kg]")
    com: list[Value] = Field(description="centre of mass [m]", min_length=3, max_length=3)
    inertia: dict[str, Value] = Field(description="xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]")
    prior: str = Field(description="where the body comes from that fills in what the data leave open")
    identified: float = Field(description="share of its ten parameters that the data determine")


class StandardParameterResult(Stored):
    """One standard parameter of the physically consistent model."""

    name: str
    unit: str
    value: Value
    std: Number = Field(description="null where the data do not determine it")
    determined: float = Field(description="share that the data determine; the rest comes from the prior")
    known: bool = Field(description="named in the robot file")


class ConsistentModel(Stored):
    """The model whose links, inertias and friction can exist, and what this costs."""

    parameters: list[StandardParameterResult]
    base_values: dict[str, Value] = Field(description="base parameters of these standard parameters, by name")
    prior_distance: str
    prior_weight: float = Field(description="in equations of unit variance per link")
    misfit: float = Field(description="rise of the sum of squared residuals, each of unit variance")
    p_value: Number = Field(description="probability of a greater rise if the truth is consistent (F-test)")
    boundary: list[str] = Field(description="links that the conditions hold near the boundary")
    limits_hit: list[str] = Field(description="ranges of the robot file that hold a parameter")
    fit: Fit | None
    validation: Fit | None
    simulation: TrackingError | None = None
    not_simulated: str = Field(default="", description="why `simulation` is null; empty in results of earlier versions")
    armature: list[Armature] = Field(
        default_factory=list, description="of the joints whose drive says `inertia: false`"
    )
    apparent_mass: Number = Field(
        default=None, description="of all links, were they all heavier than their prior by one factor [kg]"
    )


class HeldOutErrors(Stored):
    """The delivered model on one held-out recording."""

    recording: str
    overlap: float = Field(description="share of its samples that are the identification's own; 0: it is held out")
    at_rest: Number = Field(description="share of its torques that are of motors at rest")
    in_motion: Fit = Field(description="motors at rest left out, as in the fit")
    all_samples: Fit = Field(description="rest included: what a user of the model meets")
    graded_joint_error: list[Number] = Field(
        description="joint_relative_error of all samples, over at least a share of the joint's rated torque"
    )
    full_in_motion: Fit | None = Field(description="of the full model; null where that is the delivered one")
    full_all_samples: Fit | None = None
    simulation: TrackingError | None = Field(default=None, description="with a soft controller")
    open_loop: OpenLoop | None = Field(default=None, description="without one")
    not_simulated: str = Field(default="", description="why there is no simulation")
    checks: list[Check] = Field(default=[], description="that this recording raises, among the verdict's")

    @property
    def held_out(self) -> bool:
        """Whether none of its samples was used in the identification."""
        return self.overlap == 0.0


class Delivered(Stored):
    """The model that `load_model`, `predict` and the exports hand out by default, which the verdict grades."""

    parameters: DeliveredParameters
    fit: Fit | None = Field(description="on the identification data; null for merged models")
    validation: Fit | None = Field(description="in motion, over all held-out recordings")
    validation_all_samples: Fit | None = Field(description="the same with samples at rest")
    runs: list[HeldOutErrors] = Field(default=[], description="each held-out recording apart")


class EstimateResult(Stored):
    """The estimated values with their whole covariance, for merging; see ident.regression.estimate."""

    parameters: list[str] = Field(description="names of the estimated base parameters, a of them")
    root: list[list[Value]] = Field(description="(a, a) upper triangular; its square is the inverse covariance")
    covariance: list[list[Number]] = Field(description="(a, a) corrected for autocorrelated residuals")
    within: list[list[Number]] | None = Field(
        default=None, description="(a, a) the same without what changes between runs; null where that is all of it"
    )
    taken_up: dict[str, list[Value]] = Field(description="how an unexcited parameter is absorbed by each estimated one")
    blocks: int = Field(description="of the jackknife behind the covariance")

    @field_validator("root", "covariance", "within")
    @classmethod
    def _sound(cls, rows: list[list[float | None]] | None, info: ValidationInfo) -> list[list[float | None]] | None:
        """Refuse what is no triangular factor, or no covariance, of the parameters."""
        size = len(info.data.get("parameters", rows or ()))
        if rows is None:
            return None
        if len(rows) != size or any(len(row) != size for row in rows):
            raise ValueError(f"is not {size} by {size}")
        if not size:
            return rows
        matrix = np.array([[np.inf if value is None else value for value in row] for row in rows], dtype=np.float64)
        if info.field_name == "root":
            if not np.all(np.isfinite(matrix)) or not np.all(np.diag(matrix)) or np.any(np.tril(matrix, -1)):
                raise ValueError("is no triangular factor")
            return rows
        finite = np.isfinite(np.diag(matrix))
        inner = matrix[np.ix_(finite, finite)]
        if not np.all(np.isfinite(inner)) or np.any(np.diag(inner) < 0) or not np.allclose(inner, inner.T, rtol=1e-6):
            raise ValueError("is no covariance")
        return rows


class MergedModel(Stored):
    """One of the models that were merged."""

    file: str
    method: str
    experiments: list[ExperimentResult]
    parameters: int = Field(description="number of estimated base parameters")
    variance_ratio: float = Field(
        description="mean variance corrected for autocorrelated residuals, over that for white ones"
    )


class Contradiction(Stored):
    """A value that differs significantly from the merged one."""

    file: str
    parameter: str
    value: float = Field(description="of that model")
    merged: float = Field(description="the same combination of standard parameters, of the merged model")
    deviations: float = Field(description="difference in its own standard deviations")


class Consistency(Stored):
    """Whether the merged models agree on what they share, as a chi-square test."""

    statistic: float
    freedom: int = Field(description="number of combinations that more than one model identifies")
    p_value: float = Field(description="probability of a larger statistic if the models agree")
    agree: bool
    text: str
    contradictions: list[Contradiction]


class Merge(Stored):
    """Where a merged model comes from."""

    models: list[MergedModel]
    consistency: Consistency | None = Field(description="null where the models share nothing, or too little is known")


class RecordingUse(Stored):
    """A recording used in the identification or the validation."""

    file: str
    sha256: str
    role: Literal["identification", "validation"]
    window: tuple[float, float] = Field(description="[s], from the recording's first stamp")
    samples: int
    rate_hz: float
    events: list[str] = Field(description="of the recording: repairs, gaps, assumptions")
    torques_of: list[str] = Field(default=[], description="motors whose torques were used")
    sample_hashes: list[int] = Field(
        default=[], description="the smallest hashes of the window's samples (ident.signals.sample_hashes)"
    )


class DelayFigures(Stored):
    """Torque against position [s]; positive where the torque lags."""

    used: float = Field(description="of all joints that have none of their own")
    best: Number = Field(description="the delay that fits best for all joints together; null where it was not searched")
    note: str
    interval: Number = Field(default=None, description="half of the 95 % interval of `best`")
    gain: Number = Field(default=None, description="share by which `best` lowers the error on blocks held out")
    leads: bool = Field(default=False, description="the torque is ahead of its motion beyond the interval")
    joints: list[JointDelay] = Field(default=[], description="empty where it was not searched")


def _check_shapes(shapes: Mapping[str, Sequence[float]]) -> None:
    for name, values in shapes.items():
        if name not in SHAPES:
            raise ValueError(f"terms.shapes: no friction term has a shape called '{name}'")
        for value in values:
            if not SHAPES[name].allowed.holds(value):
                raise ValueError(f"terms.shapes.{name}: {value:g} is not within {SHAPES[name].allowed}")


class ModelOptions(Stored):
    """Which columns the model has."""

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
    loops: list[Loop] = Field(description="innermost first")
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
        return {one.parameter: one.travel for one in self.travels}


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


class Result(Stored):
    """The outcome of an identification."""

    dynid_schema: Literal[1] = 1
    kind: Literal["result"] = "result"
    created: str
    robot: str
    robot_file: str
    urdf: str
    joints: list[str]
    method: str
    method_options: dict[str, float | int | str | bool | None] = Field(default={}, description="of the method")
    options: dict[str, float | int | str | bool | list[float] | None]
    model_options: ModelOptions
    preprocessing: list[Step]
    delay: DelayFigures
    base_parameters: list[BaseParameterResult]
    friction: list[JointFrictionResult]
    friction_note: str = Field(default="", description="what the intervals of friction hold of changes between runs")
    friction_steps: list[FrictionStep] = Field(default=[], description="empty without --friction auto")
    standard_parameters: list[LinkResult] | None = Field(
        default=None, description="of the physically consistent model; null where none was found"
    )
    consistent: ConsistentModel | None = None
    delivered: Delivered | None = Field(default=None, description="null in results of earlier versions")
    drive_gains: list[DriveGainResult] = Field(description="those that turned a recorded signal into torque")
    fit: Fit | None = Field(description="null for merged models, which are not fitted to recordings")
    validation: Fit | None
    validation_source: str
    essential: Essential
    excitation: Excitation
    condition: Number
    residuals: Residuals
    rank_margin: Number
    recordings: list[RecordingUse]
    versions: dict[str, str]
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
        fits = [self.fit, self.validation, self.essential.fit, self.essential.validation]
        if self.consistent is not None:
            fits += [self.consistent.fit, self.consistent.validation]
        if self.delivered is not None:
            fits += [self.delivered.fit, self.delivered.validation, self.delivered.validation_all_samples]
            for run in self.delivered.runs:
                fits += [run.in_motion, run.all_samples, run.full_in_motion, run.full_all_samples]
        for part in (*fits, self.residuals, self.model_options):
            for name, values in () if part is None else part:
                if name not in _LISTS_OF_JOINTS or len(values) == count:
                    continue
                raise ValueError(f"'{name}' has {len(values)} entries for {count} joints")
        return self

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Whether each joint slides."""
        kinds = {joint.joint: joint.sliding for joint in self.friction}
        return tuple(kinds.get(name, False) for name in self.joints)

    def unit(self, unit: str) -> str:
        """The unit of a column of all joints, given that of turning joints: "N·m or N" where some slide."""
        return common_unit(unit, self.sliding)

    @computed_field(description="texts of the verdict's checks that spoil a purpose")  # type: ignore[prop-decorator]
    @property
    def warnings(self) -> list[str]:
        """Sentences of the verdict's checks, notes left out."""
        return texts(self.verdict.checks)

    @model_validator(mode="before")
    @classmethod
    def _verdict_of_text(cls, content: Any) -> Any:
        """Read results that were written before the verdict had parts: its text becomes the headline.

        Its warnings do not say what they spoil, so each of them spoils every purpose.
        """
        if not isinstance(content, dict) or not isinstance(content.get("verdict"), str):
            return content
        given = content.get("warnings")
        checks = [
            {"name": "unnamed", "severity": "warning", "purposes": PURPOSES, "text": text}
            for text in (given if isinstance(given, list) else [])
        ]
        return {**content, "verdict": {"headline": content["verdict"], "checks": checks}}


def write_result(path: Path, result: Result) -> None:
    """Write result.json.

    Raises:
        UsageError, DiskError: it cannot be written.
    """
    replace_files({path: result_file_text(result)})


def result_file_text(result: Result) -> str:
    """The text of result.json."""
    return result_json(result) + "\n"


def result_json(result: Result) -> str:
    """The JSON text, strict: null stands for what is not a number."""
    text = json.dumps(json.loads(result.model_dump_json()), ensure_ascii=False, indent=1, allow_nan=False)
    return _NUMBERS.sub(lambda match: re.sub(r"\s+", " ", match[0]), text)


def read_result(path: Path) -> Result:
    """Read a result.json.

    Raises:
        ResultFileError: no such file, no JSON, another kind of file, a newer schema, a missing key.
    """
    where = str(path)
    try:
        content = json.loads(read_text(path, RESULT_FILE, ResultFileError))
    except (ValueError, RecursionError) as error:  # also a number of more than 4,300 digits
        raise ResultFileError(f"is not JSON: {error}", where=where) from error
    if not isinstance(content, dict) or content.get("kind") != "result":
        raise ResultFileError("is not a result of dynid identify (no key 'kind': 'result')", where=where)
    schema = content.get("dynid_schema")
    if not isinstance(schema, int) or schema > RESULT_SCHEMA:
        raise ResultFileError(
            f"has schema version {schema}, this dynid reads up to {RESULT_SCHEMA}", where=where, hint="update dynid"
        )
    for strange in strange_files(path, content):
        warnings.warn(
            f"{strange} was not written with {path.name}, or was changed: a command that wrote both may have been "
            f"killed; run it again with --force",
            DynidWarning,
            stacklevel=2,
        )
    try:
        return Result.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(key) for key in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise ResultFileError(message, where=f"{where}: {key}" if key else where, hint="identify again") from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
