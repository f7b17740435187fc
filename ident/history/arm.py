"""The history of one arm: its parameters as series over its results, their trends, and which of them are findings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.history.entry import HistoryEntry, KeptValue
from ident.history.trend import LEAST_RESULTS, Series, Trend, estimate_trend

TREND_LEVEL, STEP_LEVEL = 0.025, 0.025
"""Probabilities that an arm that does not change has any finding: a change (Holm over its parameters), a step
(Bonferroni over parameters and places). Together 5 %."""


@dataclass(frozen=True)
class ParameterHistory:
    """One parameter over the results."""

    name: str  # of the parameter; those of gravity and servo models begin with their kind
    joint: str  # that it belongs to
    kind: str  # in words
    unit: str  # of its values
    series: Series  # what the results say
    # of the series; None where results are too few, or temperature and time cannot be distinguished
    trend: Trend | None
    significant: bool  # whether its change is a finding
    not_comparable: int  # results that are left out, for their value has another basis


@dataclass(frozen=True)
class ArmHistory:
    """All parameters of an arm."""

    arm: str  # its name in the history
    results: int  # that are compared
    repeated: int  # results that are left out, for later ones were identified from the same recordings
    # start, end: times of the first and the last one [s since 1970]
    start: float
    end: float
    parameters: tuple[ParameterHistory, ...]  # findings first, by falling significance

    @property
    def findings(self) -> tuple[ParameterHistory, ...]:
        """Parameters that changed or stepped."""
        return tuple(
            parameter
            for parameter in self.parameters
            if parameter.significant or (parameter.trend is not None and parameter.trend.steps)
        )


def arm_history(arm: str, entries: Sequence[HistoryEntry]) -> ArmHistory:
    """Trends of an arm's parameters."""
    latest = {entry.data: entry for entry in sorted(entries, key=lambda entry: entry.created)}
    used = [entry for entry in entries if latest[entry.data] is entry]
    grouped: dict[tuple[str, str, str], list[tuple[float, KeptValue]]] = {}
    for entry in used:
        for value in entry.values:
            name = value.name if entry.kind == "result" else f"{entry.kind}: {value.name}"
            grouped.setdefault((name, value.joint, value.unit), []).append((entry.time, value))
    level = STEP_LEVEL / max(len(grouped), 1)
    parameters = [_parameter(name, values, level) for (name, _, _), values in grouped.items()]
    return ArmHistory(arm, len(used), len(entries) - len(used), used[0].time, used[-1].time, tuple(_judged(parameters)))


def _parameter(name: str, values: Sequence[tuple[float, KeptValue]], step_level: float) -> ParameterHistory:
    counts = Counter(value.basis for _, value in values)
    last = {value.basis: place for place, (_, value) in enumerate(values)}
    basis = max(counts, key=lambda of: (counts[of], last[of]))
    alike = [(time, value) for time, value in values if value.basis == basis]
    temperature = [np.nan if value.temperature is None else value.temperature for _, value in alike]
    series = Series(
        np.array([time for time, _ in alike]),
        np.array([value.value for _, value in alike]),
        np.array([value.std for _, value in alike]),
        np.array(temperature, dtype=np.float64),
    )
    about = alike[-1][1]
    trend = estimate_trend(series, step_level) if len(series) >= LEAST_RESULTS else None
    return ParameterHistory(name, about.joint, about.kind, about.unit, series, trend, False, len(values) - len(alike))


def _judged(parameters: Sequence[ParameterHistory]) -> list[ParameterHistory]:
    """Parameters by falling significance of their change; what is below Holm's bound is a finding."""

    def p_value(entry: ParameterHistory) -> float:
        return np.inf if entry.trend is None else entry.trend.p_value

    ordered = sorted(parameters, key=p_value)
    tested = sum(entry.trend is not None for entry in ordered)
    judged, significant = [], True
    for place, entry in enumerate(ordered):
        significant = significant and p_value(entry) <= TREND_LEVEL / max(tested - place, 1)
        judged.append(replace(entry, significant=significant))
    return sorted(
        judged, key=lambda entry: not (entry.significant or (entry.trend is not None and bool(entry.trend.steps)))
    )
