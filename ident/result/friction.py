"""Friction of a joint in a result, and the steps by which its terms were chosen."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from drivers.core.arrays import FloatArray
from drivers.core.units import joint_unit
from ident.friction.table import SHAPED, TEMPERATURE_KINDS, TERM, TERMS, temperature_estimate
from ident.friction.terms import FrictionTerms
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import KINDS
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.least_squares import LeastSquares
from ident.stored import Number, Stored, Value


def _known_kind(value: str) -> str:
    if value not in KINDS:
        raise ValueError(f"no parameter is of the kind '{value}'")
    return value


ParameterKind = Annotated[str, AfterValidator(_known_kind)]
"""Kind of a standard parameter, as `ident.model.parameters` names them."""


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
    + √|q̇|·(β1 + β2·T + β3·T⁻³)) + offset, T in kelvin, τ_L the load torque (`model_options.terms`); and what `further`
    has, as friction and torque ripple with periods per turn: cos and sin of the shape times q.
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
        return next((term.value for term in self.further if term.kind == kind), named)

    def shape_value(self, name: str) -> float | None:
        """The shape of this name; None where the joint has none but the plain one."""
        named: float | None = getattr(self, name, None)
        kinds = [term.kind for term in TERMS if term.shape is not None and term.shape.name == name]
        return next((further.shape for further in self.further if further.kind in kinds), named)

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
        for further in self.further:
            term = TERM[further.kind]
            shape = "" if further.shape is None else f", shape {_with_interval(further.shape, further.shape_std)}"
            if term.needs == "position":
                shape = f" of {further.shape:g} per turn"
            unit = joint_unit(term.unit(further.shape or 1.0), sliding=self.sliding)
            parts.append(f"{term.words} {_with_interval(further.value, further.std)} {unit}{shape}")
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


REPEATED_KINDS: tuple[str, ...] = ("viscous", "coulomb", "offset")
"""Those whose σ between runs it has, too."""


def friction_note(runs: int, repeatability: FloatArray | None) -> str:
    """Return what the intervals of friction hold of changes between the runs that were identified together."""
    if repeatability is not None:
        return (
            f"Intervals of friction hold for its mean over the {runs} runs and count how much it changed between them; "
            "repeatability is σ of that change, by which a single run differs from the mean."
        )
    runs_text = "one run" if runs == 1 else f"{runs} runs, whose changes this method does not estimate"
    return (
        f"Intervals of friction come from {runs_text}: they do not cover how much friction changes from run to run "
        "(temperature, load and rest before). Identify several recordings together to have that in them."
    )


NAMED_KINDS = tuple(kind for kind in TERM if kind in JointFrictionResult.model_fields and kind != "temperature")
"""Kinds whose values and deviations `JointFrictionResult` has by name; the temperature's are β there."""


def friction_fields(
    terms: FrictionTerms,
    motor: int,
    kinds: Collection[str],
    value: Callable[[str], float | None],
    std: Callable[[str], float | None],
) -> dict[str, Any]:
    """Fields of a joint's friction but those of the temperature."""
    fields: dict[str, Any] = {"further": []}
    for term in TERMS:
        if term.needs == "temperature":
            continue
        shape, own = term.shape, dict[str, float | None]()
        if shape is not None and term.kind in kinds and terms.shape(shape.name, motor) != shape.plain:
            own = {shape.name: terms.shape(shape.name, motor), f"{shape.name}_std": std(shape.name)}
        if term.kind in NAMED_KINDS:
            fields |= {term.kind: value(term.kind), f"{term.kind}_std": std(term.kind), **own}
        elif term.kind in kinds:
            shape_value, shape_std = own.values() or (None, None)
            fields["further"].append(
                FurtherFriction(
                    kind=term.kind, value=value(term.kind), std=std(term.kind), shape=shape_value, shape_std=shape_std
                )
            )
    return fields


def friction_results(
    model: DynamicModel,
    base: BaseParameters,
    solution: LeastSquares,
    std: FloatArray,
    covariance: FloatArray,
    shape_std: Mapping[tuple[str, int], float],
    repeatability: FloatArray | None = None,
) -> list[JointFrictionResult]:
    """Friction of each joint with a motor, from the full model's solution, corrected std (b,) and covariance (a, a).

    The σ of the estimated shapes is by kind of their sensitivity and motor; repeatability (b,) is the σ between runs.
    """
    position = {(kind, joint): i for i, (kind, joint) in enumerate(zip(base.kinds, base.joints, strict=True))}

    def value(kind: str, joint: int, values: FloatArray) -> float | None:
        i = position.get((kind, joint))
        return float(values[i]) if i is not None and i in solution.active else None

    def of_motor(motor: int, joint: int) -> dict[str, Any]:
        kinds = [kind for kind in TERM if model.has(kind)[motor]]
        stated = friction_fields(
            model.terms,
            motor,
            kinds,
            lambda kind: value(kind, joint, solution.parameters),
            lambda kind: shape_std.get((kind, motor)) if kind in SHAPED else value(kind, joint, std),
        )
        if repeatability is not None:
            stated |= {f"{kind}_repeatability": value(kind, joint, repeatability) for kind in REPEATED_KINDS}
        places = [position.get((kind, joint)) for kind in TEMPERATURE_KINDS]
        estimated = {term: place for term, place in enumerate(places) if place is not None and place in solution.active}
        if estimated:
            terms, rows = list(estimated), [solution.active.index(place) for place in estimated.values()]
            values, of_terms = np.zeros(3), np.zeros((3, 3))
            values[terms] = solution.parameters[list(estimated.values())]
            of_terms[np.ix_(terms, terms)] = covariance[np.ix_(rows, rows)]
            beta, deviations = temperature_estimate(values, of_terms)
            stated["temperature"], stated["temperature_std"] = beta.tolist(), deviations.tolist()
        return stated

    return [
        JointFrictionResult(joint=name, sliding=model.sliding[motor], **of_motor(motor, joint))
        for motor, (joint, name) in enumerate(zip(model.active, model.joint_names, strict=True))
    ]
