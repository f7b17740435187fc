"""The power model."""

from __future__ import annotations

from ident.estimators.energy.estimator import EnergyEstimator
from ident.estimators.energy.power import PowerSamples
from ident.estimators.estimator import Estimator, Setup
from ident.estimators.method import Method, NoOptions
from ident.model.energy import EnergyKernel


def _estimator(options: NoOptions, setup: Setup) -> Estimator:
    return EnergyEstimator(setup, PowerSamples(EnergyKernel(setup.kernel.model, setup.kernel.columns)), "power")


METHOD = Method("the derivative of the whole arm's energy, one equation per sample", "energy", NoOptions, _estimator)
