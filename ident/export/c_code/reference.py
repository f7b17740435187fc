"""States with the torques, matrices and regressors that the model gives there, to test the C code with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import PAYLOAD, Function
from ident.export.c_code.statements import Real
from ident.model.base_parameters import random_states
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import combined
from ident.model.parameters import INERTIAL, link_parameters
from ident.model.presliding import dahl_states, presliding_motions
from ident.model.regressor import regressor

STATES = 8
SEED = 20261122
TOLERANCES: dict[Real, float] = {"double": 1e-12, "float": 1e-5}
"""Largest deviation, relative to the largest value, that the self-test of each type allows."""


@dataclass(frozen=True)
class ExpectedValues:
    """What the functions should give."""

    # q, dq, ddq and tau (N, n), payload (N, 10), and with presliding z (N, s) and step (N, 1), by name
    inputs: dict[str, FloatArray]
    outputs: dict[str, FloatArray]  # (N, …) by the function's name
    # largest value of each, that deviations are relative to; of all torques the same, of accelerations times the
    # condition number of the inertia matrix, which multiplies rounding
    scales: dict[str, float]


def reference(dynamics: InverseDynamics, real: Real, count: int = STATES, seed: int = SEED) -> ExpectedValues:
    """Random states within the joint limits, and the model's answers.

    Inputs are rounded to the type of the C code, so that both compute with the same numbers.
    """
    model = dynamics.model
    states = random_states(model, count, seed)
    position, velocity, acceleration = (
        state.astype(np.float32).astype(np.float64) if real == "float" else state for state in states
    )
    torque = dynamics.torque(position, velocity, acceleration)
    if real == "float":
        with np.errstate(over="ignore"):  # parameters that do not fit are refused where they are written
            torque = torque.astype(np.float32).astype(np.float64)
    still = np.zeros_like(position)
    payload = random_payloads(count, seed)
    if real == "float":
        payload = payload.astype(np.float32).astype(np.float64)
    inputs = {"q": position.T, "dq": velocity.T, "ddq": acceleration.T, PAYLOAD: payload, "tau": torque.T}
    inertia = dynamics.inertia(position)
    at_rest = dynamics.torque(position, velocity, still)
    rows = np.einsum(
        "mn,mbN->Nnb", dynamics.coupling, regressor(model, position, velocity, acceleration, dynamics.base.columns)
    )
    outputs = {
        "torque": torque.T,
        "coriolis": (dynamics.links(position, velocity, still) - dynamics.links(position, still, still)).T,
        "gravity": dynamics.gravity(position).T,
        "friction": dynamics.friction(velocity, position).T,
        "mass_matrix": inertia,
        "regressor": rows,
        "payload_torque": _loaded(dynamics, (position, velocity, acceleration), payload),
        "forward_dynamics": _accelerations(inertia, torque - at_rest),
        "motor_torque": np.linalg.solve(dynamics.coupling.T, torque).T,
    }
    if motions := presliding_motions(model):
        generator = np.random.default_rng(seed + 2)
        z, step = generator.uniform(-1.0, 1.0, (count, len(motions))), generator.uniform(1e-4, 1e-2, (count, 1))
        if real == "float":
            z, step = (values.astype(np.float32).astype(np.float64) for values in (z, step))
        inputs |= {"z": z, "step": step}
        after = np.empty_like(z)
        for place, (motion, travel) in enumerate(motions.items()):
            for state, rate in enumerate(combined(motion, velocity)):
                after[state, place] = dahl_states(rate[None], 1.0 / step[state, 0], [travel], z[state, place])[0, 0]
        outputs["presliding_state"] = after
        gradual = dict(zip(motions, z.T, strict=True))
        outputs["presliding_torque"] = (
            dynamics.friction(velocity, position, presliding=gradual) - dynamics.friction(velocity, position)
        ).T
    largest = {name: float(np.max(np.abs(values), initial=0.0)) or 1.0 for name, values in outputs.items()}
    names = ("torque", "coriolis", "gravity", "friction")
    torques = max(largest[name] for name in names)
    worst = float(np.max(np.linalg.cond(inertia)))
    scales = {**largest, **dict.fromkeys(names, torques), "forward_dynamics": worst * largest["forward_dynamics"]}
    return ExpectedValues(inputs, outputs, scales)


def _accelerations(inertia: FloatArray, torque: FloatArray) -> FloatArray:
    """Accelerations (N, n) that torques (n, N) cause; zeros where the parameters have no inertia."""
    try:
        return np.asarray(np.linalg.solve(inertia, torque.T[..., None])[..., 0])
    except np.linalg.LinAlgError:
        return np.zeros(torque.T.shape)


def random_payloads(count: int, seed: int) -> FloatArray:
    """Mass, centre and inertia (N, 10) of balls of up to 10 kg, as C's `payload`, with products of inertia."""
    generator = np.random.default_rng(seed + 1)
    mass = generator.uniform(0.5, 10.0, (count, 1))
    centre = generator.uniform(-0.2, 0.2, (count, 3))
    return np.hstack([mass, centre, mass * 0.01 * np.array([1.0, 0.1, -0.1, 1.2, 0.2, 1.4])])


def _loaded(
    dynamics: InverseDynamics, motion: tuple[FloatArray, FloatArray, FloatArray], payload: FloatArray
) -> FloatArray:
    """Torques (N, n) of payloads (N, 10) on the last link."""
    model, size = dynamics.model, len(INERTIAL)
    columns = tuple(size * model.tool_link + kind for kind in range(size))
    parts = regressor(model, *motion, columns=columns)
    standard = np.array([link_parameters(body[0], body[1:4].tolist(), body[4:].tolist()) for body in payload])
    return np.asarray(np.einsum("mn,mbN,Nb->Nn", dynamics.coupling, parts, standard))


def deviation(graph: Graph, function: Function, expected: ExpectedValues) -> float:
    """Largest deviation of a function's expressions from the reference, relative to its scale."""
    symbols = {
        f"{name}{joint}": column for name, values in expected.inputs.items() for joint, column in enumerate(values.T)
    }
    values = graph.evaluate(function.outputs, symbols)
    wanted = expected.outputs[function.name].reshape(values.shape[1], -1).T
    return float(np.max(np.abs(values - wanted))) / expected.scales[function.name]


def check_expressions(graph: Graph, functions: tuple[Function, ...], dynamics: InverseDynamics) -> None:
    """Refuse code that would not compute what the model does.

    Raises:
        ModelError: a function deviates by more than the tolerance of the self-test in double.
    """
    expected = reference(dynamics, "double")
    for function in functions:
        missed = deviation(graph, function, expected)
        if not missed <= TOLERANCES["double"]:
            raise ModelError(
                f"the C code's {function.name} would deviate from the model by {missed:.1e} of its largest value",
                where=dynamics.model.name,
                hint="the parameters cancel each other almost entirely; export the consistent model",
            )
