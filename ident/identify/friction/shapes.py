"""Error bars of an estimate whose friction has estimated shapes: their uncertainty is in every parameter's.

A small change of α or v_s changes the torque by its sensitivity, a column of the regressor. With these columns beside
the others, the jackknife's covariance is that of all parameters and shapes together, to first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from drivers.core.arrays import FloatArray
from ident.estimators.estimator import Estimation, Estimator
from ident.estimators.friction_steps import COEFFICIENT_OF
from ident.estimators.robust.sensitivities import with_shapes
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import CorrectedCovariance, FilteredRun, block_jackknife
from ident.regression.least_squares import (
    LinearMethod,
    excited_columns,
    ordinary_least_squares,
    weighted_least_squares,
)
from ident.regression.observability import Experiment, experiment_base
from ident.regression.observation_matrix import only_torques, reduce_segments, stack_reductions


def with_free_shapes(
    estimator: Estimator,
    estimation: Estimation,
    experiment: Experiment,
    runs: Sequence[FilteredRun],
    corrected: CorrectedCovariance,
) -> tuple[CorrectedCovariance, dict[tuple[str, int], float]]:
    """The covariance of a solution with the uncertainty of its friction's shapes, and σ of these.

    Args:
        estimator: of the parameters.
        estimation: what it gave, by OLS, WLS or a robust method; of other methods the shapes count as known. The
            covariance remains where no shape was estimated.
        experiment: locked joints, and motors whose torques were used.
        runs: the data.
        corrected: its covariance for shapes that are known.
    """
    model, solution = estimation.kernel.model, estimation.solution
    terms = model.terms
    if terms is None or not terms.shaped:
        return corrected, {}
    if estimation.joint_covariance.size:
        return _whitened(estimator, estimation, experiment, runs, corrected)
    if solution.method not in get_args(LinearMethod):
        return corrected, {}
    linear = replace(model, terms=replace(terms, sensitivities=True))
    plain, base = experiment_base(model, [experiment]), experiment_base(linear, [experiment])
    kernel = RegressorKernel(linear, base.columns)
    reduction = only_torques(
        stack_reductions([reduce_segments(kernel, run.segments, run.parallel_filter) for run in runs]),
        experiment.torques,
    )
    estimated = {plain.names[column] for column in solution.active}
    active = [
        column
        for column in excited_columns(reduction)
        if base.names[column] in estimated or base.kinds[column] in COEFFICIENT_OF
    ]
    solve = ordinary_least_squares if solution.method == "ols" else weighted_least_squares
    solved = solve(reduction, active)
    covariance = block_jackknife(kernel, runs, solved).covariance
    place = {base.names[column]: index for index, column in enumerate(active)}
    if not estimated <= place.keys():  # the shapes are confounded with parameters
        return corrected, {}
    kept = [place[plain.names[column]] for column in solution.active]
    deviations = np.full(base.count, np.inf)
    deviations[active] = np.sqrt(np.diag(covariance))
    return (
        replace(corrected, covariance=covariance[np.ix_(kept, kept)]),
        shape_deviations(linear, base, solved.parameters, deviations),
    )


def _whitened(
    estimator: Estimator,
    estimation: Estimation,
    experiment: Experiment,
    runs: Sequence[FilteredRun],
    corrected: CorrectedCovariance,
) -> tuple[CorrectedCovariance, dict[tuple[str, int], float]]:
    """The same for equations that were whitened across the joints and weighted."""
    extended, shapes = with_shapes(estimation, experiment.torques)
    covariance = estimator.covariance(runs, extended).covariance
    count = len(estimation.solution.active)
    model, kernel = estimation.kernel.model, estimation.kernel
    deviations = {}
    for place, (kind, motor) in enumerate(zip(shapes.kinds, shapes.motors, strict=True), count):
        coefficient = next(
            abs(float(value))
            for value, column in zip(estimation.solution.parameters, kernel.columns, strict=True)
            if model.parameters[column].kind == COEFFICIENT_OF[kind]
            and model.parameters[column].joint == model.active[motor]
        )
        sigma = float(np.sqrt(covariance[place, place]))
        deviations[kind, motor] = sigma / coefficient if coefficient > 0.0 else float("inf")
    return replace(corrected, covariance=covariance[:count, :count]), deviations


def shape_deviations(
    model: DynamicModel, base: BaseParameters, parameters: FloatArray, deviations: FloatArray
) -> dict[tuple[str, int], float]:
    """σ of each free shape, by kind of its sensitivity and motor; inf where the coefficient is 0.

    Args:
        model: with sensitivities.
        base: its base parameters.
        parameters: (b,) of the solution.
        deviations: (b,) corrected σ; inf where a parameter was not estimated.
    """
    place: dict[tuple[str, int], int] = {
        (kind, joint): index for index, (kind, joint) in enumerate(zip(base.kinds, base.joints, strict=True))
    }
    found: dict[tuple[str, int], float] = {}
    for (kind, joint), index in place.items():
        if kind in COEFFICIENT_OF and (COEFFICIENT_OF[kind], joint) in place:
            coefficient = abs(float(parameters[place[COEFFICIENT_OF[kind], joint]]))
            motor = model.active.index(joint)
            found[kind, motor] = float(deviations[index]) / coefficient if coefficient > 0.0 else float("inf")
    return found
