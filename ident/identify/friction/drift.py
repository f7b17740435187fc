"""Friction that rises or falls along a recording, as a gear that warms up makes it: the parameters are its mean.

For each joint the residual is regressed on the model's friction, as far as it follows the velocity alone, times the
time, beside what else may grow (the torque, as by a gain, and an offset). The uncertainty is that of a jackknife over
equal parts of the recording.
"""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from ident.friction.table import DISSIPATIVE_KINDS, TERM
from ident.identify.identification import Identification
from ident.model.joint_columns import column_signal, joint_column
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import deviation_without
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

PARTS = 20
"""Parts of the recording; one in which the joint does not count is left out."""

VELOCITY_FRICTION = {kind for kind in DISSIPATIVE_KINDS if not TERM[kind].needs}

LEAST_DRIFT, LEAST_DEVIATIONS = 0.05, 5.0
"""Smallest change that is reported, as a share of the friction and in its σ: 14 random arms with sound and 8 with
position-dependent friction reach 2.8, three real ones 2.6, a simulated UR5e with a bristle 4.0."""

LEAST_BACK = 0.1
"""Share of the samples in the direction that the joint moves less often: in one direction friction is an offset."""


def friction_drift_checks(identification: Identification) -> list[Check]:
    """Joints whose friction changes from the beginning to the end of a single recording."""
    if len(identification.runs) > 1:
        return []
    model, drifts = identification.model, dict[int, tuple[float, float]]()
    for motor in identification.experiment.torques:
        change, deviation = friction_drift(identification, motor)
        if abs(change) > max(LEAST_DRIFT, LEAST_DEVIATIONS * deviation):
            drifts[motor] = change, WITHIN_95_PERCENT * deviation
    if not drifts:
        return []
    shown = ", ".join(
        f"{model.joint_names[motor]} by {100 * change:+.0f} ± {100 * interval:.0f} %"
        for motor, (change, interval) in sorted(drifts.items(), key=lambda item: -abs(item[1][0]))
    )
    text = (
        f"friction changes from the beginning to the end of the recording ({shown}), as in gears that warm up; the "
        "parameters are its mean, and errors at other temperatures are larger than the held-out one"
    )
    return [raised("friction-changes", text, [model.joint_names[motor] for motor in drifts])]


def friction_drift(identification: Identification, motor: int) -> tuple[float, float]:
    """Change of a motor's friction along the recording over its mean, and σ; 0 and inf where they are not known."""
    found, model, unknown = identification, identification.model, (0.0, float("inf"))
    times = np.concatenate([series.time[series.counted[motor]] for series in found.fit_series])
    if not times.size:
        return unknown
    own = [
        (joint_column(model, model.parameters[index]), value)
        for index, value in zip(found.base.columns, found.solution.parameters.tolist(), strict=True)
        if model.parameters[index].kind in VELOCITY_FRICTION and model.parameters[index].joint == model.active[motor]
    ]
    grams = np.zeros((PARTS, 7, 7))
    back = []
    for series in found.fit_series:
        counted = series.counted[motor]
        velocity, late = series.velocity[:, counted], (series.time[counted] - times.min()) / np.ptp(times) - 0.5
        friction = sum(
            (value * column_signal(model, one, velocity, velocity) for one, value in own), np.zeros_like(late)
        )
        direction, predicted = np.sign(friction), series.predicted[motor, counted]
        residual = series.residual[motor, counted]
        rows = np.array((late * friction, friction, direction, late * predicted, late, np.ones_like(late), residual))
        part = np.minimum(((late + 0.5) * PARTS).astype(int), PARTS - 1)
        for place in np.unique(part).tolist():
            grams[place] += rows[:, part == place] @ rows[:, part == place].T
        back.append(direction < 0.0)
    backwards = float(np.mean(np.concatenate(back)))
    grams = grams[grams[:, -2, -2] > 0.0]
    scale = np.sqrt(grams.sum(axis=0).diagonal()[:-1])
    if len(grams) < PARTS // 2 or not np.all(scale > 0.0) or not LEAST_BACK < backwards < 1.0 - LEAST_BACK:
        return unknown

    def change(gram: FloatArray) -> float:
        inverse = np.linalg.pinv(gram[:-1, :-1] / np.outer(scale, scale), rcond=1e-10, hermitian=True)
        return float(inverse[0] @ (gram[:-1, -1] / scale) / scale[0])

    whole = grams.sum(axis=0)
    return change(whole), float(deviation_without(np.array([change(whole - part) for part in grams])))
