"""dynid as a user calls it: `dynid.identify` without options, its delivered model, and other methods and parameters."""

from __future__ import annotations

from typing import Literal

import numpy as np

from drivers.core.errors import DataError
from ident.benchmark.entry import TorquePredictor, Training
from ident.model.parameters import link_parameters
from ident.result.models.model import Model
from ident.tasks.identification import IdentificationResult, identify

KEPT = (0.5, 1.0, 2.0)
"""[s] of a single training part's end that dynid keeps for its own validation: the first that is long enough."""


def delivered(training: Training) -> TorquePredictor:
    """The model that `dynid identify` hands out: bodies that can exist."""
    return predictor_of(_identified(training, "wls"), "consistent")


def full(training: Training) -> TorquePredictor:
    """All base parameters as estimated, by weighted least squares."""
    return predictor_of(_identified(training, "wls"), "full")


def ols(training: Training) -> TorquePredictor:
    """The delivered model by ordinary least squares."""
    return predictor_of(_identified(training, "ols"), "consistent")


def irls(training: Training) -> TorquePredictor:
    """The delivered model by iteratively re-weighted least squares."""
    return predictor_of(_identified(training, "irls"), "consistent")


def _identified(training: Training, method: str) -> IdentificationResult:
    """An identification that learns from nearly all of the training data; from 70 % where there is no other way."""
    runs = list(training.recordings)
    for kept in KEPT if len(runs) == 1 else ():
        try:
            return identify(runs, split=float(np.ptp(runs[0].time)) - kept, robot=training.robot, method=method)
        except DataError:  # so short a part has no motion left between the filters' ends
            continue
    return identify(runs, robot=training.robot, method=method)


def predictor_of(identified: IdentificationResult, kind: Literal["consistent", "full"]) -> TorquePredictor:
    """One of an identification's models; the unconstrained one where no bodies were found."""
    result = identified.result
    determined = result.standard_parameters is not None
    model = Model(result, kind if determined else "full")
    bodies, parameters = None, {}
    if kind == "consistent" and result.standard_parameters is not None:
        parameters = {
            parameter.name: (parameter.value, parameter.std)
            for parameter in result.base_parameters
            if parameter.value is not None and parameter.std is not None
        }
        bodies = np.array(
            [link_parameters(link.mass, link.com, list(link.inertia.values())) for link in result.standard_parameters]
        )
    delays = result.delay.joint_delays
    delay = result.delay.used if delays is None else np.array(delays)
    return TorquePredictor(model.torque, delay, bodies, parameters)
