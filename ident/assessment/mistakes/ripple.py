"""A ripple of an encoder: an error of the position that repeats with the angle, and that no torque follows.

A shift of A·sin(k·q + φ) adds −A·k²·q̇²·sin(k·q + φ) to the acceleration, which the joint's inertia turns into torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.assessment.instants import Instants
from ident.assessment.mistakes.competition import Competition
from ident.assessment.mistakes.equations import LEAST_ERROR, equations
from ident.model.regressor import model_torque
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

ORDERS = np.arange(5, 101)
"""Ripples per turn that are tried; a slower one looks like a zero or a length that is off."""

SCREENED = 0.15
"""Share of a joint's squared residual that a ripple explains at first. On sound recordings it reaches 0.07."""

LEAST_ERROR_OF_JOINT = 0.02
"""Relative error of a joint below which no ripple of its encoder is sought."""

LEAST_FALL = 3.0
"""Factor by which a joint's squared residuals must fall."""

RIVAL = 1.5
"""Factor by which they must exceed those with a ripple of the torque, which gears and motors have."""

ROUNDS = 4
STEP = 1e-5
"""Rounds of Gauss-Newton, and the amplitude [rad] for its derivatives."""


def ripple_checks(competition: Competition) -> list[Check]:
    """The check of joints whose positions ripple, where that explains what the recording as it is leaves."""
    plain = competition.free(competition.recorded)
    if plain is None:
        return []
    few, torques, used = competition.instants, competition.recorded.torques, competition.experiment.torques
    orders = _orders(competition, plain.parameters, plain.relative)
    if not orders:
        return []
    ripples, parameters, width = np.zeros((len(orders), 2)), plain.parameters, len(plain.parameters)
    fit = plain
    for _ in range(ROUNDS):
        slopes = []
        for place in np.ndindex(ripples.shape):
            step = np.zeros_like(ripples)
            step[place] = STEP
            ahead, behind = (_torque(competition, parameters, orders, ripples + sign * step) for sign in (1.0, -1.0))
            slopes.append((ahead - behind) / (2.0 * STEP))
        moved = less_ripples(few, orders, ripples)
        rows = np.concatenate([competition.regressor(moved), np.stack(slopes, axis=1)], axis=1)
        found = equations(rows, moved, used).fit(torques)
        if found is None:
            return []
        ripples, parameters, fit = ripples + found.parameters[width:].reshape(-1, 2), found.parameters[:width], found
    waves = [
        wave(order * few.position[joint]) * (np.arange(len(few.torque)) == joint)[:, None]
        for joint, order in orders.items()
        for wave in (np.sin, np.cos)
    ]
    rows = np.concatenate([competition.regressor(few), np.stack(waves, axis=1)], axis=1)
    of_torque = equations(rows, few, used).fit(torques)
    before, after = plain.relative + LEAST_ERROR**2, fit.relative + LEAST_ERROR**2
    rival = before if of_torque is None else of_torque.relative + LEAST_ERROR**2
    named = {
        joint: (order, float(np.hypot(*ripple)))
        for (joint, order), ripple in zip(orders.items(), ripples, strict=True)
        if before[joint] > LEAST_FALL * after[joint] and rival[joint] > RIVAL * after[joint]
    }
    if not named:
        return []
    names = competition.model.joint_names
    figures = ", ".join(
        f"{names[joint]} by {np.rad2deg(size):.2g}° {order} times per turn (error {_percent(plain.relative[joint])} to "
        f"{_percent(fit.relative[joint])})"
        for joint, (order, size) in named.items()
    )
    text = f"the recorded position ripples with the angle, unlike the torque: {figures}; check the encoder"
    return [raised("position-ripple", text, [names[joint] for joint in named])]


def _percent(square: float) -> str:
    return percent_text(float(np.sqrt(square)), 2)


def _orders(competition: Competition, parameters: FloatArray, relative: FloatArray) -> dict[int, int]:
    """Ripples per turn, by turning joint, of what explains a share of the joint's residual; at most one each."""
    few, found = competition.instants, {}
    still = _torque(competition, parameters, {}, np.empty((0, 2)))
    for joint in competition.joints:
        if competition.model.sliding[joint] or relative[joint] < LEAST_ERROR_OF_JOINT**2:
            continue
        counted = few.counted[joint]
        pushed = replace(few, acceleration=few.acceleration + (np.arange(len(still)) == joint)[:, None])
        inertia = (_torque(competition, parameters, {}, np.empty((0, 2)), pushed) - still)[joint, counted]
        rest = (few.torque - still)[joint, counted]
        angle = ORDERS[:, None] * few.position[joint, counted]
        along, across = (
            ORDERS[:, None] * few.acceleration[joint, counted],
            (ORDERS[:, None] * few.velocity[joint, counted]) ** 2,
        )
        sine, cosine = np.sin(angle), np.cos(angle)
        waves = inertia * np.stack([along * cosine - across * sine, -along * sine - across * cosine])
        grams, right = np.einsum("aon,bon->oab", waves, waves), waves @ rest
        explained = np.einsum("ao,oab,bo->o", right, np.linalg.pinv(grams, hermitian=True), right)
        best = int(np.argmax(explained))
        if explained[best] > SCREENED * float(rest @ rest):
            found[joint] = int(ORDERS[best])
    return found


def less_ripples(few: Instants, orders: Mapping[int, int], ripples: FloatArray) -> Instants:
    """The instants less ripples (k, 2) [rad] of the sine and cosine of each joint's angle times its order."""
    position, velocity, acceleration = few.position.copy(), few.velocity.copy(), few.acceleration.copy()
    for (joint, order), (sine, cosine) in zip(orders.items(), ripples, strict=True):
        angle, speed = order * few.position[joint], order * few.velocity[joint]
        ripple = sine * np.sin(angle) + cosine * np.cos(angle)
        slope = sine * np.cos(angle) - cosine * np.sin(angle)
        position[joint] -= ripple
        velocity[joint] -= slope * speed
        acceleration[joint] -= slope * order * few.acceleration[joint] - ripple * speed**2
    return replace(few, position=position, velocity=velocity, acceleration=acceleration, friction=None)


def _torque(
    competition: Competition,
    parameters: FloatArray,
    orders: Mapping[int, int],
    ripples: FloatArray,
    few: Instants | None = None,
) -> FloatArray:
    """(n, N) of the active parameters (a,), along the instants less ripples."""
    moved = less_ripples(competition.instants if few is None else few, orders, ripples)
    everything = np.zeros(competition.base.count)
    everything[competition.active] = parameters
    return model_torque(competition.model, competition.base.columns, everything, *moved.motion)
