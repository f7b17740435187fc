"""What every arm's base parameters satisfy, as linear inequalities G·x ≥ 0.

Kinetic energy is not negative, and friction does not drive. Both are linear in the parameters at given states; they are
necessary, not sufficient (for that see `ident.estimators.feasible`), and cheap enough to be tried on many hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.instants import Instants
from ident.friction.table import RUBBING_KINDS, TERM
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.parameters import PAIR_SYMBOLS
from ident.model.regressor import RegressorKernel, dense_regressor
from ident.regression.observability import Experiment, experiment_states

POSES = 40
RANDOM_DIRECTIONS = 4
SPEEDS = 8
"""Instants of each friction, spread over its speeds, at which it must not drive."""

ROUNDING = 1e-9
"""Coefficient over the largest one of a condition below which it is 0."""

SLOWEST_SHARE = 0.1
"""Share of the instants, the slowest ones, at which friction's direction is not certain."""


def moving_joints(model: DynamicModel, experiment: Experiment) -> tuple[int, ...]:
    """Joints that moved and whose motors' torques are used; none where coupled motors' torques are missing."""
    moving = tuple(joint for joint in range(model.dof) if joint not in experiment.locked)
    both = tuple(joint for joint in moving if joint in experiment.torques)
    return both if model.transmission.direct or both == moving else ()


def inertia_conditions(model: DynamicModel, experiment: Experiment, base: BaseParameters) -> FloatArray:
    """(c, b) kinetic energies of unit velocities at random poses: one joint's alone, and random ones."""
    joints = moving_joints(model, experiment)
    if not joints:
        return np.empty((0, base.count))
    states = experiment_states(model, experiment)
    positions = np.concatenate([position for position, _, _ in states], axis=1)
    positions = positions[:, :: max(1, positions.shape[1] // POSES)]
    generator = np.random.default_rng(0)
    directions = np.zeros((len(joints) + RANDOM_DIRECTIONS, model.dof, positions.shape[1]))
    for number, joint in enumerate(joints):
        directions[number, joint] = 1.0
        directions[len(joints) :, joint] = generator.standard_normal((RANDOM_DIRECTIONS, positions.shape[1]))
    direction = np.concatenate(list(directions), axis=1)
    position = np.tile(positions, (1, len(directions)))
    heat = None if not model.needs_temperature else np.full_like(position, 300.0)  # at rest it does not matter
    kernel = RegressorKernel(replace(model, gravity=np.zeros(3)), base.columns)
    rows = dense_regressor(kernel, position, np.zeros_like(position), direction, heat)
    inertial = [
        kind in ("inertial", "motor_inertia") or name.startswith("Iac")
        for kind, name in zip(base.kinds, base.names, strict=True)
    ]
    return np.asarray(np.einsum("nN,nbN->Nb", model.transmission.motor_rate(direction), rows) * np.array(inertial))


def on_active(conditions: FloatArray, active: Sequence[int]) -> FloatArray:
    """Conditions (c, b) on the `active` columns alone (·, a), without those about columns that have no value."""
    size = np.max(np.abs(conditions), axis=1, initial=0.0)
    others = np.max(np.abs(np.delete(conditions, active, axis=1)), axis=1, initial=0.0)
    return np.asarray(conditions[(size > 0.0) & (others <= ROUNDING * size)][:, active])


def friction_conditions(
    model: DynamicModel, base: BaseParameters, instants: Instants, regressor: FloatArray
) -> FloatArray:
    """(c, b) powers that each friction takes, at some of the instants with this regressor (n, b, N)."""
    power = np.einsum("nN,nbN->bN", model.transmission.motor_rate(instants.velocity), regressor)
    frictions: dict[tuple[tuple[int, float], ...], list[int]] = {}
    for column, (kind, name) in enumerate(zip(base.kinds, base.names, strict=True)):
        of_pair = kind == "coupling" and PAIR_SYMBOLS.get(name[:2]) in TERM
        if of_pair or kind in RUBBING_KINDS:
            frictions.setdefault(base.motions[column], []).append(column)
    count = power.shape[1]
    rows = [np.empty((0, base.count))]
    for columns in frictions.values():
        order = np.argsort(np.abs(power[columns]).sum(axis=0))
        chosen = order[np.linspace(SLOWEST_SHARE * count, count - 1, SPEEDS).astype(int)]
        powers = np.zeros((SPEEDS, base.count))
        powers[:, columns] = power[np.ix_(columns, chosen)].T
        rows.append(powers)
    return np.vstack(rows)
