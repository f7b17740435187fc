"""A ready-made excitation for simulated arms: the best of many random Fourier series inside the limits."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import FourierSeries
from drivers.core.arrays import FloatArray
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, motion_factor

CANDIDATES = 30
HARMONICS = 5
LIMIT_SHARE = 0.9
_GRID = 400


def random_fourier_motion(model: DynamicModel, period: float, seed: int, candidates: int = CANDIDATES) -> FourierSeries:
    """The Fourier series with the lowest condition among `candidates` random ones, within 90 % of every limit.

    The limits hold on a grid of 400 points per period; with 5 harmonics the extremes lie within 0.1 % of it.
    """
    generator = np.random.default_rng(seed)
    columns = base_parameters(model).columns
    kernel = RegressorKernel(model, columns)
    time = np.linspace(0.0, period, _GRID, endpoint=False)
    best: tuple[float, FourierSeries] | None = None
    for _ in range(candidates):
        motion = _inside_limits(model, _random_series(model, period, generator), time)
        condition = scaled_condition(motion_factor(kernel, *motion.evaluate(time)))
        if best is None or condition < best[0]:
            best = (condition, motion)
    if best is None:
        raise ValueError("candidates must be at least 1")
    return best[1]


def _random_series(model: DynamicModel, period: float, generator: np.random.Generator) -> FourierSeries:
    shape = (model.dof, HARMONICS)
    return FourierSeries(
        period=period,
        offset=np.zeros(model.dof),
        sine=generator.standard_normal(shape),
        cosine=generator.standard_normal(shape),
    )


def _inside_limits(model: DynamicModel, motion: FourierSeries, time: FloatArray) -> FourierSeries:
    """Scaled so that every joint uses at most `LIMIT_SHARE` of each limit, centred in its range."""
    position, velocity, acceleration = motion.evaluate(time)
    factors, offsets = [], []
    for joint, limits in enumerate(model.limits):
        low, high = limits.position
        swing = np.ptp(position[joint])
        factor = LIMIT_SHARE * min(
            (high - low) / swing,
            limits.velocity / np.max(np.abs(velocity[joint])),
            limits.acceleration / np.max(np.abs(acceleration[joint])),
            2.0 * np.pi / swing,  # more than a turn shows nothing new
        )
        middle = factor * 0.5 * (np.max(position[joint]) + np.min(position[joint]))
        factors.append(factor)
        offsets.append(0.5 * (low + high) - middle)
    scale = np.array(factors)[:, None]
    return FourierSeries(motion.period, np.array(offsets), motion.sine * scale, motion.cosine * scale)
