"""Input of a merge: results of the same arm, of different data, each with its information on the merged parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from drivers.core.errors import ResultFileError, UsageError
from ident.experiments.merge.merge import Information, usable, variance_ratio
from ident.model.base_parameters import BaseParameters
from ident.regression.observability import experiment_base
from ident.result.result_file import StoredModel, stored_estimate, stored_model
from ident.result.schema import RecordingUse, Result


@dataclass(frozen=True)
class MergeInput:
    """One of the results to be merged, ready for it."""

    label: str  # its name in messages
    result: Result  # as read
    stored: StoredModel  # its model
    information: Information  # on the merged base parameters, weighted
    names: tuple[str, ...]  # of its values
    ratio: float  # mean variance, corrected for autocorrelation over white


def merge_inputs(results: Sequence[tuple[str, Result]]) -> tuple[list[MergeInput], BaseParameters]:
    """The results ready to be merged, and the base parameters that they can show together.

    Raises:
        UsageError: fewer than two, different arms, or data that would count twice.
        ResultFileError: a result without a covariance, or inconsistent results.
    """
    if len(results) < 2:
        raise UsageError("merging needs at least two models", hint="dynid merge a/result.json b/result.json -o merged")
    _check_same_arm(results)
    _check_disjoint(results)
    stored = [_stored(label, result) for label, result in results]
    base = experiment_base(stored[0].model, [experiment for model in stored for experiment in model.experiments])
    return [_input(label, result, model, base) for (label, result), model in zip(results, stored, strict=True)], base


def _stored(label: str, result: Result) -> StoredModel:
    try:
        return stored_model(result)
    except ResultFileError as error:
        raise ResultFileError(error.message, where=_where(label, error.where), hint=error.hint) from error


def _input(label: str, result: Result, stored: StoredModel, base: BaseParameters) -> MergeInput:
    """Information of a result on the merged base parameters."""
    try:
        estimate = stored_estimate(result, stored)
    except ResultFileError as error:
        raise ResultFileError(error.message, where=_where(label, error.where), hint=error.hint) from error
    # P_i·π = (P_i restricted to the kept columns)·x, since the merged base parameters hold each of those once.
    combined = estimate.combinations(stored.base.projection)[:, list(base.columns)]
    information = usable(Information(estimate.values, combined, estimate.root, estimate.covariance, estimate.blocks))
    finite = np.isfinite(np.diag(estimate.covariance))
    # A merged model was weighed when it was merged.
    ratio = 1.0 if result.merge is not None else variance_ratio(information.root, information.covariance)
    if not ratio > 0:
        raise ResultFileError(
            "has a residual of zero, which gives it no weight", where=label, hint="merge recordings of a real arm"
        )
    return MergeInput(
        label=label,
        result=result,
        stored=stored,
        information=Information(
            information.values,
            information.combinations,
            information.root / np.sqrt(ratio),
            information.covariance,
            information.blocks,
        ),
        names=tuple(stored.base.names[index] for index, use in zip(estimate.active, finite, strict=True) if use),
        ratio=ratio,
    )


def _check_same_arm(results: Sequence[tuple[str, Result]]) -> None:
    """Raise where two results do not have the same robot file and columns."""
    first_label, first = results[0]
    for label, other in results[1:]:
        for what, mine, theirs in (
            ("robot file", first.robot_file, other.robot_file),
            ("URDF", first.urdf, other.urdf),
        ):
            if mine != theirs:
                raise UsageError(
                    f"{first_label} and {label} are based on different versions of the {what}, which differ at "
                    f"{_first_difference(mine, theirs)}",
                    hint="identify both with the same robot file (--robot, in Python robot=)",
                )
        if first.model_options != other.model_options:
            different = [
                name
                for name, value in first.model_options.model_dump().items()
                if value != other.model_options.model_dump()[name]
            ]
            raise UsageError(
                f"{first_label} and {label} have different columns: {', '.join(different)}",
                hint=_SHAPES
                if different == ["terms"]
                else "identify both with the same --friction, --offset, --motor-inertia and --smoothing",
            )


_SHAPES = (
    "terms and shapes were chosen separately: identify both with --friction coulomb-viscous, or with terms whose "
    "shapes the robot file states"
)


def _first_difference(mine: str, theirs: str) -> str:
    """Return where two texts differ first, in words."""
    pairs = zip([*mine.splitlines(), ""], [*theirs.splitlines(), ""], strict=False)
    line, (a, b) = next(((n, pair) for n, pair in enumerate(pairs, 1) if pair[0] != pair[1]), (1, ("", "")))
    return f"line {line}: '{a.strip()}' and '{b.strip()}'"


def _check_disjoint(results: Sequence[tuple[str, Result]]) -> None:
    """Raise where two results used the same torques: they would count twice."""
    for (label, result), (other_label, other) in combinations(results, 2):
        for use in used_recordings(result):
            for again in used_recordings(other):
                torques = set(use.torques_of or result.joints) & set(again.torques_of or other.joints)
                overlap = max(use.window[0], again.window[0]) < min(use.window[1], again.window[1])
                if use.sha256 and use.sha256 == again.sha256 and torques and overlap:
                    raise UsageError(
                        f"{label} and {other_label} were both identified from the torques of "
                        f"{', '.join(joint for joint in result.joints if joint in torques)} in {use.file}, which would "
                        "count twice",
                        hint="choose different motors with --torques-of, or another recording",
                    )


def used_recordings(result: Result) -> list[RecordingUse]:
    """Those that a result was identified from."""
    return [use for use in result.recordings if use.role == "identification"]


def _where(label: str, key: str | None) -> str:
    return f"{label}: {key}" if key else label
