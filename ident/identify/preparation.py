"""All data of an identification, preprocessed alike: the recording of the fastest motion gives cut-offs and delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.reading_process import Progress
from ident.assessment.delay.delay import DelaySearch, search_delay
from ident.identify.cutoff_search import LoweredCutoffs, lowered_cutoffs
from ident.identify.data_split import DataSplit, PreparedRun, RunWindow
from ident.identify.held_friction import HeldFriction
from ident.identify.identification import IdentifyChoices
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import TorqueSeries, compare_torques, only_predicted
from ident.regression.velocity_reversals import leave_out_rest, leave_out_reversals
from ident.signals.cutoffs import POSITION_CUTOFF_OF_RATE, POSITION_CUTOFF_PER_TORQUE
from ident.signals.options import PreprocessChoices
from ident.signals.pipeline import prepare, prepare_with_rest
from ident.signals.prepared import Prepared, Step


@dataclass(frozen=True)
class PreparedData:
    """All data, ready for the estimator."""

    # runs, validation_runs: to identify from, and held out
    runs: tuple[PreparedRun, ...]
    validation_runs: tuple[PreparedRun, ...]
    delay: DelaySearch | None  # the search, where one was made
    choices: PreprocessChoices  # of all recordings, cut-offs and delay filled in
    # cut-offs that were lowered because the positions jitter; None where they were not
    lowered: LoweredCutoffs | None = None


def prepare_data(
    kernel: RegressorKernel,
    data: DataSplit,
    torques: Sequence[int],
    held_out_torques: Sequence[Sequence[int]],
    choices: IdentifyChoices,
    progress: Progress,
) -> PreparedData:
    """Preprocess all recordings with the filters and the delay of the one whose motion is the fastest.

    Args:
        kernel: of the base columns.
        data: recordings and their windows.
        torques: motors whose torques are used.
        held_out_torques: of each held-out recording, the motors whose torques can be predicted.
        choices: the user's.
        progress: called before the search for the delay.
    """
    run = _leading(kernel, data, choices.preprocess, torques)

    def prepared(preprocess: PreprocessChoices) -> Prepared:
        return _prepare_run(kernel, run, preprocess, torques, data.held).prepared

    first = prepared(choices.preprocess)
    lowered = lowered_cutoffs(kernel, first, prepared, choices.preprocess, torques)
    first = first if lowered is None else prepared(lowered.choices)
    resolved, delay = _for_all_rates(first.choices, choices.preprocess, data), None
    if choices.search_delay:
        progress("delay")
        delay = search_delay(kernel, first.segments, first.parallel_filter, torques)
        resolved = replace(resolved, delay=delay.used, joint_delays=delay.joint_delays)
    runs = [_prepare_run(kernel, run, resolved, torques, data.held) for run in data.identification]
    return PreparedData(
        runs=tuple(
            replace(run, prepared=leave_out_reversals(kernel, run.prepared, choices.reversal_share)) for run in runs
        ),
        validation_runs=tuple(
            _prepare_held_out(kernel, run, resolved, predictable, data.held)
            for run, predictable in zip(data.held_out, held_out_torques, strict=True)
        ),
        delay=delay,
        choices=resolved,
        lowered=lowered,
    )


def _leading(
    kernel: RegressorKernel, data: DataSplit, preprocess: PreprocessChoices, torques: Sequence[int]
) -> RunWindow:
    """The recording whose motion needs the highest cut-offs, of several the longest: whichever is named first."""
    if len(data.identification) == 1:
        return data.identification[0]

    def rank(run: RunWindow) -> tuple[float, int, bytes]:
        chosen = _prepare_run(kernel, run, preprocess, torques, data.held).prepared.choices
        return chosen.position_cutoff or 0.0, len(run.position), run.hashes.tobytes()

    return max(data.identification, key=rank)


def _for_all_rates(resolved: PreprocessChoices, given: PreprocessChoices, data: DataSplit) -> PreprocessChoices:
    """The cut-offs of the leading recording, low enough for the rate of every other."""
    runs = (*data.identification, *data.held_out)
    most = POSITION_CUTOFF_OF_RATE * min(1.0 / float(np.median(np.diff(np.unique(run.signals.time)))) for run in runs)
    if given.position_cutoff is None and resolved.position_cutoff is not None:
        resolved = replace(resolved, position_cutoff=min(resolved.position_cutoff, most))
    if given.torque_cutoff is None and resolved.torque_cutoff is not None:
        resolved = replace(resolved, torque_cutoff=min(resolved.torque_cutoff, most / POSITION_CUTOFF_PER_TORQUE))
    return resolved


def _prepare_run(
    kernel: RegressorKernel,
    run: RunWindow,
    resolved: PreprocessChoices,
    torques: Sequence[int],
    held: HeldFriction | None,
) -> PreparedRun:
    choices = replace(resolved, start=run.start, stop=run.stop)
    temperature = run.signals.temperature
    kernel.model.require_temperature(None if temperature is None else temperature.T, run.signals.label)
    prepared = leave_out_rest(kernel, prepare(run.signals, choices), run.signals.encoder_steps)
    if run.played:
        steps = (_played(step) if step.name == "window" else step for step in prepared.steps)
        prepared = replace(prepared, steps=tuple(steps))
    if held is not None:
        held.model.require_temperature(None if temperature is None else temperature.T, run.signals.label)
        prepared = held.taken_off(prepared)
    return PreparedRun(run.signals, choices, prepared, tuple(torques), overlap=run.overlap)


def _prepare_held_out(
    kernel: RegressorKernel,
    run: RunWindow,
    resolved: PreprocessChoices,
    torques: Sequence[int],
    held: HeldFriction | None,
) -> PreparedRun:
    """A held-out run; an error says which part of a recording it is about."""
    try:
        return _with_rest(_prepare_run(kernel, run, resolved, torques, held), held, played=run.played)
    except DataError as error:
        if not run.start:
            raise
        raise DataError(
            error.message,
            where=f"{run.signals.label} from {run.start:.4g} s on, which is held out",
            hint="hold out another part (--split), or give a held-out recording (--validate)",
        ) from error


def _with_rest(run: PreparedRun, held: HeldFriction | None, *, played: bool) -> PreparedRun:
    """The run with its samples at rest beside it."""
    if run.choices.keep_rest:
        return run
    kept = prepare_with_rest(run.signals, run.choices, played=played)
    return replace(run, with_rest=kept if held is None else held.taken_off(kept))


def _played(window: Step) -> Step:
    """The step 'window' with its reason."""
    return replace(window, text=f"{window.text}: the played motion, without the approach to its start")


def compare_run(kernel: RegressorKernel, parameters: FloatArray, run: PreparedRun) -> tuple[TorqueSeries, ...]:
    """Measured and predicted torques of a run for base parameters (b,), a series per segment."""
    prepared = run.prepared
    series = compare_torques(kernel.model, kernel.columns, parameters, prepared.segments, prepared.parallel_filter)
    return tuple(only_predicted(torque, run.torques) for torque in series)
