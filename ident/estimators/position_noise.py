"""Noise of the recorded positions, and what it does to the regressor.

Above the band of the motion and its harmonics, what is left of a filtered position is noise. It is taken as white
before the filter, as an encoder's steps are. A realisation of the same noise through the same filter and derivatives,
added to the motion, shows the errors of the columns of W and how they hang together: velocities and accelerations share
them, and a column's error depends on the motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError
from ident.model.regressor import RegressorKernel
from ident.regression.observation_matrix import Reduction, filtered_samples
from ident.signals.cutoffs import choose_cutoffs
from ident.signals.filters import butterworth
from ident.signals.options import PreprocessChoices
from ident.signals.prepared import Prepared, Segment
from ident.signals.segments import central_difference

END_PERIODS = 4.0
"""Periods of the motion's highest harmonic at both ends of a segment, where what is left of it is the filter's end."""

LEAST_BAND = 1.5
"""The positions' cut-off must be this many times the motion's and its harmonics' for noise to show between them."""


def noise_deviations(run: Prepared) -> FloatArray:
    """Standard deviation (n,) of the positions' white noise before filtering [rad or m].

    Raises:
        IdentificationError: the positions' cut-off leaves no band without motion.
    """
    rate = run.segments[0].rate
    harmonics = choose_cutoffs(run.cutoffs.band, rate, PreprocessChoices()).torque
    if run.cutoffs.position < LEAST_BAND * harmonics:
        raise IdentificationError(
            f"positions low-passed at {run.cutoffs.position:.3g} Hz show no noise beside a motion with harmonics up to "
            f"{harmonics:.3g} Hz",
            hint=f"give --position-cutoff {2.0 * harmonics:.3g}, or use --method wls",
        )
    low = butterworth(harmonics, rate)

    edge = round(END_PERIODS * rate / harmonics)

    def above(position: FloatArray, used: npt.NDArray[np.bool_]) -> FloatArray:
        return np.asarray((position - low.apply(position))[:, edge:-edge][:, used[edge:-edge]])

    measured = [above(segment.position, segment.used) for segment in run.segments]
    generator = np.random.default_rng(0)
    white = [above(_band_limited(run, segment, generator), segment.used) for segment in run.segments]
    if not sum(part.shape[1] for part in measured):
        raise IdentificationError(
            f"no segment is longer than {2.0 * END_PERIODS / harmonics:.3g} s, so that none shows the positions' noise",
            hint="record without gaps, or use --method wls",
        )
    squares, units = (sum(np.sum(part**2, axis=1) for part in parts) for parts in (measured, white))
    return np.asarray(np.sqrt(squares / units))


def _band_limited(run: Prepared, segment: Segment, generator: np.random.Generator) -> FloatArray:
    """White noise of unit deviation (n, N) through the positions' low-pass."""
    white = generator.standard_normal(segment.position.shape)
    return butterworth(run.cutoffs.position, segment.rate).apply(white)


def regressor_noise(
    kernel: RegressorKernel, run: Prepared, deviations: FloatArray, plain: Reduction
) -> list[FloatArray]:
    """Expected Gram matrix (k, k) of the errors of each joint's columns of W, from one realisation.

    Args:
        kernel: of the base columns.
        run: its data.
        deviations: (n,) of the positions' noise [rad or m].
        plain: names each joint's columns.
    """
    grams = [np.zeros((len(joint.columns), len(joint.columns))) for joint in plain.joints]
    generator = np.random.default_rng(1)
    for segment in run.segments:
        position = deviations[:, None] * _band_limited(run, segment, generator)
        velocity = central_difference(position, segment.rate)
        noisy = replace(
            segment,
            position=segment.position + position,
            velocity=segment.velocity + velocity,
            acceleration=segment.acceleration + central_difference(velocity, segment.rate),
        )
        nothing = np.empty((0, len(segment.time)))
        of_both = (filtered_samples(kernel, one, run.parallel_filter, nothing) for one in (segment, noisy))
        for clean, other in zip(*of_both, strict=True):
            for motor, rows in enumerate(kernel.joint_rows):
                counts = clean.counts(motor)
                error = other.regressor[rows.rows][:, counts] - clean.regressor[rows.rows][:, counts]
                grams[motor] += error @ error.T
    return grams
