"""The table of friction terms: a term is known to dynid by its entry here, and nowhere else.

Per motor, linear in its coefficients once the shapes α, v_s, k and the load torque τ_L are given (AUBO eq. 3-6):

    F = sign(q̇)·(Fs + Fv·|q̇|^α + Fb·exp(−(q̇/v_s)²) + Fl·|τ_L(q)|^k + √|q̇|·f(T) + Fpc·cos nq + Fps·sin nq)
        + Rc·cos mq + Rs·sin mq + Fo

k is 1 (AUBO's Model II) or 2 (Model III, eq. 6); τ_L is the gravity torque of an earlier estimate (eq. 18). Eq. 5 has
f(T) = β1 + β2·T + β3·T⁻³, T in kelvin. Over the temperatures of a joint its three columns are nearly the same, so that
the model has the same function about a reference temperature T0:

    f(T) = Ft + Fts·(T − T0) + Ftc·((T0/T)³ − 1 + 3·(T − T0)/T0)

and `temperature_coefficients` gives the paper's β. Friction and torque with n and m periods per turn are those of gears
that are eccentric or out of line. To add a term, add its `Term` to `TERMS`: regression, estimators,
simulation, prediction, C code, exports and report read it from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.ranges import EXPONENT, STRIBECK_VELOCITY, Range

REFERENCE_TEMPERATURE = 298.15
"""T0 [K]."""

LEAST_TEMPERATURE_SPAN = 5.0
LEAST_CURVATURE_SPAN = 15.0
"""Temperatures of a joint must differ by these [K] to tell its slope, and AUBO eq. 5 with its curvature."""

SLOPE_SPEED = 1e-3
"""Speed [rad/s or m/s] below which the slopes of |q̇|^α and √|q̇|, unbounded at rest, are those at this speed."""


@dataclass(frozen=True)
class Maths:
    """The functions that terms are written with, of arrays or of expressions of C code."""

    sign: Callable[[Any], Any]  # 1, 0 or −1
    power: Callable[[Any, float], Any]  # |x| to a positive constant
    decay: Callable[[Any], Any]  # exp(−x)
    # cosine, sine: of an angle [rad]
    cosine: Callable[[Any], Any]
    sine: Callable[[Any], Any]


ARRAYS = Maths(np.sign, lambda value, exponent: np.abs(value) ** exponent, lambda value: np.exp(-value), np.cos, np.sin)
"""The functions of arrays."""


@dataclass(frozen=True)
class Operands:
    """What a term's signal is made of, arrays (m,) or expressions, at one motor."""

    rate: Any  # velocity that the term follows [rad/s or m/s]
    direction: Any = None  # its sign, smoothed or with a presliding state; None for terms that are not dry
    # exponent of |q̇| or of the load torque, Stribeck velocity [rad/s or m/s], or number of periods per turn
    shape: float = 1.0
    load: Any = None  # load torque of the motor [N·m or N]; None where the term does not need it
    kelvin: Any = None  # temperature of the joint [K]; None where the term does not need it
    maths: Maths = ARRAYS  # functions of these
    # derivative of `direction` by the velocity, for slopes: 0 but where the sign is smoothed
    direction_slope: FloatArray | float = 0.0
    angle: Any = None  # position of the motor [rad]; None where the term does not need it

    @property
    def floored(self) -> FloatArray:
        """|q̇| (m,) of arrays, `SLOPE_SPEED` at least."""
        return np.asarray(np.maximum(np.abs(self.rate), SLOPE_SPEED))


Signal = Callable[[Operands], Any]

Need = Literal["", "load", "temperature", "position"]
"""What a term's signal can depend on beside the velocity."""


@dataclass(frozen=True)
class Derivative:
    """The column that is a term's derivative by its shape.

    Times the term's coefficient it is what a small change of the shape does.
    """

    symbol: str  # of its parameter
    signal: Signal  # the derivative
    slope: Signal  # of it over the velocity


@dataclass(frozen=True)
class Shape:
    """A shape parameter of a term: what its signal depends on beside velocity, load and temperature."""

    name: str  # in files; also the kind of its derivative's column
    text: str  # in words, and its unit for turning joints
    unit: str
    allowed: Range  # its range
    first: float  # value until it is estimated
    # value without which the term is none, or the plain one; None where each motor with the term has a shape
    plain: float | None
    grid: tuple[float, ...]  # values that its search begins from; shares of a motor's greatest speed where `relative`
    relative: bool
    # of the signal by the shape; None of a shape that is chosen from the grid and not estimated
    derivative: Derivative | None
    left_out: str = ""  # what a format with the plain term lacks, in words before the joints' values


@dataclass(frozen=True)
class FrictionOption:
    """A word of `--friction`, and what a motor gets by it."""

    word: str  # as the user writes it
    group: str  # key of the robot file's `friction`, or the word; of a group a motor has one
    value: object  # that the key has
    kinds: tuple[str, ...]  # of the columns
    shape: float | None = None  # of the first of them, known; None where there is none, or one that is estimated
    bends: bool = False  # whether it gives a shape to a column that is there without it


@dataclass(frozen=True)
class Term:
    """One friction column of a motor."""

    kind: str  # its name in files
    symbol: str  # of its parameter
    unit: Callable[[float], str]  # of its coefficient, for turning joints, by the shape's value
    signal: Signal  # what the coefficient multiplies
    slope: Signal  # derivative (m,) of the signal by the velocity; sign(q̇) counts as constant where it is not smoothed
    # words, colour, marker: how it is called and drawn in reports
    words: str
    colour: str
    marker: str
    dry: bool = False  # whether sign(q̇) multiplies it and it does not vanish at rest
    brakes: bool = True  # whether its coefficient is not negative on any arm
    rubs: bool = True  # whether it is friction, and not a torque that is the same in both directions
    needs: Need = ""  # what its signal depends on beside the velocity
    shape: Shape | None = None  # a parameter that the signal has beside the coefficient; None where there is none
    options: tuple[FrictionOption, ...] | None = None  # how a user asks for it; where None, by its kind
    left_out: str = ""  # what a format lacks that has no such term, in words; empty where another term's entry says it


def power_law(velocity: FloatArray, exponent: float) -> FloatArray:
    """sign(q̇)·|q̇|^α; the velocity itself where α is 1."""
    return np.asarray(_power_law(Operands(velocity, shape=exponent)))


def _power_law(at: Operands) -> Any:
    return at.rate if at.shape == 1.0 else at.maths.sign(at.rate) * at.maths.power(at.rate, at.shape)


def _power_law_slope(at: Operands) -> Any:
    return 1.0 if at.shape == 1.0 else at.shape * at.floored ** (at.shape - 1.0)


def _power_law_by_exponent(at: Operands) -> Any:
    speed = np.maximum(np.abs(at.rate), np.finfo(np.float64).tiny)
    return np.sign(at.rate) * speed**at.shape * np.log(speed)


def _stribeck_share(at: Operands) -> Any:
    """exp(−(q̇/v_s)²), 1 at rest."""
    ratio = at.rate / at.shape
    return at.maths.decay(ratio * ratio)


def _stribeck_slope(at: Operands) -> Any:
    return _stribeck_share(at) * (at.direction_slope - 2.0 * at.direction * at.rate / at.shape**2)


def _stribeck_by_velocity(at: Operands) -> Any:
    return at.direction * _stribeck_share(at) * 2.0 * np.square(at.rate) / at.shape**3


def _stribeck_by_velocity_slope(at: Operands) -> Any:
    along = 2.0 * at.rate * at.direction * _stribeck_share(at)
    return (_stribeck_slope(at) * np.square(at.rate) + along) * 2.0 / at.shape**3


def temperature_factor(kind: str, kelvin: FloatArray) -> FloatArray | float:
    """Return what √|q̇| is multiplied with in one of the three temperature columns."""
    if kind == "temperature":
        return 1.0
    rise = kelvin - REFERENCE_TEMPERATURE
    if kind == "temperature_slope":
        return rise
    return np.asarray((REFERENCE_TEMPERATURE / kelvin) ** 3 - 1.0 + 3.0 * rise / REFERENCE_TEMPERATURE)


def _temperature_term(
    kind: str,
    symbol: str,
    unit: str,
    words: str,
    colour: str,
    marker: str,
    left_out: str = "",
    options: tuple[FrictionOption, ...] = (),
) -> Term:
    """√|q̇| times one function of the temperature (AUBO eq. 5)."""
    return Term(
        kind,
        symbol,
        lambda _: unit,
        lambda at: power_law(at.rate, 0.5) * temperature_factor(kind, at.kelvin),
        lambda at: 0.5 * at.floored**-0.5 * temperature_factor(kind, at.kelvin),
        words,
        colour,
        marker,
        brakes=False,
        needs="temperature",
        options=options,
        left_out=left_out,
    )


HARMONICS = (1, 2, 3, 4, 6, 8, 12)
"""Periods per turn of the terms that depend on the position."""


def _periodic_terms(name: str, symbol: str, words: str, colours: tuple[str, str], *, rubs: bool) -> tuple[Term, Term]:
    """The cosine and sine of nq, times sign(q̇) where they are friction; q is the motor's position, n their shape."""
    harmonic = Shape(
        f"{name}_harmonic",
        f"periods of the {words} per turn",
        "",
        Range(1.0, float(HARMONICS[-1])),
        first=1.0,
        plain=None,
        grid=tuple(map(float, HARMONICS)),
        relative=False,
        derivative=None,
    )

    def wave(at: Operands, part: str) -> Any:
        turned: Any = (at.maths.cosine if part == "cos" else at.maths.sine)(at.angle * at.shape)
        return turned

    def term(part: Literal["cos", "sin"], marker: str, options: tuple[FrictionOption, ...]) -> Term:
        return Term(
            f"{name}_{part}",
            f"{symbol}{part[0]}",
            lambda _: "N·m",
            (lambda at: at.direction * wave(at, part)) if rubs else (lambda at: wave(at, part)),
            (lambda at: at.direction_slope * wave(at, part)) if rubs else (lambda _: 0.0),
            f"{words}, {part}",
            colours[part == "sin"],
            marker,
            dry=rubs,
            brakes=False,
            rubs=rubs,
            needs="position",
            shape=harmonic,
            options=options,
            left_out=words if part == "cos" else "",
        )

    kinds = (f"{name}_cos", f"{name}_sin")
    options = tuple(FrictionOption(f"{name}-{n}", name, n, kinds, float(n)) for n in HARMONICS)
    return term("cos", "triangle-left", options), term("sin", "triangle-right", ())


TERMS: tuple[Term, ...] = (
    Term(
        "viscous",
        "Fv",
        lambda shape: "N·m·s/rad" if shape == 1.0 else f"N·m·(s/rad)^{shape:.3g}",
        _power_law,
        _power_law_slope,
        "viscous friction",
        "#009E73",
        "triangle-up",
        shape=Shape(
            "exponent",
            "exponent α",
            "",
            EXPONENT,
            first=0.7,
            plain=1.0,
            # Without 0.5, which is that of the temperature columns.
            grid=(0.2, 0.3, 0.4, 0.55, 0.65, 0.75, 0.87, 1.2, 1.4, 1.7),
            relative=False,
            derivative=Derivative(
                "Fve",
                _power_law_by_exponent,
                lambda at: at.floored ** (at.shape - 1.0) * (at.shape * np.log(at.floored) + 1.0),
            ),
            left_out="viscous friction that grows with |q̇|^α, α",
        ),
        options=(FrictionOption("power", "exponent", "estimated", ("viscous",), bends=True),),
    ),
    Term(
        "coulomb",
        "Fs",
        lambda _: "N·m",
        lambda at: at.direction,
        lambda at: at.direction_slope,
        "Coulomb friction",
        "#D55E00",
        "diamond",
        dry=True,
        options=(),
    ),
    Term(
        "offset",
        "Fo",
        lambda _: "N·m",
        lambda at: 1.0,
        lambda at: 0.0,
        "offset",
        "#7C828A",
        "cross",
        brakes=False,
        rubs=False,
        options=(),
    ),
    Term(
        "stribeck",
        "Fb",
        lambda _: "N·m",
        lambda at: at.direction * _stribeck_share(at),
        _stribeck_slope,
        "Stribeck friction",
        "#56B4E9",
        "diamond-tall",
        dry=True,
        shape=Shape(
            "stribeck_velocity",
            "Stribeck velocity",
            "rad/s",
            STRIBECK_VELOCITY,
            first=0.1,
            plain=None,
            grid=(0.02, 0.03, 0.042, 0.06, 0.085, 0.12, 0.17, 0.24, 0.34, 0.5),
            relative=True,
            derivative=Derivative("Fbv", _stribeck_by_velocity, _stribeck_by_velocity_slope),
        ),
        left_out="Stribeck friction",
    ),
    Term(
        "load",
        "Fl",
        lambda power: "1" if power == 1.0 else "1/(N·m)",
        lambda at: at.direction * at.maths.power(at.load, at.shape),
        lambda at: at.direction_slope * np.abs(at.load) ** at.shape,
        "friction by load",
        "#8C564B",
        "square-cross",
        dry=True,
        needs="load",
        shape=Shape(
            "load_power",
            "power of the load torque",
            "",
            Range(1.0, 2.0),
            first=1.0,
            plain=None,
            grid=(1.0, 2.0),
            relative=False,
            derivative=None,
        ),
        options=(
            FrictionOption("load-linear", "load", "linear", ("load",), 1.0),
            FrictionOption("load", "load", "quadratic", ("load",), 2.0),
        ),
        left_out="load-dependent friction",
    ),
    _temperature_term(
        "temperature",
        "Ft",
        "N·m·(s/rad)^½",
        "friction by speed's root",
        "#AA3377",
        "star",
        "temperature-dependent friction",
        (
            FrictionOption("temperature-linear", "temperature", "linear", ("temperature", "temperature_slope")),
            FrictionOption(
                "temperature", "temperature", "full", ("temperature", "temperature_slope", "temperature_curvature")
            ),
        ),
    ),
    _temperature_term(
        "temperature_slope", "Fts", "N·m·(s/rad)^½/K", "friction by temperature", "#66A61E", "star-diamond"
    ),
    _temperature_term(
        "temperature_curvature", "Ftc", "N·m·(s/rad)^½", "friction by temperature, curved", "#6A5ACD", "hexagram"
    ),
    *_periodic_terms("position", "Fp", "friction by position", ("#8A6D3B", "#B89B5E"), rubs=True),
    *_periodic_terms("ripple", "R", "torque ripple", ("#3B6E8A", "#6FA3BF"), rubs=False),
)
"""Every friction term, in the order of the columns (SR400 eq. 6-7; Fo as f_o in AUBO eq. 6)."""

TERM: dict[str, Term] = {term.kind: term for term in TERMS}
"""The terms by kind."""

SHAPES: dict[str, Shape] = {term.shape.name: term.shape for term in TERMS if term.shape is not None}
"""The shapes by name."""

SHAPED: dict[str, Term] = {term.shape.name: term for term in TERMS if term.shape is not None and term.shape.derivative}
"""Terms with a shape that can be estimated, by its name, which is also the kind of the derivative's column."""

OPTIONS: tuple[FrictionOption, ...] = tuple(
    option
    for term in TERMS
    for option in (
        (FrictionOption(term.kind, term.kind, True, (term.kind,)),) if term.options is None else term.options
    )
)
"""What a user can ask for beside viscous, Coulomb and offset, in the order in which terms are tried."""

FURTHER_KINDS: tuple[str, ...] = tuple(
    term.kind for term in TERMS if any(term.kind in option.kinds and not option.bends for option in OPTIONS)
)
"""Kinds of the columns that motors have only where an option asks for them."""

FRICTION_KINDS: tuple[str, ...] = (*TERM, *SHAPED)
"""Kinds of the columns of a motor's own friction, offset included."""

DISSIPATIVE_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.brakes)
"""Those whose coefficient is not negative on any arm."""

DRY_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.dry)
"""Those that sign(q̇) multiplies and that do not vanish at rest."""

RUBBING_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.rubs)
"""Those of friction, which takes power or, where the coefficient is negative, gives it."""

POSITION_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.needs == "position")
"""Kinds of the columns that repeat over the motor's position."""

LOAD_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.needs == "load")
"""Kinds of the columns that a load torque enters."""

TEMPERATURE_KINDS: tuple[str, ...] = tuple(term.kind for term in TERMS if term.needs == "temperature")
"""Kinds of the columns with Ft, Fts and Ftc, in this order."""


def term_of(kind: str) -> Term:
    """The term of a column: its own, or that whose shape the column is the derivative by."""
    return TERM[kind] if kind in TERM else SHAPED[kind]


def derivative_of(name: str) -> Derivative:
    """The derivative by the shape of this name."""
    derivative = SHAPES[name].derivative
    assert derivative is not None
    return derivative


def signal_of(kind: str) -> Signal:
    """Signal of a friction column, a derivative's included."""
    return TERM[kind].signal if kind in TERM else derivative_of(kind).signal


def slope_of(kind: str) -> Signal:
    """Slope of a friction column over the velocity, a derivative's included."""
    return TERM[kind].slope if kind in TERM else derivative_of(kind).slope


def temperature_coefficients(root: float, slope: float, curvature: float) -> tuple[float, float, float]:
    """β1, β2, β3 of AUBO eq. 5 from the coefficients Ft, Fts and Ftc."""
    reference = REFERENCE_TEMPERATURE
    return (root - slope * reference - 4.0 * curvature, slope + 3.0 * curvature / reference, curvature * reference**3)


def temperature_estimate(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """β1, β2, β3 of AUBO eq. 5 and their standard deviations, of the first k of Ft, Fts, Ftc with their (k, k)."""
    to_beta = np.array([temperature_coefficients(*unit) for unit in np.eye(3)])[: len(values)].T
    return to_beta @ values, np.sqrt(np.diag(to_beta @ covariance @ to_beta.T))


def root_coefficients(beta1: float, beta2: float, beta3: float) -> tuple[float, float, float]:
    """Ft, Fts and Ftc from β1, β2 and β3 of AUBO eq. 5."""
    reference = REFERENCE_TEMPERATURE
    curvature = beta3 / reference**3
    slope = beta2 - 3.0 * curvature / reference
    return beta1 + slope * reference + 4.0 * curvature, slope, curvature
