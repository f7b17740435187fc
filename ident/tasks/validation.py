"""Validate, compare and merge identified models in one call each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from daq.robot.loader import RobotFile
from drivers.errors import UsageError
from ident.assessment.validation import fit_figures
from ident.experiments.merged_result import merge_results
from ident.identify.revalidate import revalidate, validation_verdict
from ident.regression.least_squares import Method
from ident.regression.pruning import SIGNIFICANT_RSD
from ident.result.consistent_model import fit_result
from ident.result.model import Model, result_path
from ident.result.schema import Fit, Result, read_result
from ident.result.tables import Cell, Table, table_of_rows
from ident.tasks.identification import IdentificationResult, check_significance, error_table, identify
from ident.tasks.runs import Run, Runs, recording_of, recordings_of
from ident.verdict.verdict import Verdict, together

Identified = IdentificationResult | Model | str | PathLike[str]
"""A result, a model, or the path of either."""


@dataclass(frozen=True)
class RecordingValidation:
    """A model on one held-out recording.

    Attributes:
        recording: what messages call it.
        full: errors of all base parameters.
        essential: the same of the significant ones.
        verdict: on the model, from the checks of its identification, those of this recording, and these errors.
    """

    recording: str
    full: Fit
    essential: Fit
    verdict: Verdict


@dataclass(frozen=True)
class Validation:
    """Errors of a model on held-out recordings; filters and delay as at its identification.

    Attributes:
        joints: names (n,).
        full: errors of all base parameters over all recordings: `relative_error` (a ratio), `rmse` per joint [N·m], …
        essential: the same of the significant ones.
        verdict: the worst of the recordings', purpose by purpose.
        recordings: each apart.

    Example:
        >>> import dynid
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> validation = dynid.validate(result, dynid.simulate("ur5e", duration=10.0, seed=2))
        >>> validation.errors.columns[1].heading
        'full_rmse [N·m]'
        >>> validation.verdict.purposes["torque_prediction"].grade in ("good", "usable", "poor")
        True
    """

    joints: tuple[str, ...]
    full: Fit
    essential: Fit
    verdict: Verdict
    recordings: tuple[RecordingValidation, ...]

    @property
    def errors(self) -> Table:
        """Errors of the filtered torque of each joint [N·m, %]."""
        return error_table("Errors", self.joints, {"full": self.full, "essential": self.essential})

    def __str__(self) -> str:
        return f"{self.errors}\n\n{self.verdict}"

    def _repr_html_(self) -> str:
        return f"{self.verdict._repr_html_()}{self.errors._repr_html_()}"


def validate(identified: Identified, runs: Runs) -> Validation:
    """Predict the torques [N·m] of recordings with an identified model and compare, each recording apart.

    Args:
        identified: a result, a model, or the folder or file of one.
        runs: a held-out recording or several, or their paths.

    Raises:
        DataError: a recording lacks signals, or its motion is outside what the model covers.
        ResultFileError: the result's parts do not belong together.

    Example:
        >>> import dynid
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> dynid.validate(result.model, dynid.simulate("ur5e", duration=10.0, seed=2)).full.relative_error < 0.2
        True
    """
    result, recordings = _result(identified), recordings_of(runs)
    if not recordings:
        raise UsageError("no recording to validate with")
    compared = [revalidate(result, recording) for recording in recordings]
    apart = []
    for recording, fits in zip(recordings, compared, strict=True):
        full = fit_result(fits.full)
        verdict = validation_verdict(result, recording, full)
        apart.append(RecordingValidation(recording.label, full, fit_result(fits.essential), verdict))
    return Validation(
        joints=tuple(result.joints),
        full=fit_result(fit_figures([part for fits in compared for part in fits.series])),
        essential=fit_result(fit_figures([part for fits in compared for part in fits.essential_series])),
        verdict=together([(one.recording, one.verdict) for one in apart]),
        recordings=tuple(apart),
    )


def merge(
    results: Sequence[Identified], *, validation: Run | None = None, significance: float = SIGNIFICANT_RSD
) -> IdentificationResult:
    """One model from several experiments on one arm, each weighted by its covariance (SR400 .4.3 point 7).

    Args:
        results: results, models, or the folders or files of them.
        validation: a held-out recording, used by none of them.
        significance: threshold of the relative standard deviation [%].

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
    check_significance(significance)
    named = [
        (_label(identified, position), _result(identified)) for position, identified in enumerate(results, start=1)
    ]
    held_out = None if validation is None else recording_of(validation)
    merged, validated = merge_results(named, held_out, significance)
    return IdentificationResult(merged, (), validated.series if validated is not None else ())


def compare(
    runs: Runs,
    methods: Sequence[Method] = ("ols", "wls"),
    *,
    validation: Runs = (),
    robot: str | Path | RobotFile | None = None,
) -> Table:
    """Identify with several methods and set their errors side by side.

    Args:
        runs: a recording, or several of one arm, or their paths.
        methods: of "ols", "wls", "energy" and "power".
        validation: held-out recordings; the last 30 % without any.
        robot: in place of the recording's own robot file.

    Returns:
        One row per method: relative errors of fit and validation [%], then the validation's RMSE of each joint [N·m].

    Raises:
        InputError: invalid recordings or methods.
        IdentificationError: a method has no solution.

    Example:
        >>> import dynid
        >>> table = dynid.compare(dynid.simulate("ur5e", duration=10.0, seed=1), methods=("ols", "wls"))
        >>> table.names
        ('ols', 'wls')
    """
    if isinstance(methods, str) or not methods:
        raise UsageError("methods must be a list of method names", hint='methods=("ols", "wls")')
    recordings, held_out = recordings_of(runs), recordings_of(validation)
    rows: list[tuple[Cell, ...]] = []
    joints: list[str] = []
    for method in methods:
        result = identify(recordings, validation=held_out, method=method, robot=robot).result
        joints = result.joints
        rows.append((method, _percent(result.fit), _percent(result.validation), *_rmse(result.validation, joints)))
    headings = [("method", ""), ("fit", "%"), ("validation", "%"), *((f"rmse_{name}", "N·m") for name in joints)]
    return table_of_rows("Methods compared: relative errors, and RMSE of the validation", headings, rows)


def _percent(fit: Fit | None) -> float | None:
    return None if fit is None or fit.relative_error is None else 100.0 * fit.relative_error


def _rmse(fit: Fit | None, joints: Sequence[str]) -> list[float | None]:
    return [None] * len(joints) if fit is None else list(fit.rmse)


def _result(identified: Identified) -> Result:
    if isinstance(identified, (IdentificationResult, Model)):
        return identified.result
    return read_result(result_path(identified))


def _label(identified: Identified, position: int) -> str:
    given = isinstance(identified, (IdentificationResult, Model))
    return f"result {position}" if given else str(result_path(identified))  # type: ignore[arg-type]
