"""Is a recording long enough? Expected error bars of its motion, and the time needed for a wanted precision."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.errors import DynidError
from drivers.core.text import percentage_text
from ident.assessment.excitation import RecordedMotion, excited_base_columns
from ident.excite.forecast import Forecast, forecast
from ident.excite.prior import PriorKnowledge, find_prior, least_noise
from ident.regression.comparison import compare_torques
from ident.regression.jackknife import FilteredRun, block_jackknife
from ident.regression.least_squares import weighted_least_squares
from ident.regression.options import SIGNIFICANT_RSD
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare

OWN_TORQUE = "a quick identification of this recording"
"""Source of parameters and noise where the recording holds torque."""

REPEATED = 1.2
"""From this many repetitions on, errors that repeat with the motion do not average out."""


@dataclass(frozen=True)
class Sufficiency:
    """Expected error bars of a recorded motion."""

    seconds: float  # duration of the motion used [s]
    source: str  # origin of parameters and noise, in words
    repetitions: float  # how often the motion was repeated, on average; 1 where it was not, or where there is no torque
    forecast: Forecast  # condition, log det, predicted error bars


@dataclass(frozen=True)
class TimeNeeded:
    """How long a motion must last for one parameter."""

    name: str  # of the base parameter
    rsd_percent: float  # predicted for this recording [%]
    seconds: float  # of the same motion until it is reached [s]; the standard deviation falls with the root of the time


@dataclass(frozen=True)
class TimesNeeded:
    """How long a motion must last for a wanted relative standard deviation."""

    wanted_rsd_percent: float  # [%]
    parameters: tuple[TimeNeeded, ...]  # the significant ones (RSD below 15 % by now), the slowest first
    sentence: str  # the conclusion


def motion_sufficiency(motion: RecordedMotion, choices: PreprocessChoices | None = None) -> Sufficiency | None:
    """Expected error bars of a recorded motion; None without knowledge of parameters and noise.

    Both come from a quick identification of the recording, or from the robot file where no torque is known. The
    recording is preprocessed as `motion` was where no choices are given.
    """
    if motion.measured is not None:
        with suppress(DynidError):  # too short to identify anything from
            if choices is None:
                return _from_torque(motion)
            return _from_torque(replace(motion, prepared=prepare(motion.measured, choices)))
    try:
        prior = find_prior(motion.robot_file)
    except DynidError:
        return None
    return _summary(motion, prior)


def _summary(motion: RecordedMotion, prior: PriorKnowledge, repetitions: float = 1.0) -> Sufficiency:
    prepared = motion.prepared
    rate = prepared.segments[0].rate
    active = excited_base_columns(motion.reduction, motion.base, [prepared])
    rows = (motion.reduction, rate / prepared.parallel_filter.factor)
    return Sufficiency(
        seconds=sum(int(segment.used.sum()) for segment in prepared.segments) / rate,
        source=prior.source,
        repetitions=repetitions,
        forecast=forecast(motion.base, motion.model, rows, prior, active),
    )


def _from_torque(motion: RecordedMotion) -> Sufficiency:
    """Forecast with the values of weighted least squares and its residuals as noise.

    They are autocorrelated and scaled up by the ratio of jackknife to classical standard deviations (median).
    """
    segments, parallel_filter = motion.prepared.segments, motion.prepared.parallel_filter
    active = excited_base_columns(motion.reduction, motion.base, [motion.prepared])
    solution = weighted_least_squares(motion.reduction, active)
    series = compare_torques(motion.model, motion.base.columns, solution.parameters, segments, parallel_filter)
    corrected = block_jackknife(motion.kernel, [FilteredRun(segments, parallel_filter, series)], solution)
    classical = np.diag(solution.covariance)  # 0 where the model leaves no residual, as of a torque that is 0
    ratios = np.sqrt(np.diag(corrected.covariance)[classical > 0.0] / classical[classical > 0.0])
    ratio = float(np.median(ratios)) if len(ratios) else 1.0
    prior = PriorKnowledge(
        parameters=solution.parameters,
        noise=np.maximum(solution.joint_std * ratio, least_noise(motion.model.limits)),
        source=OWN_TORQUE,
        rate=segments[0].rate / parallel_filter.factor,
    )
    return _summary(motion, prior, corrected.repetitions)


def times_needed(sufficiency: Sufficiency, wanted_rsd_percent: float) -> TimesNeeded:
    """Return how long the recorded motion must last for a wanted RSD [%] of every significant parameter."""
    entries = [
        TimeNeeded(p.name, p.rsd_percent, sufficiency.seconds * (p.rsd_percent / wanted_rsd_percent) ** 2)
        for p in sufficiency.forecast.parameters
        if p.rsd_percent is not None and p.rsd_percent < SIGNIFICANT_RSD
    ]
    entries.sort(key=lambda entry: -entry.seconds)
    return TimesNeeded(wanted_rsd_percent, tuple(entries), _sentence(sufficiency, wanted_rsd_percent, entries))


def _sentence(sufficiency: Sufficiency, wanted: float, entries: list[TimeNeeded]) -> str:
    count = len(sufficiency.forecast.parameters)
    if all(parameter.rsd_percent is None for parameter in sufficiency.forecast.parameters):
        return (
            "Without torque or a prior, parameter values are unknown and no relative standard deviation can be "
            "predicted."
        )
    if not entries:
        return (
            f"None of {count} base parameters is significant (RSD below {SIGNIFICANT_RSD:g} %): "
            "a longer recording will not help much; use a motion with more excitation."
        )
    longest = entries[0]
    significant = f"all {len(entries)} significant of {count} base parameters"
    if longest.seconds <= sufficiency.seconds:
        return (
            f"These {sufficiency.seconds:.1f} s are enough for an RSD of {percentage_text(wanted)} % in {significant}; "
            f"the largest is {percentage_text(longest.rsd_percent, 2)} % ({longest.name})."
        )
    text = (
        f"For an RSD of {percentage_text(wanted)} % in {significant} this motion must be recorded for "
        f"{math.ceil(longest.seconds)} s instead of {sufficiency.seconds:.1f} s; {longest.name} takes longest."
    )
    if sufficiency.repetitions >= REPEATED:
        text += " This holds for noise; errors that repeat with the motion, such as ripple, need a different motion."
    return text
