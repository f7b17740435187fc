"""The figures of a result that acceptance limits are compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.assessment.validation import Fit
from ident.result.delivered import DELIVERED_WORDS, HeldOutErrors, delivered_parameters
from ident.result.schema import Result
from ident.verdict.acceptance import ModelFigures
from ident.verdict.evidence import known
from ident.verdict.verdict import Verdict


def result_figures(result: Result) -> ModelFigures:
    """Figures of an identification or a merge on its held-out data."""
    delivered = result.delivered
    if delivered is None:
        return acceptance_figures(result, None, [], result.verdict)
    return acceptance_figures(result, delivered.validation_all_samples, delivered.runs, result.verdict)


def acceptance_figures(
    result: Result, errors: Fit | None, runs: Sequence[HeldOutErrors], verdict: Verdict
) -> ModelFigures:
    """Figures of the delivered model on held-out recordings; none on data that it was identified from.

    Args:
        result: the model.
        errors: over all samples of the recordings together.
        runs: each apart.
        verdict: on the model with these data.
    """
    held_out = errors if runs and all(run.held_out for run in runs) else None
    joints = result.joints
    return ModelFigures(
        model=DELIVERED_WORDS[delivered_parameters(result.consistent)],
        relative_error=None if held_out is None else held_out.relative_error,
        joint_relative_error=_by_joint(joints, None if held_out is None else held_out.joint_relative_error),
        rmse=_by_joint(joints, None if held_out is None else held_out.rmse),
        motion_rmse=_by_joint(joints, _motion_error(runs)),
        sliding=dict(zip(joints, result.sliding, strict=True)),
        consistent=result.consistent is not None,
        consistency_cost=_cost(runs),
        verdict=verdict,
    )


def _motion_error(runs: Sequence[HeldOutErrors]) -> Sequence[float | None] | None:
    """The largest error of each joint over the recordings; none where one could not be simulated."""
    motions = [None if run.simulation is None else run.simulation.position_rmse for run in runs]
    if not motions or any(motion is None for motion in motions):
        return None
    return [max(of_joint) for of_joint in zip(*(motion for motion in motions if motion is not None), strict=True)]


def _cost(runs: Sequence[HeldOutErrors]) -> float | None:
    """The largest ratio of the delivered model's error to the full one's over the recordings."""
    ratios = [_ratio(run.all_samples, run.full_all_samples) for run in runs if run.full_all_samples is not None]
    return max((ratio for ratio in ratios if ratio is not None), default=None)


def _by_joint(joints: Sequence[str], values: Sequence[float | None] | None) -> Mapping[str, float | None]:
    return dict.fromkeys(joints) if values is None else dict(zip(joints, values, strict=True))


def _ratio(consistent: Fit | None, full: Fit | None) -> float | None:
    if consistent is None or full is None or not full.relative_error:
        return None
    return known(consistent.relative_error / full.relative_error)
