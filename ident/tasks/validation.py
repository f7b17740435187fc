"""Validate and merge identified models in one call each."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

from drivers.core.errors import UsageError
from drivers.core.files import given_kind
from drivers.core.options import keywords_of
from ident.assessment.validation import Fit, fit_errors
from ident.experiments.merge.merged_result import merge_results
from ident.identify.held_out import delivered_model, model_checks, model_verdict
from ident.identify.revalidate import acceptance_figures, revalidate
from ident.result.delivered import Delivered, HeldOutErrors
from ident.result.models.gravity_model import refuse_gravity_alone
from ident.result.models.model import Model, result_path
from ident.result.result_file import read_result
from ident.result.schema import Result
from ident.result.tables import Table
from ident.tasks.arguments import ShownResult, limits_of, recording_of, recordings_of
from ident.tasks.identification import IdentificationResult
from ident.tasks.options import MergeOptions, ValidateOptions
from ident.verdict.acceptance import Acceptance, check_joints, judge_acceptance
from ident.verdict.verdict import Verdict
from ident.views.result_tables import error_table

Identified = IdentificationResult | Model | str | PathLike[str]
"""A result, a model, or the path of either."""


@dataclass(frozen=True)
class RecordingValidation:
    """A model on one held-out recording."""

    recording: str  # what messages call it
    full: Fit  # errors of all base parameters
    essential: Fit  # the same of the significant ones
    consistent: Fit | None  # the same of the physically consistent ones; None where the result holds none
    # errors of the model that `load_model` hands out, in motion and over all samples; its simulated motion; whether the
    # recording is held out
    delivered: HeldOutErrors
    verdict: Verdict  # on the model, from the checks of its identification, those of this recording, and these errors


@dataclass(frozen=True)
class Validation(ShownResult):
    """Errors of a model on held-out recordings; filters and delay as at its identification.

    Attributes:
        joints: names (n,).
        torque_unit: of the errors: "N·m", of sliding joints "N", of both "N·m or N".
        full: errors of all base parameters over all recordings: `relative_error` (a ratio), `rmse` per joint [N·m], …
        essential: the same of the significant ones.
        consistent: the same of the physically consistent ones; None where the result holds none.
        delivered: those of the model that `load_model` hands out, which the verdict grades.
        verdict: the worst of the recordings', purpose by purpose; recordings of the identification do not count.
        recordings: each apart.
        acceptance: whether all recordings together keep the declared limits; None where none were declared.

    Example:
        >>> import dynid
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> validation = dynid.validate(result, dynid.simulate("ur5e", duration=10.0, seed=2))
        >>> validation.errors.columns[1].heading
        'delivered RMSE [N·m]'
        >>> validation.verdict.purposes["torque_prediction"].grade in ("good", "usable", "poor")
        True
    """

    joints: tuple[str, ...]
    torque_unit: str
    full: Fit
    essential: Fit
    consistent: Fit | None
    delivered: Delivered
    verdict: Verdict
    recordings: tuple[RecordingValidation, ...]
    acceptance: Acceptance | None = None

    @property
    def errors(self) -> Table:
        """Errors of the filtered torque of each joint [N·m, %]."""
        fits: dict[str, Fit | None] = {
            "delivered": self.delivered.validation_all_samples,
            "in_motion": self.delivered.validation,
            "full": self.full,
            "essential": self.essential,
        }
        return error_table("Errors", self.joints, self.torque_unit, fits)

    def __repr__(self) -> str:
        names = ", ".join(recording.recording for recording in self.recordings)
        return f"<dynid.Validation on {names}: {self.verdict.headline}>"

    def _parts(self) -> tuple[object, ...]:
        return self.errors, self.verdict, self.acceptance or ""


@keywords_of(ValidateOptions)
def validate(options: ValidateOptions) -> Validation:
    """Predict the torques [N·m] of recordings with an identified model and compare, each recording apart.

    Raises:
        DataError: a recording lacks signals, or its motion is outside what the model covers.
        ResultFileError: the result's parts do not belong together.
        UsageError: wrong limits.

    Example:
        >>> import dynid
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> dynid.validate(result.model, dynid.simulate("ur5e", duration=10.0, seed=2)).full.relative_error < 0.2
        True
    """
    limits = None if options.accept is None else limits_of(options.accept)
    result, recordings = result_of(options.identified), recordings_of(options.runs)
    if not recordings:
        raise UsageError("no recording to validate with")
    if limits is not None:
        check_joints(limits, result.joints)
    compared = [revalidate(result, recording) for recording in recordings]
    checks, held_out = model_checks(result), [fits.delivered for fits in compared]
    apart = tuple(
        RecordingValidation(
            recording=recording.label,
            full=fits.full,
            essential=fits.essential,
            consistent=fits.consistent,
            delivered=fits.delivered.errors,
            verdict=model_verdict(result, checks, [fits.delivered.errors]),
        )
        for recording, fits in zip(recordings, compared, strict=True)
    )
    of_consistent = [series for fits in compared for series in fits.consistent_series or ()]
    verdict = model_verdict(result, checks, [run.errors for run in held_out])
    delivered = delivered_model(result.consistent, result.delivered.fit, held_out)
    figures = acceptance_figures(result, delivered.validation_all_samples, delivered.runs, verdict)
    return Validation(
        joints=tuple(result.joints),
        torque_unit=result.unit("N·m"),
        full=fit_errors([series for fits in compared for series in fits.series]),
        essential=fit_errors([series for fits in compared for series in fits.essential_series]),
        consistent=fit_errors(of_consistent) if of_consistent else None,
        delivered=delivered,
        verdict=verdict,
        recordings=apart,
        acceptance=None if limits is None else judge_acceptance(limits, figures),
    )


@keywords_of(MergeOptions)
def merge(options: MergeOptions) -> IdentificationResult:
    """One model from several experiments on one arm, each weighted by its covariance (SR400 .4.3 point 7).

    Raises:
        UsageError: fewer than two, different arms, or data that would count twice.
        ResultFileError: a result without a covariance.
        IdentificationError: the values do not determine any parameter.

    Example:
        >>> import dynid
        >>> results = [dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=seed)) for seed in (1, 2)]
        >>> merged = dynid.merge(results)
        >>> merged.result.merge.consistency.agree in (True, False)
        True
    """
    if not isinstance(options.results, (list, tuple)):
        hint = "give a list of at least two, of dynid.identify or their paths"
        raise UsageError(f"{given_kind(options.results)} is not a list of results", hint=hint)
    named = [
        (_label(identified, position), result_of(identified))
        for position, identified in enumerate(options.results, start=1)
    ]
    held_out = None if options.validation is None else recording_of(options.validation)
    merged, validated = merge_results(named, held_out, options.essential, options.significance)
    return IdentificationResult(merged, (), validated.series if validated is not None else ())


def result_of(identified: Identified) -> Result:
    """The result, read where a path is given.

    Raises:
        ResultFileError: no such file, or it is no result.
    """
    if isinstance(identified, Model):
        refuse_gravity_alone(identified, "the torque of a motion")
    if isinstance(identified, (IdentificationResult, Model)):
        return identified.result
    return read_result(result_path(identified))


def _label(identified: Identified, position: int) -> str:
    given = isinstance(identified, (IdentificationResult, Model))
    return f"result {position}" if given else str(result_path(identified))  # type: ignore[arg-type]
