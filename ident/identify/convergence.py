"""How an iterative estimator converged, for the result."""

from __future__ import annotations

import numpy as np

from ident.identify.identification import Identification
from ident.result.schema import Convergence, JointEquations


def convergence_result(identification: Identification) -> Convergence | None:
    """Loops, passes and weights; None for a method that solves in one step."""
    estimation = identification.estimation
    if not estimation.loops:
        return None
    names = identification.model.joint_names
    equations = []
    if estimation.weights:
        weights = np.concatenate(estimation.weights, axis=1)
        for name, of_joint in zip(names, weights, strict=True):
            known = of_joint[~np.isnan(of_joint)]
            equations.append(
                JointEquations(
                    joint=name,
                    equations=len(known),
                    rejected=int(np.sum(known == 0.0)),
                    mean_weight=float(known.mean()) if len(known) else None,
                )
            )
    covariance = estimation.joint_covariance
    deviations = np.sqrt(np.diag(covariance)) if covariance.size else np.empty(0)
    return Convergence(
        passes=estimation.passes,
        loops=list(estimation.loops),
        equations=equations,
        joint_correlation=(covariance / np.outer(deviations, deviations)).tolist() if covariance.size else [],
    )
