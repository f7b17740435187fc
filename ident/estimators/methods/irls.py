"""Iteratively reweighted least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method
from ident.estimators.robust.irls import RobustEstimator
from ident.estimators.robust.weight_functions import WeightName


@dataclass(frozen=True)
class IrlsOptions:
    """Options of IRLS."""

    weights: Annotated[WeightName, Field(description="how residuals that are too large count: not at all, or less")] = (
        "hard"
    )
    consistent: Annotated[bool, Field(description="weigh by the residuals of the physically consistent parameters")] = (
        False
    )


def _estimator(options: IrlsOptions, setup: Setup) -> Estimator:
    return RobustEstimator(setup, options.weights, options.consistent)


METHOD = Method(
    "robust: equations whitened across the joints, samples with too large residuals rejected or weighted down",
    "torque",
    IrlsOptions,
    _estimator,
)
