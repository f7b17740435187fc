"""The regressor Y(q, q̇, q̈) of the inverse dynamic model τ = Y·π (SR400 eq. 13; AUBO eq. 8).

`RegressorKernel` evaluates it for many samples at once: a Newton-Euler recursion in which every operation runs over
all samples of a chunk. Its output is packed: only the structurally non-zero entries are computed and stored, one row a
(joint, column) pair, time-contiguous, ready to be filtered row by row and reduced joint by joint.

For a link with ten parameters, force and moment at its frame's origin are linear in them: with ω, α the angular
velocity and acceleration and a the origin's acceleration minus gravity,

    f = a·M + ([α]× + [ω]×²)·h        n = I·α + ω × I·ω + h × a        h = (MX, MY, MZ)

and the torque that joint k needs for it is v_k·f + w_k·n, where (v_k, w_k) is the motion of the link's frame that a
unit velocity of joint k causes. So a row is built from the axes of the joints below the link, expressed in its frame.

With closed loops or coupled motors, rows belong to motors: R⁻ᵀGᵀ times the tree's rows (SR400 eq. 4 and 6). A motor's
axis in a link's frame is that combination of the joints' axes, so nothing is computed twice. General loops make some
factors of the combination vary with the position.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import LOAD_KINDS
from ident.friction.terms import NO_STATES, NO_TERMS, FrictionConditions, FrictionTerms, States
from ident.linear_algebra.triangular import QrAccumulator
from ident.linear_algebra.vectors import cross
from ident.model.compiled_rows import LinkRows, Share, compiled_rows, compiled_torques
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, joint_column
from ident.model.kinematics.joints import ancestors
from ident.model.kinematics.transmission import TreeMotion
from ident.model.newton_euler import FrameMotion, Recursion, stacked
from ident.model.parameters import LINK_SIZE
from ident.signals.prepared import Prepared

SAMPLES_AT_ONCE = 4096
"""Samples evaluated at once: enough to hide the interpreter, few enough for the cache."""

_UNIT_INERTIAS = np.zeros((6, 3, 3))
"""Matrices (6, 3, 3) of XX XY XZ YY YZ ZZ, each 1 by itself."""
for _kind, (_row, _column) in enumerate(zip(*np.triu_indices(3), strict=True)):
    _UNIT_INERTIAS[_kind, _row, _column] = _UNIT_INERTIAS[_kind, _column, _row] = 1.0


@dataclass(frozen=True)
class JointRows:
    """Places of one motor's packed rows."""

    rows: slice  # slice of the packed array's first axis
    columns: tuple[int, ...]  # for each of these rows, the column of the kernel's selection that it belongs to


@dataclass(frozen=True)
class JointParameterRow:
    """A packed row of a column that is no link's: `factor` times the column's signal."""

    row: int
    column: JointColumn
    factor: float


def _motor_axes(
    constant: list[list[float]], varies: list[list[bool]], chain: Sequence[int]
) -> list[tuple[tuple[int, Share], ...]]:
    """The axes that make up each motor's own, (index in the chain, factor); empty where it moves none."""
    return [
        tuple(
            (index, (motor, joint) if varying[joint] else shares[joint])
            for index, joint in enumerate(chain)
            if varying[joint] or shares[joint] != 0.0
        )
        for motor, (shares, varying) in enumerate(zip(constant, varies, strict=True))
    ]


class RegressorKernel:
    """Evaluates chosen columns of the standard regressor, packed.

    Attributes:
        model: whose regressor this is.
        columns: standard columns in the order of the caller's choice.
        joint_rows: one entry a motor; together they cover the packed rows.
        row_count: number of packed rows.
        joint_parameter_rows: the packed rows of every column that is no link's.
        link_rows: where each link's rows are.
        tree: motion of the tree's joints as of the last `evaluate`.
        shares: (dof, n, m) R⁻ᵀGᵀ of then, where it varies; empty where it is constant.
        filtered: rows of motions that were filtered, kept for the next pass over them (`filtered_samples`).
    """

    tree: TreeMotion

    def __init__(self, model: DynamicModel, columns: Sequence[int] | None = None, chunk: int = SAMPLES_AT_ONCE) -> None:
        """Prepare the scratch arrays.

        Args:
            model: the arm.
            columns: standard columns to evaluate; all of them where None.
            chunk: most samples that one call of `evaluate` may bring.
        """
        self.model = model
        parameters = model.parameters
        self.columns = tuple(range(len(parameters))) if columns is None else tuple(columns)
        self.chunk = chunk
        position_of = {column: position for position, column in enumerate(self.columns)}
        links = range(len(model.joints))
        self._chains = tuple(ancestors(model.joints, index) for index in links)
        selected = [[c for c in range(10 * link, 10 * link + 10) if c in position_of] for link in links]
        constant, varies = (shares.tolist() for shares in model.transmission.share_pattern())
        axes = [_motor_axes(constant, varies, (*self._chains[link], link)) for link in links]
        of_joints = {c: joint_column(model, parameters[c]) for c in self.columns if parameters[c].kind != "inertial"}

        targets: list[list[tuple[int, tuple[tuple[int, Share], ...]]]] = [[] for _ in links]
        joint_rows = []
        self.joint_parameter_rows: list[JointParameterRow] = []
        row = 0
        for motor in range(model.dof):
            first = row
            row_columns: list[int] = []
            for link in links:
                if selected[link] and axes[link][motor]:
                    targets[link].append((row, axes[link][motor]))
                    row_columns += [position_of[c] for c in selected[link]]
                    row += len(selected[link])
            for standard, column in of_joints.items():
                for acting, factor in column.rows:
                    if acting == motor:
                        self.joint_parameter_rows.append(JointParameterRow(row, column, factor))
                        row_columns.append(position_of[standard])
                        row += 1
            joint_rows.append(JointRows(slice(first, row), tuple(row_columns)))
        self.joint_rows = tuple(joint_rows)
        self.row_count = row
        self.link_rows = tuple(
            LinkRows(
                kinds=tuple(column - 10 * link for column in selected[link]),
                joints=(*self._chains[link], link) if targets[link] else (),
                targets=tuple(targets[link]),
            )
            for link in links
        )
        self._recursed = True
        self._compiled = compiled_rows(model.joints, model.gravity, self.link_rows)
        self.shares = np.empty((0, 0, 0))
        self.filtered: list[tuple[tuple[object, ...], list[FloatArray]]] = []
        loads = any(row.column.quantity in LOAD_KINDS for row in self.joint_parameter_rows)
        self._load = LoadTorqueKernel(model, chunk) if loads else None

    @cached_property
    def _recursion(self) -> Recursion:
        return Recursion(self.model.joints, self._chains, self.model.gravity, self.chunk)

    @property
    def frames(self) -> list[FrameMotion]:
        """Every link's motion as of the last `evaluate`; arrays (3, chunk), the first m samples of which are filled."""
        if not self._recursed:
            self._recursion.run(self.tree.position, self.tree.velocity, self.tree.acceleration)
            self._recursed = True
        return self._recursion.frames

    def evaluate(
        self,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        out: FloatArray,
        temperature: FloatArray | None = None,
        presliding: States = NO_STATES,
    ) -> None:
        """Write the packed regressor of m ≤ `chunk` samples into `out` (row_count, m).

        Args:
            position: (n, m) of the joints with a motor [rad or m].
            velocity: (n, m) [rad/s or m/s].
            acceleration: (n, m) [rad/s² or m/s²].
            out: (row_count, m), written in full.
            temperature: (n, m) [K] of the joints, where the friction depends on it.
            presliding: states (m,) in place of sign(q̇), by motion.

        Raises:
            ModelError: the friction depends on a temperature, and none is given.
        """
        model = self.model
        self.tree = model.tree_motion(position, velocity, acceleration)
        self._recursed = False
        if self.tree.follow.ndim == 3:
            self.shares = model.transmission.to_motors(self.tree.follow)
        if self._compiled is not None and out.strides[1] == out.itemsize:
            self._compiled.write(self.tree, self.shares, out)
        else:
            for frame, rows in zip(self.frames, self.link_rows, strict=True):
                self._fill_link(frame, rows, position.shape[1], out)
        load = None if self._load is None else self._load.torque(position)
        conditions = FrictionConditions(load, temperature, presliding, position)
        for entry in self.joint_parameter_rows:
            signal = column_signal(model, entry.column, velocity, acceleration, conditions)
            out[entry.row] = signal if entry.factor == 1.0 else entry.factor * signal

    def _fill_link(self, frame: FrameMotion, rows: LinkRows, count: int, out: FloatArray) -> None:
        """Write a link's rows: power of the forces that its unit parameters need, per unit velocity of each motor."""
        if not rows.targets:
            return
        kinds = list(rows.kinds)
        moment, force = (wrench[kinds] for wrench in unit_wrenches(frame, count))
        axes = stacked(frame.axes, count)
        for start, combination in rows.targets:
            shares = [(at, share if isinstance(share, float) else self.shares[share]) for at, share in combination]
            angular, linear = (sum(share * axis[at] for at, share in shares) for axis in axes)
            out[start : start + len(kinds)] = np.einsum("it,kit->kt", angular, moment)
            out[start : start + len(kinds)] += np.einsum("it,kit->kt", linear, force)


def unit_wrenches(frame: FrameMotion, count: int) -> tuple[FloatArray, FloatArray]:
    """Moment about the frame's origin and force (10, 3, count) that each of a link's unit parameters needs."""
    w, alpha, a = (vector[:, :count] for vector in (frame.angular_velocity, frame.angular_acceleration, frame.linear))
    units = np.eye(3)[:, :, None]
    moment, force = np.zeros((2, 10, 3, count))
    moment[:6] = np.tensordot(_UNIT_INERTIAS, alpha, 1) + cross(w, np.tensordot(_UNIT_INERTIAS, w, 1))
    moment[6:9] = cross(units, a)
    force[6:9] = cross(alpha, units) + cross(w, cross(w, units))
    force[9] = a
    return moment, force


class LoadTorqueKernel:
    """Gravity torque of a model's `terms.load_torque` at the motors (AUBO eq. 18)."""

    def __init__(self, model: DynamicModel, chunk: int = SAMPLES_AT_ONCE) -> None:
        """Prepare a model with load-dependent friction, evaluated `chunk` samples at once."""
        load = model.terms.load_torque
        if load is None:
            raise ValueError("the model has no load torque")
        self._kernel = RegressorKernel(replace(model, terms=NO_TERMS), load.columns, chunk)
        self._values = np.array(load.values)

    def torque(self, position: FloatArray) -> FloatArray:
        """Load torque (n, N) [N·m or N] at positions (n, N)."""
        still = np.zeros_like(position)
        return _weighted(self._kernel, self._values, evaluate_in_chunks(self._kernel, position, still, still))


def _weighted(kernel: RegressorKernel, values: FloatArray, chunks: Iterator[tuple[slice, FloatArray]]) -> FloatArray:
    """Torques (n, N) of the motors: the kernel's columns times their values (p,)."""
    torques = [
        np.array([values[list(rows.columns)] @ packed[rows.rows] for rows in kernel.joint_rows]) for _, packed in chunks
    ]
    return np.concatenate(torques, axis=1)


def regressor(
    model: DynamicModel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    columns: Sequence[int] | None = None,
    temperature: FloatArray | None = None,
) -> FloatArray:
    """Regressor (n, p, N) for (n, N) joint motions and temperatures [K], p the chosen columns (all where None)."""
    kernel = RegressorKernel(model, columns, min(max(1, position.shape[1]), SAMPLES_AT_ONCE))
    return dense_regressor(kernel, position, velocity, acceleration, temperature)


def dense_regressor(
    kernel: RegressorKernel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    temperature: FloatArray | None = None,
) -> FloatArray:
    """The kernel's columns (n, p, N) with their structural zeros, for (n, N) motions."""
    dense = np.zeros((kernel.model.dof, len(kernel.columns), position.shape[1]))
    for chunk, packed in evaluate_in_chunks(kernel, position, velocity, acceleration, temperature):
        for joint, rows in enumerate(kernel.joint_rows):
            dense[joint, list(rows.columns), chunk] = packed[rows.rows]
    return dense


def model_torque(
    model: DynamicModel,
    columns: Sequence[int] | None,
    parameters: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    temperature: FloatArray | None = None,
    presliding: States = NO_STATES,
) -> FloatArray:
    """Torque (n, N) [N·m] of parameters (p,) on the standard `columns` (all where None) along a motion (n, N)."""
    standard = np.zeros(len(model.parameters))
    standard[slice(None) if columns is None else list(columns)] = parameters
    others = range(len(standard)) if columns is None else columns
    of_joints = [
        (joint_column(model, model.parameters[column]), float(standard[column]))
        for column in others
        if model.parameters[column].kind != "inertial"
    ]
    loads = any(column.quantity in LOAD_KINDS for column, _ in of_joints)
    count, transmission = position.shape[1], model.transmission
    at_once = min(count, SAMPLES_AT_ONCE)
    load_kernel = LoadTorqueKernel(model, at_once) if loads else None
    inertial = standard[: LINK_SIZE * len(model.joints)]
    links = compiled_torques(model.joints, model.gravity, inertial)
    if links is None:
        kernel = RegressorKernel(model, columns, at_once)
        chunks = evaluate_in_chunks(kernel, position, velocity, acceleration, temperature, presliding)
        return _weighted(kernel, standard[list(kernel.columns)], chunks)
    torque = np.empty(position.shape)
    for start in range(0, count, SAMPLES_AT_ONCE):
        chunk = slice(start, start + SAMPLES_AT_ONCE)
        q, rate, change = position[:, chunk], velocity[:, chunk], acceleration[:, chunk]
        motion = model.tree_motion(q, rate, change)
        at_tree = links(motion.position, motion.velocity, motion.acceleration)
        at_motors = at_tree
        if not transmission.direct:
            at_motors = transmission.joint_to_motor @ transmission.from_tree(motion, at_tree)
        states = {motion: state[chunk] for motion, state in presliding.items()}
        load = None if load_kernel is None else load_kernel.torque(q)
        heat = None if temperature is None else temperature[:, chunk]
        conditions = FrictionConditions(load, heat, states, q)
        for column, value in of_joints:
            signal = column_signal(model, column, rate, change, conditions)
            for motor, factor in column.rows:
                at_motors[motor] += factor * value * signal
        torque[:, chunk] = at_motors
    return torque


def motion_factor(
    kernel: RegressorKernel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    temperature: FloatArray | None = None,
) -> FloatArray:
    """Triangular factor (b, b) of the kernel's columns, all joints' rows stacked, along a motion (n, N)."""
    accumulator = QrAccumulator(len(kernel.columns))
    for _, packed in evaluate_in_chunks(kernel, position, velocity, acceleration, temperature):
        for rows in kernel.joint_rows:
            wide = np.zeros((len(kernel.columns), packed.shape[1]))
            wide[list(rows.columns)] = packed[rows.rows]
            accumulator.add(wide)
    return accumulator.factor()


def evaluate_in_chunks(
    kernel: RegressorKernel,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    temperature: FloatArray | None = None,
    presliding: States = NO_STATES,
) -> Iterator[tuple[slice, FloatArray]]:
    """Slices of the samples with their packed regressor (row_count, m), valid until the next one is requested."""
    count = position.shape[1]
    buffer = np.empty((kernel.row_count, min(count, kernel.chunk)))
    for start in range(0, count, kernel.chunk):
        chunk = slice(start, min(start + kernel.chunk, count))
        packed = buffer[:, : chunk.stop - chunk.start]
        heat = None if temperature is None else temperature[:, chunk]
        states = {motion: state[chunk] for motion, state in presliding.items()}
        kernel.evaluate(position[:, chunk], velocity[:, chunk], acceleration[:, chunk], packed, heat, states)
        yield chunk, packed


def load_change(model: DynamicModel, runs: Sequence[Prepared], before: FrictionTerms, after: FrictionTerms) -> float:
    """Largest change of a motor's load torque over the data's largest one of any motor."""
    if before.load_torque is None:
        return float("inf")
    old, new = (LoadTorqueKernel(replace(model, terms=terms)) for terms in (before, after))
    change, size = 0.0, float(np.finfo(np.float64).tiny)
    for run in runs:
        for segment in run.segments:
            position = segment.position[:, :: run.parallel_filter.factor]
            torque = new.torque(position)
            change = max(change, float(np.max(np.abs(torque - old.torque(position)))))
            size = max(size, float(np.max(np.abs(torque))))
    return change / size
