"""The checks of mistakes, of the whole: what is wrong with signs, columns, gains, lengths, zeros and gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.assessment.file_errors.model_errors import (
    candidates,
    model_error_checks,
    most_likely,
    quarter_turns,
    reported,
    unchecked_lengths,
)
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Deviation
from ident.assessment.instants import instants
from ident.assessment.mistakes.changes import Changes, change_check
from ident.assessment.mistakes.competition import Competition, explanations
from ident.assessment.mistakes.hypotheses import Mistake
from ident.assessment.mistakes.ripple import ripple_checks
from ident.assessment.mistakes.shifts import shift_check
from ident.assessment.mistakes.switches import switch_check
from ident.assessment.mistakes.unsigned import unsigned_torques
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.least_squares import LeastSquares
from ident.regression.observability import Experiment
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check


def mistake_checks(
    model: DynamicModel,
    experiment: Experiment,
    base: BaseParameters,
    runs: Sequence[Prepared],
    solution: LeastSquares,
    independent: float,
    whole: Sequence[Prepared] = (),
) -> list[Check]:
    """Return at most one check: the mistake that explains the data best, if one does.

    Args:
        model: as believed.
        experiment: joints that were locked, and motors whose torques count.
        base: parameters of the experiment.
        runs: prepared data, with the equations that were fitted.
        solution: of these, with a weight per joint.
        independent: number of independent equations.
        whole: the recording that the data are a part of, in the order of time; nothing is sought there that changes
            where it is empty.
    """
    kernel = RegressorKernel(model, base.columns)
    few = instants(kernel, runs)
    if few.torque.shape[1] <= len(solution.active):
        return []
    # Friction that was taken off has the sign of what was believed: columns and signs compete for what was recorded.
    recorded = [_as_recorded(run) for run in runs]
    held = any(segment.known_torque is not None for run in runs for segment in run.segments)
    competition = Competition(model, experiment, base, solution.active, instants(kernel, recorded) if held else few)
    folded = unsigned_torques(competition, recorded)
    if folded:
        return [_unsigned_check([model.joint_names[joint] for joint in folded])]
    well = competition.well_explained
    refit = Refit(model, experiment, base.columns, few, solution)
    tried = candidates(refit, independent, poor=not well)
    deviations = most_likely(refit, runs, independent, tried)
    found = explanations(competition, deviations)
    rippled = [] if any(one.name == "position-scaled" for one in found) else ripple_checks(competition)
    if rippled:
        return rippled
    if found:
        axes = all(one.name == "joint-sign" for one in found)  # a neighbour that is turned over looks the same
        return [_check(model, found, _equal_turns(competition, refit, found[0]) if axes else ())]
    changes = Changes(model, experiment, base, whole, solution) if whole else None
    changed = None if changes is None else changes.best()
    if changes is not None and changed is not None:
        static = competition.with_deviation(deviations[0]) if deviations and reported(deviations[0]) else None
        if static is None or changed.level < static[0].level:
            return [change_check(model, changed, changes.times)]
    if whole and not well:
        recorded = [_as_recorded(run) for run in whole]
        switched = switch_check(
            model, Competition(model, experiment, base, solution.active, instants(kernel, recorded))
        )
        if switched and not (deviations and reported(deviations[0]) and competition.explained_by(deviations[0])):
            return switched
    misplaced = [] if well else shift_check(competition)
    if misplaced:
        return misplaced
    if not well or (deviations and reported(deviations[0])):
        deviations = most_likely(refit, runs, independent, [*tried, *quarter_turns(refit)])
    if deviations and not well and not competition.explained_by(deviations[0]):
        return []
    return model_error_checks(model, deviations) or (unchecked_lengths(refit, independent) if well else [])


def _as_recorded(run: Prepared) -> Prepared:
    """The run with the torque of friction that was held."""
    segments = (
        segment
        if segment.known_torque is None
        else replace(segment, torque=segment.torque + segment.known_torque, known_torque=None)
        for segment in run.segments
    )
    return replace(run, segments=tuple(segments))


def _unsigned_check(names: Sequence[str]) -> Check:
    text = (
        f"the torque of {', '.join(names)} is never negative although it comes near 0, and the data are not explained: "
        "its sign was not recorded and cannot be restored; record signed currents or torques"
    )
    return raised("unsigned-torque", text, names)


def _equal_turns(competition: Competition, refit: Refit, best: Mistake) -> list[Deviation]:
    """Zeros off by a quarter or half a turn that explain the data as a mistake of sign or column does."""
    level = competition.bound(best)
    fits = [(one, competition.with_deviation(one)) for one in quarter_turns(refit)]
    return [one for one, fit in fits if level is not None and fit is not None and fit[0].level < level.level + EQUAL]


def _check(model: DynamicModel, found: Sequence[Mistake], turns: Sequence[Deviation]) -> Check:
    """The check of a mistake, or of several that explain the data equally well."""
    first = found[0]
    joints = {joint for one in found for joint in one.joints} | {turn.unknown.joint for turn in turns}
    names = [model.joint_names[joint] for joint in sorted(joints)]
    pairs = {one.joints if one.coupling else None for one in found}
    if first.coupling and len(pairs) <= len(names) == 2:
        signals = list(dict.fromkeys(one.signal for one in found if one.coupling))
        text = (
            f"{' or '.join(_IN_COLUMNS[signal] for signal in signals)} of {' and '.join(names)} seem to be those of "
            "coupled motors, of which one also turns with the other joint (by a factor of 1 or -1): this explains the "
            f"data, unlike what was recorded; {', or '.join(_UNCOUPLED[signal] for signal in signals)}"
        )
        return raised(first.name, text, names)
    if len(found) == 1 and not turns:
        text = f"{_clause(model, first)}: this explains the data, unlike what was recorded; {_REMEDIES[first.name]}"
        return raised(first.name, text, names)
    what = ", or ".join(
        [
            *(_clause(model, one) for one in found),
            *(
                f"the zero of {model.joint_names[turn.unknown.joint]} is off by {np.rad2deg(-turn.value):.0f}°"
                for turn in turns
            ),
        ]
    )
    text = (
        f"a sign or a column is wrong: {what}; each of these explains the data equally well, unlike what was recorded"
    )
    return raised("sign-or-column", text, names)


def _clause(model: DynamicModel, one: Mistake) -> str:
    """Return what a mistake says."""
    columns = one.positions if one.signal == "position" else one.torques
    if len(one.joints) > 2 and one.name.endswith("s-exchanged"):
        held = ", ".join(model.joint_names[columns.order.index(joint)] for joint in one.joints)
        names = ", ".join(model.joint_names[joint] for joint in one.joints)
        return f"the columns of {names} hold {_IN_COLUMNS[one.signal]} of {held}, in this order"
    names = " and ".join(model.joint_names[joint] for joint in one.joints)
    factor, torque = 1.0 / max(one.positions.factor, key=_size), 1.0 / max(one.torques.factor, key=_size)
    too = f" and its torque {torque:.3g} times" if torque != 1.0 else ""
    clause = _CLAUSES[one.name].format(joints=names, factor=factor, too=too, columns=_IN_COLUMNS.get(one.signal))
    each = one.name in ("torque-sign", "position-scaled") and one.joints[1:]
    return clause.replace("the ", "each ", 1) if each else clause


def _size(factor: float) -> float:
    return abs(float(np.log(abs(factor))))


EQUAL = 0.1
"""Difference of two levels below which two mistakes are the same arm in other words."""

_IN_COLUMNS = {"torque": "the torques", "position": "the positions", "both": "positions and torques"}
_CLAUSES = {
    "motors-coupled": "{columns} of {joints} are those of coupled motors",
    "time-reversed": "time runs backwards: friction drives the motion",
    "position-scaled": "the position of {joints} is {factor:.3g} times its own{too}",
    "gravity-opposite": "gravity has the opposite sign",
    "gravity-missing": "the torques hold no gravity",
    "torques-opposite": "all torques have the opposite sign",
    "positions-opposite": "all positions have the opposite sign",
    "torque-sign": "the torque of {joints} has the opposite sign",
    "position-sign": "the position of {joints} has the opposite sign",
    "joint-sign": "position and torque of {joints} have the opposite sign",
    "torques-exchanged": "the torques of {joints} are swapped",
    "positions-exchanged": "the positions of {joints} are swapped",
    "joints-exchanged": "positions and torques of {joints} are swapped",
}
_REMEDIES = {
    "gravity-opposite": "check `model.gravity`, the mounting, and the signs of the drive gains",
    "gravity-missing": "record the torques of the motors, from which no gravity was taken off",
    "torques-opposite": "reverse the sign of all drive gains, or of the torque columns",
    "positions-opposite": "reverse the sign of the position columns, or the joints' axes in the robot file",
    "torque-sign": "check the sign of its drive gain",
    "position-sign": "check the sign of its position column and its axis in the robot file",
    "joint-sign": "check the direction of its axis in the robot file",
    "torques-exchanged": "check the order of the torque or current columns",
    "positions-exchanged": "check the order of the position columns",
    "joints-exchanged": "check the order of the columns, and of the joints in the robot file",
    "time-reversed": "check the order of the rows and their stamps",
    "position-scaled": "check its gear ratio and encoder counts",
}
_UNCOUPLED = {
    "torque": "state `model.coupling` in the robot file",
    "position": "convert the positions to the joints' own",
    "both": "state `model.coupling` in the robot file and convert the positions to the joints' own",
}
