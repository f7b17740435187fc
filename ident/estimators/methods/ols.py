"""Ordinary least squares."""

from __future__ import annotations

from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, NoOptions
from ident.estimators.torque_estimator import TorqueEstimator
from ident.regression.least_squares import ordinary_least_squares


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return TorqueEstimator(setup, ordinary_least_squares)


METHOD = Method("ordinary least squares, all joints' equations with equal weight", "torque", NoOptions, _estimator)
