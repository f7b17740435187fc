"""Base parameters: the fewest combinations of standard parameters that fix the torque (SR400 .3.2; Gautier 1991).

They are found numerically from random states inside the joint limits, never from a recording: what an arm can reveal
does not depend on the recording. Columns are kept greedily in a fixed order of preference that
follows Khalil's regrouping rules (keep XX XY XZ YZ ZZ MX MY, regroup YY MZ M towards the base), so that the choice is
stable and reads like the papers' tables.

Gravity parameters are those of an arm at rest, which shows first moments and masses only, and of those fewer
combinations than an arm in motion: nothing of what turns about a vertical axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from drivers.core.units import ZERO_CELSIUS
from ident.friction.table import FRICTION_KINDS, SHAPES
from ident.friction.terms import NO_TERMS, LoadTorque
from ident.linear_algebra.independent_columns import independent_columns
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.joint_columns import joint_column
from ident.model.kinematics.loops import main_chain
from ident.model.parameters import StandardParameter
from ident.model.regressor import RegressorKernel, motion_factor, regressor

RANDOM_SEED = 20260101
STATES_PER_PARAMETER = 6
RANK_TOLERANCE = 1e-7
"""Singular values of the column-normalised matrix below this share of the largest count as zero."""

ROUNDED_GEOMETRY = 1e-5
"""Up to this share, singular values may come from a URDF's rounded angles and lengths."""
LEAST_GAP = 10.0
"""Between the last singular value that counts and the next."""

COEFFICIENT_TOLERANCE = 1e-9
"""Regrouping coefficients below this are rounding."""

_KEEP_FIRST = ("XX", "XY", "XZ", "YZ", "ZZ", "MX", "MY")
_KEEP_LAST = ("YY", "MZ", "M")


@dataclass(frozen=True)
class BaseParameters:
    """The identifiable combinations of an arm's standard parameters."""

    # of the kept standard parameter of each combination, an `R` inserted where others are regrouped on it (`ZZR1`), as
    # SR400 Table 1 writes them
    names: tuple[str, ...]
    expressions: tuple[str, ...]  # each combination in full, `ZZ2 + 0.166·M3 + …`
    kinds: tuple[str, ...]  # of the kept parameters
    joints: tuple[int, ...]  # number in the tree of the joint of each, from 0
    columns: tuple[int, ...]  # standard columns kept; the base regressor is Y[:, columns]
    projection: FloatArray  # (b, p); base parameters = projection @ standard parameters
    no_effect: tuple[str, ...]  # names of the standard parameters that never act on the torque
    margin: float  # smallest singular value that counts divided by the largest that does not (inf where none is left)
    smallest: float  # smallest singular value that counts, relative to the largest
    # (joint, factor) of the joints with a motor that each acts along with; empty for inertial ones
    motions: tuple[tuple[tuple[int, float], ...], ...]

    @property
    def count(self) -> int:
        """Number of base parameters."""
        return len(self.names)


def random_states(
    model: DynamicModel, count: int, seed: int = RANDOM_SEED
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and accelerations (n, count) drawn evenly inside the joint limits."""
    generator = np.random.default_rng(seed)
    low = np.array([limits.position[0] for limits in model.limits])[:, None]
    high = np.array([limits.position[1] for limits in model.limits])[:, None]
    velocity = np.array([limits.velocity for limits in model.limits])[:, None]
    acceleration = np.array([limits.acceleration for limits in model.limits])[:, None]
    shape = (model.dof, count)
    return (
        generator.uniform(low, high, shape),
        velocity * generator.uniform(-1, 1, shape),
        acceleration * generator.uniform(-1, 1, shape),
    )


def random_temperature(model: DynamicModel, count: int, seed: int = RANDOM_SEED) -> FloatArray | None:
    """Temperatures (n, count) [K] drawn evenly between 0 and 60 °C; None where the friction depends on none."""
    if not model.needs_temperature:
        return None
    low, high = ZERO_CELSIUS, ZERO_CELSIUS + 60.0
    return np.random.default_rng(seed + 1).uniform(low, high, (model.dof, count))


def base_parameters(model: DynamicModel) -> BaseParameters:
    """Base parameters of a model, inertial, motor and friction columns together.

    Raises:
        IdentificationError: the rank cannot be decided (no gap between the singular values).
    """
    return _cached(ModelKey(model))


class ModelKey:
    """Lets the cache compare models by content: their arrays are not hashable.

    Friction's shapes do not count: which columns are independent does not depend on them, and at extreme ones it would
    not show at a few random states.
    """

    def __init__(self, model: DynamicModel) -> None:
        self.model = model = _with_plain_shapes(model)
        joints = tuple(
            (
                joint.name,
                joint.parent,
                joint.prismatic,
                *(value.tobytes() for value in (joint.rotation, joint.translation, joint.axis)),
            )
            for joint in model.joints
        )
        limits = tuple((limit.position, limit.velocity, limit.acceleration) for limit in model.limits)
        columns = (model.motor_inertia, model.viscous, model.coulomb, model.offset, model.smoothing, repr(model.terms))
        follows = repr(model.transmission.content())
        self._content = (joints, limits, model.gravity.tobytes(), *columns, follows)

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ModelKey) and self._content == other._content


def _with_plain_shapes(model: DynamicModel) -> DynamicModel:
    """The model with shapes of its friction that show at any velocity."""
    terms = model.terms
    if terms.plain:
        return replace(model, terms=NO_TERMS)
    for name in terms.shapes:
        shape = SHAPES[name]
        for motor, limits in enumerate(model.limits):
            if shape.relative:
                terms = terms.with_shape(name, motor, 0.3 * limits.velocity, free=terms.is_free(name, motor))
            elif shape.derivative is not None and terms.bent(name, motor):
                terms = terms.with_shape(name, motor, shape.first, free=terms.is_free(name, motor))
    return replace(model, terms=terms)


@lru_cache(maxsize=32)
def _cached(key: ModelKey) -> BaseParameters:
    return base_parameters_of(key.model, _random_factor(key.model))


def base_parameters_of(model: DynamicModel, gram_root: FloatArray, still: Sequence[int] = ()) -> BaseParameters:
    """Base parameters that a triangular factor (p, p) of the model's standard columns at random states shows.

    The links behind the joints of the tree that are `still` in all these states are regrouped on the others.

    Raises:
        IdentificationError: the rank cannot be decided (no gap between the singular values).
    """
    parameters = model.parameters
    scale = np.linalg.norm(gram_root, axis=0)
    silent = scale <= RANK_TOLERANCE * scale.max()
    active = np.flatnonzero(~silent)
    scaled = gram_root[:, active] / scale[active]
    singular = np.linalg.svd(scaled, compute_uv=False)
    relative = singular / singular[0]
    rank, margin = _rank(relative, model.name)
    rest = float(relative[rank]) if rank < len(relative) else 0.0
    # In the middle of the gap, as far as it lies above the threshold: a URDF's rounded angles leave columns of 1e-7.
    tolerance = max(RANK_TOLERANCE, float(np.sqrt(relative[rank - 1] * rest)))
    kept = _greedy_columns(scaled, [parameters[i] for i in active], rank, tolerance, model, still)
    columns = sorted(int(active[i]) for i in kept)
    order = [int(np.flatnonzero(active == column)[0]) for column in columns]
    coefficients, *_ = np.linalg.lstsq(scaled[:, order], scaled, rcond=None)
    projection = np.zeros((rank, len(parameters)))
    projection[:, active] = coefficients * scale[active] / scale[columns][:, None]
    projection[np.abs(projection) < COEFFICIENT_TOLERANCE] = 0.0
    projection[:, columns] = np.eye(rank)
    texts = [_expression(row, column, parameters) for row, column in zip(projection, columns, strict=True)]
    return BaseParameters(
        names=tuple(name for name, _ in texts),
        expressions=tuple(expression for _, expression in texts),
        kinds=tuple(parameters[column].kind for column in columns),
        joints=tuple(parameters[column].joint for column in columns),
        columns=tuple(columns),
        projection=projection,
        no_effect=tuple(parameters[i].name for i in np.flatnonzero(silent)),
        margin=margin,
        smallest=float(relative[rank - 1]),
        motions=tuple(
            () if parameters[column].kind == "inertial" else joint_column(model, parameters[column]).motion
            for column in columns
        ),
    )


def _rank(relative: FloatArray, where: str) -> tuple[int, float]:
    """Number of base parameters that singular values, relative to the first, show; the gap behind the last of them.

    A URDF's rounded angles (1.5708, 5e-5) leave some of 1e-6 to 1e-9, which no recording can show. Where the threshold
    meets such ones, the widest gap a little above it decides.

    Raises:
        IdentificationError: there is no gap.
    """
    following = np.append(relative[1:], 0.0)
    gaps = np.divide(relative, following, out=np.full(relative.size, np.inf), where=following > 0.0)
    rank = int(np.count_nonzero(relative > RANK_TOLERANCE))
    if gaps[rank - 1] >= LEAST_GAP:
        return rank, float(gaps[rank - 1])
    above = np.where((following > RANK_TOLERANCE) & (following < ROUNDED_GEOMETRY), gaps, 0.0)
    if above.max() < LEAST_GAP:
        raise IdentificationError(
            f"the number of base parameters cannot be decided: singular values {relative[rank - 1]:.1e} and "
            f"{following[rank - 1]:.1e} lie on both sides of the threshold",
            where=where,
            hint="check the geometry for lengths or angles that are nearly, but not quite, zero",
        )
    return int(above.argmax()) + 1, float(above.max())


def _random_factor(model: DynamicModel) -> FloatArray:
    """Triangular factor (p, p) of the standard regressor at random states."""
    kernel = RegressorKernel(model)
    count = max(100, STATES_PER_PARAMETER * len(kernel.columns))
    return motion_factor(kernel, *random_states(model, count), random_temperature(model, count))


def _preference(parameter: StandardParameter, preferred: Sequence[int]) -> tuple[int, bool, int, int]:
    """Sort key: first columns are kept, last ones regrouped; among equals that of a preferred link is kept."""
    beside = parameter.joint not in preferred
    if parameter.symbol in _KEEP_FIRST:
        return (0, beside, -parameter.joint, _KEEP_FIRST.index(parameter.symbol))
    if parameter.kind in ("viscous", "coulomb", "offset") or parameter.symbol in ("Fv", "Fs"):
        return (1, False, parameter.joint, 0)
    if parameter.kind in FRICTION_KINDS:
        return (1, True, parameter.joint, FRICTION_KINDS.index(parameter.kind))
    if parameter.kind in ("motor_inertia", "coupling"):
        return (2, False, -parameter.joint, 0)
    return (3, beside, -parameter.joint, _KEEP_LAST.index(parameter.symbol))


def _greedy_columns(
    scaled: FloatArray,
    parameters: list[StandardParameter],
    rank: int,
    tolerance: float,
    model: DynamicModel,
    still: Sequence[int],
) -> list[int]:
    """Indices of `rank` independent columns, the preferred ones first."""
    # The rods of a closed loop are regrouped on the links between base and tool, as SR400 Table 1 does.
    closed = model.transmission.closed
    chain = main_chain(model.joints, model.active) if closed else range(len(model.joints))
    preferred = [column for column in chain if column not in still]
    order = sorted(range(len(parameters)), key=lambda i: _preference(parameters[i], preferred))
    kept = independent_columns(scaled, order, tolerance)
    if len(kept) != rank:
        raise IdentificationError(
            f"{len(kept)} independent columns were found where the singular values show {rank}",
            where=model.name,
            hint="check the geometry for lengths or angles that are nearly, but not quite, zero",
        )
    return kept


def _expression(row: FloatArray, column: int, parameters: tuple[StandardParameter, ...]) -> tuple[str, str]:
    """Name and printed combination of one base parameter."""
    kept = parameters[column]
    others = [i for i in np.flatnonzero(row) if i != column]
    terms = [kept.name]
    for i in others:
        size = f"{abs(row[i]):.4g}"
        factor = "" if size == "1" else f"{size}·"
        terms.append(f"{'-' if row[i] < 0 else '+'} {factor}{parameters[i].name}")
    name = f"{kept.symbol}R{kept.joint + 1}" if others else kept.name
    return name, " ".join(terms)


def gravity_of(base: BaseParameters, parameters: FloatArray) -> LoadTorque:
    """Return what the links' parameters among base parameters (b,) say of gravity (AUBO eq. 18)."""
    links = [place for place, kind in enumerate(base.kinds) if kind == "inertial"]
    return LoadTorque(tuple(base.columns[place] for place in links), tuple(parameters[links].tolist()))


def resting_model(robot_file: RobotFile) -> DynamicModel:
    """The model of an arm whose motors have an offset and nothing that a motion shows.

    Raises:
        RobotFileError: the geometry cannot be used.
    """
    model = build_model(robot_file)
    none, every = (False,) * model.dof, (True,) * model.dof
    return replace(model, motor_inertia=none, viscous=none, coulomb=none, offset=every, terms=NO_TERMS, presliding=())


def gravity_base(model: DynamicModel) -> BaseParameters:
    """Base parameters of a `resting_model`, offsets among them.

    A joint that slides along gravity has its weight and its offset in one parameter.

    Raises:
        IdentificationError: their number cannot be decided.
    """
    kernel = RegressorKernel(model)
    position, _, _ = random_states(model, max(100, STATES_PER_PARAMETER * len(kernel.columns)))
    still = np.zeros_like(position)
    return base_parameters_of(model, motion_factor(kernel, position, still, still))


def gravity_rows(model: DynamicModel, base: BaseParameters, position: FloatArray) -> FloatArray:
    """Rows (N, n, b) of the motors' torques in poses (N, n) by the gravity parameters, offsets among them."""
    still = np.zeros_like(position.T)
    rows = regressor(model, np.ascontiguousarray(position.T), still, still, base.columns)
    return np.ascontiguousarray(np.moveaxis(rows, -1, 0))


def gravity_columns(base: BaseParameters) -> list[int]:
    """Indices of the parameters other than offsets, which thus weigh."""
    return [index for index, kind in enumerate(base.kinds) if kind == "inertial"]
