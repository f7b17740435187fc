"""Equations near velocity reversals, where Coulomb friction is not well defined.

A joint that reverses stands still for a while; meanwhile friction takes any value between its two limits, and a static
model does not hold (AUBO .IV: below 0.1 rad/s). Filters carry the error into the neighbouring samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from drivers.errors import UsageError
from ident.model.joint_columns import combined
from ident.model.regressor import RegressorKernel
from ident.signals.prepared import Prepared, Segment, Step

ADVISED_SHARE = 0.2
"""Of a velocity's root mean square: below it a motor is near a reversal (docs/excitation.md has the figures)."""


def without_reversals(
    kernel: RegressorKernel, segments: Sequence[Segment], share: float = ADVISED_SHARE
) -> tuple[Segment, ...]:
    """Segments without the equations of motors slower than `share` of their velocity's root mean square.

    The search of a delay takes these: a joint that sticks at a reversal passes its torque on late, which
    looks like a delay of many milliseconds.
    """
    return tuple(replace(part, reversing=reversal_mask(kernel, part, share)) for part in segments)


def leave_out_reversals(kernel: RegressorKernel, prepared: Prepared, share: float) -> Prepared:
    """The same data without the equations near velocity reversals.

    Args:
        kernel: says which motors have Coulomb friction, and of which motion.
        prepared: data.
        share: a motor slower than this share of its root mean square is near a reversal; 0 leaves out nothing.

    Raises:
        UsageError: the share is not within [0, 1).
    """
    check_share(share)
    if share == 0.0:
        return prepared
    segments = without_reversals(kernel, prepared.segments, share)
    counted = sum(int(part.used.sum()) for part in segments) * kernel.model.dof
    left_out = sum(int((part.reversing & part.used).sum()) for part in segments if part.reversing is not None)
    step = Step(
        "reversals",
        {"share": share, "left_out": left_out / max(1, counted)},
        f"left out where a motor is slower than {share:g} of its root mean square: {left_out / max(1, counted):.1%} "
        "of all equations",
    )
    return replace(prepared, segments=segments, steps=(*prepared.steps, step))


def check_share(share: float) -> None:
    """Refuse what is no share.

    Raises:
        UsageError: not within [0, 1).
    """
    if not 0.0 <= share < 1.0:
        raise UsageError(f"{share:g} is no share of a velocity", where="--leave-out-reversals", hint="give 0 to 0.9")


def reversal_mask(kernel: RegressorKernel, segment: Segment, share: float) -> npt.NDArray[np.bool_]:
    """(n, N) motors near a reversal: a velocity whose sign is in their equation is below `share` of its rms."""
    reversing = np.zeros((kernel.model.dof, segment.velocity.shape[1]), dtype=np.bool_)
    for row in kernel.joint_parameter_rows:
        if row.column.quantity != "coulomb":
            continue
        motor = next(joint for joint, rows in enumerate(kernel.joint_rows) if row.row < rows.rows.stop)
        speed = np.abs(combined(row.column.motion, segment.velocity))
        reversing[motor] |= speed < share * np.sqrt(np.mean(np.square(speed[segment.used])))
    return reversing
