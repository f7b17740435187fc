"""Equations near velocity reversals and of motors at rest, where Coulomb friction is not well defined.

A joint that reverses stands still for a while; meanwhile friction takes any value between its two limits, and a static
model does not hold (AUBO .IV: below 0.1 rad/s). Filters carry the error into the neighbouring samples. A motor that
rests while others move holds its load by a friction that says nothing of the load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from daq.recording.quality.windows import least_within
from drivers.core.arrays import FloatArray
from drivers.core.text import percent_text
from ident.model.joint_columns import combined
from ident.model.regressor import RegressorKernel
from ident.regression.options import REVERSAL_SHARE
from ident.signals.prepared import Prepared, Segment, Step
from ident.signals.segments import SHORTEST_REST, moving_mask

STICKING_SHARE = 0.2
"""The same, below which a joint that sticks can affect an equation: the search of a delay and the check of friction
near reversals do without these, where data are plenty and a bias counts."""

TOGGLING = 1.2
"""Encoder steps within which a joint is at rest: the smoothed position of one that toggles between two counts."""

REVERSAL_REACH = 0.5
"""Periods of the parallel filter's cut-off by which a reversal reaches into the motion before and after it: the filter
spreads what a joint that sticks for an instant does to friction over half the width of its impulse response."""

REST_REACH = 0.5
"""Periods of the parallel filter's cut-off by which a rest reaches into the motion before and after it: half the width
of the filter's impulse response."""


def leave_out_rest(kernel: RegressorKernel, prepared: Prepared, steps: FloatArray | None = None) -> Prepared:
    """The same data without the torques of motors at rest, unless samples at rest are to be kept.

    A motor rests where a velocity whose sign is in its equation stays below the rest velocity as long as a window
    without motion lasts (see `moving_mask`), or its joints stay within a step of their encoders as long.

    Args:
        kernel: says which motors have Coulomb friction, and of which motion.
        prepared: data.
        steps: (n,) of the joints' encoders [rad or m], nan where not known.
    """
    if prepared.choices.keep_rest:
        return prepared
    reach = REST_REACH / prepared.cutoffs.torque
    segments = []
    for segment in prepared.segments:
        resting = _rest_mask(kernel, segment, prepared.rest_velocity, round(reach * segment.rate), steps)
        reversing = resting if segment.reversing is None else resting | segment.reversing
        segments.append(replace(segment, resting=resting, reversing=reversing))
    counted = sum(int(segment.used.sum()) for segment in segments) * kernel.model.dof
    left_out = sum(int((segment.resting & segment.used).sum()) for segment in segments if segment.resting is not None)
    if not left_out:
        return prepared
    share = left_out / max(1, counted)
    step = Step(
        "motors at rest",
        {"rest_velocity": prepared.rest_velocity, "left_out": share},
        f"left out where a motor rests while others move: {percent_text(share, 2)} of all torques",
    )
    return replace(prepared, segments=tuple(segments), steps=(*prepared.steps, step))


def leave_out_reversals(kernel: RegressorKernel, prepared: Prepared, share: float) -> Prepared:
    """The same data without the equations near velocity reversals.

    Args:
        kernel: says which motors have Coulomb friction, and of which motion.
        prepared: data.
        share: a motor slower than this share of its root mean square is near a reversal; 0 leaves out nothing.
    """
    if share == 0.0:
        return prepared
    masks = (reversal_mask(kernel, segment, share) for segment in prepared.segments)
    segments = tuple(
        replace(segment, reversing=mask if segment.reversing is None else mask | segment.reversing)
        for segment, mask in zip(prepared.segments, masks, strict=True)
    )
    counted = sum(int(segment.used.sum()) for segment in segments) * kernel.model.dof
    left_out = sum(
        int((segment.reversing & segment.used).sum()) for segment in segments if segment.reversing is not None
    )
    step = Step(
        "reversals",
        {"share": share, "left_out": left_out / max(1, counted)},
        f"left out where a motor is slower than {share:g} of its root mean square, or rests: "
        f"{percent_text(left_out / max(1, counted))} of all equations",
    )
    return replace(prepared, segments=segments, steps=(*prepared.steps, step))


def without_reversals(kernel: RegressorKernel, prepared: Prepared) -> Prepared:
    """The same data without what velocity reversals reach: `REVERSAL_REACH` before and after each, and slow motors."""
    reach = REVERSAL_REACH / prepared.cutoffs.torque
    segments = []
    for segment in prepared.segments:
        mask = reversal_mask(kernel, segment, REVERSAL_SHARE, reach)
        segments.append(replace(segment, reversing=mask if segment.reversing is None else mask | segment.reversing))
    return replace(prepared, segments=tuple(segments))


def reversal_mask(kernel: RegressorKernel, segment: Segment, share: float, reach: float = 0.0) -> npt.NDArray[np.bool_]:
    """(n, N) motors near a reversal: a velocity whose sign is in their equation is slow, or changes sign soon.

    Args:
        kernel: says which motors have Coulomb friction, and of which motion.
        segment: the motion.
        share: of a velocity's root mean square, below which it is slow.
        reach: time before and after a change of sign [s].
    """
    reversing = np.zeros((kernel.model.dof, segment.velocity.shape[1]), dtype=np.bool_)
    width = round(reach * segment.rate)
    for motor, motion in _rubbing(kernel):
        velocity = combined(motion, segment.velocity)
        speed = np.abs(velocity)
        reversing[motor] |= speed < share * np.sqrt(np.mean(np.square(speed[segment.used])))
        if width:
            changes = np.append(False, np.diff(np.sign(velocity)) != 0.0)
            reversing[motor] |= _dilated(changes, 2 * width + 1)
    return reversing


def _rest_mask(
    kernel: RegressorKernel, segment: Segment, rest_velocity: float, reach: int, steps: FloatArray | None
) -> npt.NDArray[np.bool_]:
    """(n, N) motors at rest, and `reach` samples before and after."""
    resting = np.zeros((kernel.model.dof, segment.velocity.shape[1]), dtype=np.bool_)
    still = np.zeros_like(resting) if steps is None else _within_a_step(segment, steps)
    for motor, motion in _rubbing(kernel):
        resting[motor] |= ~moving_mask(combined(motion, segment.velocity)[None], segment.rate, rest_velocity)
        resting[motor] |= np.all(still[[joint for joint, _ in motion]], axis=0)
    return _dilated(resting, 2 * reach + 1)


def _within_a_step(segment: Segment, steps: FloatArray) -> npt.NDArray[np.bool_]:
    """(n, N) joints whose positions stay within a step of their encoder for `SHORTEST_REST` or longer."""
    width = max(1, round(SHORTEST_REST * segment.rate))
    window = width // 2, (width - 1) // 2
    spreads = (-least_within(-row, *window) - least_within(row, *window) for row in segment.position)
    # Nothing is still where the step is nan.
    still = np.array([spread <= TOGGLING * step for spread, step in zip(spreads, steps, strict=True)])
    return _dilated(still, width)


def _dilated(mask: npt.NDArray[np.bool_], width: int) -> npt.NDArray[np.bool_]:
    """A mask (…, N) that reaches `width` // 2 samples further to both sides, one less after where it is even."""
    return ~least_within(~mask, (width - 1) // 2, width // 2)


def _rubbing(kernel: RegressorKernel) -> Iterator[tuple[int, tuple[tuple[int, float], ...]]]:
    """Motors and the motions whose velocities' signs are in their equations."""
    for row in kernel.joint_parameter_rows:
        if row.column.quantity == "coulomb":
            motor = next(joint for joint, rows in enumerate(kernel.joint_rows) if row.row < rows.rows.stop)
            yield motor, row.column.motion
