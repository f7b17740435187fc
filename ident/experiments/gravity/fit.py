"""Gravity parameters, offsets and friction from poses passed in both directions, with intervals and held-out errors.

The mean of both passes is linear in the gravity parameters; joints have residuals of their own size, which weight the
equations in turn (feasible generalised least squares). Errors of a pose are held out: its torque is predicted from the
other poses, those at the same place left out with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from drivers.core.arrays import BoolArray, FloatArray, IntArray
from drivers.core.errors import IdentificationError
from ident.experiments.gravity.passes import Visit
from ident.model.dynamic_model import DynamicModel

PASSES = 8
"""Iterations of the weights; they settle in three or four."""

UNSEEN = 1e-5
"""Singular values of the column-normalised rows below this share of the largest tell nothing."""

SAME_POSE = 0.02
"""Poses closer than this [rad or m] are one."""

FEWEST_VISITS = 3


@dataclass(frozen=True, eq=False)
class GravityFit:
    """What the visits tell."""

    values: FloatArray  # (b,) gravity parameters and offsets; 0 where they are not determined
    covariance: FloatArray  # (b, b) of them
    determined: BoolArray  # (b,) whether the poses tell each of them
    quantile: FloatArray  # (b,) of Student's t for 95 %, by the residuals that each parameter's σ comes from
    deviation: FloatArray  # (n,) σ of a joint's equations [N·m or N]; nan of a joint without any
    used: BoolArray  # (K, n) which joints of which visit have an equation
    residual: FloatArray  # (K, n) measured minus fitted, nan where not used
    held_out: FloatArray  # (K, n) measured minus predicted from the other poses
    group: IntArray  # (K,) number of the place of each visit
    friction: FloatArray  # (n,) mean half difference of the directions [N·m or N], nan without equations
    friction_interval: FloatArray  # (n,) half of its 95 % interval
    friction_spread: FloatArray  # (n,) its standard deviation over the poses


def used_equations(visits: Sequence[Visit], model: DynamicModel) -> BoolArray:
    """(K, n) whether each motor turns in each visit: the torque of one that rests holds an unknown friction."""
    coupling = model.transmission.coupling
    rates = np.array([coupling @ visit.direction for visit in visits])
    return np.asarray(np.abs(rates) > 0.0)


def fit_gravity(visits: Sequence[Visit], model: DynamicModel) -> GravityFit:
    """Estimate from visits.

    Raises:
        IdentificationError: fewer visits than a held-out error needs.
    """
    used = used_equations(visits, model)
    torque = np.array([visit.mean[0] for visit in visits])
    rows = np.array([visit.mean[1] for visit in visits])
    noise = np.array([visit.noise for visit in visits])
    group = _places(visits)
    if len(set(group.tolist())) < FEWEST_VISITS:
        raise IdentificationError(
            f"only {len(set(group.tolist()))} different poses are passed in both directions",
            hint=f"at least {FEWEST_VISITS} are needed; 20 are usual: dynid excite ROBOT --for gravity",
        )
    values, covariance, determined, deviation, freedom = _weighted(rows, torque, used, noise)
    residual = np.where(used, torque - rows @ values, np.nan)
    held_out = np.full_like(torque, np.nan)
    for place in set(group.tolist()):
        others = group != place
        without, *_ = _weighted(rows[others], torque[others], used[others], noise[others], deviation)
        held_out[~others] = (torque - rows @ without)[~others]
    held_out = np.where(used, held_out, np.nan)
    friction, interval, spread = _friction(visits, values, model, used)
    shares = _shares_of_joints(rows, used, deviation, covariance)
    # Welch and Satterthwaite: degrees of freedom of a variance that several joints' residuals make up.
    with np.errstate(divide="ignore", invalid="ignore"):
        effective = 1.0 / np.sum(shares**2 / np.maximum(freedom, 1.0), axis=1)
    quantile = stdtrit(np.where(np.isfinite(effective), np.maximum(effective, 1.0), 1.0), 0.975)
    return GravityFit(
        values,
        covariance,
        determined,
        np.asarray(quantile),
        deviation,
        used,
        residual,
        held_out,
        group,
        friction,
        interval,
        spread,
    )


def _weighted(
    rows: FloatArray, torque: FloatArray, used: BoolArray, noise: FloatArray, fixed: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray]:
    """Values, covariance, which are determined, σ of the joints' equations, and their degrees of freedom (n,)."""
    count = used.sum(axis=0)
    least = np.array([np.sqrt(np.mean(noise[used[:, j], j] ** 2)) if count[j] else 1.0 for j in range(used.shape[1])])
    size = float(np.max(np.abs(torque), initial=0.0, where=used)) or 1.0
    least = np.maximum(least, 1e-9 * size)
    deviation = np.full(used.shape[1], size) if fixed is None else fixed
    deviation = np.where(np.isfinite(deviation), deviation, size)
    for _ in range(PASSES if fixed is None else 1):
        weight = used / deviation
        wide = (rows * weight[..., None]).reshape(-1, rows.shape[2])
        scale = np.linalg.norm(wide, axis=0)
        seen = scale > 0.0
        scale = np.where(seen, scale, 1.0)
        left, singular, axes = np.linalg.svd(wide / scale, full_matrices=False)
        kept = singular > UNSEEN * singular.max(initial=0.0)
        inverse = (axes[kept].T / singular[kept]) @ left[:, kept].T
        values = inverse @ np.where(used, torque * weight, 0.0).ravel() / scale
        covariance = (axes[kept].T / singular[kept] ** 2) @ axes[kept] / np.outer(scale, scale)
        determined = seen & (np.linalg.norm(axes[kept], axis=0) > 1.0 - 1e-6)
        leverage = np.sum(left[:, kept] ** 2, axis=1).reshape(used.shape)
        freedom = np.maximum(count - np.sum(leverage, axis=0), 0.5)
        if fixed is None:
            squares = np.sum(np.where(used, torque - rows @ values, 0.0) ** 2, axis=0)
            deviation = np.maximum(np.sqrt(squares / freedom), least)
    values = np.where(determined, values, 0.0)
    return values, covariance, determined, np.where(count > 0, deviation, np.nan), freedom


def _shares_of_joints(rows: FloatArray, used: BoolArray, deviation: FloatArray, covariance: FloatArray) -> FloatArray:
    """(b, n) share of each parameter's variance that each joint's equations account for."""
    weight = np.where(used, 1.0 / np.nan_to_num(deviation, nan=np.inf), 0.0)
    informations = np.einsum("kj,kjb,kjc->jbc", weight**2, rows, rows)
    parts = np.einsum("pb,jbc,cp->pj", covariance, informations, covariance)
    total = parts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(parts, total, out=np.zeros_like(parts), where=total > 0.0))


def _places(visits: Sequence[Visit]) -> IntArray:
    """Number of the place of each visit."""
    places: list[FloatArray] = []
    numbers = []
    for visit in visits:
        for number, place in enumerate(places):
            if np.abs(place - visit.pose).max() < SAME_POSE:
                numbers.append(number)
                break
        else:
            numbers.append(len(places))
            places.append(visit.pose)
    return np.array(numbers)


def _friction(
    visits: Sequence[Visit], values: FloatArray, model: DynamicModel, used: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, half 95 % interval and spread (n,) of half the difference of the directions, gravity's change taken out."""
    signs = np.array([np.sign(model.transmission.coupling @ visit.direction) for visit in visits])
    torque = np.array([visit.torque[0] - visit.torque[1] for visit in visits])
    rows = np.array([visit.rows[0] - visit.rows[1] for visit in visits])
    half = 0.5 * signs * (torque - rows @ values)
    mean, interval, spread = (np.full(model.dof, np.nan) for _ in range(3))
    for joint in range(model.dof):
        of = half[used[:, joint], joint]
        if len(of):
            mean[joint] = of.mean()
        if len(of) > 1:
            spread[joint] = of.std(ddof=1)
            interval[joint] = stdtrit(len(of) - 1, 0.975) * spread[joint] / np.sqrt(len(of))
    return mean, interval, spread
