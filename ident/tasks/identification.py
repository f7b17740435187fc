"""Identify a dynamic model in one call; the result shows and saves itself."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from daq.plotting import Backend
from daq.robot.loader import load_robot
from drivers.core.errors import DataError, UsageError
from drivers.core.options import keywords_of, same_named
from ident.assessment.validation import Fit
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify as identify_recordings
from ident.identify.predict import predict_recording
from ident.identify.revalidate import result_figures
from ident.regression.comparison import TorqueSeries
from ident.regression.options import ExperimentChoices
from ident.report import RecordedRuns, ReportData, recorded_runs, render_report
from ident.report.figures.torque_figure import torque_figure
from ident.result.delivered import Delivered
from ident.result.models.model import Model, result_path
from ident.result.result_file import read_result, result_json, stored_model
from ident.result.schema import Result
from ident.result.tables import Table
from ident.signals.pipeline import PreprocessChoices
from ident.tasks.arguments import Run, SavedResult, held_out_of, limits_of, recording_of, recordings_of
from ident.tasks.options import IdentifyOptions
from ident.verdict.acceptance import Acceptance, check_joints, judge_acceptance
from ident.verdict.verdict import Verdict
from ident.views.result_tables import joint_friction_table, parameter_table, result_errors


class IdentificationResult(SavedResult):
    """Result of an identification or a merge; shows itself in a notebook, and is saved as the command saves it.

    Attributes:
        result: all of it, as `result.json` holds it.
        fit_series, validation_series: measured and predicted torques [N·m], for the report: of the full model in the
            fit, of the delivered one over all held-out samples. Empty for results that were read from a file.
        recorded: motion and temperatures of the recordings, for the report.

    Example:
        >>> import dynid
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> result.fit.relative_error < 0.2, result.warnings == tuple(result.result.warnings)
        (True, True)
        >>> result.parameters.row("Fv1")["unit"]
        'N·m·s/rad'
    """

    def __init__(
        self,
        result: Result,
        fit_series: Sequence[TorqueSeries] = (),
        validation_series: Sequence[TorqueSeries] = (),
        recorded: RecordedRuns | None = None,
    ) -> None:
        """Hold a result with the torques behind it."""
        self.result: Result = result
        self.fit_series = tuple(fit_series)
        self.validation_series = tuple(validation_series)
        self.recorded = recorded or RecordedRuns()

    @property
    def verdict(self) -> Verdict:
        """Return how far the model can be trusted: headline, purposes, joints, checks; printed as a few lines."""
        return self.result.verdict

    @property
    def acceptance(self) -> Acceptance | None:
        """Judge whether the declared limits are kept, limit by limit; None where none were declared."""
        return self.result.acceptance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences of the verdict's checks, notes left out."""
        return tuple(self.result.warnings)

    @property
    def delivered(self) -> Delivered:
        """Errors of the model that `load_model` hands out, which the verdict grades."""
        return self.result.delivered

    @property
    def fit(self) -> Fit | None:
        """Errors of the full model on the identification data: `relative_error`, `rmse`, …; None of a merge."""
        return self.result.fit

    @property
    def validation(self) -> Fit | None:
        """The same on held-out data in motion; None where nothing was held out."""
        return self.result.validation

    @cached_property
    def parameters(self) -> Table:
        """The base parameters: values, σ (corrected for autocorrelated residuals), partial F, expressions."""
        return parameter_table(self.result)

    @cached_property
    def friction(self) -> Table:
        """Friction of each joint with its σ, and σ between several runs; empty where the model has no such column."""
        return joint_friction_table(self.result)

    @cached_property
    def errors(self) -> Table:
        """Errors of the delivered model's filtered torque: on the identification data, on held-out data, in motion."""
        return result_errors(self.result)

    @cached_property
    def model(self) -> Model:
        """The model that the verdict grades and `load_model` hands out; `load_model(…, "full")` gives another.

        Raises:
            ModelError: the recordings identify only some of the base parameters.
        """
        return Model(self.result)

    def score(self, run: Run) -> float:
        """Coefficient of determination R² of the predicted torque of a recording: 1 is best, 0 no better than a mean.

        As `score` of scikit-learn's regressors: of the filtered torque of each joint, mean over the joints. `validate`
        gives the errors in N·m, and a verdict.

        Args:
            run: a recording that was not identified from, or its path.

        Raises:
            DataError: the recording lacks what is needed, or its torque does not vary.

        Example:
            >>> import dynid
            >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
            >>> dynid.identify(run).score(other) > 0.9
            True
        """
        recording = recording_of(run)
        segments = predict_recording(self.model, stored_model(self.result).robot_file, recording).segments
        residuals = [segment.residual for segment in segments if segment.residual is not None]
        if not residuals:
            raise DataError("no torque was recorded for comparison", where=recording.label)
        residual = np.concatenate(residuals)
        spread = np.var(residual + np.concatenate([segment.torque for segment in segments]), axis=0)
        if not np.all(spread > 0.0):
            raise DataError("the torque of a joint does not vary, which leaves R² undefined", where=recording.label)
        return float(np.mean(1.0 - np.mean(np.square(residual), axis=0) / spread))

    def plot(self, *, backend: Backend = "plotly") -> Any:
        """Measured and predicted torque of each joint, the worst one first: held-out data, else those of the fit.

        Args:
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: the result was read from a file, which holds no torques; or the backend does not exist or is
                not installed.
        """
        data = ReportData(self.result, self.fit_series, self.validation_series)
        errors = self.delivered.validation_all_samples if self.validation_series else self.fit
        series = self.validation_series or self.fit_series
        figure = torque_figure("torques-plot", self.result, data.worst_first, series, errors)
        if figure is None:
            hint = "dynid.predict(result, run).plot()"
            raise UsageError("the result was read from a file, which holds no torques", hint=hint)
        return figure.drawn(backend)

    def _page(self) -> str:
        return render_report(ReportData(self.result, self.fit_series, self.validation_series, recorded=self.recorded))

    def to_json(self) -> str:
        """The text of `result.json`."""
        return result_json(self.result)

    def _parts(self) -> tuple[object, ...]:
        return self.verdict, self.acceptance or "", self.errors, self.parameters

    def __repr__(self) -> str:
        return f"<dynid.IdentificationResult {self.result.robot}, {len(self.result.base_parameters)} base parameters>"


@keywords_of(IdentifyOptions, {"gravity": "dynid.identify_gravity(runs)"})
def identify(options: IdentifyOptions) -> IdentificationResult:
    """Identify the dynamic model from recordings and validate it on held-out data: all that `dynid identify` does.

    Method and options: docs/identification.md; weighted least squares after SR400 .4.3.

    Raises:
        InputError: invalid recordings or options; names the place.
        IdentificationError: there is no solution.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> result = dynid.identify(run, validation=other)
        >>> result.validation.relative_error < 0.2
        True
    """
    choices = _choices(options)
    limits = None if options.accept is None else limits_of(options.accept)
    options.progress("reading")
    recordings, held_out = recordings_of(options.runs), held_out_of(options.validation)
    robot_file = None if options.robot is None else load_robot(options.robot)
    if limits is not None and recordings:
        check_joints(limits, (robot_file or recordings[0].robot()).robot.joint_names)
    identification = identify_recordings(recordings, held_out, choices, robot_file, options.progress)
    result = identification.result
    if limits is not None:
        result = result.model_copy(update={"acceptance": judge_acceptance(limits, result_figures(result))})
    recorded = recorded_runs(identification)
    held_out_series = [all_sample for run in identification.held_out for all_sample in run.all_samples]
    return IdentificationResult(result, identification.fit_series, held_out_series, recorded)


def _choices(options: IdentifyOptions) -> IdentifyChoices:
    experiment = None
    if options.friction_from is not None:
        from ident.result.friction_experiment import read_friction_experiment

        experiment = read_friction_experiment(options.friction_from)
    return same_named(
        options,
        IdentifyChoices,
        model=same_named(options, ModelChoices, experiment=experiment),
        preprocess=same_named(options, PreprocessChoices, delay=options.delay or 0.0),
        search_delay=options.delay is None,
        experiment=same_named(
            options, ExperimentChoices, locked=tuple(options.locked), torques_of=tuple(options.torques_of)
        ),
    )


def load_result(path: str | PathLike[str]) -> IdentificationResult:
    """Read a result back.

    Args:
        path: a folder that `identify` wrote, or its result.json.

    Raises:
        ResultFileError: no such file, or it is no result.

    Example:
        >>> import dynid, tempfile
        >>> result = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     result.save(folder)
        ...     dynid.load_result(folder).verdict == result.verdict
        True
    """
    return IdentificationResult(read_result(result_path(path)))
