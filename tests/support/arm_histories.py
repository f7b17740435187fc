"""Results of arms that wear and warm, without identifications."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from ident.history.entry import HistoryEntry, KeptValue

START, DAY = 1.7e9, 86400.0


def entry(
    number: int, day: float, values: Mapping[str, tuple[float, float]], temperature: float | None = 25.0, arm: str = "a"
) -> HistoryEntry:
    """One result; `values` are name → value and σ."""
    digest = hashlib.sha256(f"{arm} {number}".encode()).hexdigest()
    kept = tuple(
        KeptValue(name, f"j{name[-1]}", "Coulomb friction", "N·m", "coulomb, viscous", *pair, temperature)
        for name, pair in values.items()
    )
    created = f"2026-01-01T00:00:{number % 60:02}+00:00"
    return HistoryEntry(digest, digest, arm, "", "result", START + DAY * day, created, f"model-{number}", kept)


def worn_arm(
    seed: int,
    count: int,
    wear: Mapping[str, float],
    *,
    step: float = 0.0,
    days: float = 400.0,
    scatter: float = 0.02,
    sigma: float = 0.01,
) -> list[HistoryEntry]:
    """Results of an arm whose friction falls with the temperature, exponentially, as it warms by seasons and use.

    Args:
        seed: of the noise.
        count: of results.
        wear: parameter → rise from the first to the last result, relative to a value of 1.
        step: of every parameter, in the middle.
        days: between the first and the last result.
        scatter: σ between results.
        sigma: σ of an identification.
    """
    rng = np.random.default_rng(seed)
    day = np.sort(rng.uniform(0.0, days, count))
    day[[0, -1]] = 0.0, days
    warm = 25.0 + 8.0 * np.sin(2 * np.pi * day / 365.0 + rng.uniform(0, 6)) + 6.0 * day / days + rng.normal(0, 2, count)
    found = []
    for number in range(count):
        values = {}
        for name, rise in wear.items():
            std = sigma * float(np.exp(rng.normal(0.0, 0.3)))
            value = 1.0 + rise * day[number] / days + 0.2 * np.expm1(-(warm[number] - 25.0) / 20.0)
            value += step * (number >= count // 2) + rng.normal(0.0, scatter) + rng.normal(0.0, std)
            values[name] = (float(value), std)
        found.append(entry(number, float(day[number]), values, float(warm[number])))
    return found
