"""Multiplications, additions, sines and cosines of the code of `dynid export --c` (docs/measurements/export.md).

Every base parameter of the arm has a value, as after an identification. "links" leaves out friction and motor inertia;
"ten per link" takes all standard parameters of the links in place of the base parameters. A few seconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.robot.loader import load_robot
from ident.export.c_code.expressions import Graph
from ident.export.c_code.functions import Function, arm_functions
from ident.model.base_parameters import BaseParameters, base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics


def counts(model: DynamicModel, base: BaseParameters) -> dict[str, str]:
    """Multiplications/additions/sines of every function."""
    graph = Graph()
    values = np.random.default_rng(0).uniform(0.5, 1.5, base.count)
    functions = arm_functions(graph, InverseDynamics(model, base, values))
    return {function.name: text(graph, function) for function in functions}


def text(graph: Graph, function: Function) -> str:
    """Return the counts of multiplications, additions and sines of one function."""
    operations = graph.operations(function.outputs)
    return f"{operations.multiplications}/{operations.additions}/{operations.sines}"


def links_only(model: DynamicModel) -> DynamicModel:
    """The arm without friction, offsets and motor inertia."""
    none = (False,) * model.dof
    transmission = replace(model.transmission, pair_friction=none, pair_inertia=none)
    return replace(model, motor_inertia=none, viscous=none, coulomb=none, offset=none, transmission=transmission)


def all_standard(model: DynamicModel) -> BaseParameters:
    """Every standard parameter as if it were a base parameter."""
    parameters = model.parameters
    return replace(
        base_parameters(model),
        names=tuple(parameter.name for parameter in parameters),
        kinds=tuple(parameter.kind for parameter in parameters),
        columns=tuple(range(len(parameters))),
        projection=np.eye(len(parameters)),
    )


def main() -> None:
    """Print the table, a row an arm."""
    print("multiplications/additions/sines and cosines")
    names = ("torque", "gravity", "mass_matrix", "regressor")
    print(f"{'':8}{'links':>14}{'ten per link':>14}" + "".join(f"{name:>14}" for name in names))
    for robot in ("ur5e", "panda", "sr400"):
        model = build_model(load_robot(robot))
        links = links_only(model)
        whole = counts(model, base_parameters(model))
        row = [
            counts(links, base_parameters(links))["torque"],
            counts(links, all_standard(links))["torque"],
            *(whole[name] for name in names),
        ]
        print(f"{robot:8}" + "".join(f"{entry:>14}" for entry in row))


if __name__ == "__main__":
    main()
