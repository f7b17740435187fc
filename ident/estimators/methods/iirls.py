"""Iteratively reweighted least squares with nonlinear friction and load torque estimated along."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from drivers.core.errors import UsageError
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, within
from ident.estimators.robust.iirls import FullFrictionEstimator
from ident.estimators.robust.weight_functions import WeightName
from ident.ranges import FRICTION_SHARE


@dataclass(frozen=True)
class IirlsOptions:
    """Options of I-IRLS."""

    weights: Annotated[WeightName, Field(description="how residuals that are too large count: not at all, or less")] = (
        "hard"
    )
    consistent: Annotated[bool, Field(description="weigh by the residuals of the physically consistent parameters")] = (
        False
    )
    decoupled: Annotated[bool, Field(description="estimate inertial and friction parameters in turn (ID-IRLS)")] = False
    largest_friction: Annotated[
        float | None,
        within(FRICTION_SHARE),
        Field(
            description="bounds of the friction (AUBO eq. 16): a term's largest share of the joint's torque limit; "
            "dissipative terms are then not negative; no bounds if absent"
        ),
    ] = None

    def __post_init__(self) -> None:
        if self.consistent and self.largest_friction is not None:
            raise UsageError(
                "consistent=true and largest_friction exclude each other",
                where="--method iirls",
                hint="consistent parameters have no negative friction either",
            )


def _estimator(options: IirlsOptions, setup: Setup) -> Estimator:
    return FullFrictionEstimator(
        setup, options.weights, options.consistent, options.decoupled, options.largest_friction
    )


METHOD = Method(
    "as irls; the shapes of the friction and its load torque are estimated along, by the equations that count",
    "torque",
    IirlsOptions,
    _estimator,
)
