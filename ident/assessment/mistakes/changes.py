"""What changed while the arm was recorded: a gain, a sign, a zero, a load, from a moment on or little by little.

A model of the whole then fits none of its parts. Beside the parameters, columns that act from a moment on (or grow) are
estimated by least squares: the torque itself for a gain, its derivative for a zero, the last link's columns for a load.
Friction that changes as a gear warms up is a rival that is no mistake.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.file_errors.refit import Refit
from ident.assessment.instants import instants
from ident.assessment.mistakes.competition import EXPLAINED
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import independent_share, lag_one
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

EDGES = tuple(place / 8 for place in range(1, 8))
ALWAYS = -1.0
FINER = tuple(place / 64 for place in range(-7, 8))
"""Parts of the recording after which something may have changed, the beginning, and parts about the best of them."""

LIKELIHOOD, OF_LOAD = 100.0, 150.0
"""What the doubled log-likelihood ratio must exceed, in independent equations. On sound recordings (UR10, Panda, TX40,
15 random arms) a gain reaches 68, and a zero of 1° 79 (Panda); a gain that grows by 20 % makes 150 and more."""

RIVAL = 1.5
"""Factor by which it must exceed that of friction, which changes as gears warm up."""

LEAST_FALL, FALL_OF_OTHERS = 1.8, 4.0
"""Factor by which a joint's squared residuals must fall: that of the gain; else the joint whose fall most. Parts of the
Panda's recording reach likelihoods of 133 to 262, and factors of 1.0 to 1.6 of a gain's own joint, 2.2 of a zero (4.2°)
and 2.3 of a load; a gain times 1.1 from the middle on reaches 2.7 there."""

LEAST_GAIN = 0.08
LEAST_ZERO = float(np.deg2rad(3.0))
"""Smallest change of a gain and of a zero [rad] that is reported."""

STEADY = 2.0
"""Mean of a torque over its standard deviation; where all of an arm are steadier, their torques do not grow."""

LEAST_ERROR = 0.005
"""Relative error of a joint below which a better fit says nothing more."""

SIMPLER = 0.7
"""A load must lower the level by more than this against one wrong number, and a change against what is so throughout:
one joint's error by 30 %."""

MOST_TRIED = 4
"""Changes, the most likely ones, whose moment is found finely."""

PROMISING, MOST_FITTED = 20.0, 8
"""Fall of the weighted sum of squares from which on changes are fitted with weights of their own, and how many."""

AT_ONCE = 32
"""Changes whose columns are multiplied together."""

LEAST_FACTOR = 0.05
"""Factor at least from which a gain's is estimated."""

RIDGE = 1e-10
ROUNDS = 4
"""Iterations of the joints' weights."""

What = Literal["gain", "gains", "zero", "load", "friction"]


@dataclass(frozen=True, eq=False)
class Change:
    """Something that is different in a part of the recording."""

    what: What  # kind of the change
    joint: int  # index; -1 where it is of the whole arm
    start: float | None  # part of the recording after which it is so; None where it grows from the beginning to the end
    before: bool  # it is so up to `start`, or fades to nothing, instead
    columns: FloatArray  # (n, k, N) that act then, of each joint's equations


@dataclass(frozen=True, eq=False)
class FittedChange:
    """A change as it was estimated."""

    change: Change  # change that was estimated
    value: float  # factor of the torque minus 1, or its growth over the recording; shift [rad or m]; of a load 0
    level: float  # Σ log of the joints' relative squared residuals
    likelihood: float  # doubled log-likelihood ratio, the equations being independent
    error: float  # relative error of the whole arm
    fall: float  # factor by which squared residuals fall, of a gain's joint, else of the joint whose fall most


class Changes:
    """The equations of one recording, in the order of time, to be solved with something that changes.

    Attributes:
        refit: equations.
        times: (N,) stamps [s after the first] of the instants.
    """

    def __init__(
        self,
        model: DynamicModel,
        experiment: Experiment,
        base: BaseParameters,
        runs: Sequence[Prepared],
        solution: LeastSquares,
    ) -> None:
        few = instants(RegressorKernel(model, base.columns), runs)
        self.refit, self._base = Refit(model, experiment, base.columns, few, solution), base
        self._parameters = solution.parameters
        self.times = few.time
        self._share = (self.times - self.times[0]) / max(float(np.ptp(self.times)), np.finfo(float).tiny)
        self._own = self.refit.regressor[:, list(solution.active)]
        self._grams = {joint: self._products(joint, self._own) for joint in self.refit.used}
        self._plain = self._solved(self._own, np.empty((len(few.torque), 0, len(self.times))))

    def best(self) -> FittedChange | None:
        """The change that explains most, if it is clear, large, no friction's, and explains the recording."""
        torque = self.refit.instants.torque[self.refit.used]
        if np.all(np.abs(torque.mean(axis=1)) > STEADY * torque.std(axis=1)):
            return None
        tried = [self._fit(change) for change in self._promising(list(self._changes(EDGES)))]
        rival = max((one.likelihood for one in tried if one.change.what == "friction"), default=0.0)
        likely = sorted((one for one in tried if _clear(one, rival)), key=lambda one: -one.likelihood)
        kinds = {(one.change.what, one.change.joint): one for one in reversed(likely)}
        sharper = [self._sharpened(one) for one in sorted(kinds.values(), key=lambda one: -one.likelihood)[:MOST_TRIED]]
        found = [one for one in sharper if _clear(one, rival) and one.error < EXPLAINED]
        if not found:
            return None
        best = max(found, key=lambda one: one.likelihood)
        if self._throughout(best) < best.level + SIMPLER:
            return None
        # A load has many numbers, and fits what one wrong number leaves.
        simple = [one for one in found if one.change.what != "load" and one.level < best.level + SIMPLER]
        return max(simple, key=lambda one: one.likelihood, default=best)

    def _promising(self, changes: Sequence[Change]) -> list[Change]:
        """The changes that lower the weighted sum of squares most, the joints' weights being those without any."""
        used, rows = self.refit.used, self.refit.rows
        power = np.array([products[1] @ products[1] for products in self._grams.values()])
        scale = np.sqrt(rows[used] / np.maximum(self._plain[0][used] + LEAST_ERROR**2 * power, np.finfo(float).tiny))

        def stacked(columns: FloatArray) -> FloatArray:
            parts = [w * columns[j][:, self.refit.instants.counted[j]] for j, w in zip(used, scale, strict=True)]
            return np.concatenate(parts, axis=1)

        basis = np.linalg.qr(stacked(self._own).T)[0]
        torque = stacked(self.refit.instants.torque[:, None])[0]
        rest = torque - basis @ (basis.T @ torque)
        products = []
        for first in range(0, len(changes), AT_ONCE):
            some = [change.columns for change in changes[first : first + AT_ONCE]]
            columns = stacked(np.concatenate(some, axis=1))
            across = columns - (columns @ basis) @ basis.T
            parts = np.split(across, np.cumsum([each.shape[1] for each in some])[:-1])
            products += [(part @ part.T, part @ rest) for part in parts]
        gains = np.zeros(len(changes))
        for width in {len(right) for _, right in products}:
            places = [n for n, (_, right) in enumerate(products) if len(right) == width]
            inverses = np.linalg.pinv(np.array([products[n][0] for n in places]), hermitian=True)
            rights = np.array([products[n][1] for n in places])
            gains[places] = np.einsum("ni,nij,nj->n", rights, inverses, rights)
        order = sorted(range(len(changes)), key=lambda n: -gains[n])
        mistakes = [n for n in order if changes[n].what != "friction"][:MOST_FITTED]
        rivals = [n for n in order if changes[n].what == "friction"][:MOST_FITTED]
        return [changes[n] for n in (*mistakes, *rivals)] if gains[mistakes[0]] > PROMISING else []

    def _sharpened(self, one: FittedChange) -> FittedChange:
        """The change with its moment found more finely, and a gain's factor on the model, which has no noise."""
        start = one.change.start
        if start is not None:
            finer = [part for step in FINER if 0.05 < (part := start + step) < 0.95]
            near = [self._fit(other) for other in self._changes(finer, (one.change.what, one.change.joint))]
            one = max((one, *near), key=lambda other: other.likelihood)
        return self._with_factor(one) if one.change.what in ("gain", "gains") else one

    def _throughout(self, one: FittedChange) -> float:
        """The level that the same gain or zero has if it is so from the beginning to the end; inf of all else."""
        if one.change.what == "gain":
            always = replace(one.change, start=ALWAYS, before=False)
            return self._with_factor(replace(one, change=always)).level
        if one.change.what == "zero":
            return min(self._fit(change).level for change in self._changes((ALWAYS,), ("zero", one.change.joint)))
        return np.inf

    def _changes(self, edges: Sequence[float], only: tuple[What, int] | None = None) -> Iterator[Change]:
        model, torque, used = self.refit.model, self.refit.instants.torque, self.refit.used
        profiles = [(start, before) for start in (*edges, None) for before in (False, True)]
        joints = [joint for joint in used if only in (None, ("gain", joint))]
        zeros = [one for one in self.refit.unknowns() if one.kind == "zero" and only in (None, ("zero", one.joint))]
        slopes = {zero.joint: self.refit.slope(zero, 0.0, self._parameters) for zero in zeros}
        tool = [n for n, one in enumerate(model.parameters) if one.kind == "inertial" and one.joint == model.tool_link]
        loads = self.refit.instants.regressor(RegressorKernel(model, tool)) if only in (None, ("load", -1)) else None
        for start, before in profiles:
            profile = self._profile(start, before)
            for joint in joints:
                own = np.zeros((len(torque), 1, len(profile)))
                own[joint] = profile * torque[joint]
                yield Change("gain", joint, start, before, own)
            if start is not None:
                for joint, slope in slopes.items():
                    yield Change("zero", joint, start, before, (profile * slope)[:, None])
            if before:
                continue  # of the whole arm, before and after are the same
            if only in (None, ("gains", -1)):
                yield Change("gains", -1, start, before, (profile * torque)[:, None])
            if loads is not None and start is not None:
                yield Change("load", -1, start, before, profile * loads)
            for joint in () if only else used:
                rubbing = [n for n, of in enumerate(self._base.joints) if self._rubs(n) and of == model.active[joint]]
                rows = np.zeros((len(torque), len(rubbing), len(profile)))
                rows[joint] = profile * self.refit.regressor[joint, rubbing]
                if rubbing:
                    yield Change("friction", joint, start, before, rows)

    def _rubs(self, column: int) -> bool:
        """Return whether a base parameter is friction's or an offset."""
        return self._base.kinds[column] not in ("inertial", "motor_inertia")

    def _fit(self, change: Change) -> FittedChange:
        sums, values = self._solved(self._own, change.columns)
        design = np.concatenate([self._own, change.columns], axis=1)
        return self._fitted(change, float(values[self._own.shape[1]]), sums, design, values)

    def _with_factor(self, one: FittedChange) -> FittedChange:
        """A gain's change estimated as a factor 1 + g·profile on the model's torque, by Gauss-Newton."""
        torque, change = self.refit.instants.torque, one.change
        acting = np.any(change.columns[:, 0] != 0.0, axis=1)[:, None]
        profile = self._profile(change.start, change.before) * acting
        left = 1.0 - one.value
        gain = one.value if change.start is None else one.value / np.copysign(max(abs(left), LEAST_FACTOR), left)
        design, values, sums = self._own, np.zeros(0), np.zeros(len(torque))
        for _ in range(ROUNDS):
            own = (1.0 + gain * profile)[:, None] * self._own
            sums, values = self._solved(own, np.empty((len(torque), 0, torque.shape[1])))
            slope = profile * np.einsum("nkN,k->nN", self._own, values)
            design = np.concatenate([own, slope[:, None]], axis=1)
            sums, values = self._solved(own, slope[:, None])
            gain += float(values[-1])
        return self._fitted(change, gain, sums, design, values)

    def _profile(self, start: float | None, before: bool) -> FloatArray:
        """(N,) of a change: 1 from a part of the recording on, or growing to 1; `before` 1 up to it, or fading to 0."""
        late = self._share if start is None else (self._share >= start).astype(np.float64)
        return np.asarray(1.0 - late if before else late)

    def _fitted(
        self, change: Change, value: float, sums: FloatArray, design: FloatArray, values: FloatArray
    ) -> FittedChange:
        before, used = self._plain[0], self.refit.used
        counted, torque = self.refit.instants.counted, self.refit.instants.torque
        power = np.sum(np.where(counted, torque, 0.0) ** 2, axis=1)[used]
        floor = LEAST_ERROR**2 * power
        falls = (before[used] + floor) / (sums[used] + floor)
        raw = float(np.sum(self.refit.rows[used] * np.log(falls)))
        fall = float(falls[used.index(change.joint)] if change.what == "gain" else falls.max())
        rest = np.where(counted, torque - np.einsum("nkN,k->nN", design, values), 0.0)
        total = float(self.refit.rows.sum())
        worth = max(0.0, independent_share(lag_one([rest])[used]) * total - design.shape[1]) / total
        level = float(np.sum(np.log((sums[used] + floor) / np.maximum(power, np.finfo(float).tiny))))
        error = float(np.sqrt(sums[used].sum() / max(float(power.sum()), np.finfo(float).tiny)))
        return FittedChange(change, value, level, raw * worth, error, fall)

    def _products(self, joint: int, own: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Columns (a, m) and torque (m,) of a joint's equations that count, and the columns' products with both."""
        counted = self.refit.instants.counted[joint]
        rows, measured = own[joint][:, counted], self.refit.instants.torque[joint, counted]
        return rows, measured, rows @ rows.T, rows @ measured

    def _solved(self, own: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums of squares (n,) and values of the parameters, of columns (n, a, N), and of further ones (n, k, N)."""
        used, width = self.refit.used, own.shape[1]
        size = width + columns.shape[1]
        gram, score, power = np.zeros((len(used), size, size)), np.zeros((len(used), size)), np.zeros(len(used))
        for place, joint in enumerate(used):
            rows, measured, products, with_torque = (
                self._grams[joint] if own is self._own else self._products(joint, own)
            )
            further = columns[joint][:, self.refit.instants.counted[joint]]
            gram[place, :width, :width], score[place, :width] = products, with_torque
            gram[place, width:, :width] = further @ rows.T
            gram[place, :width, width:] = gram[place, width:, :width].T
            gram[place, width:, width:], score[place, width:] = further @ further.T, further @ measured
            power[place] = measured @ measured
        left, values = power.copy(), np.zeros(size)
        for _ in range(ROUNDS):
            weight = self.refit.rows[used] / np.maximum(left + LEAST_ERROR**2 * power, np.finfo(float).tiny)
            matrix = np.tensordot(weight, gram, 1)
            scale = np.sqrt(np.diag(matrix))
            scale[scale == 0.0] = 1.0
            scaled = matrix / np.outer(scale, scale) + RIDGE * np.eye(size)
            values = np.linalg.solve(scaled, weight @ score / scale) / scale
            left = np.maximum(power - 2.0 * score @ values + np.einsum("a,nab,b->n", values, gram, values), 0.0)
        sums = np.zeros(len(self.refit.instants.torque))
        sums[used] = left
        return sums, values


def _clear(one: FittedChange, rival: float) -> bool:
    """Return whether a change is one that is reported, against friction of a likelihood."""
    least = {"zero": LEAST_ZERO, "load": 0.0, "friction": np.inf}.get(one.change.what, LEAST_GAIN)
    likely = OF_LOAD if one.change.what == "load" else LIKELIHOOD
    fall = LEAST_FALL if one.change.what == "gain" else FALL_OF_OTHERS
    return abs(one.value) >= least and one.fall >= fall and one.likelihood > max(likely, RIVAL * rival)


def change_check(model: DynamicModel, found: FittedChange, times: FloatArray) -> Check:
    """The check of a change, with its time."""
    change, value = found.change, found.value
    name = model.joint_names[change.joint] if change.joint >= 0 else ""
    what = {"gain": f"the torque of {name}", "gains": "all torques", "load": "another load on the last link"}
    if change.start is None:
        factor = (1.0 / max(1.0 + value, LEAST_FACTOR) if change.before else 1.0 + value) - 1.0
        clause = f"{what[change.what]} growing by {100 * factor:+.0f} % from the beginning to the end"
    else:
        moment = f"{float(np.ptp(times)) * change.start + float(times[0]):.1f} s"
        when = f"up to about {moment}" if change.before else f"from about {moment} on"
        if change.what == "zero":
            clause = f"{np.rad2deg(value):+.1f}° added to the position of {name} {when}"
        else:
            clause = f"{what[change.what]} {'' if change.what == 'load' else f'times {1.0 + value:.2g} '}{when}"
    text = (
        f"something changed during the recording: the data fit {clause}; check the drive, its gain, its encoder and "
        "the load, and identify from an unchanged part (--start, --stop)"
    )
    return raised("recording-changes", text, [name] if name else [])
