"""Is a recording long enough? What its motion lets expect of the parameters, and how much longer it would take."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from daq.recording import Recording
from daq.robot import RobotFile
from drivers.errors import DynidError, UsageError
from ident.base_parameters import BaseParameters, base_parameters
from ident.comparison import compare_torques
from ident.covariance import FilteredRun, block_jackknife
from ident.excitation import excited_base_columns
from ident.excite.figures import Forecast, forecast
from ident.excite.prior import Prior, assumed_noise, find_prior
from ident.least_squares import weighted_least_squares
from ident.measured import joint_positions, measured_motion
from ident.model import DynamicModel, build_model
from ident.observation import Reduction, reduce_segments
from ident.preprocess import Prepared, PreprocessChoices, prepare
from ident.pruning import SIGNIFICANT_RSD
from ident.regressor import RegressorKernel

OWN_TORQUE = "a quick identification of this recording"
"""Source of parameters and noise where the recording holds torque."""

REPEATED = 1.2
"""From so many repetitions on the same errors come back, which more of the same motion does not average out."""


@dataclass(frozen=True)
class Sufficiency:
    """What a recorded motion lets expect.

    Attributes:
        seconds: of the motion that counts [s].
        source: where parameters and noise come from, in words.
        repetitions: how often the motion was repeated, on average; 1 where it was not, or where there is no torque.
        forecast: condition, log det, predicted error bars.
    """

    seconds: float
    source: str
    repetitions: float
    forecast: Forecast


@dataclass(frozen=True)
class TimeNeeded:
    """How long a motion must last for one parameter.

    Attributes:
        name: of the base parameter.
        rsd_percent: predicted for this recording [%].
        seconds: of the same motion until it is as wanted [s]; the standard deviation falls with the root of the time.
    """

    name: str
    rsd_percent: float
    seconds: float


@dataclass(frozen=True)
class TimesNeeded:
    """How long a motion must last for a wanted relative standard deviation.

    Attributes:
        wanted_rsd_percent: [%].
        parameters: the significant ones (RSD below 15 % by now), those that take longest first.
        sentence: what follows from it.
    """

    wanted_rsd_percent: float
    parameters: tuple[TimeNeeded, ...]
    sentence: str


def recording_sufficiency(recording: Recording, robot_file: RobotFile, delay: float = 0.0) -> Sufficiency | None:
    """What a recording's motion lets expect; None where nothing could be analysed.

    Parameters and noise come from a quick identification of all of it, or from the robot file where it holds no torque.

    Args:
        recording: as read.
        robot_file: of its arm.
        delay: of the torque [s].
    """
    try:
        model = build_model(robot_file)
        base = base_parameters(model)
    except DynidError:
        return None
    try:
        motion = measured_motion(recording, robot_file.robot)
        prepared = prepare(motion.time, motion.position, motion.torque, PreprocessChoices(delay=delay))
        return _from_torque(model, base, prepared)
    except DynidError:  # no torque or no gain, or too short to identify anything from
        pass
    try:
        positions = joint_positions(recording, robot_file.robot)
        still = np.zeros_like(positions.position)
        prepared = prepare(positions.time, positions.position, still, PreprocessChoices())
        prior = find_prior(robot_file)
    except DynidError:  # no motion: `dynid info` says so
        return None
    return _summary(model, base, prepared, _reduce(model, base, prepared), prior)


def _reduce(model: DynamicModel, base: BaseParameters, prepared: Prepared) -> Reduction:
    return reduce_segments(RegressorKernel(model, base.columns), prepared.segments, prepared.parallel_filter)


def _summary(
    model: DynamicModel,
    base: BaseParameters,
    prepared: Prepared,
    reduction: Reduction,
    prior: Prior,
    repetitions: float = 1.0,
) -> Sufficiency:
    rate = prepared.segments[0].rate
    active = excited_base_columns(reduction, base, [prepared])
    return Sufficiency(
        seconds=sum(int(segment.used.sum()) for segment in prepared.segments) / rate,
        source=prior.source,
        repetitions=repetitions,
        forecast=forecast(base, model, (reduction, rate / prepared.parallel_filter.factor), prior, active),
    )


def _from_torque(model: DynamicModel, base: BaseParameters, prepared: Prepared) -> Sufficiency:
    """With the values of weighted least squares and its residuals as noise.

    They are no white noise and count for more, by the ratio of jackknife to classical standard deviations (median).
    """
    kernel = RegressorKernel(model, base.columns)
    segments, parallel_filter = prepared.segments, prepared.parallel_filter
    reduction = reduce_segments(kernel, segments, parallel_filter)
    solution = weighted_least_squares(reduction, excited_base_columns(reduction, base, [prepared]))
    series = compare_torques(model, base.columns, solution.parameters, segments, parallel_filter)
    corrected = block_jackknife(kernel, [FilteredRun(segments, parallel_filter, series)], solution)
    ratio = float(np.median(np.sqrt(np.diag(corrected.covariance) / np.diag(solution.covariance))))
    floor = [1e-6 * assumed_noise(limits.torque) for limits in model.limits]  # noise-free simulations
    prior = Prior(
        parameters=solution.parameters,
        noise=np.maximum(solution.joint_std * ratio, floor),
        source=OWN_TORQUE,
        rate=segments[0].rate / parallel_filter.factor,
    )
    return _summary(model, base, prepared, reduction, prior, corrected.repetitions)


def check_wanted_rsd(percent: float) -> None:
    """Refuse a wanted relative standard deviation that is none.

    Raises:
        UsageError: it is not above 0 and at most 100 %.
    """
    if not 0.0 < percent <= 100.0:
        raise UsageError(f"--wanted-rsd {percent:g} is not a percentage above 0", hint="5 is usual")


def times_needed(sufficiency: Sufficiency, wanted_rsd_percent: float) -> TimesNeeded:
    """How long the recorded motion must last for a wanted RSD [%] of every significant parameter."""
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
            "Without torque and without a prior no parameter's value is known, so no relative standard deviation can "
            "be predicted."
        )
    if not entries:
        return (
            f"None of {count} base parameters is significant (RSD below {SIGNIFICANT_RSD:g} %): "
            "a more exciting motion would tell more, a longer recording of this one hardly."
        )
    longest = entries[0]
    significant = f"all {len(entries)} significant of {count} base parameters"
    if longest.seconds <= sufficiency.seconds:
        return (
            f"These {sufficiency.seconds:.1f} s are enough for an RSD of {wanted:g} % in {significant}; "
            f"the largest is {longest.rsd_percent:.2g} % ({longest.name})."
        )
    text = (
        f"For an RSD of {wanted:g} % in {significant} this motion must be recorded for {math.ceil(longest.seconds)} s "
        f"in place of {sufficiency.seconds:.1f} s; {longest.name} takes longest."
    )
    if sufficiency.repetitions >= REPEATED:
        text += (
            " That holds for noise: what comes back with every repetition, as ripple does, only another motion evens."
        )
    return text
