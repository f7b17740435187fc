"""How far beyond the recorded motion a model holds: the uncertainty of its torque anywhere within the arm's limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from drivers.core.units import joint_unit
from ident.model.base_parameters import BaseParameters, base_parameters, random_states, random_temperature
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel, dense_regressor
from ident.verdict.catalogue import raised
from ident.verdict.check import Check
from ident.verdict.verdict import GOOD_ERROR, USABLE_JOINT_ERROR

STATES = 200
"""Random states within the limits of positions, velocities and accelerations."""

SHARES = (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)
"""Shares of the velocity limits that the uncertainty is computed for; accelerations have their squares."""


def extrapolation_checks(
    model: DynamicModel,
    base: BaseParameters,
    values: FloatArray,
    covariance: FloatArray,
    active: Sequence[int],
    moves: FloatArray | None = None,
    recorded: FloatArray | None = None,
) -> list[Check]:
    """Whether the parameters' own uncertainty makes the model less than good within the limits of the robot file.

    Held-out data that are as slow as those of the identification do not show it. σ of the torque, √diag(Y·Σ·Yᵀ), over
    states drawn evenly within the limits does: it is 1 to 8 times the true error there (docs/measurements/checks.md).
    A joint's torque may be as uncertain as makes it poor.

    Args:
        model: the arm.
        base: its base parameters (b).
        values: (b,) of the delivered model.
        covariance: (a, a) of the estimated ones, for the friction's shapes as they are.
        active: (a,) which are estimated; one that is not, or of unknown variance, is uncertain by its own size.
        moves: (b, a) derivative of the delivered values by the estimated ones; None where they are the same.
        recorded: (n,) largest recorded speeds [rad/s or m/s].
    """
    if base.count != base_parameters(model).count:
        return []
    finite = np.isfinite(np.diag(covariance))
    sure = [column for column, there in zip(active, finite, strict=True) if there]
    guessed = np.diag(np.where(np.isin(np.arange(base.count), sure), 0.0, np.nan_to_num(values)))
    followed = (np.eye(base.count)[:, list(active)] if moves is None else moves)[:, finite]
    powers, axes = np.linalg.eigh(covariance[np.ix_(finite, finite)])
    root = np.hstack([followed @ (axes * np.sqrt(np.clip(powers, 0.0, None))), guessed])
    kernel = RegressorKernel(model, base.columns)
    position, velocity, acceleration = random_states(model, STATES)
    heat = random_temperature(model, STATES)

    def uncertainty(share: float) -> tuple[float, FloatArray]:
        rows = dense_regressor(kernel, position, share * velocity, share**2 * acceleration, heat)
        torque = np.linalg.norm(np.einsum("nbN,b->nN", rows, np.nan_to_num(values)), axis=1)
        deviation = np.linalg.norm(np.einsum("nbN,bk->nkN", rows, root), axis=(1, 2))
        least = np.finfo(float).tiny
        return float(np.linalg.norm(deviation) / max(np.linalg.norm(torque), least)), deviation / np.maximum(
            torque, least
        )

    def good(share: float) -> bool:
        whole, joints = uncertainty(share)
        return whole < GOOD_ERROR and bool(np.all(joints < USABLE_JOINT_ERROR))

    if good(1.0):
        return []
    whole, joints = uncertainty(1.0)
    share = next((one for one in SHARES if good(one)), None)
    if share is None:
        reach = "like the recorded one only" + ("" if recorded is None else f", up to {_speeds(model, recorded)}")
    else:
        limits = share * np.array([limits.velocity for limits in model.limits])
        reach = f"up to {_speeds(model, limits)} only, {percent_text(share, 2)} of the velocity limits"
    worst = [joint for joint in np.argsort(-joints).tolist() if joints[joint] >= USABLE_JOINT_ERROR]
    names = [model.joint_names[joint] for joint in worst]
    of_worst = f", {percent_text(float(joints[worst[0]]), 2)} of that of {names[0]}" if worst else ""
    text = (
        f"it holds for motion {reach}: its parameters leave {percent_text(whole, 2)} of the torque uncertain at the "
        f"limits of the robot file{of_worst}; record motion that is as fast and as wide, or state the limits within "
        "which the arm will work"
    )
    return [raised("extrapolation", text, names)]


def _speeds(model: DynamicModel, speeds: FloatArray) -> str:
    """Speeds (n,) in words: "0.3 to 0.6 rad/s and 0.2 m/s"."""
    words = []
    for slides in sorted(set(model.sliding)):
        own = [speed for speed, sliding in zip(speeds.tolist(), model.sliding, strict=True) if sliding == slides]
        low, high = f"{min(own):.2g}", f"{max(own):.2g}"
        words.append(f"{low if low == high else f'{low} to {high}'} {joint_unit('rad/s', sliding=slides)}")
    return " and ".join(words)
