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
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import LOAD_KINDS
from ident.friction.terms import NO_STATES, NO_TERMS, FrictionConditions, States
from ident.linear_algebra.triangular import QrAccumulator
from ident.model.compiled_rows import LinkRows, Share, compiled_rows, compiled_torques
from ident.model.dynamic_model import DynamicModel
from ident.model.joint_columns import JointColumn, column_signal, joint_column
from ident.model.kinematics.joints import ancestors
from ident.model.kinematics.transmission import TreeMotion
from ident.model.newton_euler import AxisMotion, Direction, FrameMotion, Recursion, combine, scaled
from ident.model.parameters import LINK_SIZE

SAMPLES_AT_ONCE = 4096
"""Samples evaluated at once: enough to hide the interpreter, few enough for the cache."""

_INERTIA_COUNT = 6  # XX XY XZ YY YZ ZZ
_MASS_INDEX = 9

_PRODUCTS = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))
"""Products of the angular velocity's components, by name."""

# Columns of the matrix that takes XX XY XZ YY YZ ZZ to I·α + ω × I·ω; ax ay az are α's components.
_INERTIA_TERMS: tuple[tuple[tuple[Any, ...], ...], ...] = (
    ((np.positive, "ax"), (np.positive, "xz"), (np.negative, "xy")),
    ((np.subtract, "ay", "xz"), (np.add, "ax", "yz"), (np.subtract, "xx", "yy")),
    ((np.add, "az", "xy"), (np.subtract, "zz", "xx"), (np.subtract, "ax", "yz")),
    ((np.negative, "yz"), (np.positive, "ay"), (np.positive, "xy")),
    ((np.subtract, "yy", "zz"), (np.subtract, "az", "xy"), (np.add, "ay", "xz")),
    ((np.positive, "yz"), (np.negative, "xz"), (np.positive, "az")),
)

# Columns of [α]× + [ω]×², which maps MX MY MZ to the force.
_MOMENT_TERMS: tuple[tuple[tuple[Any, ...], ...], ...] = (
    ((np.subtract, "-yy", "zz"), (np.add, "az", "xy"), (np.subtract, "xz", "ay")),
    ((np.subtract, "xy", "az"), (np.subtract, "-xx", "zz"), (np.add, "ax", "yz")),
    ((np.add, "ay", "xz"), (np.subtract, "yz", "ax"), (np.subtract, "-xx", "yy")),
)


@dataclass(frozen=True)
class JointRows:
    """Where one motor's packed rows are."""

    rows: slice  # slice of the packed array's first axis
    columns: tuple[int, ...]  # for each of these rows, the column of the kernel's selection that it belongs to


@dataclass(frozen=True)
class _LinkBlock:
    """Packed rows that one link fills: for each motor that moves it, where its rows start and which axes act."""

    link: int
    inertia: tuple[int, ...]  # which of XX..ZZ
    moments: tuple[int, ...]  # which of MX MY MZ
    mass: bool
    targets: tuple[tuple[int, tuple[tuple[int, Share], ...]], ...]  # first packed row, (index of an axis, factor)


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


def _link_block(
    link: int, selected: Sequence[int], targets: Sequence[tuple[int, tuple[tuple[int, Share], ...]]]
) -> _LinkBlock:
    kinds = [column - 10 * link for column in selected]
    return _LinkBlock(
        link=link,
        inertia=tuple(kind for kind in kinds if kind < _INERTIA_COUNT),
        moments=tuple(kind - _INERTIA_COUNT for kind in kinds if _INERTIA_COUNT <= kind < _MASS_INDEX),
        mass=_MASS_INDEX in kinds,
        targets=tuple(targets),
    )


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
        self._blocks = tuple(_link_block(link, selected[link], targets[link]) for link in links)
        self.link_rows = tuple(
            LinkRows(
                kinds=tuple(column - 10 * link for column in selected[link]),
                joints=(*self._chains[link], link) if block.targets else (),
                targets=block.targets,
            )
            for link, block in enumerate(self._blocks)
        )
        self._recursion, self._recursed = Recursion(model.joints, self._chains, model.gravity, chunk), True
        self._compiled = compiled_rows(model.joints, model.gravity, self.link_rows)
        self._rotating = np.empty((3, _INERTIA_COUNT, chunk))
        self._pushing = np.empty((3, 4, chunk))
        self._products = np.empty((len(_PRODUCTS) + 2, chunk))
        self._term = np.empty((_INERTIA_COUNT, chunk))
        self._axis = np.empty((6, chunk))
        self._part = np.empty(chunk)
        self.shares = np.empty((0, 0, 0))
        loads = any(row.column.quantity in LOAD_KINDS for row in self.joint_parameter_rows)
        self._load = LoadTorqueKernel(model, chunk) if loads else None

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
        count = position.shape[1]
        model = self.model
        self.tree = model.tree_motion(position, velocity, acceleration)
        self._recursed = False
        if self.tree.follow.ndim == 3:
            self.shares = model.transmission.to_motors(self.tree.follow)
        if self._compiled is not None and out.strides[1] == out.itemsize:
            self._compiled.write(self.tree, self.shares, out)
        else:
            for block in self._blocks:
                if block.targets:
                    self._fill_link(block, count, out)
        load = None if self._load is None else self._load.torque(position)
        conditions = FrictionConditions(load, temperature, presliding, position)
        for entry in self.joint_parameter_rows:
            signal = column_signal(model, entry.column, velocity, acceleration, conditions)
            out[entry.row] = signal if entry.factor == 1.0 else entry.factor * signal

    def _fill_link(self, block: _LinkBlock, count: int, out: FloatArray) -> None:
        motion = self.frames[block.link]
        rotating, pushing = self._rotating[..., :count], self._pushing[..., :count]
        self._body_rows(motion, block, count)
        inertias, moments = len(block.inertia), len(block.moments)
        pushes = moments + block.mass
        acceleration = motion.linear[:, :count]
        for start, axes in block.targets:
            direction = self._motor_axis(motion, axes, count)
            for_inertia = out[start : start + inertias, :count]
            for_push = out[start + inertias : start + inertias + pushes, :count]
            if inertias:
                combine(direction.angular, rotating[:, :inertias], count, for_inertia, self._term)
            if pushes:
                combine(direction.linear, pushing[:, :pushes], count, for_push, self._term)
            if moments:
                self._add_moment_of_first_moments(direction.angular, acceleration, block.moments, count, for_push)

    def _motor_axis(self, motion: FrameMotion, axes: Sequence[tuple[int, Share]], count: int) -> AxisMotion:
        """The combination of the joints' axes, valid until the next call."""
        if len(axes) == 1 and axes[0][1] == 1.0:
            return motion.axes[axes[0][0]]
        components: list[FloatArray | float] = []
        for row in range(6):
            component, total = row % 3, self._axis[row]
            constant, varies = 0.0, False
            for index, share in axes:
                axis = motion.axes[index]
                value = (axis.angular if row < 3 else axis.linear)[component]
                factor = share if isinstance(share, float) else self.shares[share]
                if isinstance(value, float) and isinstance(factor, float):
                    constant += factor * value
                    continue
                if isinstance(value, float) and value == 0.0:
                    continue
                chunk = self._part if varies else total
                np.multiply(value if isinstance(value, float) else value[:count], factor, out=chunk[:count])
                if varies:
                    total[:count] += chunk[:count]
                varies = True
            if varies and constant != 0.0:
                total[:count] += constant
            components.append(total if varies else constant)
        return AxisMotion((components[0], components[1], components[2]), (components[3], components[4], components[5]))

    def _body_rows(self, motion: FrameMotion, block: _LinkBlock, count: int) -> None:
        """Moment (3, inertias) and force (3, moments + mass) that unit parameters of this link cause in its frame."""
        w, a = motion.angular_velocity[:, :count], motion.angular_acceleration[:, :count]
        operands = {"ax": a[0], "ay": a[1], "az": a[2]}
        for row, (name, left, right) in enumerate(_PRODUCTS):
            operands[name] = np.multiply(w[left], w[right], out=self._products[row, :count])
        operands["-xx"] = np.negative(operands["xx"], out=self._products[-2, :count])
        operands["-yy"] = np.negative(operands["yy"], out=self._products[-1, :count])
        n, f = self._rotating[..., :count], self._pushing[..., :count]
        for slot, kind in enumerate(block.inertia):
            for component, (operation, *names) in enumerate(_INERTIA_TERMS[kind]):
                operation(*(operands[name] for name in names), out=n[component, slot])
        for slot, kind in enumerate(block.moments):
            for component, (operation, *names) in enumerate(_MOMENT_TERMS[kind]):
                operation(*(operands[name] for name in names), out=f[component, slot])
        if block.mass:
            f[:, len(block.moments)] = motion.linear[:, :count]

    def _add_moment_of_first_moments(
        self, angular: Direction, acceleration: FloatArray, moments: Sequence[int], count: int, out: FloatArray
    ) -> None:
        """Add (a × w)·h for the selected first moments."""
        term = self._term[0, :count]
        for slot, kind in enumerate(moments):
            first, second = (kind + 1) % 3, (kind + 2) % 3
            if scaled(angular[second], acceleration[first], count, term):
                out[slot] += term
            if scaled(angular[first], acceleration[second], count, term):
                out[slot] -= term


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
