"""Weighted least squares."""

from __future__ import annotations

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, NoOptions
from ident.estimators.torque_estimator import TorqueEstimator
from ident.regression.least_squares import weighted_least_squares


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return TorqueEstimator(setup, weighted_least_squares)


METHOD = Method(
    "weighted least squares, each joint's equations divided by the standard deviation of its residual",
    "torque",
    NoOptions,
    _estimator,
)
