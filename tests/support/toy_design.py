"""A design problem whose optimum is known: keep two joints near a point of least cost, within a limit each."""

from __future__ import annotations

import os
from functools import partial

import numpy as np

from drivers.errors import UsageError
from ident.excite.constraints.soft_maximum import soft_maximum
from ident.excite.path import Path
from ident.excite.problem import Problem

BEST = np.array([0.5, 2.0])
LIMIT = 1.0


class Still:
    """Two joints that rest at x."""

    size = 2

    def path(self, variables, time):
        zero = np.zeros((2, len(time)))
        return Path(time, zero + variables[:, None], zero, zero)

    def pull_back(self, variables, time, gradient):
        return gradient[..., 0, :, :].sum(axis=-1)

    def random(self, generator):
        return generator.uniform(-1.0, 1.0, 2)


class Distance:
    """Squared distance from BEST, with shallow waves that make local optima."""

    def cost(self, path):
        return self.smooth_cost(path, np.inf)[0]

    def smooth_cost(self, path, sharpness):
        away = path.position[:, 0] - BEST
        gradient = np.zeros((3, *path.position.shape))
        gradient[0, :, 0] = 2.0 * away + 0.3 * np.sin(6.0 * away)
        return float(away @ away + 0.05 * np.sum(1.0 - np.cos(6.0 * away))), gradient


class Below:
    """Both joints stay below LIMIT."""

    names = ("position of j1", "position of j2")

    def use(self, path):
        return path.position.max(axis=1) / LIMIT

    def smooth_use(self, path, sharpness):
        bound, weights = soft_maximum(path.position / LIMIT, sharpness)
        gradient = np.zeros((2, 3, *path.position.shape))
        gradient[[0, 1], 0, [0, 1]] = weights / LIMIT
        return bound, gradient


def toy_problem(fault: str = "") -> Problem:
    """The problem; building it may raise, or end the process."""
    if fault == "raise":
        raise UsageError("refused on purpose")
    if fault == "die":
        os._exit(3)
    return Problem(Still(), Distance(), Distance(), (Below(),), np.linspace(0.0, 1.0, 4), 0.99)


def maker(**choices):
    """Something picklable that builds the problem."""
    return partial(toy_problem, **choices)
