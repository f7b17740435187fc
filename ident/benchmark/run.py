"""Judge every entry on every data set, each in a process of its own, so that one's imports and failures are its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from daq.recording.recording import Recording
from drivers.core.child_process import end_with_parent, started_without_main
from drivers.core.cluster import cluster_executor, peak_memory, why_lost
from drivers.core.errors import DataError, DynidError
from drivers.core.reading_process import Progress
from drivers.core.software import software_versions
from ident.benchmark.dataset import Dataset, LoadedData, download, load_dataset, part
from ident.benchmark.entry import (
    METHODS,
    SERVO_METHODS,
    Training,
    kind_of,
    load_method,
    servo_predictor,
    torque_predictor,
)
from ident.benchmark.judge import agreement, judge_servo, judge_torques
from ident.benchmark.motion import BenchmarkMotion, motions
from ident.benchmark.results import Benchmark, Entry, Skipped


def run_benchmark(
    datasets: Sequence[Dataset],
    methods: dict[str, str],
    folder: Path,
    *,
    fetch: bool = False,
    scheduler: str = "",
    progress: Progress = lambda step: None,
) -> Benchmark:
    """Every method, by its name and `module:function`, on every data set in the folder.

    With `fetch` what the folder lacks and has an address is downloaded. The workers of a Dask scheduler
    (tcp://host:8786) must see the folder; without one this computer works.

    Raises:
        DataError: the folder has none of the data sets.
        WorkError: a download failed.
        UsageError, ConnectionFailedError: no such cluster.
    """
    skipped: list[Skipped] = []
    present = []
    for dataset in datasets:
        try:
            if fetch:
                download(dataset, folder)
            load_dataset(dataset, folder)
        except DataError as error:
            skipped.append(Skipped(dataset.name, str(error)))
            continue
        present.append(dataset)
    if not present:
        raise DataError(skipped[0].reason if skipped else "no data set is named")
    with _judge(folder, scheduler) as judge:
        begun = []
        for dataset in present:
            for name, place in methods.items():
                if METHODS.get(name) == place and (name in SERVO_METHODS) != (dataset.kind == "servo"):
                    continue
                progress(f"{dataset.name}: {name}")
                begun.append((Entry(dataset.name, name), judge(dataset, name, place)))
        entries = [entry for empty, judged in begun if (entry := _entry(empty, judged)) is not None]
    return Benchmark(tuple(present), tuple(entries), tuple(skipped), dict(software_versions()))


Judge = Callable[[Dataset, str, str], Future[Entry | None]]


@contextmanager
def _judge(folder: Path, scheduler: str) -> Iterator[Judge]:
    """What judges: the workers of a cluster, else one process after the other, so that none slows another down."""
    if scheduler:
        with cluster_executor(scheduler) as executor:
            yield lambda dataset, name, place: executor.submit(judge_method, dataset, name, place, folder.absolute())
        return

    def in_a_process(dataset: Dataset, name: str, place: str) -> Future[Entry | None]:
        pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent)
        with pool, started_without_main():
            return pool.submit(judge_method, dataset, name, place, folder)

    yield in_a_process


def _entry(empty: Entry, judging: Future[Entry | None]) -> Entry | None:
    """A method's figures on a data set; None where it is not for this kind."""
    try:
        return judging.result()
    except DynidError as error:
        return replace(empty, failure=str(error))
    except CancelledError as error:
        return replace(empty, failure=why_lost(error))
    except BrokenProcessPool:
        return replace(empty, failure="its process ended: out of memory, or a crash")
    except (Exception, SystemExit) as error:  # what a third party's method raises is its result, not the others' end
        return replace(empty, failure=f"{type(error).__name__}: {error}")


def judge_method(dataset: Dataset, name: str, place: str, folder: Path) -> Entry | None:
    """Train a method and judge it; in the process that calls. None where it is not for this kind of data.

    Raises:
        DynidError: the method cannot be found, does not suit the data, or predicts what cannot be compared.
    """
    method = load_method(place)
    if kind_of(method) != dataset.kind:
        return None
    data = load_dataset(dataset, folder)
    training = Training(data.robot, data.train, _motions(data, data.train))
    start = time.process_time()
    predicted = method(training)
    seconds = time.process_time() - start
    if dataset.kind == "servo":
        score = judge_servo(servo_predictor(predicted, place), data.test, data.robot, dataset.judged)
        return Entry(dataset.name, name, score, None, seconds, peak_memory())
    predictor = torque_predictor(predicted, place)
    torques = judge_torques(predictor, list(_motions(data, data.test)), data.robot)
    parameters = None
    if predictor.parameters:
        first, second = (torque_predictor(method(half), place) for half in _halves(data))
        parameters = agreement(first, second)
    return Entry(dataset.name, name, torques, parameters, seconds, peak_memory())


def _motions(data: LoadedData, recordings: Sequence[Recording]) -> tuple[BenchmarkMotion, ...]:
    if data.dataset.kind == "servo":
        return ()
    of = data.dataset
    return tuple(
        motion for recording in recordings for motion in motions(recording, data.robot, of.rate, of.states, of.band)
    )


def _halves(data: LoadedData) -> tuple[Training, Training]:
    """Two trainings without a common sample: half of the recordings each, or the halves of a single one."""
    runs = data.train
    if len(runs) > 1:
        sides = runs[::2], runs[1::2]
    else:
        times = [stream.time for stream in runs[0].streams.values() if len(stream.time)]
        middle = 0.5 * (max(float(time[-1]) for time in times) - min(float(time[0]) for time in times))
        sides = (part(runs[0], 0.0, middle),), (part(runs[0], middle, None),)
    first, second = (Training(data.robot, side, _motions(data, side)) for side in sides)
    return first, second
