"""What every driver checks of a joint position before it commands it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DriverStateError
from drivers.core.units import joint_unit

FIRST_STEP_LIMIT = 0.1
"""How far [rad or m] a first command may be from the measured position; it would be reached within one period."""


def finite_position(position: FloatArray, joints: Sequence[str]) -> FloatArray:
    """A commanded joint position as an array (n,) [rad or m].

    Raises:
        ValueError: not n finite numbers.
    """
    target = np.asarray(position, dtype=np.float64)
    if target.shape != (len(joints),) or not np.all(np.isfinite(target)):
        raise ValueError(f"a position has {len(joints)} finite numbers, not {position!r}")
    return target


def check_first_step(
    target: FloatArray, measured: FloatArray | None, joints: Sequence[str], sliding: Sequence[bool] = ()
) -> None:
    """Refuse a first command (n,) [rad or m] that the arm could only reach by a jump.

    What was measured is None before the first sample. All joints turn where `sliding` is empty.

    Raises:
        DriverStateError: it is further than `FIRST_STEP_LIMIT` from the measured position, or either of them is
            unknown, NaN or infinite; names the joint that is worst.
    """
    if measured is None:
        raise DriverStateError("no position of the arm is known yet", hint="read samples before the first command")
    with np.errstate(invalid="ignore"):
        away = np.abs(target - measured)
    if np.all(away <= FIRST_STEP_LIMIT):  # false for NaN
        return
    worst = int(np.argmax(np.where(np.isnan(away), np.inf, away)))
    unit = joint_unit("rad", sliding=bool(sliding) and sliding[worst])
    if np.isfinite(away[worst]):
        message = f"the first position is {away[worst]:.3f} {unit} away from the measured one"
    else:
        message = (
            f"the first position, {target[worst]:g}, cannot be compared with the measured one, {measured[worst]:g}"
        )
    raise DriverStateError(
        message,
        where=f"joint {joints[worst]}",
        hint=f"begin within {FIRST_STEP_LIMIT:g} {unit} of the measured position",
    )
