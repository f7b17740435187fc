"""Accuracy of torque prediction: per joint, separately at low and at high speed (AUBO .3.4, Tables III and IV)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pydantic import Field

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.text import percent_text
from ident.regression.comparison import TorqueSeries
from ident.stored import Number, Real, Stored
from ident.verdict.catalogue import raised
from ident.verdict.check import Check

LOW_SPEED = 0.1
"""Joint speed [rad/s or m/s] below which a static friction model is not valid (AUBO .3.4)."""

HELD_OUT_SHARE = 0.3
"""Last share of a recording, held out for validation where no other recording is given."""

MUCH_LARGER = 2.0
"""Ratio of the validation's errors to the identification's beyond which there is a check."""

LEAST_DIFFERENCE = 0.005
"""Difference of two relative errors that does not matter, whatever their ratio: half a percent of the torque."""


class Fit(Stored):
    """Errors of filtered torques; the lists have one entry per joint.

    An error is None where the model predicts no torque, or where the joint rests throughout.
    """

    relative_error: Real = Field(
        description="‖τ − Ŵx‖ / ‖τ‖ over all samples of the joints whose torque is predicted, where they do not rest"
    )
    joint_relative_error: list[Number] = Field(description="the same of each joint; null where it has no torque")
    rmse: list[Number] = Field(description="root mean square error [N·m]")
    low_speed_rmse: list[Number] = Field(description="below 0.1 rad/s or m/s [N·m]; null where there is no such sample")
    high_speed_rmse: list[Number] = Field(description="from there on [N·m]")
    max_error: list[Number] = Field(description="largest error [N·m]")
    samples: int = Field(description="filtered samples that count")
    held_out: bool | None = Field(
        default=None, description="of a validation: false where data of the identification are in it; else null"
    )


def fit_errors(series: Sequence[TorqueSeries], held_out: bool | None = None) -> Fit:
    """Errors over all segments together.

    Args:
        series: measured and predicted torques, one per segment.
        held_out: of a validation, whether none of its data was used in the identification.

    Raises:
        DataError: no sample counts (the arm never moves).
    """
    counted = np.concatenate([torques.counted[:, torques.used] for torques in series], axis=1)
    measured = np.concatenate([torques.measured[:, torques.used] for torques in series], axis=1)
    error = measured - np.concatenate([torques.predicted[:, torques.used] for torques in series], axis=1)
    speed = np.abs(np.concatenate([torques.velocity[:, torques.used] for torques in series], axis=1))
    if not counted.any():
        raise DataError("the arm does not move in these data", hint="choose another window with start and stop")
    slow = speed < LOW_SPEED
    measured, error = np.where(counted, measured, 0.0), np.where(counted, error, 0.0)
    torque_norms, error_norms = np.linalg.norm(measured, axis=1), np.linalg.norm(error, axis=1)
    predicted = ~np.isnan(error_norms)
    total = float(np.linalg.norm(torque_norms[predicted]))
    return Fit(
        relative_error=float(np.linalg.norm(error_norms[predicted])) / total if total > 0 else float("nan"),
        joint_relative_error=_ratio(error_norms, torque_norms).tolist(),
        rmse=_rmse_where(error, counted).tolist(),
        low_speed_rmse=_rmse_where(error, counted & slow).tolist(),
        high_speed_rmse=_rmse_where(error, counted & ~slow).tolist(),
        max_error=np.where(counted.any(axis=1), np.max(np.abs(error), axis=1), np.nan).tolist(),
        samples=measured.shape[1],
        held_out=held_out,
    )


def overfitting_checks(fitted: Fit, held_out: Fit) -> list[Check]:
    """Check whether errors on held-out data are much larger than the identification's, and the cause.

    A motion that needs less torque has larger relative errors, one that needs more has larger ones in N·m: no sign of a
    bad model. Both must have grown, each joint's beside its own.
    """
    ratio = _times_larger(fitted.rmse, held_out.rmse)
    grown = min(ratio, _times_larger(fitted.joint_relative_error, held_out.joint_relative_error))
    if not grown > MUCH_LARGER or held_out.relative_error - fitted.relative_error < LEAST_DIFFERENCE:
        return []
    larger = f"the joints' torque errors in the validation are {ratio:.1f} times the identification's"
    if np.isfinite(fitted.relative_error) and np.isfinite(held_out.relative_error):
        shares = (percent_text(errors.relative_error, 2) for errors in (held_out, fitted))
        larger += f" ({' against '.join(shares)} of the whole arm's torque)"
    moving = _times_larger(fitted.high_speed_rmse, held_out.high_speed_rmse)
    if moving <= MUCH_LARGER:
        text = f"{larger}, at high speed only {moving:.1f} times: friction near standstill, where no static model holds"
        return [raised("errors-near-standstill", text)]
    text = f"{larger}, in motion, too: the model overfits, or the other motion shows effects that this one does not"
    return [raised("overfitting", text)]


def _times_larger(fitted: Sequence[float | None], held_out: Sequence[float | None]) -> float:
    """Ratio of the joints' errors (root mean square over the joints with both); nan without any."""
    one, other = np.array(fitted, dtype=np.float64), np.array(held_out, dtype=np.float64)
    both = (one > 0.0) & np.isfinite(other)
    return float(np.sqrt(np.mean((other[both] / one[both]) ** 2))) if both.any() else float("nan")


def _rmse_where(error: FloatArray, mask: npt.NDArray[np.bool_]) -> FloatArray:
    counts = np.sum(mask, axis=1).astype(np.float64)
    return np.asarray(np.sqrt(_ratio(np.sum(np.where(mask, error**2, 0.0), axis=1), counts)))


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    return np.asarray(np.divide(numerator, denominator, out=np.full(len(numerator), np.nan), where=denominator > 0))
