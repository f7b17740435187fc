"""The physically consistent model as a result stores it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.loader import RobotFile
from ident.assessment.validation import Fit
from ident.estimators.feasible.consistent import ConsistentParameters
from ident.estimators.feasible.pseudo_inertia import body_of
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import INERTIAL
from ident.result.schema import (
    ConsistentModel,
    HeldOutErrors,
    LinkResult,
    StandardParameterResult,
)
from ident.result.units import parameter_unit


def link_results(model: DynamicModel, consistent: ConsistentParameters) -> list[LinkResult]:
    """The bodies of the links."""
    size = len(INERTIAL)
    links = []
    for index, name in enumerate(model.link_names):
        own = slice(size * index, size * (index + 1))
        body = body_of(consistent.values[own])
        links.append(
            LinkResult(
                link=name,
                mass=body.mass,
                com=body.com.tolist(),
                inertia=dict(
                    zip(("xx", "xy", "xz", "yy", "yz", "zz"), body.inertia[np.triu_indices(3)].tolist(), strict=True)
                ),
                prior=consistent.sources[index],
                identified=float(np.mean(consistent.determined[own])),
            )
        )
    return links


def consistent_model(
    model: DynamicModel,
    base: BaseParameters,
    robot_file: RobotFile,
    consistent: ConsistentParameters,
    fit: Fit | None = None,
    validation: Fit | None = None,
    runs: Sequence[HeldOutErrors] = (),
) -> ConsistentModel:
    """The consistent model with what it costs.

    Args:
        model: the arm.
        base: base parameters of the experiment.
        robot_file: whose prior was used.
        consistent: its parameters.
        fit: its error on the identification data, where there are any.
        validation: on held-out data.
        runs: held-out recordings, on the longest of which the simulated arm's motion error is taken.
    """
    prior = robot_file.robot.prior
    simulated = [run.simulation for run in runs if run.simulation is not None]
    simulation = max(simulated, key=lambda motion: motion.duration, default=None)
    return ConsistentModel(
        parameters=[
            StandardParameterResult(
                name=parameter.name,
                unit=parameter_unit(model, index),
                value=float(value),
                std=float(std),
                determined=float(np.clip(share, 0.0, 1.0)),
                known=bool(known),
            )
            for index, (parameter, value, std, share, known) in enumerate(
                zip(
                    model.parameters,
                    consistent.values,
                    consistent.std,
                    consistent.determined,
                    consistent.known,
                    strict=True,
                )
            )
        ],
        base_values=dict(zip(base.names, consistent.base.tolist(), strict=True)),
        prior_distance=prior.distance,
        prior_weight=prior.weight,
        misfit=consistent.misfit,
        p_value=None if consistent.cost is None else consistent.cost.p_value,
        boundary=[model.link_names[link] for link in consistent.boundary],
        limits_hit=list(consistent.limits_hit),
        fit=fit,
        validation=None
        if validation is None
        else validation.model_copy(update={"held_out": all(run.held_out for run in runs)}),
        simulation=simulation,
        not_simulated="" if simulation else next((run.not_simulated for run in runs), "nothing was held out"),
        armature=list(consistent.armatures),
        apparent_mass=consistent.apparent_mass,
    )
