"""Several methods on the same recordings in one call."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daq.plotting import Backend
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from drivers.core.cluster import cluster_executor, why_lost
from drivers.core.errors import DynidError, IdentificationError, UsageError
from drivers.core.options import keywords_of
from drivers.core.text import in_percent, json_text
from drivers.core.units import common_unit
from ident.experiments.method_comparison import (
    JointGroup,
    PairedDifference,
    RunErrors,
    joint_groups,
    paired_difference,
    run_errors,
)
from ident.identify.data_split import NOT_HELD_OUT, labelled
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify as identify_recordings
from ident.identify.preparation import compare_run
from ident.model.regressor import RegressorKernel
from ident.report.comparison_page import comparison_figure, comparison_page
from ident.result.tables import Cell, Column, Table, table_of_rows
from ident.signals.options import PreprocessChoices
from ident.tasks.arguments import Runs, SavedResult, held_out_of, paths_of, recordings_of
from ident.tasks.options import CompareOptions, silent

COMPARISON_FILE = "comparison.json"
"""Name of the figures in the folder that `save` writes."""

Parameters = Literal["full", "consistent"]


@dataclass(frozen=True)
class ComparedModel:
    """One method's model with its errors."""

    method: str  # as given
    friction: str  # as given; empty where the robot file says it
    parameters: Parameters  # all base parameters as estimated ("full"), or the physically consistent ones
    fit: float  # relative error on the identification data, a ratio
    runs: tuple[RunErrors, ...]  # errors on each held-out recording
    seconds: float  # CPU time of the identification with error bars and checks [s]; of both parameter sets together
    failure: str = ""  # why there is no model; empty where there is one

    @property
    def label(self) -> str:
        """Method, friction and parameters in a few words."""
        friction = f", {self.friction}" if self.friction else ""
        return f"{self.method}{friction}{', consistent' if self.parameters == 'consistent' else ''}"


@dataclass(frozen=True)
class MethodComparison(SavedResult):
    """Errors of several methods on the same held-out recordings; the first model is what the others are compared with.

    Attributes:
        robot: its name.
        recordings: what was held out.
        groups: joints whose largest errors are taken together.
        models: in the order of the methods, full before consistent.
        torque_unit: of the joints' torques: "N·m", of sliding joints "N", of both "N·m or N".

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> comparison = dynid.compare(run, ("ols", "wls"), validation=other)
        >>> comparison.errors.names
        ('ols', 'ols, consistent', 'wls', 'wls, consistent')
    """

    FILE = COMPARISON_FILE

    robot: str
    recordings: tuple[str, ...]
    groups: tuple[JointGroup, ...]
    models: tuple[ComparedModel, ...]
    torque_unit: str = "N·m"

    @property
    def errors(self) -> Table:
        """Relative errors [%] and RMSE over all joints [N·m], means over the held-out recordings; CPU time [s]."""
        headings: list[Column | tuple[str, str]] = [
            ("model", ""),
            ("fit", "%"),
            ("validation", "%"),
            Column("rmse", unit=self.torque_unit, label="RMSE"),
            Column("rmse_low_speed", unit=self.torque_unit, label="RMSE low speed"),
            Column("rmse_high_speed", unit=self.torque_unit, label="RMSE high speed"),
            ("time", "s"),
        ]
        rows: list[tuple[Cell, ...]] = [
            (
                model.label,
                in_percent(model.fit),
                in_percent(_mean([run.relative_error for run in model.runs])),
                _mean([run.rmse for run in model.runs]),
                _mean([run.low_speed_rmse for run in model.runs]),
                _mean([run.high_speed_rmse for run in model.runs]),
                model.seconds,
            )
            for model in self.models
        ]
        not_held_out = [f"; {label}" for label in self.recordings if NOT_HELD_OUT in label]
        return table_of_rows(f"Methods compared on {self.robot}{''.join(not_held_out)}", headings, rows)

    @property
    def maxima(self) -> Table:
        """Largest errors of each group of joints below and above `LOW_SPEED` [N·m]: mean over the recordings, and σ.

        One recording has no σ.
        """
        headings = [("model", "")]
        for group in self.groups:
            for speed in ("low", "high"):
                names = (f"{group.name} {speed}", f"{group.name} {speed} std")
                headings += [(name, self.torque_unit) for name in (names if self._several else names[:1])]
        rows: list[tuple[Cell, ...]] = []
        for model in self.models:
            cells: list[Cell] = [model.label]
            for place in range(len(self.groups)):
                for of_run in ("low_speed_max", "high_speed_max"):
                    values = [getattr(run, of_run)[place] for run in model.runs]
                    cells += [_mean(values), *([_deviation(values)] if self._several else [])]
            rows.append(tuple(cells))
        return table_of_rows("Largest errors at low and at high speed", headings, rows)

    @property
    def differences(self) -> Table:
        """RMSE of each model minus the first one's on the same recordings, with the 95 % interval of the mean [N·m].

        One recording has no interval, and no difference on it can be called significant.
        """
        unit = self.torque_unit
        headings = [("model", ""), ("difference", unit), ("interval", unit), ("relative", "%"), ("significant", "")]
        rows: list[tuple[Cell, ...]] = []
        for model in self.models[1:]:
            paired = self.difference(model)
            base = _mean([run.rmse for run in self.models[0].runs])
            interval = paired.half_width if np.isfinite(paired.half_width) else None
            answer = "" if interval is None else "yes" if paired.significant else "no"
            rows.append((model.label, paired.mean, interval, 100.0 * paired.mean / base if base else None, answer))
        first = self.models[0].label if self.models else ""
        table = table_of_rows(f"RMSE against {first}", headings, rows)
        return table if self._several else table.pick("model", "difference", "relative")

    @property
    def _several(self) -> bool:
        """Return whether recordings can be compared with each other."""
        return len(self.recordings) > 1

    def difference(self, model: ComparedModel) -> PairedDifference:
        """RMSE of a model minus that of the first one, recording by recording [N·m]."""
        return paired_difference([run.rmse for run in self.models[0].runs], [run.rmse for run in model.runs])

    @property
    def failures(self) -> tuple[str, ...]:
        """Methods without a model, and why."""
        return tuple(f"{model.label}: {model.failure}" for model in self.models if model.failure)

    def to_json(self) -> str:
        """Output of `dynid compare --json`."""
        return json_text(
            {
                "robot": self.robot,
                "recordings": self.recordings,
                "torque_unit": self.torque_unit,
                "groups": self.groups,
                "models": [{"label": model.label, **asdict(model)} for model in self.models],
                "differences": self.differences,
            }
        )

    def _page(self) -> str:
        return comparison_page(
            self.robot,
            self.recordings,
            self.groups,
            (self.errors, self.maxima, self.differences),
            self._rmse,
            self.torque_unit,
            self.failures,
        )

    def plot(self, *, backend: Backend = "plotly") -> Any:
        """The RMSE of each model on every held-out recording, as a figure.

        Args:
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: the backend does not exist or is not installed.
        """
        return comparison_figure(self._rmse, self.torque_unit).drawn(backend)

    @property
    def _rmse(self) -> list[tuple[str, list[float]]]:
        return [(model.label, [run.rmse for run in model.runs]) for model in self.models if model.runs]

    def __repr__(self) -> str:
        models = "; ".join(model.label for model in self.models)
        return f"<dynid.MethodComparison on {self.robot}: {models}>"

    def _parts(self) -> tuple[object, ...]:
        return *(table for table in (self.errors, self.maxima, self.differences) if len(table)), *self.failures


@keywords_of(CompareOptions)
def compare(options: CompareOptions) -> MethodComparison:
    """Identify with several methods and set their errors on held-out recordings side by side.

    Raises:
        InputError: invalid recordings, methods or friction models; recordings that are no paths for a scheduler.
        ConnectionFailedError: the scheduler does not answer.
        IdentificationError: no method has a solution.

    Example:
        >>> import dynid
        >>> run, other = (dynid.simulate("ur5e", duration=10.0, seed=seed) for seed in (1, 2))
        >>> dynid.compare(run, ("ols", "wls"), validation=other).differences.columns[1].heading
        'difference [N·m]'
    """
    cases = [(method, model) for method in options.methods for model in options.friction or ("",)]
    compared = list(_on_a_cluster(options, cases) if options.scheduler else _one_by_one(options, cases))
    models = [model for case in compared for model in case.models]
    solved = next((case for case in compared if case.labels), None)
    if solved is None:
        raise IdentificationError(f"no method has a solution; {models[0].label}: {models[0].failure}")
    return MethodComparison(solved.arm, solved.labels, solved.groups, tuple(models), solved.unit)


@dataclass(frozen=True)
class _Case:
    """What one method and friction model gave; `labels` of the held-out recordings are empty where it failed."""

    models: tuple[ComparedModel, ...]
    arm: str = ""
    unit: str = ""
    groups: tuple[JointGroup, ...] = ()
    labels: tuple[str, ...] = ()


def _one_by_one(options: CompareOptions, cases: Sequence[tuple[str, str]]) -> Iterator[_Case]:
    recordings, held_out = recordings_of(options.runs), held_out_of(options.validation)
    robot_file = None if options.robot is None else load_robot(options.robot)
    for method, model in cases:
        options.progress(f"{method} {model}".strip())
        choices = _choices(method, model, options.delay, options.split)
        start = time.process_time()
        try:
            identification = identify_recordings(recordings, held_out, choices, robot_file)
        except IdentificationError as error:
            yield _failed(method, model, str(error))
            continue
        seconds = time.process_time() - start
        groups = joint_groups(identification.model.joint_names)
        labels = tuple(labelled(run.signals.label, run.overlap) for run in identification.validation_runs)
        arm = (robot_file or recordings[0].robot()).robot
        models = tuple(_models(method, model, identification, groups, seconds))
        yield _Case(models, arm.name, common_unit("N·m", arm.sliding), groups, labels)


def _on_a_cluster(options: CompareOptions, cases: Sequence[tuple[str, str]]) -> Iterator[_Case]:
    """Every case on a worker, which reads the recordings itself.

    Raises:
        UsageError: recordings that are no paths, which would go through the scheduler; no Dask.
        ConnectionFailedError: the scheduler does not answer.
    """
    runs, validation = _seen_from_anywhere(options.runs), _seen_from_anywhere(options.validation)
    robot = None if options.robot is None else load_robot(options.robot)
    sent = replace(options, runs=runs, validation=validation, robot=robot, scheduler="", progress=silent)
    with cluster_executor(options.scheduler) as executor:
        futures = [executor.submit(_on_a_worker, sent, case) for case in cases]
        for (method, model), future in zip(cases, futures, strict=True):
            options.progress(f"{method} {model}".strip())
            try:
                yield future.result()
            except DynidError:
                raise
            except Exception as error:  # Dask's KilledWorker, or what its lost scheduler leaves
                yield _failed(method, model, why_lost(error))


def _seen_from_anywhere(runs: Runs) -> list[Path]:
    given = runs if isinstance(runs, list | tuple) else [runs]
    paths = [path.absolute() for path in paths_of(given)]
    if len(paths) < len(given):
        raise UsageError("a scheduler's workers read recordings by path", hint="save them, and give their paths")
    return paths


def _failed(method: str, model: str, why: str) -> _Case:
    return _Case((ComparedModel(method, model, "full", float("nan"), (), float("nan"), why),))


def _on_a_worker(options: CompareOptions, case: tuple[str, str]) -> _Case:
    return next(_one_by_one(options, [case]))


def _choices(method: str, friction: str, delay: float | None, split: float | None) -> IdentifyChoices:
    return IdentifyChoices(
        method=method,
        model=ModelChoices(friction=friction or None),
        preprocess=PreprocessChoices(delay=delay or 0.0),
        search_delay=delay is None,
        split=split,
    )


def _models(
    method: str, friction: str, identified: Identification, groups: Sequence[JointGroup], seconds: float
) -> list[ComparedModel]:
    """The model as estimated, and the physically consistent one where there is one."""
    kernel = RegressorKernel(identified.model, identified.base.columns)
    consistent = identified.consistent

    def compared(parameters: Parameters, values: FloatArray, fit: float) -> ComparedModel:
        series = [compare_run(kernel, values, run) for run in identified.validation_runs]
        errors = tuple(run_errors(of_run, groups) for of_run in series)
        return ComparedModel(method, friction, parameters, fit, errors, seconds)

    models = [compared("full", identified.solution.parameters, identified.fit.relative_error)]
    if consistent is not None:
        models.append(compared("consistent", consistent.parameters.base, consistent.fit.relative_error))
    return models


def _mean(values: Sequence[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else None


def _deviation(values: Sequence[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.std(finite, ddof=1)) if len(finite) > 1 else None
