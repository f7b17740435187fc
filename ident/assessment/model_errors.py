"""Drive gains and lengths that the data contradict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.assessment.refit import Deviation, deviations, first_samples, shifted
from ident.model.dynamic_model import DynamicModel
from ident.model.regressor import RegressorKernel
from ident.regression.autocorrelation import independent_share, residual_autocorrelation
from ident.regression.comparison import TorqueSeries, compare_torques
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.least_squares import LeastSquares
from ident.signals.prepared import Prepared
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LIKELIHOOD_LEVEL = 16.0
"""What the doubled log-likelihood ratio must exceed: four σ, since a dozen gains and lengths are tried. On the public
recordings and their halves no length reaches more than 12."""

GAIN_OFF = 0.2
"""Relative deviation of a gain from which on `LIKELIHOOD_LEVEL` suffices. What friction models leave out moves the
estimate by up to 0.14 on halves of the public recordings (Panda)."""

SMALL_GAIN_LEVEL = 40.0
"""What the ratio must exceed for a smaller deviation: what friction models leave out looks like a gain. On the public
recordings it reaches 31 (Panda, joint 6: 12 %)."""

LEAST_GAIN_OFF = 0.05
LEAST_SHIFT = 5e-3
"""Smallest deviation of a gain, and of a length [m], that is reported."""

MOST_UNCERTAIN = 3.0
"""A deviation of less than this many σ is not named, whatever its likelihood."""

INDEPENDENT_PER_PARAMETER = 2
"""Independent equations per parameter that must remain; a fit to fewer hides what a wrong number leaves."""

WORTH_A_LOOK = 2.0
"""Doubled log-likelihood ratio from which on the residuals without the deviation are looked at."""


def reported(deviation: Deviation) -> bool:
    """Whether a deviation is clear and large enough to be named."""
    if abs(deviation.value) < MOST_UNCERTAIN * deviation.std or deviation.likelihood < LIKELIHOOD_LEVEL:
        return False
    if deviation.axis is not None:
        return abs(deviation.value) >= LEAST_SHIFT
    off = abs(float(np.log(1.0 + deviation.value)))
    return off >= np.log(1.0 + GAIN_OFF) or (off >= LEAST_GAIN_OFF and deviation.likelihood > SMALL_GAIN_LEVEL)


def model_error_checks(
    kernel: RegressorKernel,
    torques: Sequence[int],
    runs: Sequence[Prepared],
    solution: LeastSquares,
    independent: float,
) -> list[Check]:
    """The gain or the length that is off most clearly: a wrong one makes others look wrong, too.

    Args:
        kernel: of the base columns.
        torques: motors whose torques count.
        runs: prepared data, with the equations that were fitted.
        solution: of these.
        independent: number of independent equations.
    """
    worst = most_likely(kernel, torques, runs, solution, independent)
    if worst is None or not reported(worst):
        return []
    return [_gain_check(kernel.model, worst) if worst.axis is None else _length_check(kernel.model, worst, worst.axis)]


def most_likely(
    kernel: RegressorKernel,
    torques: Sequence[int],
    runs: Sequence[Prepared],
    solution: LeastSquares,
    independent: float,
) -> Deviation | None:
    """The deviation that explains most, judged by the residuals that it leaves; arguments as of `model_error_checks`.

    A wrong number makes the residuals alike over long times, so that few of them seem independent. Were it right, those
    that remain are: their autocorrelation counts.
    """
    found = deviations(kernel, torques, runs, solution, independent)
    worst = max(found, key=lambda one: one.likelihood, default=None)
    if worst is None or worst.likelihood < WORTH_A_LOOK:
        return worst
    used = [n for n in torques if solution.weights[n] > 0]
    shares = [
        independent_share(residual_autocorrelation(_compared(kernel, runs, one))[used])
        for one in (replace(worst, value=0.0, parameters=solution.parameters), worst)
    ]
    width = len(solution.active)
    before, after = (independent * share / shares[0] for share in shares)
    if before <= width or after < INDEPENDENT_PER_PARAMETER * width:  # too few to judge by
        return None
    worth = (after - width) / (before - width)
    return replace(worst, likelihood=worst.likelihood * worth, std=worst.std / float(np.sqrt(worth)))


def _compared(kernel: RegressorKernel, runs: Sequence[Prepared], deviation: Deviation) -> list[TorqueSeries]:
    """Measured torques of all runs, and those predicted with a gain or a length changed."""
    model, joint = kernel.model, deviation.joint
    if deviation.axis is not None:
        model = shifted(model, joint, deviation.axis, deviation.value)
    series = []
    for run in runs:
        segments, parallel = first_samples(run.segments), run.parallel_filter
        for part in compare_torques(model, kernel.columns, deviation.parameters, segments, parallel):
            scale = np.ones((len(part.predicted), 1))
            if deviation.axis is None:
                scale[joint] += deviation.value
            series.append(replace(part, predicted=scale * part.predicted))
    return series


def _gain_check(model: DynamicModel, gain: Deviation) -> Check:
    name = model.joint_names[gain.joint]
    factor = 1.0 / (1.0 + gain.value)  # the gain multiplies the recorded torque, the unknown the model's
    text = (
        f"the torque of {name} agrees with the other joints' when its drive gain is multiplied by "
        f"{factor:.2f} ± {WITHIN_95_PERCENT * gain.std * factor**2:.2f}: check the gain, or identify the gains with a "
        "known load (dynid gains)"
    )
    return raised("inconsistent-gain", text, [name])


def _length_check(model: DynamicModel, length: Deviation, axis: int) -> Check:
    joint = model.joints[length.joint]
    parent = "the base" if joint.parent < 0 else model.joints[joint.parent].name
    believed = float(joint.translation[axis])
    text = (
        f"the torques agree better with the origin of {joint.name} at {'xyz'[axis]} = {believed + length.value:.3f} ± "
        f"{WITHIN_95_PERCENT * length.std:.3f} m in the frame of {parent} than at the robot file's {believed:.3f} m: "
        "check this length"
    )
    return raised("inconsistent-length", text, [joint.name] if joint.name in model.joint_names else [])
