"""The figures of a result that acceptance limits are compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.result.schema import Fit, Result
from ident.verdict.acceptance import ModelFigures
from ident.verdict.verdict import Verdict


def result_figures(result: Result) -> ModelFigures:
    """Of an identification or a merge, on its held-out data."""
    consistent = None if result.consistent is None else result.consistent.validation
    return validation_figures(result, result.validation, consistent, result.verdict)


def validation_figures(result: Result, full: Fit | None, consistent: Fit | None, verdict: Verdict) -> ModelFigures:
    """On other held-out data; the motion error stays that of the identification.

    Args:
        result: the model.
        full: errors of all base parameters.
        consistent: errors of the physically consistent model, which are judged where there are any.
        verdict: on the model with these data.
    """
    judged, joints = consistent if consistent is not None else full, result.joints
    motion = None if result.consistent is None else result.consistent.simulation
    return ModelFigures(
        model="consistent" if consistent is not None else "unconstrained",
        relative_error=None if judged is None else judged.relative_error,
        joint_relative_error=_by_joint(joints, None if judged is None else judged.joint_relative_error),
        rmse=_by_joint(joints, None if judged is None else judged.rmse),
        motion_rmse=_by_joint(joints, None if motion is None else motion.position_rmse),
        consistent=result.consistent is not None,
        consistency_cost=_ratio(consistent, full),
        verdict=verdict,
    )


def _by_joint(joints: Sequence[str], values: Sequence[float | None] | None) -> Mapping[str, float | None]:
    return dict.fromkeys(joints) if values is None else dict(zip(joints, values, strict=True))


def _ratio(consistent: Fit | None, full: Fit | None) -> float | None:
    if consistent is None or full is None or consistent.relative_error is None or not full.relative_error:
        return None
    return consistent.relative_error / full.relative_error
