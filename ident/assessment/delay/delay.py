"""Delay of the recorded torque against the recorded position, used only where it predicts held-out torque better.

It is estimated from the equations that no velocity reversal affects, since a joint that sticks at a reversal passes its
torque on late or early, which looks like a delay of many milliseconds. It is judged by all equations of all joints:
by blocks of the recording that were not used to estimate it (delete-block cross-validation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass as stored

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.assessment.delay.delay_equations import (
    FEWEST_BLOCKS,
    DelayData,
    DelayEquations,
    DelayFit,
    contiguous_blocks,
    delay_equations,
    fit_delays,
    held_out_errors,
    recorded_weights,
    torque_slopes,
)
from ident.model.regressor import RegressorKernel
from ident.regression.jackknife import deviation_without
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.prepared import Segment
from ident.stored import Number, Stored
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

WORTHWHILE_GAIN = 0.01
"""A delay is used only if it lowers the error on held-out blocks by at least this share."""

LEVEL = 0.05
"""Significance level of a delay; of the delays of single joints, all tested at once."""

LONGEST_DELAY = 0.2
"""No filter or bus delays by more than this [s]: the stamps have another error."""

READ_APART = 0.25
"""Share of the sampling period by which a torque may be ahead: within a cycle it is read before the position."""

LEAST_DRIFT = 1e-3
"""A drift over the recording by less than this [s] is not reported."""

DRIFT_INTERVALS = 3.0
"""A drift is reported where it is beyond so many times its interval; a torque that ripples reached 2.7."""

LEAST_LATE = 0.01
"""Delay [s] that is reported although it is taken out, where its interval lies above: drives' have 0.5 to 5 ms."""

EXPLAINED_BY_LEAD = 0.1
"""Share by which a lead of all torques lowers the error on held-out blocks from which on no number of one joint is
blamed: 0.26 and more where all positions are 20 ms late, at most 0.005 where one is 60 ms late (19 joints)."""

_STEPS = 25
_LONGEST_STEP = 0.01
_SETTLED_DELAY = 1e-5


@stored(frozen=True)
class JointDelay:
    """One joint's torque against its position [s]; positive where the torque lags."""

    joint: str  # its name
    used: float  # the delay to use
    best: Number  # estimate for this joint alone; None where its torque shows none
    interval: Number  # half of its 95 % interval; None where it is not known


class DelaySearch(Stored):
    """The delay of the torque behind the position, positive where the torque lags: given, or as the search left it."""

    used: float = Field(description="[s], for all joints without their own: `best` where it helps, else 0")
    note: str = Field(default="as given, not searched", description="the outcome in words")
    best: Number = Field(default=None, description="[s] that fits best for all joints; null where none was found")
    std: Number = Field(default=None, description="of `best` [s], by delete-block jackknife")
    interval: Number = Field(default=None, description="half of its 95 % interval [s]")
    gain: Number = Field(default=None, description="share by which `best` lowers the error on blocks held out")
    joints: list[JointDelay] = Field(default=[], description="each joint's own; empty where it was not searched")
    leads: bool = Field(
        default=False, description="the torque is ahead of its motion beyond the interval and a quarter period"
    )
    drift: Number = Field(default=None, description="growth of the delay with time [s/s]")
    drift_interval: Number = Field(default=None, description="half of its 95 % interval [s/s]")
    drifts: bool = Field(default=False, description="whether the drift is significant and matters")

    @property
    def explains_error(self) -> bool:
        """Whether a lead of all torques explains what no number of one joint does."""
        return self.leads and (self.gain or 0.0) >= EXPLAINED_BY_LEAD

    @property
    def joint_delays(self) -> tuple[float, ...] | None:
        """The delay to use for each joint [s] where they differ; None where `used` holds for all."""
        delays = tuple(joint.used for joint in self.joints)
        return delays if any(delay != self.used for delay in delays) else None


def search_delay(
    kernel: RegressorKernel,
    segments: Sequence[Segment],
    parallel_filter: ZeroPhaseFilter,
    torques_of: Sequence[int] | None = None,
) -> DelaySearch:
    """Estimate the delay by which the torque of all segments lags their motion, and whether it improves the model.

    Args:
        kernel: of the base columns.
        segments: prepared with delay 0; all their equations count, near velocity reversals too.
        parallel_filter: for τ and W.
        torques_of: indices of the joints whose torques are used; all where None.
    """
    dof = kernel.model.dof
    seen = np.isin(np.arange(dof), range(dof) if torques_of is None else list(torques_of))
    data = DelayData(kernel, segments, parallel_filter, seen, contiguous_blocks(segments, parallel_filter))
    if data.count < FEWEST_BLOCKS:
        return _none_found(kernel, f"too few samples to estimate a delay: fewer than {FEWEST_BLOCKS} blocks; none used")
    if not any(np.ptp(segment.torque[seen], axis=1).any() for segment in segments):
        return _none_found(kernel, "the torque does not change: no delay can be estimated")
    common = _settled(data, tuple(0 if joint else None for joint in seen), np.zeros(dof))
    if common is None:
        return _none_found(kernel, f"no delay within ±{LONGEST_DELAY * 1e3:g} ms fits; none used")
    return _judged(data, common)


def delay_checks(search: DelaySearch | None) -> list[Check]:
    """A torque that is ahead of its motion where that matters, a long delay, and one that drifts."""
    if search is None or search.best is None or search.interval is None or search.gain is None:
        return []
    checks = []
    late = {
        joint.joint: _milliseconds(joint.used, interval)
        for joint in search.joints
        if (interval := search.interval if joint.used == search.used else joint.interval) is not None
        and joint.used - interval > LEAST_LATE
    }
    if late:
        alike = len(late) == len(search.joints) and len(set(late.values())) == 1
        by = next(iter(late.values())) if alike else ", ".join(f"{value} at {joint}" for joint, value in late.items())
        text = (
            f"the torque lags the motion by {by}: identification takes this out; check filters, and how torque and "
            "position are stamped"
        )
        checks.append(raised("torque-late", text, () if alike else late))
    if search.leads and search.gain >= WORTHWHILE_GAIN:
        text = (
            f"the torque leads the motion by {_milliseconds(-search.best, search.interval)}, which is impossible: "
            "check the clocks of position and torque, a filter of the positions in the controller, and friction (not "
            f"compensated, although the error on held-out blocks would fall by {percent_text(search.gain, 2)})"
        )
        checks.append(raised("torque-ahead", text))
    if search.drifts and search.drift is not None and search.drift_interval is not None:
        text = (
            f"the delay of the torque changes by {search.drift * 1e3:.3g} ± {search.drift_interval * 1e3:.2g} ms per "
            f"second: the clocks of torque and position differ by the factor {1.0 + search.drift:.6g}; check how the "
            "recording's signals were merged"
        )
        checks.append(raised("clocks-drift", text))
    return checks


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Delays that joints share."""

    equations: DelayEquations  # at these delays
    fit: DelayFit  # on all blocks
    without: FloatArray  # (B, n) delays [s], found without each block

    @property
    def std(self) -> FloatArray:
        """Jackknife standard deviations (n,) of the delays [s]."""
        return deviation_without(self.without)


def _settled(data: DelayData, groups: Sequence[int | None], start: FloatArray) -> _Candidate | None:
    """Newton from `start` (n,) [s]; None where it leaves ±LONGEST_DELAY or does not settle."""
    delays = start
    for _ in range(_STEPS):
        equations = delay_equations(data, delays)
        fit = fit_delays(equations, groups)
        steps = fit.delays - delays
        if np.max(np.abs(steps)) < _SETTLED_DELAY:
            return _candidate(equations, groups)
        delays = delays + np.clip(steps, -_LONGEST_STEP, _LONGEST_STEP)
        if np.max(np.abs(delays)) > LONGEST_DELAY:
            return None
    return None


def _candidate(equations: DelayEquations, groups: Sequence[int | None]) -> _Candidate:
    """The delays of `groups`, from equations near them."""
    fit = fit_delays(equations, groups)
    without = [
        fit_delays(equations, groups, without=block, weights=fit.weights).delays for block in range(equations.blocks)
    ]
    return _Candidate(equations, fit, np.array(without))


def _judged(data: DelayData, common: _Candidate) -> DelaySearch:
    """Judge whether the common delay helps, and beside it delays of single joints."""
    count, dof = data.count, data.kernel.model.dof
    quantile = _t_quantile(1.0 - LEVEL / 2.0, count)
    first = int(np.flatnonzero(data.seen)[0])
    best, std = float(common.fit.delays[first]), float(common.std[first])
    interval = quantile * std
    lead = max(interval, READ_APART / data.segments[0].rate)
    weights = recorded_weights(common.equations, data.seen)
    errors = held_out_errors(common.equations, None, weights)
    delayed = held_out_errors(common.equations, common.without, weights)
    gain = _gain(errors, delayed)
    used, helps = 0.0, best > interval and gain >= WORTHWHILE_GAIN
    if helps:
        used, errors = best, delayed
    alone = _candidate(common.equations, [joint if seen else None for joint, seen in enumerate(data.seen)])
    delays = np.full(dof, used)
    sharing = _sharing(data, alone, helps)
    own = _own_delays(data, alone, sharing, used)
    if own is not None and _gain(errors, held_out_errors(own.equations, own.without, weights)) >= WORTHWHILE_GAIN:
        delays = np.where(data.seen, own.fit.delays, used)
        used = float(delays[sharing][0]) if used else 0.0
    drift, drift_interval = _drift(common, quantile)
    seconds = float(data.segments[-1].time[-1] - data.segments[0].time[0])
    values = np.where(torque_slopes(common.equations) > 0.0, alone.fit.delays, np.nan)
    joints = [
        JointDelay(name, float(delay), float(value), float(quantile * deviation))
        for name, value, deviation, delay in zip(data.kernel.model.joint_names, values, alone.std, delays, strict=True)
    ]
    return DelaySearch(
        best=best,
        std=std,
        interval=interval,
        gain=gain,
        used=used,
        joints=joints,
        leads=best < -lead,
        drift=drift,
        drift_interval=drift_interval,
        drifts=abs(drift) > DRIFT_INTERVALS * drift_interval and abs(drift) * seconds > LEAST_DRIFT,
        note=_in_words(best, interval, lead, gain, helps, used, joints),
    )


def _sharing(data: DelayData, alone: _Candidate, helps: bool) -> npt.NDArray[np.bool_]:
    """(n,) joints whose delay does not differ significantly from most others', or from 0 where the common is not used.

    The others' is the median weighted by the inverse variances: a joint with another delay moves the common one.
    """
    reference = 0.0
    if helps:
        order = np.flatnonzero(data.seen & (alone.std > 0.0))
        order = order[np.argsort(alone.fit.delays[order])]
        share = np.cumsum(alone.std[order] ** -2.0)
        reference = float(alone.fit.delays[order[np.searchsorted(share, 0.5 * share[-1])]]) if len(order) else 0.0
    return data.seen & (np.abs(alone.fit.delays - reference) <= _all_joints_quantile(data) * alone.std)


def _own_delays(data: DelayData, alone: _Candidate, sharing: npt.NDArray[np.bool_], shared: float) -> _Candidate | None:
    """Joints that share no delay get their own, 0 where they lead; None where there are none."""
    own = data.seen & ~sharing
    lagging = own & (alone.fit.delays > 0.0)
    if not lagging.any() and not (own.any() and shared):
        return None
    start = np.where(lagging, np.clip(alone.fit.delays, 0.0, LONGEST_DELAY), np.where(sharing, shared, 0.0))
    groups: list[int | None] = [
        joint + 1 if lagging[joint] else 0 if sharing[joint] and shared else None for joint in range(len(own))
    ]
    candidate = _settled(data, groups, start)
    beyond = _all_joints_quantile(data)
    if candidate is None or not np.all(candidate.fit.delays[lagging] > beyond * candidate.std[lagging]):
        return None
    return candidate


def _all_joints_quantile(data: DelayData) -> float:
    return _t_quantile(1.0 - LEVEL / 2.0 / int(data.seen.sum()), data.count)


def _drift(common: _Candidate, quantile: float) -> tuple[float, float]:
    """Growth of the common delay with time [s/s], and half of its 95 % interval."""
    equations, weights = common.equations, common.fit.weights
    groups = [0 if weight > 0.0 else None for weight in weights]
    drift = fit_delays(equations, groups, weights=weights, drift=True).drift
    without = [
        fit_delays(equations, groups, without=block, weights=weights, drift=True).drift
        for block in range(equations.blocks)
    ]
    return drift, quantile * float(deviation_without(np.array(without)))


def _gain(errors: FloatArray, other: FloatArray) -> float:
    """Share by which `other` is below `errors`, sums of squares (B,) of all blocks, as norms."""
    total = float(errors.sum())
    return 1.0 - float(np.sqrt(other.sum() / total)) if total > 0.0 else 0.0


def _t_quantile(probability: float, blocks: int) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(blocks - 1, probability))


def _milliseconds(value: float, interval: float) -> str:
    return f"{value * 1e3:.2f} ± {interval * 1e3:.2f} ms"


def _in_words(
    best: float, interval: float, lead: float, gain: float, helps: bool, used: float, joints: Sequence[JointDelay]
) -> str:
    text = f"torque {'lags' if best > 0 else 'leads'} the motion by {_milliseconds(abs(best), interval)}"
    effect = f"error on held-out blocks {percent_text(abs(gain), 2)} {'smaller' if gain > 0 else 'larger'} with it"
    if helps:
        text += f" ({effect})"
    elif best < -lead:
        text += f": suspicious (clock, filter in the controller, friction; {effect}), none used"
    elif best <= interval:
        text += f": {'not significant' if best >= -interval else 'less than a quarter period'}, none used"
    else:
        text += f": it does not help ({effect}), none used"
    own = [f"{joint.joint} {joint.used * 1e3:.2f} ms" for joint in joints if joint.used != used]
    if own:
        text += f"; of their own: {', '.join(own)}"
    return text


def _none_found(kernel: RegressorKernel, note: str) -> DelaySearch:
    joints = [JointDelay(name, 0.0, None, None) for name in kernel.model.joint_names]
    return DelaySearch(used=0.0, note=note, gain=0.0, joints=joints)
