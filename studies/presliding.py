"""Presliding in place of sign(q̇) on recorded and simulated arms: held-out errors near reversals, travels found.

    python studies/presliding.py [NAME…]
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt
from consistency import public
from friction_models import choices_of

from drivers.streams import FloatArray
from ident.assessment.validation import LOW_SPEED
from ident.identify.identification import Identification, PreparedRun
from ident.identify.identify import identify
from ident.model.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import column_signal, combined
from ident.regression.comparison import TorqueSeries

DRY = ("coulomb", "stribeck", "load")
TRAVELS = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 41)])


def dahl(velocity, rate, travel):
    sign = np.sign(velocity)
    if travel == 0.0:
        return sign
    decay = np.exp(-np.abs(velocity) / (rate * travel))
    z = np.empty_like(velocity)
    state = sign[np.flatnonzero(sign)[0]]
    for index in range(len(velocity)):
        state = sign[index] + (state - sign[index]) * decay[index]
        z[index] = state
    return z


def maxwell(velocity, rate, travel):
    sign = np.sign(velocity)
    if travel == 0.0:
        return sign
    step = velocity / (rate * travel)
    z = np.empty_like(velocity)
    state = sign[np.flatnonzero(sign)[0]]
    for index in range(len(velocity)):
        state = min(1.0, max(-1.0, state + step[index]))
        z[index] = state
    return z


def corrections(found, runs, element):
    """For each motion: motors, and corrections (T, motors, M) concatenated over segments."""
    dynamics = InverseDynamics(found.model, found.base, found.solution.parameters)
    groups = {}
    for column, value in dynamics.joint_columns:
        if column.quantity in DRY and not np.isnan(value):
            groups.setdefault(column.motion, []).append((column, value))
    result = {}
    for motion, columns in groups.items():
        motors = sorted({m for c, _ in columns for m, _ in c.rows})
        parts = []
        for run in runs:
            for segment in run.prepared.segments:
                rate = combined(motion, segment.velocity)
                conditions = dynamics.conditions(segment.position, segment.temperature)
                dry = np.zeros((len(motors), len(rate)))
                for column, value in columns:
                    signal = value * column_signal(found.model, column, segment.velocity, segment.acceleration, conditions)
                    for motor, factor in column.rows:
                        dry[motors.index(motor)] += factor * signal
                magnitude = dry * np.sign(rate)
                filt = run.prepared.parallel_filter
                rows = [
                    filt.apply(magnitude * (element(rate, segment.rate, travel) - np.sign(rate))) for travel in TRAVELS
                ]
                parts.append(np.array(rows))
        result[motion] = motors, np.concatenate(parts, axis=2)
    return result


def joined(series, name):
    return np.concatenate([np.asarray(getattr(part, name)) for part in series], axis=1)


def search(residual, counted, table):
    chosen = dict.fromkeys(table, 0)
    for _ in range(4):
        before = dict(chosen)
        for motion, (motors, rows) in table.items():
            rest = residual.copy()
            for other, (m, r) in table.items():
                if other != motion:
                    rest[m] -= r[chosen[other]]
            cost = [np.sum(((rest[motors] - row) ** 2)[counted[motors]]) for row in rows]
            chosen[motion] = int(np.argmin(cost))
        if chosen == before:
            break
    return chosen


def apply(residual, table, chosen):
    out = residual.copy()
    for motion, (m, r) in table.items():
        out[m] -= r[chosen[motion]]
    return out


def errors(measured, residual, counted, speed):
    slow = counted & (np.abs(speed) < LOW_SPEED)
    return [100 * np.linalg.norm(residual[k]) / np.linalg.norm(measured[k]) for k in (counted, counted & ~slow, slow)]


def study(name, recording, validation, choices):
    found = identify([recording], validation, choices)
    m, r, c, v = (joined(found.validation_series, n) for n in ("measured", "residual", "counted", "velocity"))
    rf, cf = joined(found.fit_series, "residual"), joined(found.fit_series, "counted")
    vf = joined(found.fit_series, "velocity")
    print(name, "static", " ".join(f"{e:7.3f}" for e in errors(m, r, c, v)), " per joint slow rmse", np.round([np.sqrt(np.mean(r[j][c[j] & (abs(v[j]) < LOW_SPEED)]**2)) for j in range(len(r))], 3), "slow share", np.round((c & (abs(v) < LOW_SPEED)).sum(1) / c.sum(1), 3))
    for element in (dahl, maxwell):
        tf = corrections(found, found.runs, element)
        tv = corrections(found, found.validation_runs, element)
        chosen = search(rf, cf, tf)
        oracle = search(r, c, tv)
        for label, which in (("found", chosen), ("oracle", oracle)):
            rr = apply(r, tv, which)
            print(f"  {element.__name__:8} {label:7}", " ".join(f"{e:7.3f}" for e in errors(m, rr, c, v)), [f"{TRAVELS[k]:.2g}" for k in which.values()],
              np.round([np.sqrt(np.mean(rr[j][c[j] & (abs(v[j]) < LOW_SPEED)]**2)) for j in range(len(r))], 3), flush=True)


def main(names):
    folder = Path(os.environ.get("DYNID_DATA", "/work/shared/data"))
    for name in names or ["ur10", "panda", "tx40"]:
        recording, choices = public(folder, name)
        for friction in ("coulomb-viscous", "coulomb-viscous+power+stribeck+load", "auto"):
            study(f"{name} {friction}", recording, [], choices_of(choices, friction))


if __name__ == "__main__":
    main(sys.argv[1:])
