"""Drive gains, lengths, joint zeros and a direction of gravity that the data contradict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.assessment.file_errors.refit import TELLING, Refit
from ident.assessment.file_errors.unknowns import Deviation, Kind, Unknown, shifted_origins
from ident.assessment.instants import MOTION, later_motion
from ident.model.dynamic_model import DynamicModel
from ident.regression.comparison import TorqueSeries, compare_torques, independent_share, residual_autocorrelation
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.signals.prepared import Prepared, Segment
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LIKELIHOOD_LEVEL = 16.0
"""What the doubled log-likelihood ratio must exceed: four σ, since some two dozen numbers are tried. On the public
recordings and their halves no length reaches more than 6.5."""

GAIN_OFF = 0.17
"""Relative deviation of a gain from which on `LIKELIHOOD_LEVEL` suffices. What friction models leave out moves the
estimate by up to 0.14 on halves of the public recordings (Panda)."""

SMALL_GAIN_LEVEL = 40.0
"""What the ratio must exceed for a smaller deviation: what friction models leave out looks like a gain. On the public
recordings it reaches 20 (Panda, joint 6: 13 %)."""

LEAST_GAIN_OFF = 0.05
LEAST_SHIFT = 5e-3
LEAST_SCALE = 0.05
LEAST_ZERO = float(np.deg2rad(3.0))
LEAST_TILT = float(np.deg2rad(2.0))
LEAST_LATE = 0.015
"""Smallest deviation of a gain, of a length [m], of all lengths' factor, of a joint's zero and of gravity's direction
[rad], and time [s] of a position that is reported. On the public recordings, which are in order, a zero reaches 1.5°
(Panda, joint 4) and the direction 0.3°."""

_LEAST: dict[Kind, float] = {
    "length": LEAST_SHIFT, "scale": LEAST_SCALE, "zero": LEAST_ZERO, "gravity": LEAST_TILT, "late": LEAST_LATE,
}  # fmt: skip

LATE_LEVEL, MOST_LATE = 25.0, 0.2
"""What the ratio must exceed for a late position, and the longest time [s]; on the public recordings it reaches 9.4
(UR10, shoulder)."""

MOST_OF_LENGTH = 0.5
"""Share of a length by which it may be wrong."""

MOST_OF_ZERO = float(np.deg2rad(60.0))
"""Angle by which a joint's zero may be wrong."""

QUARTERS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
NEAR_QUARTER = float(np.deg2rad(15.0))
"""Angles [rad] by which zeros of two conventions differ, and how near to one an estimate must come."""

MOST_UNCERTAIN = 3.0
"""A deviation of less than this many σ is not named, whatever its likelihood."""

INDEPENDENT_PER_PARAMETER = 2
"""Independent equations per parameter that a fit needs. With so many it leaves half of the noise's variance in its
residual, with fewer less: the error bars come out too small, and what a wrong number leaves is hidden. The public
recordings have 3.3 to 3.6."""

WORTH_A_LOOK = 2.0
"""Doubled log-likelihood ratio of an unknown, linearised at the file's value, from which on it is looked at."""

RIVAL_LIKELIHOOD = 9.0
"""Difference of the doubled log-likelihood ratios (three σ) below which two deviations explain the data alike."""

LEAST_FALL = 0.3
"""Mean over the equations of the fall of log ε² from which on several lengths, or gains, are blamed: the error falls by
14 %."""

CLEAR_FALL = 1.0
"""The same from which on a deviation is judged as if the equations were enough: the error falls by 40 %, and what a
poor fit leaves hides how many of them are independent."""

REFINED_UNKNOWNS = 4
"""Unknowns that are linearised anew where their estimate is, those that explain most."""

MOST_SAMPLES = 100_000
"""Samples of a recording whose residuals are compared."""

LATE = (0.03, 0.06, 0.12)
"""Times [s] from which it is estimated by how much a position is late, beside 0."""

LATE_ERROR = 0.02
"""Relative error of a joint's torque below which, in a good fit, its position is not tried from these."""

STARTS = (0.01, 0.1, 10.0, 100.0)
"""Factors on a gain from which it is estimated, beside 1, where the fit is poor: a gain that was left at 1."""

OPPOSITE = float(np.deg2rad(165.0))
"""Angle [rad] between gravity and the file's from which on it is called opposite."""

DIRECTIONS = tuple(np.array(sign * axis) for axis in np.eye(3) for sign in (1.0, -1.0))
"""Directions of gravity in the base's frame from which it is estimated, beside the file's, where the fit is poor."""


def reported(deviation: Deviation) -> bool:
    """Return whether a deviation is clear and large enough to be named."""
    level = LATE_LEVEL if deviation.unknown.kind == "late" else LIKELIHOOD_LEVEL
    if deviation.likelihood < level:
        return False
    if deviation.parts:  # each has its own σ
        return bool(_off(deviation))
    if abs(deviation.value) < MOST_UNCERTAIN * deviation.std:
        return False
    if deviation.unknown.kind != "gain":
        return abs(deviation.value) >= _LEAST[deviation.unknown.kind]
    off = abs(float(np.log(1.0 + deviation.value)))
    return off >= np.log(1.0 + GAIN_OFF) or (off >= LEAST_GAIN_OFF and deviation.likelihood > SMALL_GAIN_LEVEL)


def _off(deviation: Deviation) -> list[tuple[Unknown, float, float]]:
    """Lengths or gains of several that are clearly off, with value and standard deviation.

    What gains are off from is the one that most others agree with; where fewer than half do, all are off.
    """
    if deviation.unknown.kind == "gains":
        return _disagreeing(deviation)
    return [
        (unknown, shift, std)
        for unknown, shift, std in deviation.parts
        if abs(shift) > max(MOST_UNCERTAIN * std, LEAST_SHIFT)
    ]


def _disagreeing(deviation: Deviation) -> list[tuple[Unknown, float, float]]:
    gains = [(Unknown("gain", deviation.unknown.joint), 0.0, 0.0), *deviation.parts]

    def off(reference: tuple[Unknown, float, float]) -> list[tuple[Unknown, float, float]]:
        found = []
        for unknown, value, std in gains:
            ratio = (1.0 + value) / (1.0 + reference[1])
            share = ratio * float(np.hypot(std / (1.0 + value), reference[2] / (1.0 + reference[1])))
            if abs(np.log(ratio)) > max(np.log(1.0 + GAIN_OFF), MOST_UNCERTAIN * share / ratio):
                found.append((unknown, ratio - 1.0, share))
        return found

    known = [gain for gain in gains if MOST_UNCERTAIN * gain[2] < GAIN_OFF * (1.0 + gain[1])]
    fewest = min((off(reference) for reference in known), key=len)
    if 2 * len(fewest) < len(gains):
        return fewest
    return gains if off(gains[0]) else []


def candidates(refit: Refit, independent: float, poor: bool) -> list[Deviation]:
    """Deviations that may explain the data.

    Args:
        refit: equations of the recording.
        independent: number of independent equations.
        poor: whether the fit is poor, so that a gain may be far from what the robot file says.
    """
    deviations = sorted(refit.deviations, key=lambda one: -one.likelihood)
    total = float(refit.rows.sum())
    if not deviations:
        return []
    least = WORTH_A_LOOK * total / max(independent, 1.0)
    late = _late_positions(refit, poor, least)
    if not poor and not late and deviations[0].likelihood < least:
        return []
    tried = list(
        dict.fromkeys([*(deviation.unknown for deviation in deviations[:REFINED_UNKNOWNS]), Unknown("gravity")])
    )
    finer = [refit.deviation(unknown) for unknown in tried] + _other_directions(refit) + late
    together = refit.lengths()
    if together is not None and together.likelihood > LEAST_FALL * total:
        finer.append(together)
    gains = refit.gains()
    if gains is not None and gains.likelihood > LEAST_FALL * total and len(_off(gains)) > 1:  # one is a gain by itself
        finer.append(gains)
    if poor:
        finer += _far_gains(refit)
    return [one for one in finer if one is not None and _plausible(refit.model, one)]


def quarter_turns(refit: Refit) -> list[Deviation]:
    """Zeros off by about a quarter or half a turn, as two conventions of one arm are; the two that fit best."""
    zeros = [unknown for unknown in refit.unknowns() if unknown.kind == "zero"]
    once = [(refit.deviation(unknown, 1, start), start) for unknown in zeros for start in QUARTERS]
    nearest = sorted(((one, start) for one, start in once if one is not None), key=lambda pair: -pair[0].likelihood)[:2]
    found = [(refit.deviation(one.unknown, start=start), start) for one, start in nearest]
    return [one for one, start in found if one is not None and abs(one.value - start) < NEAR_QUARTER]


def most_likely(
    refit: Refit, runs: Sequence[Prepared], independent: float, found: Sequence[Deviation]
) -> list[Deviation]:
    """The deviations that explain most, best first, judged by the residuals that the best one leaves.

    A wrong number makes others look wrong, too, and the residuals alike over long times, so that few of them seem
    independent. Were the best one right, those that remain are: their autocorrelation counts.

    Args:
        refit: equations of the recording.
        runs: prepared data, with the equations that were fitted.
        independent: number of independent equations.
        found: the deviations.
    """
    total = float(refit.rows.sum())
    # An angle that no torque shows, as out of a pendulum's plane, fits by its length alone what a number does.
    known = [one for one in found if abs(one.value) >= MOST_UNCERTAIN * one.std]
    deviations = sorted(known or found, key=lambda one: _price(one) * total / max(1.0, independent) - one.likelihood)
    if not deviations:
        return []
    believed = _compared(runs, refit.as_believed(deviations[0].unknown))
    while True:  # what explains the residuals to first order alone leaves larger ones
        left = _compared(runs, deviations[0])
        if len(deviations) == 1 or np.mean((_squares(left) / _squares(believed))[list(refit.used)]) <= 1.0:
            break
        deviations.pop(0)
    shares = [independent_share(residual_autocorrelation(one)[list(refit.used)]) for one in (believed, left)]
    width = len(deviations[0].parameters)
    after = min(total, independent * shares[1] / shares[0])
    needed = INDEPENDENT_PER_PARAMETER * width
    if deviations[0].likelihood > CLEAR_FALL * total:
        after = max(after, min(total, needed))
    if after < needed:  # too few to judge by
        return []
    worth = (after - width) / total
    judged = [_judged(deviation, worth) for deviation in deviations]
    lasting = [one for one in judged if not reported(one) or refit.throughout(one)]
    return simplest_first(sorted(lasting, key=lambda one: -one.likelihood)) if lasting else []


def _squares(series: Sequence[TorqueSeries]) -> FloatArray:
    """Sums (n,) of the joints' squared residuals, none of them 0 [(N·m)²]."""
    sums = sum((np.nansum(np.square(one.residual), axis=1) for one in series), start=np.array(0.0))
    return np.asarray(np.maximum(sums, np.finfo(np.float64).tiny))


def _price(deviation: Deviation) -> float:
    """Return what several lengths or gains must explain more than a single number."""
    return RIVAL_LIKELIHOOD * max(0, len(deviation.parts) - 1)


def _judged(deviation: Deviation, worth: float) -> Deviation:
    """A deviation whose equations count as so many independent ones each."""
    wider = 1.0 / float(np.sqrt(worth))
    parts = tuple((unknown, shift, std * wider) for unknown, shift, std in deviation.parts)
    likelihood = deviation.likelihood * worth - _price(deviation)
    return replace(deviation, likelihood=likelihood, std=deviation.std * wider, parts=parts)


def _plausible(model: DynamicModel, one: Deviation) -> bool:
    """Return whether a length is off by no more than half, a zero by no more than 60°: not a mirrored arm."""
    if one.unknown.kind == "zero":
        return abs(one.value) <= MOST_OF_ZERO
    if one.unknown.kind == "late":  # a torque that is late is found, and taken into account, where delays are sought
        return 0.0 <= one.value <= MOST_LATE
    if one.unknown.kind == "scale":
        return abs(one.value) <= MOST_OF_LENGTH
    if one.unknown.kind == "lengths":
        lengths = [float(model.joints[part.joint].translation[part.axis or 0]) for part, _, _ in one.parts]
        return all(
            abs(shift) <= MOST_OF_LENGTH * abs(length) for (_, shift, _), length in zip(one.parts, lengths, strict=True)
        )
    if one.unknown.kind != "length" or one.unknown.axis is None:
        return True
    return abs(one.value) <= MOST_OF_LENGTH * abs(float(model.joints[one.unknown.joint].translation[one.unknown.axis]))


def _far_gains(refit: Refit) -> list[Deviation | None]:
    """Gains that are estimated from other factors than 1."""
    gains = [unknown for unknown in refit.unknowns() if unknown.kind == "gain"]
    return [refit.deviation(unknown, start=start) for unknown in gains for start in STARTS]


def _late_positions(refit: Refit, poor: bool, least: float) -> list[Deviation | None]:
    """Late positions, estimated from the two of `LATE` that fit best: from none at all the way there is too long.

    Args:
        refit: equations of the recording.
        poor: whether the fit is poor, so that any joint may be late, else the one whose torque fits worst.
        least: doubled log-likelihood ratio, the equations being independent, below which none is looked at.
    """
    errors = refit.relative_errors
    late = [unknown for unknown in refit.unknowns() if unknown.kind == "late"]
    tried = [one for one in late if poor or errors[one.joint] == errors.max() > LATE_ERROR]
    once = [(refit.deviation(unknown, 1, start), start) for unknown in tried for start in LATE]
    known = [(one, start) for one, start in once if one is not None and one.likelihood > least]
    nearest = sorted(known, key=lambda pair: -pair[0].likelihood)[:2]
    return [refit.deviation(one.unknown, start=start) for one, start in nearest]


def _other_directions(refit: Refit) -> list[Deviation | None]:
    """Gravity estimated from the two directions of the base's axes that fit best."""
    if not np.any(refit.model.gravity) or len(refit.used) < 2:
        return []
    once = [(refit.deviation(Unknown("gravity"), 1, direction), direction) for direction in DIRECTIONS]
    known = [(one.likelihood, direction) for one, direction in once if one is not None]
    nearest = sorted(known, key=lambda one: -one[0])[:2]
    found = [refit.deviation(Unknown("gravity"), start=direction) for _, direction in nearest]
    return [*found, refit.opposite_gravity()]


def simplest_first(deviations: Sequence[Deviation]) -> list[Deviation]:
    """The deviations, best first, but of those that explain as much as the best: a sign, then the smaller turn.

    Arms whose lengths show little fit mirrored gravity as well: of two such directions, neither is significantly
    better.
    """
    best = deviations[0]
    alike = [
        deviation
        for deviation in deviations
        if deviation.unknown.kind == "gravity" and deviation.likelihood > best.likelihood - RIVAL_LIKELIHOOD
    ]
    opposite = [rival for rival in alike if rival.std == 0.0]
    first = opposite or sorted((rival for rival in alike if best in alike), key=lambda one: one.value)
    return [*first[:1], *(deviation for deviation in deviations if deviation not in first[:1])]


def model_error_checks(model: DynamicModel, deviations: Sequence[Deviation]) -> list[Check]:
    """The check of the deviation that explains most, if it is clear and large enough, with those that do so as well.

    Args:
        model: as believed.
        deviations: as of `most_likely`.
    """
    if not deviations or not reported(deviations[0]):
        return []
    best = deviations[0]
    rivals = [deviation for deviation in deviations[1:] if deviation.unknown != best.unknown and reported(deviation)]
    equal = [rival for rival in rivals if rival.likelihood > best.likelihood - RIVAL_LIKELIHOOD]
    if best.unknown.kind in _OF_LENGTHS:  # all lengths explain what one of them, or a common factor, does
        equal = [rival for rival in equal if rival.unknown.kind != "lengths"]
    alone = {one.unknown: one for one in (*reversed(equal), best)}
    kinds = list(dict.fromkeys(one.unknown.kind for one in alone.values()))
    blamed = [unknown for one in alone.values() for unknown in ([part for part, _, _ in _off(one)] or [one.unknown])]
    joints = {joint for unknown in blamed for joint in _joints(model, unknown)}
    clauses = ", or equally well with ".join(_clause(model, one) for one in reversed(alone.values()))
    opposite = best.unknown.kind == "gravity" and best.value > OPPOSITE
    name = "gravity-opposite" if opposite else _CHECKS[best.unknown.kind]
    far, least = _FAR.get(best.unknown.kind, ("", np.inf))
    if kinds == [best.unknown.kind] and abs(np.log(1.0 + best.value)) > np.log(least):
        name = far
    remedies = "; ".join(_REMEDIES[kind] for kind in reversed(kinds))
    text = f"the torques fit better with {clauses}: {remedies}"
    return [raised(name, text, [name for name in model.joint_names if name in joints])]


def unchecked_lengths(refit: Refit, independent: float) -> list[Check]:
    """The note that no length could be checked, which predictions hide: the parameters fit any lengths then."""
    model = refit.model
    lengths = {origin: abs(float(model.joints[origin[0]].translation[origin[1]])) for origin in shifted_origins(model)}
    lengths = {origin: length for origin, length in lengths.items() if model.joints[origin[0]].parent >= 0}
    worth = (independent - len(refit.active)) / max(1.0, float(refit.rows.sum()))
    for one in refit.deviations if worth > 0.0 else ():
        length = lengths.get((one.unknown.joint, one.unknown.axis or 0), 0.0) if one.unknown.kind == "length" else 0.0
        if MOST_UNCERTAIN * one.std / float(np.sqrt(worth)) < TELLING * length:
            return []
    if not lengths:
        return []
    text = (
        f"the lengths are the robot file's: these data do not show {percent_text(TELLING, 1)} of one, since the other "
        "parameters can compensate; check that the file belongs to this arm, or record a faster motion of all joints"
    )
    return [raised("lengths-unchecked", text)]


_CHECKS: dict[Kind, str] = {
    "gain": "inconsistent-gain",
    "gains": "wrong-gain",
    "length": "inconsistent-length",
    "scale": "inconsistent-length",
    "lengths": "inconsistent-length",
    "zero": "joint-zero",
    "late": "position-late",
    "gravity": "gravity-direction",
}
_FAR: dict[Kind, tuple[str, float]] = {"gain": ("wrong-gain", 2.0), "scale": ("other-size", 1.1)}
"""Checks of a gain and of all lengths off by more than a factor, where nothing else explains the data as well."""

_OF_LENGTHS = ("length", "scale")
_REMEDIES: dict[Kind, str] = {
    "gain": "check the gain (one left at 1 gives amperes), or identify the gains with a known load (dynid gains)",
    "gains": "check the torques' unit (N·m, not percent of each joint's rated torque) and all drive gains",
    "length": "check this length",
    "scale": "check that the file is for this arm, not for another size, and the stamps' unit and rate",
    "lengths": "check these lengths, and that the file belongs to this arm",
    "zero": "compare the encoder's zero with the robot file's",
    "late": "check how this joint's position was read and stamped",
    "gravity": "check `model.gravity` and the mounting",
}


def _joints(model: DynamicModel, unknown: Unknown) -> list[str]:
    """Names of the joints that an unknown is about."""
    if unknown.joint < 0:
        return []
    return [model.joints[unknown.joint].name if unknown.kind == "length" else model.joint_names[unknown.joint]]


def _clause(model: DynamicModel, one: Deviation) -> str:
    """Return what the torques agree better with."""
    between = WITHIN_95_PERCENT * one.std
    if one.unknown.kind == "gain":
        return f"the drive gain of {_factor(model, one.unknown, one.value, one.std, ' multiplied by')}"
    if one.unknown.kind == "gains":
        factors = ", ".join(_factor(model, *gain) for gain in sorted(_off(one), key=lambda gain: gain[0].joint))
        return f"drive gains multiplied by factors relative to each other: {factors}"
    if one.unknown.kind == "zero":
        size = f"{np.rad2deg(one.value):+.1f}° ± {np.rad2deg(between):.1f}°"
        return f"{size} added to the position of {model.joint_names[one.unknown.joint]}"
    if one.unknown.kind == "late":
        size = f"{1e3 * one.value:.0f} ± {1e3 * between:.0f} ms"
        return f"the position of {model.joint_names[one.unknown.joint]} {size} behind its torque and all other signals"
    if one.unknown.kind == "scale":
        stamps = float(np.exp(-0.5 * np.log1p(one.value)))
        size = f"{1.0 + one.value:.3f} ± {between:.3f}"
        return f"all lengths of the robot file multiplied by {size}, or all time stamps by {stamps:.3f}"
    if one.unknown.kind == "length":
        return _origin(model, one.unknown, one.value, between)
    if one.unknown.kind == "lengths":
        return ", ".join(_origin(model, part, shift, WITHIN_95_PERCENT * std) for part, shift, std in _off(one))
    direction = ", ".join(f"{value + 0.0:.2f}" for value in one.model.gravity)
    angle = f"{np.rad2deg(one.value):.1f}° ± {np.rad2deg(between):.1f}° from the robot file's"
    what = "opposite to the robot file's" if one.value > OPPOSITE else angle
    return f"gravity along [{direction}] m/s² in the base's frame ({what})"


def _factor(model: DynamicModel, unknown: Unknown, value: float, std: float, by: str = "") -> str:
    """A gain's factor: it multiplies the recorded torque, the unknown the model's."""
    factor = 1.0 / (1.0 + value)
    size = f"{factor:.3g} ± {WITHIN_95_PERCENT * std * factor**2:.2g}" if std else "1"
    return f"{model.joint_names[unknown.joint]}{by} {size}"


def _origin(model: DynamicModel, unknown: Unknown, shift: float, between: float) -> str:
    """Return where a joint's origin fits better [m]."""
    joint, axis = model.joints[unknown.joint], unknown.axis or 0
    parent = "the base" if joint.parent < 0 else model.joints[joint.parent].name
    believed = float(joint.translation[axis])
    return (
        f"the origin of {joint.name} at {'xyz'[axis]} = {believed + shift:.3f} ± {between:.3f} m in the frame of "
        f"{parent} (robot file: {believed:.3f} m)"
    )


def _compared(runs: Sequence[Prepared], deviation: Deviation) -> list[TorqueSeries]:
    """Measured torques of all runs, and those predicted with a deviation."""
    unknown = deviation.unknown
    series = []
    for run in runs:
        segments = first_samples(run.segments)
        if unknown.kind == "zero":
            segments = [
                replace(segment, position=_moved(segment.position, unknown.joint, deviation.value))
                for segment in segments
            ]
        if unknown.kind == "late":
            segments = [_later(segment, unknown.joint, deviation.value) for segment in segments]
        for compared in compare_torques(
            deviation.model, deviation.columns, deviation.parameters, segments, run.parallel_filter
        ):
            scale = np.ones((len(compared.predicted), 1))
            for joint, value in deviation.gains.items():
                scale[joint] += value
            series.append(replace(compared, predicted=scale * compared.predicted))
    return series


def _moved(position: FloatArray, joint: int, angle: float) -> FloatArray:
    moved = position.copy()
    moved[joint] += angle
    return moved


def _later(segment: Segment, joint: int, seconds: float) -> Segment:
    changed = {name: getattr(segment, name).copy() for name in MOTION}
    for name, values in later_motion(segment, joint, seconds, segment.time).items():
        changed[name][joint] = values
    return replace(segment, **changed)


def first_samples(segments: Sequence[Segment]) -> list[Segment]:
    """The segments up to `MOST_SAMPLES`, the last one cut there."""
    kept, left = [], MOST_SAMPLES
    for segment in segments:
        if left > 0:
            arrays = {name: values for name, values in vars(segment).items() if isinstance(values, np.ndarray)}
            cut: dict[str, Any] = {name: values[..., :left] for name, values in arrays.items()}
            kept.append(replace(segment, **cut))
        left -= len(segment.time)
    return kept
