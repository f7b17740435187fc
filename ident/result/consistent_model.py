"""The physically consistent model as a result stores it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from daq.robot.loader import RobotFile
from ident.assessment.validation import Fit
from ident.estimators.feasible.armature import Armature
from ident.estimators.feasible.consistent import ConsistentParameters
from ident.estimators.feasible.pseudo_inertia import Body, body_of
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import INERTIAL
from ident.result.delivered import HeldOutErrors
from ident.result.units import parameter_unit
from ident.simulation.tracking import TrackingError
from ident.stored import Number, Stored, Value


class LinkResult(Body):
    """A link of the physically consistent model, in the frame of its joint."""

    link: str = Field(description="name of the joint that moves it")
    prior: str = Field(description="source of the prior body for what the data leave open")
    identified: float = Field(description="share of its ten parameters that the data determine")


class StandardParameterResult(Stored):
    """One standard parameter of the physically consistent model."""

    name: str
    unit: str
    value: Value
    std: Number = Field(description="null where the data do not determine it")
    determined: float = Field(description="share that the data determine; the rest comes from the prior")
    known: bool = Field(description="named in the robot file")


class ConsistentModel(Stored):
    """The model whose links, inertias and friction can exist, and what this costs."""

    parameters: list[StandardParameterResult]
    base_values: dict[str, Value] = Field(description="base parameters of these standard parameters, by name")
    prior_distance: str
    prior_weight: float = Field(description="in equations of unit variance per link")
    misfit: float = Field(description="rise of the sum of squared residuals, each of unit variance")
    p_value: Number = Field(description="probability of a greater rise if the truth is consistent (F-test)")
    boundary: list[str] = Field(description="links that the conditions hold near the boundary")
    limits_hit: list[str] = Field(description="ranges of the robot file that hold a parameter")
    fit: Fit | None
    validation: Fit | None
    simulation: TrackingError | None = None
    not_simulated: str = Field(default="", description="why `simulation` is null")
    armature: list[Armature] = Field(
        default_factory=list, description="of the joints whose drive says `inertia: false`"
    )
    apparent_mass: Number = Field(
        default=None, description="of all links, were they all heavier than their prior by one factor [kg]"
    )


def link_results(model: DynamicModel, consistent: ConsistentParameters) -> list[LinkResult]:
    """The bodies of the links."""
    size = len(INERTIAL)
    own = [slice(size * index, size * (index + 1)) for index in range(len(model.link_names))]
    return [
        LinkResult(
            link=name,
            **dict(body_of(consistent.values[place])),
            prior=source,
            identified=float(np.mean(consistent.determined[place])),
        )
        for name, place, source in zip(model.link_names, own, consistent.sources, strict=True)
    ]


def consistent_model(
    model: DynamicModel,
    base: BaseParameters,
    robot_file: RobotFile,
    consistent: ConsistentParameters,
    fit: Fit | None = None,
    validation: Fit | None = None,
    runs: Sequence[HeldOutErrors] = (),
) -> ConsistentModel:
    """The consistent model with what it costs."""
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
