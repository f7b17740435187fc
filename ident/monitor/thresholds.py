"""Thresholds of the external torque, earned on recordings without contact, joint by joint and by how a joint moves.

What an arm's model leaves without contact depends on how each joint moves: most near rest and velocity reversals, where
friction is not known. Its spread in each of three ways of motion is learnt, and for each a level in units of the
spreads, from the extreme values of the joints' largest ratio (`extremes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.errors import DataError
from ident.monitor.choices import Kind
from ident.monitor.extremes import FEWEST_PEAKS, PEAK_SHARE, ReturnLevel, require_time, return_level
from ident.monitor.interval_torque import Intervals
from ident.monitor.observers import Observer, observer

NEAR_REST = 0.02
"""Share of a joint's velocity limit below which its friction is not known."""
SETTLING = 3.0
"""Time constants of the observer after which what happened near rest is forgotten, or the start of a recording."""
QUANTILE = 0.99
"""Quantile of |residual| that spreads are learnt from; 2.576 of a normal distribution's σ."""
NORMAL_QUANTILE = 2.576
FEWEST_CONSTANTS = 20.0
"""Time constants of the observer that a way of motion must have been observed for; else it has the largest spread."""
BLOCK = 10.0
"""Length of a block of the extreme values, in time constants of the observer."""
FASTER, WARMER = 1.2, 5.0
"""Ratio of speeds, and difference of temperatures [K], beyond which thresholds say little."""
SAME_RATE = 0.05
"""Relative difference of two rates of samples which changes no threshold."""
FRICTION_PER_KELVIN = 0.01
"""Share of a joint's friction by which its threshold grows per kelvin beyond the temperatures that were observed."""
CONTACT = 0.2
"""Length [s] of the contacts that smallest forces are stated for."""
SURELY = 1.645
"""Spreads above its threshold by which a torque is noticed in 95 % of the moments, where windows are too few."""
FEWEST_WINDOWS = 20
STD_EVERY = 200
"""Samples between two evaluations of the model's σ."""
REST, SLOW, FAST = 0, 1, 2
WAYS = ("near rest and reversals", "slow", "fast")
"""The ways of motion."""


@dataclass(frozen=True)
class MotionWays:
    """What separates the ways of motion."""

    low: FloatArray  # (n,) speed below which a joint is near rest [rad/s or m/s]
    fast: FloatArray  # (n,) speed from which on it is fast [rad/s or m/s]
    hold: int  # samples for which it counts as near rest after it was

    def of(self, velocity: FloatArray, since: FloatArray) -> tuple[IndexArray, FloatArray]:
        """The way (N, n) of velocities (N, n), and how many samples ago (n,) each joint was near rest.

        Args:
            velocity: (N, n) [rad/s or m/s].
            since: (n,) samples before the first; inf where never.
        """
        if not len(velocity):
            return np.zeros(velocity.shape, dtype=np.intp), since
        speed = np.abs(velocity)
        count = np.arange(1.0, len(speed) + 1.0)[:, None]
        # Near a reversal some sample is this slow: the limit is many times what a joint gains in a sample period.
        last = np.maximum.accumulate(np.where(speed < self.low, count, -np.inf), axis=0)
        ago = np.minimum(count - last, count + since)
        way = np.where(ago <= self.hold, REST, np.where(speed < self.fast, SLOW, FAST))
        return way, ago[-1]


@dataclass(frozen=True)
class Thresholds:
    """When a residual is an alarm."""

    kind: Kind  # of the observer
    bandwidth: float  # of it [1/s]
    period: float  # of the samples [s]
    ways: MotionWays  # of motion
    spread: FloatArray  # (3, n) σ of the residual in each way of motion, without contact [N·m or N]
    level: FloatArray  # (3,) alarms begin at this many spreads, in each way of motion
    # where they come from, of the ways of motion that were observed long enough; the others have the largest
    tails: dict[str, ReturnLevel]
    per_hour: float  # false alarms asked for [1/h]
    # (n,) mean of the model's σ in the recordings [N·m or N]; where it is larger, so is the threshold
    model_std: FloatArray
    fastest: FloatArray  # (n,) speed that was observed [rad/s or m/s]
    # (2, n) lowest and highest temperature that was observed [°C]; None where none was recorded
    celsius: FloatArray | None
    # (n,) by which thresholds grow per kelvin beyond these [N·m/K or N/K]; 0 where the model's friction depends on the
    # temperature, and its σ with it
    drift: FloatArray
    # (3, n) external torque that is noticed in 95 % of contacts of `CONTACT`, by the way of motion in which they begin
    # [N·m or N]; near rest, where the joint stays there
    noticed: FloatArray
    # momentum_noise, torque_noise: (n,) of the observer [N·m·s, N·m]
    momentum_noise: FloatArray
    torque_noise: FloatArray
    torque_limit: FloatArray  # (n,) largest |torque of the drives| that was observed, for comparison [N·m or N]
    sources: tuple[str, ...]  # recordings

    def observer(self) -> Observer:
        """The observer that they belong to, at rest."""
        joints = self.spread.shape[1]
        return observer(self.kind, self.period, joints, self.bandwidth, self.momentum_noise, self.torque_noise)

    @property
    def limit(self) -> FloatArray:
        """(3, n) residual at which an alarm begins in each way of motion [N·m or N]."""
        return np.asarray(self.level[:, None] * self.spread)

    def of(self, way: IndexArray, spread: FloatArray, celsius: FloatArray | None) -> FloatArray:
        """Thresholds (N, n) [N·m or N], by way of motion, `spread_of` and temperatures (N, n) [°C]."""
        threshold = self.level[way] * spread
        if celsius is not None and self.celsius is not None:
            # fmax: of a joint whose temperature is not known, nothing is added
            threshold += self.drift * np.fmax(np.fmax(self.celsius[0] - celsius, celsius - self.celsius[1]), 0.0)
        return threshold

    def beyond(self, names: Sequence[str], velocity: FloatArray, celsius: FloatArray | None) -> tuple[str, ...]:
        """Return what of a motion the thresholds were not learnt on, in words: speeds and temperatures.

        Args:
            names: (n,) of the joints.
            velocity: (N, n) [rad/s or m/s].
            celsius: (N, n) [°C]; None where no temperature is measured.
        """
        said = []
        speed = np.abs(velocity).max(axis=0, initial=0.0)
        for name, value, learnt in zip(names, speed.tolist(), self.fastest.tolist(), strict=True):
            if value > FASTER * learnt:
                said.append(f"{name} is faster ({value:.2g}) than where thresholds were learnt ({learnt:.2g})")
        if celsius is not None and self.celsius is not None and len(celsius):
            away = np.maximum(self.celsius[0] - celsius.min(axis=0), celsius.max(axis=0) - self.celsius[1])
            said += [
                f"{name} is {value:.0f} K outside the temperatures at which thresholds were learnt"
                + (f": its threshold is {value * more:.2g} higher" if more else "")
                for name, value, more in zip(names, away.tolist(), self.drift.tolist(), strict=True)
                if value > WARMER
            ]
        return tuple(said)

    def spread_of(self, way: IndexArray, std: FloatArray) -> FloatArray:
        """σ (N, n) of the residual without contact [N·m or N], by way of motion (N, n) and the model's σ (N, n)."""
        excess = np.maximum(np.square(std) - np.square(self.model_std), 0.0)
        return np.asarray(np.sqrt(np.square(np.take_along_axis(self.spread, way, axis=0)) + excess))


def learn(
    runs: Sequence[tuple[str, Intervals]],
    stds: Sequence[FloatArray],
    limits: FloatArray,
    *,
    kind: Kind,
    bandwidth: float,
    period: float,
    per_hour: float,
    inertia: FloatArray,
    friction: FloatArray,
) -> Thresholds:
    """Thresholds from recordings without contact.

    Args:
        runs: recording → intervals.
        stds: of each, σ (K, n) of the model at some of its samples [N·m or N].
        limits: (n,) velocity limits [rad/s or m/s].
        kind: of the observer.
        bandwidth: of it [1/s].
        period: of the samples [s].
        per_hour: false alarms [1/h].
        inertia: (n,) typical joint inertias, for the noise of the momentum [kg·m²].
        friction: (n,) of the joints, as far as the model does not know how it depends on temperature [N·m or N].

    Raises:
        DataError: the recordings are too short for the rate.
    """
    joints = len(limits)
    everything = [intervals for _, intervals in runs if len(intervals)]
    if not everything:
        raise DataError("no samples without contact to learn from", hint="give a recording of ordinary motion: --quiet")
    speed = np.concatenate([np.abs(run.velocity) for run in everything])
    low = NEAR_REST * limits
    moving = np.where(speed > low, speed, np.nan)
    fast = np.array([np.nanmedian(column) if np.isfinite(column).any() else np.inf for column in moving.T])
    ways = MotionWays(low, fast, max(1, round(SETTLING / (bandwidth * period))))
    momentum_noise = inertia * np.mean([_second_difference(run.position) for run in everything], axis=0) / period
    torque_noise = np.mean([_second_difference(run.measured) for run in everything], axis=0)
    settle = round(SETTLING / (bandwidth * period))
    residuals, classes, counts = [], [], []
    for run in everything:
        filtered = observer(kind, period, joints, bandwidth, momentum_noise, torque_noise).apply(
            run.external, run.restarted
        )
        way, _ = ways.of(run.velocity, np.full(joints, np.inf))
        settled = _settled(run.restarted, settle)
        residuals.append(filtered[settled])
        classes.append(way[settled])
        counts.append(int(np.count_nonzero(settled)))
    residual, way = np.concatenate(residuals), np.concatenate(classes)
    size = np.abs(residual)
    spread = _spreads(size, way, round(FEWEST_CONSTANTS / (bandwidth * period)))
    ratio = size / np.take_along_axis(spread, way, axis=0)
    block = max(1, round(BLOCK / (bandwidth * period)))
    require_time(len(size) * period, block * period, per_hour)
    tails = {}
    for kind_of_motion, name in enumerate(WAYS):
        largest = np.max(np.where(way == kind_of_motion, ratio, -np.inf), axis=1)
        maxima = _block_maxima(largest, np.cumsum([0, *counts]), block)
        if PEAK_SHARE * len(maxima) >= FEWEST_PEAKS:
            tails[name] = return_level(maxima, len(size) * period / 3600.0, per_hour / len(WAYS))
    highest = max((tail.level for tail in tails.values()), default=np.nan)
    level = np.array([tails[name].level if name in tails else highest for name in WAYS])
    celsius = [run.celsius for run in everything if run.celsius is not None]
    return Thresholds(
        kind=kind,
        bandwidth=bandwidth,
        period=period,
        ways=ways,
        spread=spread,
        level=level,
        tails=tails,
        per_hour=per_hour,
        model_std=np.sqrt(np.mean(np.square(np.concatenate(stds)), axis=0)),
        fastest=speed.max(axis=0),
        celsius=np.array(
            [np.min([c.min(axis=0) for c in celsius], axis=0), np.max([c.max(axis=0) for c in celsius], axis=0)]
        )
        if celsius
        else None,
        drift=FRICTION_PER_KELVIN * friction,
        noticed=_noticed(residual, way, level[:, None], spread, settle, round(CONTACT / period)),
        momentum_noise=momentum_noise,
        torque_noise=torque_noise,
        torque_limit=np.max([np.abs(run.measured).max(axis=0) for run in everything], axis=0),
        sources=tuple(name for name, _ in runs),
    )


def _spreads(size: FloatArray, way: IndexArray, fewest: int) -> FloatArray:
    """(3, n) σ of residuals (N, n) in each way of motion (N, n); the largest where one was hardly observed."""
    spread = np.full((len(WAYS), size.shape[1]), np.nan)
    for joint in range(size.shape[1]):
        for kind in range(len(WAYS)):
            seen = size[way[:, joint] == kind, joint]
            if len(seen) >= fewest:
                spread[kind, joint] = max(np.quantile(seen, QUANTILE) / NORMAL_QUANTILE, np.finfo(float).tiny)
        finite = spread[np.isfinite(spread[:, joint]), joint]
        largest = finite.max() if len(finite) else np.quantile(size[:, joint], QUANTILE) / NORMAL_QUANTILE
        spread[np.isnan(spread[:, joint]), joint] = max(largest, np.finfo(float).tiny)
    return spread


def _noticed(
    residual: FloatArray, way: IndexArray, level: FloatArray, spread: FloatArray, settle: int, length: int
) -> FloatArray:
    """`Thresholds.noticed` (3, n), from residuals (N, n) without contact and their ways of motion.

    In windows of so many samples, a torque that the observer shows after `settle` of them is noticed if it passes the
    threshold once, together with the residual: it needs the smallest difference of both.
    """
    limit, count = level * spread, len(residual) // length
    noticed = limit + SURELY * spread
    if length <= settle or not count:
        return np.asarray(noticed)
    residuals = residual[: count * length].reshape(count, length, -1)
    ways = way[: count * length].reshape(count, length, -1)
    limits = np.take_along_axis(limit[None], ways, axis=1)
    needed = [np.min((limits - sign * residuals)[:, settle:], axis=1) for sign in (1.0, -1.0)]
    stays = np.all(ways == REST, axis=1)
    for kind, joint in np.ndindex(noticed.shape):
        windows = stays[:, joint] if kind == REST else ways[:, 0, joint] == kind
        if np.count_nonzero(windows) >= FEWEST_WINDOWS:
            noticed[kind, joint] = np.quantile([torque[windows, joint] for torque in needed], 0.95)
    return np.asarray(noticed)


def _second_difference(values: FloatArray) -> FloatArray:
    """σ (n,) of the white part of slowly changing values (N, n)."""
    if len(values) < 3:
        return np.zeros(values.shape[1])
    return np.asarray(np.median(np.abs(np.diff(values, n=2, axis=0)), axis=0) / (0.6745 * np.sqrt(6.0)))


def _settled(
    restarted: np.ndarray[tuple[int], np.dtype[np.bool_]], samples: int
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which samples lie more than so many after a restart."""
    count = np.arange(len(restarted))
    last = np.maximum.accumulate(np.where(restarted, count, 0))
    return np.asarray(count - last >= samples)


def _block_maxima(values: FloatArray, edges: IndexArray, block: int) -> FloatArray:
    """Maxima of the whole blocks of each recording between edges; those without a finite value left out."""
    whole = []
    for start, stop in pairwise(edges.tolist()):
        count = (stop - start) // block
        whole.append(values[start : start + count * block].reshape(count, block).max(axis=1, initial=-np.inf))
    maxima = np.concatenate(whole)
    return np.asarray(maxima[np.isfinite(maxima)])
