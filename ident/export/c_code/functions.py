"""The functions of an arm's C code: what they take, what they give, and the expressions of it.

With (w, v) the motion of a link's frame that a unit velocity of a joint causes, the joint's torque for a force f and a
moment n at that frame is v·f + w·n. Where joints without a motor follow, the axes of a motor's joint add up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.export.c_code.expressions import Expression, ExpressionArray, Graph, solved
from ident.export.c_code.frames import JointFrame, combination, joint_frames
from ident.export.c_code.joint_terms import (
    friction,
    joint_parameter_column,
    joint_terms,
    presliding_states,
    presliding_torque,
)
from ident.export.c_code.recursion import LinkMotion, link_motions, link_wrench, tree_inertia, tree_torques, unit_wrench
from ident.model.base_parameters import random_states
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.kinematics.transmission import LinearTransmission
from ident.model.parameters import INERTIAL
from ident.model.presliding import presliding_motions

Axes = dict[int, tuple[ExpressionArray, ExpressionArray]]
"""(w, v) by the number of the joint in the tree."""

SIZE = len(INERTIAL)

PAYLOAD = "payload"
PAYLOAD_SIZE = 10
"""Mass, centre of mass x y z, inertia xx xy xz yy yz zz about it."""

POSTURES = 100
"""Random ones at which the inertia matrix has to be positive definite for forward dynamics."""


def link_axes(graph: Graph, frames: Sequence[JointFrame]) -> list[Axes]:
    """Axes of the joints that each link hangs on, in its frame."""
    none = graph.constants(np.zeros(3))
    axes: list[Axes] = []
    for index, frame in enumerate(frames):
        own: Axes = {}
        if frame.joint.parent != BASE_INDEX:
            for joint, (angular, linear) in axes[frame.joint.parent].items():
                moved = linear + np.cross(angular, frame.translation)
                own[joint] = frame.to_joint(angular), frame.to_joint(moved)
        axis = graph.constants(frame.joint.axis)
        own[index] = (none, axis) if frame.joint.prismatic else (axis, none)
        axes.append(own)
    return axes


def inertial_column(graph: Graph, motion: LinkMotion, axes: Axes, kind: int, follow: FloatArray) -> list[Expression]:
    """Torques (n,) at the joints with a motor for a unit of a link's parameter number `kind` of ten."""
    wrench = unit_wrench(motion, kind)
    none = graph.constants(np.zeros(3))
    column = []
    for motor in range(follow.shape[1]):
        angular, linear = none, none
        for joint, (w, v) in axes.items():
            share = float(follow[joint, motor])
            angular, linear = angular + w * share, linear + v * share
        column.append(linear @ wrench.force + angular @ wrench.moment)
    return column


def payload_torque(graph: Graph, motion: LinkMotion, axes: Axes, follow: FloatArray) -> tuple[Expression, ...]:
    """Torques (n,) at the joints with a motor, linear in the payload's standard parameters (SR400 .4.4).

    The symbols are `payload0` to `payload9`: mass, centre of mass x y z in the link's frame, inertia xx xy xz yy yz zz
    about the centre of mass.
    """
    mass, x, y, z, xx, xy, xz, yy, yz, zz = (graph.symbol(f"payload{number}") for number in range(10))
    standard = (
        xx + mass * (y * y + z * z),
        xy - mass * (x * y),
        xz - mass * (x * z),
        yy + mass * (x * x + z * z),
        yz - mass * (y * z),
        zz + mass * (x * x + y * y),
        mass * x,
        mass * y,
        mass * z,
        mass,
    )
    totals = [graph.constant(0.0)] * follow.shape[1]
    for kind, value in enumerate(standard):
        column = inertial_column(graph, motion, axes, kind, follow)
        totals = [total + entry * value for total, entry in zip(totals, column, strict=True)]
    return tuple(totals)


@dataclass(frozen=True)
class Function:
    """One C function."""

    name: str  # without the arm's prefix
    summary: str  # what it gives, for a comment
    inputs: tuple[str, ...]  # names of its arrays (n,)
    output: str  # name of what it writes
    rows: tuple[tuple[Expression, ...], ...]  # the output's entries, (1, n) for a vector
    matrix: bool = False  # whether the output has rows and columns
    sizes: Mapping[str, int] = field(default_factory=dict)  # length of the arrays that are not (n,)

    @property
    def outputs(self) -> list[Expression]:
        """All entries, row by row."""
        return [entry for row in self.rows for entry in row]


def arm_functions(graph: Graph, dynamics: InverseDynamics) -> tuple[Function, ...]:
    """The functions of an arm with identified parameters; those that the parameters do not allow are left out.

    Raises:
        ModelError: loops of the arm are solved numerically.
    """
    model = dynamics.model
    refuse_numerical_loops(dynamics)
    refuse_temperature(dynamics)
    count = model.dof
    q, dq, ddq = ([graph.symbol(f"{name}{joint}") for joint in range(count)] for name in ("q", "dq", "ddq"))
    still = [graph.constant(0.0)] * count
    follow = model.transmission.follow if isinstance(model.transmission, LinearTransmission) else np.eye(count)
    standard = np.zeros(len(model.parameters))
    standard[list(dynamics.base.columns)] = dynamics.parameters
    inertial = [standard[SIZE * link : SIZE * (link + 1)] for link in range(len(model.joints))]
    terms = joint_terms(dynamics)

    frames = joint_frames(graph, model, q, dq, ddq)
    motions = link_motions(graph, frames, model.gravity)
    moving = tree_torques(frames, [link_wrench(*pair) for pair in zip(motions, inertial, strict=True)])
    rotors = [combination(graph, row, ddq) for row in terms.inertia]
    links = [combination(graph, column, moving) for column in follow.T]

    resting_frames = joint_frames(graph, model, q, still, still)
    resting = link_motions(graph, resting_frames, model.gravity)

    def held(links_values: list[FloatArray]) -> list[Expression]:
        """Torques (n,) at the joints that hold links of these parameters."""
        wrenches = [link_wrench(*pair) for pair in zip(resting, links_values, strict=True)]
        return [combination(graph, column, tree_torques(resting_frames, wrenches)) for column in follow.T]

    load_torque = still
    if model.terms.load_torque is not None:
        of_links = np.zeros(SIZE * len(model.joints))
        of_links[list(model.terms.load_torque.columns)] = model.terms.load_torque.values
        at_joints = held([of_links[SIZE * link : SIZE * (link + 1)] for link in range(len(model.joints))])
        load_torque = [combination(graph, row, at_joints) for row in np.linalg.inv(dynamics.coupling).T]
    rubbing = friction(graph, terms, model.smoothing, q, dq, load_torque)
    torque = tuple(a + b + c for a, b, c in zip(links, rotors, rubbing, strict=True))

    held_links = held(inertial)
    gravity = tuple(held_link + float(weight) for held_link, weight in zip(held_links, dynamics.weight, strict=True))
    rubbing_alone = tuple(term - float(weight) for term, weight in zip(rubbing, dynamics.weight, strict=True))
    drifting_frames = joint_frames(graph, model, q, dq, still)
    drifting = link_motions(graph, drifting_frames, np.zeros(3))
    carried = tree_torques(drifting_frames, [link_wrench(*pair) for pair in zip(drifting, inertial, strict=True)])
    coriolis = tuple(combination(graph, column, carried) for column in follow.T)
    driving = [
        graph.symbol(f"tau{joint}") - (coriolis[joint] + held_links[joint] + rubbing[joint]) for joint in range(count)
    ]

    mass = _joint_inertia(graph, tree_inertia(graph, resting_frames, inertial), follow, terms.inertia)
    axes = link_axes(graph, frames)
    columns = [
        inertial_column(graph, motions[number // SIZE], axes[number // SIZE], number % SIZE, follow)
        if model.parameters[number].kind == "inertial"
        else joint_parameter_column(graph, dynamics, number, q, dq, ddq, load_torque)
        for number in dynamics.base.columns
    ]
    regressor = tuple(tuple(column[joint] for column in columns) for joint in range(count))

    pull = " ".join(f"{value:g}" for value in model.gravity)
    functions = [
        Function(
            "torque", "Torques of a motion, friction and motor inertia included.", ("q", "dq", "ddq"), "tau", (torque,)
        ),
        Function(
            "coriolis", "Coriolis and centrifugal torques, the vector C(q, dq) dq.", ("q", "dq"), "tau", (coriolis,)
        ),
        Function("gravity", f"Torques of gravity, {pull} m/s^2 in the base frame.", ("q",), "tau", (gravity,)),
        Function(
            "friction",
            "Torques of friction, constant offsets included.",
            ("q", "dq") if model.needs_position else ("dq",),
            "tau",
            (rubbing_alone,),
        ),
        Function("mass_matrix", "Joint-space inertia matrix, motor inertia included.", ("q",), "M", mass, matrix=True),
        Function(
            "regressor",
            "Base regressor Y with torque = Y * parameters.",
            ("q", "dq", "ddq"),
            "Y",
            regressor,
            matrix=True,
        ),
    ]
    tool = model.tool_link
    functions.append(
        Function(
            "payload_torque",
            "Torques that a payload on the last link adds to those of a motion (at rest: its weight).",
            ("q", "dq", "ddq", PAYLOAD),
            "tau",
            (payload_torque(graph, motions[tool], axes[tool], follow),),
            sizes={PAYLOAD: PAYLOAD_SIZE},
        )
    )
    functions.append(
        Function(
            "forward_dynamics",
            "Accelerations that torques cause, friction included; the inverse of torque.",
            ("q", "dq", "tau"),
            "ddq",
            (solved(mass, driving),),
        )
    )
    if count_of_states := len(presliding_motions(model)):
        z = [graph.symbol(f"z{number}") for number in range(count_of_states)]
        functions += [
            Function(
                "presliding_state",
                "Presliding states after one more time step [s] at dq; they start at the sign of the first motion.",
                ("z", "dq", "step"),
                "next",
                (presliding_states(graph, model, dq, z, graph.symbol("step0")),),
                sizes={"z": count_of_states, "step": 1},
            ),
            Function(
                "presliding_torque",
                "Torques that presliding states add to those of a motion: its friction reverses gradually.",
                ("q", "dq", "z"),
                "tau",
                (presliding_torque(graph, model, terms, q, dq, z, load_torque),),
                sizes={"z": count_of_states},
            ),
        ]
    if not np.array_equal(dynamics.coupling, np.eye(count)):
        functions.append(_motor_torque(graph, dynamics))
    lacking = left_out(dynamics)
    return tuple(function for function in functions if function.name not in lacking)


def left_out(dynamics: InverseDynamics) -> dict[str, str]:
    """Functions that these parameters do not allow, by name, and why."""
    reasons: dict[str, str] = {}
    if dynamics.confounded:
        together = f"weight and offset of {', '.join(dynamics.confounded)} are one parameter, which no motion separates"
        reasons |= {"gravity": together, "friction": together}
    position = random_states(dynamics.model, POSTURES)[0]
    if not np.all(np.linalg.eigvalsh(dynamics.inertia(position))[:, 0] > 0.0):
        reasons["forward_dynamics"] = "the inertia matrix is not positive definite everywhere within the limits"
    return reasons


def _joint_inertia(
    graph: Graph, entries: Mapping[tuple[int, int], Expression], follow: FloatArray, motors: FloatArray
) -> tuple[tuple[Expression, ...], ...]:
    """Gᵀ·M·G of the tree's inertia matrix, of which the lower triangle is given, plus the motors' (n, n)."""
    count = follow.shape[1]
    matrix: list[list[Expression]] = [[graph.constant(0.0)] * count for _ in range(count)]
    for i in range(count):
        for j in range(i + 1):
            total = graph.constant(float(motors[i, j]))
            for (row, column), entry in entries.items():
                share = follow[row, i] * follow[column, j]
                if row != column:
                    share += follow[column, i] * follow[row, j]
                total = total + entry * float(share)
            matrix[i][j] = matrix[j][i] = total
    return tuple(tuple(row) for row in matrix)


def refuse_numerical_loops(dynamics: InverseDynamics) -> None:
    """Refuse an arm whose joints without a motor follow by equations that straight-line code cannot solve.

    Raises:
        ModelError: it is one.
    """
    model = dynamics.model
    if model.transmission.solved_numerically:
        raise ModelError(
            "C code needs joints that follow linearly; a loop of this arm is solved numerically",
            where=model.name,
            hint="parallelograms and equations can be exported; for this arm, use the model from Python",
        )


def refuse_temperature(dynamics: InverseDynamics) -> None:
    """Refuse friction that depends on the temperature, which the functions do not take.

    Raises:
        ModelError: it does.
    """
    model = dynamics.model
    if model.needs_temperature:
        raise ModelError(
            "C code has no temperature, which the friction of this model depends on",
            where=model.name,
            hint="identify without the friction term 'temperature', or use the model from Python",
        )


def _motor_torque(graph: Graph, dynamics: InverseDynamics) -> Function:
    shares = np.linalg.inv(dynamics.coupling).T
    tau = [graph.symbol(f"tau{joint}") for joint in range(dynamics.model.dof)]
    rows = tuple(combination(graph, np.where(np.abs(row) < 1e-12, 0.0, row), tau) for row in shares)
    return Function(
        "motor_torque", "Torques of the motors from those of the joints (coupled motors).", ("tau",), "motor", (rows,)
    )
