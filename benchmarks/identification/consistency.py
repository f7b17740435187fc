"""Physically consistent parameters: our interior-point method on the triangular factor against cvxpy with Clarabel."""

from __future__ import annotations

import cvxpy
import numpy as np

from benchmarks.timing import medians
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.estimators.feasible.consistent import consistent_parameters
from ident.estimators.feasible.pseudo_inertia import BASIS
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.parameters import INERTIAL
from ident.model.regressor import regressor
from ident.model.true_parameters import truth_vector
from ident.regression.estimate import Estimate

COMPARED = """\
consistency_panda_ms: consistent_parameters() of a Panda's estimate (7 joints, 2 % noise) with prior and error bars.
consistency_vs_clarabel_on_factor: cvxpy and Clarabel on the same triangular factor, pseudo-inertias, inertias and
  friction positive, over ours; the time of building the problem counts, as a user would wait for it.
consistency_vs_clarabel_on_rows: the same on all rows of 10,000 samples, over ours."""

SAMPLES = 10_000
NOISE = 0.02


def run(samples: int = SAMPLES, rounds: int = 3) -> dict[str, float]:
    """Milliseconds and ratios."""
    robot_file = load_robot("panda")
    model = build_model(robot_file)
    base = base_parameters(model)
    rows = regressor(model, *random_states(model, samples, seed=1), base.columns)
    matrix = np.concatenate([joint.T for joint in rows])
    torque = matrix @ (base.projection @ truth_vector(robot_file))
    sigma = NOISE * float(np.sqrt(np.mean(torque**2)))
    torque = torque + sigma * np.random.default_rng(1).standard_normal(len(torque))
    root = np.asarray(np.linalg.qr(matrix / sigma, mode="r"))
    values = np.linalg.lstsq(matrix, torque, rcond=None)[0]
    estimate = Estimate(
        tuple(range(base.count)), values, root, np.linalg.inv(root.T @ root), np.zeros((base.count, 0)), 20
    )
    links = len(model.joints)
    positive = [i for i, parameter in enumerate(model.parameters) if parameter.kind not in ("inertial", "offset")]
    seconds = medians(
        {
            "ours": lambda: consistent_parameters(model, base, estimate, robot_file),
            "factor": lambda: _reference(root @ base.projection, root @ values, links, positive),
            "rows": lambda: _reference(matrix @ base.projection / sigma, torque / sigma, links, positive),
        },
        rounds,
    )
    return {
        "consistency_panda_ms": 1e3 * seconds["ours"],
        "consistency_vs_clarabel_on_factor": seconds["factor"] / seconds["ours"],
        "consistency_vs_clarabel_on_rows": seconds["rows"] / seconds["ours"],
    }


def _reference(system: FloatArray, target: FloatArray, links: int, positive: list[int]) -> FloatArray:
    """The semidefinite program, as one writes it with cvxpy."""
    x = cvxpy.Variable(system.shape[1])
    size = len(INERTIAL)
    constraints = [x[positive] >= 0]
    constraints += [
        sum(x[size * link + i] * BASIS[i] for i in range(size)) >> 1e-6 * np.eye(4) for link in range(links)
    ]
    cost = cvxpy.sum_squares(system @ x - target)  # type: ignore[attr-defined]
    cvxpy.Problem(cvxpy.Minimize(cost), constraints).solve(solver=cvxpy.CLARABEL)  # type: ignore[no-untyped-call]
    return np.asarray(x.value)
