"""Signs and columns that are wrong in a part of the recording only: up to a moment, or from it on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np

from ident.assessment.instants import BLOCKS
from ident.assessment.mistakes.competition import EXPLAINED, HALVED, RIVAL, Competition
from ident.assessment.mistakes.equations import HypothesisFit
from ident.assessment.mistakes.hypotheses import Mistake, mistakes
from ident.model.dynamic_model import DynamicModel
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

COARSE, MOST_LIKELY = (2, 5), 4
"""Parts in which every mistake is tried first, and how many mistakes are then tried in all."""

MOST_FITTED = 6
"""Switches, the most likely ones, that are fitted under the conditions."""


@dataclass(frozen=True)
class Switch:
    """A mistake in a part of the recording."""

    mistake: Mistake  # which
    block: int  # the part in which it begins or ends; its equations are left out
    before: bool  # it is so up to there, instead of from there on

    @property
    def wrong(self) -> list[int]:
        """Parts in which it is so."""
        return list(range(self.block) if self.before else range(self.block + 1, BLOCKS))

    @property
    def right(self) -> list[int]:
        """Parts in which it is not."""
        return list(range(self.block + 1, BLOCKS) if self.before else range(self.block))


def switch_check(model: DynamicModel, competition: Competition) -> list[Check]:
    """The exchange or the sign that begins or ends within the recording and explains it, if one does.

    Args:
        model: as believed.
        competition: the whole recording in the order of time, which nothing explains that is so throughout.
    """
    found = _best(competition)
    if found is None:
        return []
    times = competition.instants.time[competition.instants.block == found.block]
    names = [model.joint_names[joint] for joint in found.mistake.joints]
    what, verb = _WHAT[found.mistake.signal], "are exchanged" if len(names) > 1 else "have the opposite sign"
    start = float(competition.instants.time[0])
    when = f"{'up to' if found.before else 'from'} {times[0] - start:.1f} to {times[-1] - start:.1f} s"
    text = (
        f"something changed during the recording: the data fit {what} of {' and '.join(names)} that {verb} "
        f"{when}{'' if found.before else ' on'}; check the order of the columns, and identify from an unchanged part "
        "(--start, --stop)"
    )
    return [raised("recording-changes", text, names)]


_WHAT = {"torque": "torques", "position": "positions", "both": "positions and torques"}


def _best(competition: Competition) -> Switch | None:
    """The switch that explains most, if it is clear and explains the recording."""
    if not competition.joints:
        return None
    coarse = _falls(competition, _switches(competition, _mistakes(competition), COARSE))
    likely = list(dict.fromkeys(switch.mistake for _, switch in coarse))[:MOST_LIKELY]
    found = []
    for fall, switch in _falls(competition, _switches(competition, likely, range(1, BLOCKS - 1)))[:MOST_FITTED]:
        bound, plain = _fit(competition, switch, bound=True), _recorded(competition, switch, bound=True)
        if fall < HALVED or bound is None or plain is None or plain.level - bound.level < HALVED:
            continue
        if _error(competition, switch, bound) < EXPLAINED:
            found.append((plain.level - bound.level, switch))
    if not found:
        return None
    largest = max(fall for fall, _ in found)
    alike = [switch for fall, switch in found if fall > largest - RIVAL]
    # Which of several mistakes it is must be clear; when it began need not be.
    return alike[0] if len({one.mistake for one in alike}) == 1 else None


def _mistakes(competition: Competition) -> list[Mistake]:
    """Two columns exchanged, or a sign."""
    found = mistakes(competition.model.dof, competition.joints)
    return [one for one in found if len(one.joints) == (2 if one.name.endswith("exchanged") else 1)]


def _switches(competition: Competition, tried: Iterable[Mistake], blocks: Iterable[int]) -> list[Switch]:
    """Switches of some mistakes in some blocks; one joint alone has no order."""
    if len(competition.joints) < 2:
        return []
    return [Switch(*one) for one in product(tried, blocks, (False, True))]


def _falls(competition: Competition, switches: Iterable[Switch]) -> list[tuple[float, Switch]]:
    """Return how much each switch lowers the level, the most first, without conditions."""
    plain: dict[int, HypothesisFit | None] = {}
    falls = []
    for switch in switches:
        if switch.block not in plain:
            plain[switch.block] = _recorded(competition, switch)
        fit, recorded = _fit(competition, switch), plain[switch.block]
        if fit is not None and recorded is not None:
            falls.append((recorded.level - fit.level, switch))
    return sorted(falls, key=lambda one: -one[0])


def _fit(competition: Competition, switch: Switch, *, bound: bool = False) -> HypothesisFit | None:
    """The fit with the mistake in its part alone."""
    wrong, conditions = competition.system(switch.mistake)
    right, _ = competition.system(competition.recorded)
    mixed = right.of(switch.right, competition.recorded.torques).beside(wrong.of(switch.wrong, switch.mistake.torques))
    return mixed.fit(competition.recorded.torques, conditions if bound else None)


def _recorded(competition: Competition, switch: Switch, *, bound: bool = False) -> HypothesisFit | None:
    """The fit without it, to the same parts."""
    system, conditions = competition.system(competition.recorded)
    return system.fit(
        competition.recorded.torques, conditions if bound else None, sorted([*switch.wrong, *switch.right])
    )


def _error(competition: Competition, switch: Switch, fit: HypothesisFit) -> float:
    """Relative error of the whole arm."""
    system, _ = competition.system(competition.recorded)
    power = np.einsum("kjj->j", system.power)  # Σ τ² of each joint's own torque
    return float(np.sqrt(np.sum(fit.relative * power) / max(float(power.sum()), np.finfo(float).tiny)))
