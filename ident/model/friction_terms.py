"""Friction beside viscous, Coulomb and offset: power law, Stribeck, load and temperature (AUBO eq. 3-6).

Per motor, linear in its coefficients once the shapes α, v_s and the load torque τ_L are given:

    F = sign(q̇)·(Fs + Fv·|q̇|^α + Fb·exp(−(q̇/v_s)²) + Fl·|τ_L(q)|^k + √|q̇|·f(T)) + Fo

k is 1 (AUBO's Model II) or 2 (Model III, eq. 6); τ_L is the gravity torque of an earlier estimate (eq. 18). Eq. 5 has
f(T) = β1 + β2·T + β3·T⁻³, T in kelvin. Over the temperatures of a joint its three columns are nearly the same, so that
the model has the same function about a reference temperature T0:

    f(T) = Ft + Fts·(T − T0) + Ftc·((T0/T)³ − 1 + 3·(T − T0)/T0)

and `temperature_coefficients` gives the paper's β.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from daq.robot.schema import Friction, LoadFriction, TemperatureFriction
from drivers.core.arrays import FloatArray
from ident.model.parameters import Kind, Quantity

REFERENCE_TEMPERATURE = 298.15
"""T0 [K]."""

LEAST_TEMPERATURE_SPAN = 5.0
LEAST_CURVATURE_SPAN = 15.0
"""Temperatures of a joint must differ by these [K] to tell its slope, and AUBO eq. 5 with its curvature."""

SLOWEST = 1e-3
"""Speed [rad/s or m/s] below which the slopes of |q̇|^α and √|q̇|, unbounded at rest, are those at this speed."""

TEMPERATURE_KINDS: tuple[Quantity, ...] = ("temperature", "temperature_slope", "temperature_curvature")
"""Kinds of the columns with Ft, Fts and Ftc, in this order."""

FIRST_EXPONENT = 0.7
FIRST_STRIBECK_VELOCITY = 0.1
"""Shapes [-, rad/s or m/s] of joints whose are to be estimated, until they are."""

LOAD_POWERS: dict[LoadFriction, float] = {"linear": 1.0, "quadratic": 2.0}


Motion = tuple[tuple[int, float], ...]
"""(joint, factor) of the active joints that a motion is made of; Σ factor · q̇."""

States = Mapping[Motion, FloatArray]
"""Presliding states (…, m) in place of sign(q̇), by the motion that rubs (`ident.model.presliding`)."""

NO_STATES: States = {}


@dataclass(frozen=True)
class LoadTorque:
    """Parameters whose gravity torque the load-dependent friction follows (AUBO eq. 18).

    Attributes:
        columns: standard columns of links' parameters.
        values: of them; those of base parameters from an earlier estimate.
    """

    columns: tuple[int, ...]
    values: tuple[float, ...]


@dataclass(frozen=True)
class FrictionTerms:
    """Further friction of n motors, and its shapes.

    Attributes:
        exponent: α of |q̇|^α in the viscous column; 1 is linear.
        stribeck: whether there is a Stribeck column.
        stribeck_velocity: v_s [rad/s or m/s].
        load: how the friction grows with the load torque.
        temperature: "linear" in T, or "full" as AUBO eq. 5.
        load_torque: what the load torque follows from; without it there is no load column.
        free_exponent, free_stribeck_velocity: whether α and v_s are estimated.
        sensitivities: whether there are columns for the derivatives by the free shapes, through which a regression
            takes them for unknown: their parameters are a coefficient times a small change of its shape.
    """

    exponent: tuple[float, ...]
    stribeck: tuple[bool, ...]
    stribeck_velocity: tuple[float, ...]
    load: tuple[LoadFriction, ...]
    temperature: tuple[TemperatureFriction, ...]
    free_exponent: tuple[bool, ...]
    free_stribeck_velocity: tuple[bool, ...]
    load_torque: LoadTorque | None = None
    sensitivities: bool = False

    def has(self, kind: Kind) -> tuple[bool, ...]:
        """Whether each motor has a column of this kind, one of this module's."""
        nowhere = (False,) * len(self.exponent)
        if kind == "stribeck":
            return self.stribeck
        if kind == "load":
            return nowhere if self.load_torque is None else tuple(load != "none" for load in self.load)
        if kind in ("temperature", "temperature_slope"):
            return tuple(temperature != "none" for temperature in self.temperature)
        if kind == "temperature_curvature":
            return tuple(temperature == "full" for temperature in self.temperature)
        free = self.free_exponent if kind == "exponent" else self.free_stribeck_velocity
        return free if self.sensitivities else nowhere

    @property
    def shaped(self) -> bool:
        """Whether some shape is to be estimated."""
        return any(self.free_exponent) or any(self.free_stribeck_velocity)

    @property
    def loaded(self) -> bool:
        """Whether some friction is to follow a load torque, known or not."""
        return any(load != "none" for load in self.load)


@dataclass(frozen=True)
class FrictionConditions:
    """What friction depends on beside the velocity; None where the model asks for neither.

    Attributes:
        load_torque: (n, m) of the motors [N·m or N].
        temperature: (n, m) of the motors' joints [K].
        presliding: states in place of sign(q̇).
    """

    load_torque: FloatArray | None = None
    temperature: FloatArray | None = None
    presliding: States = field(default_factory=dict)


def friction_terms(friction: Friction, joint_names: Sequence[str]) -> FrictionTerms | None:
    """The further friction that a robot file's section asks for; None where it asks for none."""
    joints = [friction.joints.get(name) for name in joint_names]

    def chosen(key: str) -> list[Any]:
        of_joints = [None if joint is None else getattr(joint, key) for joint in joints]
        return [getattr(friction, key) if value is None else value for value in of_joints]

    exponents, velocities, stribeck = chosen("exponent"), chosen("stribeck_velocity"), chosen("stribeck")
    terms = FrictionTerms(
        exponent=tuple(FIRST_EXPONENT if value == "estimated" else value for value in exponents),
        stribeck=tuple(stribeck),
        stribeck_velocity=tuple(FIRST_STRIBECK_VELOCITY if value == "estimated" else value for value in velocities),
        load=tuple(chosen("load")),
        temperature=tuple(chosen("temperature")),
        free_exponent=tuple(value == "estimated" for value in exponents),
        free_stribeck_velocity=tuple(
            wanted and value == "estimated" for wanted, value in zip(stribeck, velocities, strict=True)
        ),
    )
    plain = all(value == 1.0 for value in exponents) and not any(stribeck)
    return None if plain and not terms.loaded and not any(terms.has("temperature")) else terms


def no_terms(dof: int) -> FrictionTerms:
    """No further friction of n motors, as a start from which terms are added."""
    return FrictionTerms(
        exponent=(1.0,) * dof,
        stribeck=(False,) * dof,
        stribeck_velocity=(FIRST_STRIBECK_VELOCITY,) * dof,
        load=cast(tuple[LoadFriction, ...], ("none",) * dof),
        temperature=cast(tuple[TemperatureFriction, ...], ("none",) * dof),
        free_exponent=(False,) * dof,
        free_stribeck_velocity=(False,) * dof,
    )


def power_law(velocity: FloatArray, exponent: float) -> FloatArray:
    """sign(q̇)·|q̇|^α; the velocity itself where α is 1."""
    return velocity if exponent == 1.0 else np.sign(velocity) * np.abs(velocity) ** exponent


def stribeck_share(velocity: FloatArray, stribeck_velocity: float) -> FloatArray:
    """exp(−(q̇/v_s)²), 1 at rest."""
    return np.asarray(np.exp(-np.square(velocity / stribeck_velocity)))


def temperature_factor(kind: Kind, kelvin: FloatArray) -> FloatArray | float:
    """What √|q̇| is multiplied with in one of the three temperature columns."""
    if kind == "temperature":
        return 1.0
    rise = kelvin - REFERENCE_TEMPERATURE
    if kind == "temperature_slope":
        return rise
    return np.asarray((REFERENCE_TEMPERATURE / kelvin) ** 3 - 1.0 + 3.0 * rise / REFERENCE_TEMPERATURE)


def temperature_coefficients(root: float, slope: float, curvature: float) -> tuple[float, float, float]:
    """β1, β2, β3 of AUBO eq. 5 from the coefficients Ft, Fts and Ftc."""
    reference = REFERENCE_TEMPERATURE
    return (
        root - slope * reference - 4.0 * curvature,
        slope + 3.0 * curvature / reference,
        curvature * reference**3,
    )


def root_coefficients(beta1: float, beta2: float, beta3: float) -> tuple[float, float, float]:
    """Ft, Fts and Ftc from β1, β2 and β3 of AUBO eq. 5."""
    reference = REFERENCE_TEMPERATURE
    curvature = beta3 / reference**3
    slope = beta2 - 3.0 * curvature / reference
    return beta1 + slope * reference + 4.0 * curvature, slope, curvature
