"""States with the torques, matrices and regressors that the model gives there, to test the C code with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.errors import ModelError
from drivers.streams import FloatArray
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import Function
from ident.export.c_code.statements import Real
from ident.model.base_parameters import random_states
from ident.model.inverse_dynamics import InverseDynamics
from ident.model.regressor import regressor

STATES = 8
SEED = 20261122
TOLERANCES: dict[Real, float] = {"double": 1e-12, "float": 1e-5}
"""Largest deviation, relative to the largest value, that the self-test of each type allows."""


@dataclass(frozen=True)
class Reference:
    """What the functions should give.

    Attributes:
        inputs: q, dq, ddq and tau (N, n) by name.
        outputs: (N, …) by the function's name.
        scales: largest value of each, that deviations are relative to; of all torques the same.
    """

    inputs: dict[str, FloatArray]
    outputs: dict[str, FloatArray]
    scales: dict[str, float]


def reference(dynamics: InverseDynamics, real: Real, count: int = STATES, seed: int = SEED) -> Reference:
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
    rows = np.einsum(
        "mn,mbN->Nnb",
        dynamics.coupling,
        regressor(model, position, velocity, acceleration, dynamics.base.columns),
    )
    outputs = {
        "torque": torque.T,
        "gravity": dynamics.links(position, still, still).T,
        "friction": dynamics.friction(velocity, position).T,
        "mass_matrix": dynamics.inertia(position),
        "regressor": rows,
        "motor_torque": np.linalg.solve(dynamics.coupling.T, torque).T,
    }
    largest = {name: float(np.max(np.abs(values), initial=0.0)) or 1.0 for name, values in outputs.items()}
    torques = max(largest[name] for name in ("torque", "gravity", "friction"))
    scales = {**largest, "torque": torques, "gravity": torques, "friction": torques}
    inputs = {"q": position.T, "dq": velocity.T, "ddq": acceleration.T, "tau": torque.T}
    return Reference(inputs, outputs, scales)


def deviation(graph: Graph, function: Function, expected: Reference) -> float:
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
