"""Ordinary least squares, then a particle swarm about it."""

from __future__ import annotations

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method
from ident.estimators.search_options import ConstantWeightOptions, swarm_estimator
from ident.regression.least_squares import ordinary_least_squares


def _estimator(options: ConstantWeightOptions, setup: Setup) -> Estimator:
    return swarm_estimator(options, setup, ordinary_least_squares)


METHOD = Method(
    "particle swarm about ordinary least squares (LS-PSO); least squares itself is its exact optimum",
    "torque",
    ConstantWeightOptions,
    _estimator,
)
