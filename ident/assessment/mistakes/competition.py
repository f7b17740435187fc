"""Search for the mistake of sign or column that explains a recording as no other does.

Every hypothesis is fitted under the conditions that every arm satisfies (`conditions`), so that one number tells how
well it explains the data: friction that drives and energies below zero cost error. A mistake is claimed only where it
explains the data, clearly and on every part of them, where as recorded they are not explained.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.core.arrays import FloatArray
from ident.assessment.file_errors.unknowns import Deviation, in_unknown_gravity
from ident.assessment.instants import BLOCKS, Columns, Instants
from ident.assessment.mistakes.conditions import friction_conditions, inertia_conditions, moving_joints, on_active
from ident.assessment.mistakes.equations import Equations, HypothesisFit, equations
from ident.assessment.mistakes.hypotheses import (
    Mistake,
    as_recorded,
    couplings,
    mistakes,
    other_gravity,
    ratios,
    reversed_time,
)
from ident.friction.table import RUBBING_KINDS
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.observability import Experiment, experiment_base

HALVED = float(2.0 * np.log(2.0))
"""How much the level falls where one joint's error is halved: the least that a mistake must explain."""

RIVAL = 0.7
"""A hypothesis whose level is less than this above the best one's is not distinguishable from it: one joint's error
falls by less than 30 %."""

WELL_EXPLAINED = 0.15
"""Relative error of a joint below which, all joints alike and at no cost of the conditions, nothing is searched."""

DOUBTFUL = 0.05
"""The same above which gravity may be missing."""

EXPLAINED = 0.2
"""Relative error of the whole arm above which no hypothesis counts as an explanation: something else is wrong."""

WELL_BY_ONE = 0.03
"""The same above which coupled motors compete with signs and columns that explain the recording."""

COUPLED = 0.1
"""The same of coupled motors: there are many couplings, which also fit a part of what is not one."""

JOINT_EXPLAINED = 0.5
"""The same of each joint that a hypothesis is about, where it is about one or two. Of several, one may only rub."""

FEWEST_ROWS = 0.25
"""Equations of a joint over those of the joint with most below which its columns are not exchanged: there a torque that
fits nothing would not count."""

WORSE_BLOCKS = 1
"""Held-out blocks at most in which a claimed mistake may predict worse than the recording as it is."""

BOUND_SLACK = 1.0
"""Levels with conditions may be lower than without by this much, as the joints' weights differ."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """A hypothesis with its fit under the conditions."""

    mistake: Mistake
    fit: HypothesisFit


class Competition:
    """A recording, and hypotheses of what is wrong with it.

    Attributes:
        model, experiment, base, active: of the identification.
        measured: the recording.
        instants: the same, its torques about their means where all motors have an offset.
        joints: that moved and whose torques are used.
        seldom_counted: of these, joints with few equations, as those that are near velocity reversals throughout.
    """

    def __init__(
        self,
        model: DynamicModel,
        experiment: Experiment,
        base: BaseParameters,
        active: Sequence[int],
        instants: Instants,
    ) -> None:
        self.model, self.experiment, self.base, self.active = model, experiment, base, list(active)
        offsets = sum(base.kinds[column] == "offset" for column in active)
        self.measured = instants
        self.instants = instants.without_constants() if offsets == model.dof else instants
        self.joints = moving_joints(model, experiment)
        rows = instants.counted.sum(axis=1)
        self.seldom_counted = frozenset(np.flatnonzero(rows < FEWEST_ROWS * rows.max()).tolist())
        self._kernel = RegressorKernel(model, base.columns)
        self._in_gravity = {
            name: RegressorKernel(replace(model, gravity=size * model.gravity), base.columns)
            for name, size in (("gravity-opposite", -1.0), ("gravity-missing", 0.0))
        }
        self._inertia = on_active(inertia_conditions(model, experiment, base), self.active)
        self._equations: dict[tuple[object, ...], tuple[Equations, FloatArray]] = {}
        self.recorded = as_recorded(model.dof)

    def system(self, mistake: Mistake) -> tuple[Equations, FloatArray]:
        """Equations with a mistake's positions and gravity, and their conditions (c, a)."""
        coupled = (mistake.joints, mistake.coupling, mistake.signal) if mistake.coupling else None
        kernel = self._in_gravity.get(mistake.name, self._kernel)
        backwards = mistake.name == "time-reversed"
        key = mistake.positions, kernel, coupled, backwards
        if key not in self._equations:
            moved = self.instants.with_positions(mistake.positions)
            if backwards:
                moved = replace(moved, velocity=-moved.velocity, friction=None)
            if mistake.coupling and mistake.signal != "torque":
                moved = moved.less(mistake.joints[0], mistake.joints[1], mistake.coupling)
            regressor = moved.regressor(kernel)
            friction = on_active(friction_conditions(self.model, self.base, moved, regressor), self.active)
            conditions = np.vstack([self._inertia, friction])
            rows = regressor[:, self.active]
            if mistake.coupling and mistake.signal != "position":
                rows = self._of_motors(mistake, rows)
                conditions = np.pad(conditions, ((0, 0), (0, rows.shape[1] - conditions.shape[1])))
            system = equations(rows, moved, self.experiment.torques)
            self._equations[key] = system, conditions
        return self._equations[key]

    def _of_motors(self, mistake: Mistake, rows: FloatArray) -> FloatArray:
        """Columns of the coupled motors' equations, Γ_motor = R⁻ᵀ·Γ_joint, from those of the joints (n, a, N).

        The first motor's inertia and friction come as further columns: they follow the motor, not the joint.
        """
        (one, other), factor = mistake.joints, mistake.coupling
        turning = self.instants if mistake.signal == "both" else self.instants.less(one, other, -factor)
        of_motor = [
            column
            for column in self.active
            if self.base.joints[column] == self.model.active[one]
            and self.base.kinds[column] in (*RUBBING_KINDS, "motor_inertia")
        ]
        further = np.zeros((len(rows), len(of_motor), rows.shape[2]))
        further[one] = turning.regressor(self._kernel)[one, of_motor]
        rows[other] -= factor * rows[one]
        return np.concatenate([rows, further], axis=1)

    def regressor(self, moved: Instants) -> FloatArray:
        """(n, a, N) of the active columns along a motion."""
        return moved.regressor(self._kernel)[:, self.active]

    def free(self, mistake: Mistake) -> HypothesisFit | None:
        """The fit without conditions."""
        return self.system(mistake)[0].fit(mistake.torques)

    def bound(self, mistake: Mistake, blocks: Sequence[int] | None = None) -> HypothesisFit | None:
        """The fit under the conditions, to some blocks or all."""
        system, conditions = self.system(mistake)
        return system.fit(mistake.torques, conditions, blocks)

    @cached_property
    def well_explained(self) -> bool:
        """Whether the recording as it is leaves nothing to explain."""
        free, bound = self.free(self.recorded), self.bound(self.recorded)
        if free is None or bound is None:
            return False
        used = list(self.experiment.torques)
        return bool(bound.level - free.level < RIVAL and np.all(bound.relative[used] < WELL_EXPLAINED**2))

    def best(self, candidates: Iterable[Mistake]) -> list[Explanation]:
        """The candidates that may be the best or its rivals, best first.

        Fits without conditions are never worse than with them, so that most candidates need no second fit.
        """
        counted = [
            one for one in candidates if "exchanged" not in one.name or self.seldom_counted.isdisjoint(one.joints)
        ]
        free = [(fit.level, mistake) for mistake in counted if (fit := self.free(mistake)) is not None]
        lowest = np.inf
        found = []
        for level, mistake in sorted(free, key=lambda one: one[0]):
            if level > lowest + RIVAL + BOUND_SLACK:
                break
            fit = self.bound(mistake)
            if fit is not None:
                found.append(Explanation(mistake, fit))
                lowest = min(lowest, fit.level)
        return sorted(found, key=lambda one: one.fit.level)

    def explains(self, one: Explanation, recorded: HypothesisFit) -> bool:
        """Return whether a mistake explains what the recording as it is does not, in all of it and well."""
        # Without gravity there is nothing more to fit with: what fits as well then is no coincidence.
        if recorded.level - one.fit.level < (RIVAL if one.mistake.name == "gravity-missing" else HALVED):
            return False
        joints = list(one.mistake.joints)
        if self.error(one) > EXPLAINED or (len(joints) < 3 and np.any(one.fit.relative[joints] > JOINT_EXPLAINED**2)):
            return False
        worse = [
            block for block in range(BLOCKS) if self.held_out(one.mistake, block) > self.held_out(self.recorded, block)
        ]
        return len(worse) <= WORSE_BLOCKS

    def held_out(self, mistake: Mistake, block: int) -> float:
        """Σ log of the joints' relative squared residuals of a block, fitted to the other ones; inf without a fit."""
        fit = self.bound(mistake, [other for other in range(BLOCKS) if other != block])
        if fit is None:
            return np.inf
        system, _ = self.system(mistake)
        return float(np.sum(system.levels(mistake.torques, fit.parameters, [block])))

    def error(self, one: Explanation) -> float:
        """Relative error of the whole arm."""
        return self._whole(self.system(one.mistake)[0], one.mistake.torques, one.fit)

    def with_deviation(self, deviation: Deviation) -> tuple[HypothesisFit, float] | None:
        """The fit under the conditions with a number of the robot file changed, and the whole arm's relative error."""
        model, moved, base, active = deviation.model, self.instants, self.base, self.active
        if deviation.unknown.kind == "zero":
            moved = moved.shifted(deviation.unknown.joint, deviation.value)
        if deviation.unknown.kind == "late":
            moved = moved.later(deviation.unknown.joint, deviation.value)
        torques = self.recorded.torques
        factor = tuple(1.0 / (1.0 + deviation.gains.get(n, 0.0)) for n in range(self.model.dof))
        torques = replace(torques, factor=factor)
        if deviation.columns != self.base.columns:
            base = experiment_base(in_unknown_gravity(model), [self.experiment])
            active = list(range(base.count))
        regressor = moved.regressor(RegressorKernel(model, base.columns))
        conditions = np.vstack(
            [inertia_conditions(model, self.experiment, base), friction_conditions(model, base, moved, regressor)]
        )
        system = equations(regressor[:, active], moved, self.experiment.torques)
        fit = system.fit(torques, on_active(conditions, active))
        return None if fit is None else (fit, self._whole(system, torques, fit))

    def explained_by(self, deviation: Deviation) -> bool:
        """Return whether a deviation leaves what still is an explanation, also of the joint that it is about."""
        found = self.with_deviation(deviation)
        own = [deviation.unknown.joint] if deviation.unknown.kind == "late" else list(deviation.gains)
        return found is not None and found[1] < EXPLAINED and not np.any(found[0].relative[own] > JOINT_EXPLAINED**2)

    def _whole(self, system: Equations, torques: Columns, fit: HypothesisFit) -> float:
        """Root of the sum of squared residuals over that of the torques, constants among them."""
        varying = system.power.sum(axis=0)[np.arange(len(fit.relative)), list(torques.order)]
        whole = np.sum(np.where(self.measured.counted, torques.of(self.measured.torque), 0.0) ** 2)
        return float(
            np.sqrt(
                np.sum(fit.relative * varying * np.square(torques.factor)) / max(float(whole), np.finfo(float).tiny)
            )
        )


def explanations(competition: Competition, deviations: Sequence[Deviation]) -> list[Mistake]:
    """The mistake that explains the recording, and others that do so as simply; none where none does.

    Args:
        competition: the recording.
        deviations: gains, lengths, zeros and directions of gravity, best first; the first of each kind is a rival.
    """
    recorded = competition.bound(competition.recorded) if competition.joints else None
    if recorded is None:
        return []
    tried = other_gravity(competition.model.dof) if np.any(competition.model.gravity) else []
    well = competition.well_explained
    if well:  # inertia and friction may hide that gravity is missing
        tried = tried[:1] if np.max(recorded.relative) > DOUBTFUL**2 else []
    else:
        count, joints = competition.model.dof, competition.joints
        turning = [joint for joint in joints if not competition.model.sliding[joint]]
        tried = [*mistakes(count, joints), *ratios(count, joints, turning), reversed_time(count), *tried]
    found = competition.best(tried)
    if not found or not competition.explains(found[0], recorded):
        found = []
    scaled = bool(found) and found[0].mistake.name == "position-scaled"
    if not well and (not found or scaled or competition.error(found[0]) > WELL_BY_ONE):
        level = found[0].fit.level - (0.0 if scaled else RIVAL) if found else np.inf
        coupled = competition.best(couplings(competition.model.dof, competition.joints))
        if coupled and coupled[0].fit.level < level and competition.error(coupled[0]) < COUPLED:
            found = coupled if competition.explains(coupled[0], recorded) else found
    if not found:
        return []
    lowest = found[0].fit.level
    rivals = {one.unknown.kind: one for one in reversed(deviations)}
    others = [competition.with_deviation(rival) for rival in rivals.values()]
    if any(other is not None and other[0].level < lowest + RIVAL for other in others):
        return []
    best = found[0].mistake
    alike = [one.mistake for one in found if one.fit.level < lowest + RIVAL]
    return [best] if best.name == "gravity-missing" else _simplest(alike)


def _simplest(alike: Sequence[Mistake]) -> list[Mistake]:
    """Those of several equal explanations that need nothing more than another one of the same kind."""
    return [
        rival
        for rival in alike
        if not any(other.name == rival.name and set(other.joints) < set(rival.joints) for other in alike)
    ]
