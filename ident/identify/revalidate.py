"""A stored model against another recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import TypeAdapter, ValidationError

from daq.recording.recording import Recording
from drivers.errors import ResultFileError
from ident.assessment.validation import FitFigures, fit_figures
from ident.identify.played_motion import played_window
from ident.regression.comparison import TorqueSeries, compare_torques, only_predicted
from ident.regression.observability import predictable_torques
from ident.result.schema import Result
from ident.result.stored_model import stored_model
from ident.signals.joint_signals import read_joint_signals
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare


@dataclass(frozen=True)
class Revalidation:
    """Errors of the full and of the essential model on a recording, and the full model's torques."""

    full: FitFigures
    essential: FitFigures
    series: tuple[TorqueSeries, ...]


def revalidate(result: Result, recording: Recording) -> Revalidation:
    """Predict a recording's torques with a stored model, filters and delay as at its identification.

    Raises:
        ResultFileError: the stored parameters do not belong to the stored robot file.
        DataError: the recording lacks what is needed.
    """
    stored_parts = stored_model(result)
    model, base = stored_parts.model, stored_parts.base
    stored = {parameter.name: parameter for parameter in result.base_parameters}
    full = np.array([stored[name].value or 0.0 for name in base.names])
    essential = np.array([stored[name].essential_value or 0.0 for name in base.names])
    motion = read_joint_signals(recording, stored_parts.robot_file.robot)
    start, stop = played_window(recording, motion.position)
    choices = replace(stored_choices(result), start=start, stop=stop)
    prepared = prepare(motion, choices)
    seconds = motion.time - motion.time[0]
    inside = (seconds >= (start or 0.0)) & (seconds <= (np.inf if stop is None else stop))
    torques = predictable_torques(model, stored_parts.experiments, motion.label, motion.position[inside])
    full_series, essential_series = (
        tuple(
            only_predicted(part, torques)
            for part in compare_torques(model, base.columns, values, prepared.segments, prepared.parallel_filter)
        )
        for values in (full, essential)
    )
    return Revalidation(fit_figures(full_series), fit_figures(essential_series), full_series)


def stored_choices(result: Result) -> PreprocessChoices:
    """The preprocessing of the identification, its window left out: that belonged to its own recording."""
    names = PreprocessChoices.__dataclass_fields__
    chosen = {key: value for key, value in result.options.items() if key in names and key not in ("start", "stop")}
    try:
        return TypeAdapter(PreprocessChoices).validate_python(chosen)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ResultFileError(first["msg"], where=f"options.{key}", hint="identify again") from error
