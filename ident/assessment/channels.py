"""Torques that fit better exchanged or with the other sign, or with gravity along another axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from drivers.percentage import percent_text
from drivers.streams import FloatArray
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.observability import Experiment, experiment_base
from ident.regression.observation_matrix import filtered_samples
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

CLEARLY_BETTER = 0.9
"""Ratio of the sums of squared relative residuals below which another arrangement fits clearly better. On the public
recordings (TX40, UR10, Panda), which are in order, no exchange has a ratio below 4.6, no other direction of gravity one
below 1.1, and no sign one below 0.98 (a light last joint fits either sign)."""

LIKELIHOOD_LEVEL = 16.0
"""Threshold of the log-likelihood ratio, doubled and counted in independent equations: four σ, since up to thirty
arrangements are tried."""

EXPLAINED = 0.05
"""Relative error of the fit up to which gravity's axis is not doubted. A wrong axis leaves 0.09 to 0.63 on the public
recordings, which are fitted to 0.01 to 0.05 with the right one."""

AXES = "xyz"
SAME_DIRECTION = float(np.sqrt(0.5))
"""Cosine of 45°: an axis this near to the believed gravity counts as it."""


@dataclass(frozen=True, eq=False)
class ChannelGrams:
    """The system's normal equations with every torque in every joint's rows.

    Attributes:
        gram: (n, b, b) W_jᵀW_j of each joint's rows.
        score: (n, n, b) W_jᵀτ_k of joint j's rows and torque k.
        power: (n,) Σ τ_k².
    """

    gram: FloatArray
    score: FloatArray
    power: FloatArray


def channel_grams(kernel: RegressorKernel, runs: Sequence[Prepared], columns: Sequence[int]) -> ChannelGrams:
    """Sum up the normal equations of filtered torques over all runs, for some of the kernel's columns."""
    dof, width = kernel.model.dof, len(columns)
    gram, score, power = np.zeros((dof, width, width)), np.zeros((dof, dof, width)), np.zeros(dof)
    place = {column: position for position, column in enumerate(columns)}
    chosen: list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]] = []
    for joint in kernel.joint_rows:
        pairs = [(joint.rows.start + i, place[column]) for i, column in enumerate(joint.columns) if column in place]
        packed, there = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        chosen.append((packed, there))
    for run in runs:
        for segment in run.segments:
            for samples in filtered_samples(kernel, segment, run.parallel_filter, segment.torque):
                torque = samples.torque[:, samples.used]
                power += np.sum(torque**2, axis=1)
                for joint_index, (packed, there) in enumerate(chosen):
                    rows = samples.regressor[packed][:, samples.used]
                    gram[joint_index][there[:, None], there] += rows @ rows.T
                    score[joint_index][:, there] += torque @ rows.T
    return ChannelGrams(gram, score, power)


@dataclass(frozen=True)
class Arrangement:
    """Which torque belongs to which joint's rows, with which sign.

    Attributes:
        order: of joint j's rows, the torque's index.
        sign: (n,) of each joint's torque.
    """

    order: tuple[int, ...]
    sign: tuple[float, ...]


def relative_residual(grams: ChannelGrams, arrangement: Arrangement, joints: Sequence[int]) -> float:
    """Σ_j ‖τ_j − W_j x‖² / ‖τ_j‖² at its smallest, over the rows of some joints."""
    weight = np.array([1.0 / power if power > 0 else 0.0 for power in grams.power])
    total, gram, score = 0.0, 0.0, 0.0
    for joint in joints:
        torque = arrangement.order[joint]
        total += weight[torque] * grams.power[torque]
        gram = gram + weight[torque] * grams.gram[joint]
        score = score + weight[torque] * arrangement.sign[joint] * grams.score[joint, torque]
    return float(total - _explained(np.asarray(gram), np.asarray(score)))


def _explained(gram: FloatArray, score: FloatArray) -> float:
    """Reduction of the sum of squares by the best parameters."""
    scale = np.sqrt(np.diag(gram))
    scale = np.where(scale > 0, scale, 1.0)
    solution = np.linalg.lstsq(gram / np.outer(scale, scale), score / scale, rcond=1e-12)[0]
    return float(score / scale @ solution)


def arrangement_checks(
    model: DynamicModel,
    experiment: Experiment,
    runs: Sequence[Prepared],
    columns: Sequence[int],
    active: Sequence[int],
    independent: float,
    error: float,
) -> list[Check]:
    """Test common mistakes: gravity's axis, a sign, two torques exchanged.

    Args:
        model: as believed.
        experiment: joints that were locked, and motors whose torques count.
        runs: prepared data, with all equations: one motor's reversals are not another's.
        columns: standard columns of the base parameters.
        active: indices of the base parameters that were estimated.
        independent: number of independent equations.
        error: relative error of the fit.

    Returns:
        At most one check, the one that fits best.
    """
    joints = experiment.torques
    grams = channel_grams(RegressorKernel(model, columns), runs, active)
    if not all(grams.power[joint] > 0 for joint in joints):
        return []
    usual = Arrangement(tuple(range(model.dof)), (1.0,) * model.dof)
    believed = relative_residual(grams, usual, joints)
    candidates = _arranged(model.joint_names, grams, usual, joints)
    if error > EXPLAINED:
        candidates += _turned(model, experiment, runs)
    residual, check = min(candidates, key=lambda candidate: candidate[0])
    if clearly_better(residual, believed, independent):
        fall = 1.0 - float(np.sqrt(max(residual, 0.0) / believed))
        return [replace(check, text=check.text.format(change=percent_text(fall, 2)))]
    return []


def clearly_better(residual: float, believed: float, independent: float) -> bool:
    """Whether a residual is clearly and significantly smaller than that of what was believed."""
    if not residual < CLEARLY_BETTER * believed:
        return False
    return residual <= 0.0 or independent * np.log(believed / residual) > LIKELIHOOD_LEVEL


def _arranged(
    names: Sequence[str], grams: ChannelGrams, usual: Arrangement, joints: Sequence[int]
) -> list[tuple[float, Check]]:
    """The residual of each sign and each exchange, with the check that it would raise."""
    candidates = []
    for joint in joints:
        sign = list(usual.sign)
        sign[joint] = -1.0
        text = (
            f"the torque of {names[joint]} with the opposite sign makes the error {{change}} smaller: check the sign "
            "of its drive gain"
        )
        residual = relative_residual(grams, Arrangement(usual.order, tuple(sign)), joints)
        candidates.append((residual, raised("torque-sign", text, [names[joint]])))
    for first, second in combinations(joints, 2):
        order = list(usual.order)
        order[first], order[second] = order[second], order[first]
        text = (
            f"the torques of {names[first]} and {names[second]} exchanged make the error {{change}} smaller: check the "
            "order of the columns"
        )
        residual = relative_residual(grams, Arrangement(tuple(order), usual.sign), joints)
        candidates.append((residual, raised("torques-exchanged", text, [names[first], names[second]])))
    return candidates


def _turned(model: DynamicModel, experiment: Experiment, runs: Sequence[Prepared]) -> list[tuple[float, Check]]:
    """The residual with gravity along each other direction of the base's axes, with the check that it would raise."""
    size = float(np.linalg.norm(model.gravity))
    usual = Arrangement(tuple(range(model.dof)), (1.0,) * model.dof)
    candidates = []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (1.0, -1.0)):
        gravity = np.zeros(3)
        gravity[axis] = sign * size
        cosine = float(gravity @ model.gravity) / size**2 if size > 0.0 else 1.0
        if cosine > SAME_DIRECTION:
            continue
        turned = replace(model, gravity=gravity)
        base = experiment_base(turned, [experiment])
        grams = channel_grams(RegressorKernel(turned, base.columns), runs, range(base.count))
        residual = relative_residual(grams, usual, experiment.torques)
        if cosine < -SAME_DIRECTION:
            candidates.append((residual, opposite_gravity()))
            continue
        direction = ", ".join(f"{value:g}" for value in gravity)
        text = (
            f"gravity along {'+' if sign > 0 else '-'}{AXES[axis]} of the base makes the error {{change}} smaller: "
            f"check `model.gravity` (try [{direction}]) and how the arm is mounted"
        )
        candidates.append((residual, raised("gravity-other-axis", text)))
    return candidates


def opposite_gravity() -> Check:
    """The check of gravity's sign."""
    text = (
        "gravity of the opposite sign fits the data better: check `model.gravity`, how the arm is mounted, and the "
        "signs of the drive gains"
    )
    return raised("gravity-opposite", text)
