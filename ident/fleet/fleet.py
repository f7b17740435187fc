"""Identify a fleet in one call: what is done stands, what failed is listed, what is missing is done next time."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection
from os import PathLike
from pathlib import Path
from typing import Any

from daq.output_files import REPORT_FILE, check_output_folder, replace_files
from drivers.core.child_process import end_with_parent, started_without_main
from drivers.core.clock import SYSTEM_CLOCK
from drivers.core.cluster import cluster_executor, why_lost
from drivers.core.errors import UsageError
from drivers.core.files import path_of
from drivers.core.numerics import numerical_settings
from drivers.core.reading_process import Progress
from drivers.core.text import in_percent, parsed_json
from ident.fleet.job import JobOutcome, finished, run_job
from ident.fleet.plan import Job, merges, read_fleet
from ident.report.html_file import rendered
from ident.report.section import Tile
from ident.result.tables import Cell, Table, table_of_rows
from ident.tasks.history import History
from ident.tasks.options import silent
from ident.verdict.verdict import GRADES

PRELOADED = ["ident.fleet.job", "ident.tasks.identification", "jinja2", "pinocchio", "scipy.special", "threadpoolctl"]
"""What every job needs, imported once for all."""


def outcomes(jobs: Sequence[Job], out: str, workers: int, scheduler: str) -> Iterator[JobOutcome]:
    """Run jobs, and give each outcome as it comes; a job whose worker dies fails, the others go on.

    Raises:
        UsageError: Dask is not installed.
        ConnectionFailedError: the scheduler does not answer.
    """
    with _submitter(workers, scheduler) as submit:
        futures = {submit(job, out): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield _outcome(future, futures[future])
        finally:
            for future in futures:
                future.cancel()


Submit = Callable[[Job, str], Future[JobOutcome]]


@contextmanager
def _submitter(workers: int, scheduler: str) -> Iterator[Submit]:
    if not scheduler:
        with ThreadPoolExecutor(workers) as pool:
            context = multiprocessing.get_context("forkserver")
            context.set_forkserver_preload(PRELOADED)
            yield lambda job, out: pool.submit(_in_a_process, context, job, out)
        return
    with cluster_executor(scheduler) as executor:
        yield lambda job, out: executor.submit(run_job, job, out)


def _in_a_process(context: Any, job: Job, out: str) -> JobOutcome:
    """Run a job in a process of its own, which frees its memory and ends no other job when it dies."""
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(sending, job, out))  # it starts processes itself
    with started_without_main():
        process.start()
    sending.close()
    try:
        with receiving:
            return receiving.recv()  # type: ignore[no-any-return]
    except EOFError:
        process.join()
        return _failed(job, f"its process died (exit status {process.exitcode})")
    finally:
        process.join()


def _work(sending: Connection, job: Job, out: str) -> None:
    end_with_parent()
    with sending, numerical_settings(), suppress(KeyboardInterrupt):  # Ctrl-C comes to every process of a terminal
        sending.send(run_job(job, out))


def _outcome(future: Future[JobOutcome], job: Job) -> JobOutcome:
    try:
        outcome = future.result()
    except Exception as error:  # Dask's KilledWorker, or what cannot be sent
        return _failed(job, why_lost(error))
    if outcome.key != job.key():
        return _failed(job, "its worker has another version of dynid or another file, or the recording has changed")
    return outcome


def _failed(job: Job, why: str) -> JobOutcome:
    empty = JobOutcome(job.name, job.arm, job.method, job.recordings, job.key())
    return replace(empty, failure=f"{why}; run the fleet again to repeat it")


FLEET_RESULT = "fleet.json"
REFRESH = 5.0
"""The page is written so often while jobs run, and loads itself again [s]."""


@dataclass(frozen=True)
class Fleet:
    """What became of a fleet.

    Attributes:
        folder: of all results.
        outcomes: of each job that has ended, in the file's order.
        total: number of jobs.
        repeated: how many of them this call has done; the others stood already.

    Example:
        >>> from pathlib import Path
        >>> import dynid
        >>> dynid.Fleet(Path("results"), (), total=3, repeated=0).summary
        '0 of 3 results: 3 to do'
    """

    folder: Path
    outcomes: tuple[JobOutcome, ...]
    total: int
    repeated: int

    @property
    def results(self) -> Table:
        """A row per result: held-out error over all samples, grade for torque prediction, worst joint, CPU time."""
        headings = [("name", ""), ("arm", ""), ("error", "%"), ("grade", ""), ("worst_joint", ""), ("cpu_time", "s")]
        rows: list[tuple[Cell, ...]] = [
            (outcome.name, outcome.arm, in_percent(outcome.error), outcome.grade, outcome.worst_joint, outcome.seconds)
            for outcome in self.done
        ]
        return table_of_rows(f"Results in {self.folder}", headings, rows)

    @property
    def done(self) -> tuple[JobOutcome, ...]:
        """Jobs with a result."""
        return tuple(outcome for outcome in self.outcomes if not outcome.failure)

    @property
    def failures(self) -> tuple[JobOutcome, ...]:
        """Jobs without a result, each with the reason."""
        return tuple(outcome for outcome in self.outcomes if outcome.failure)

    @property
    def summary(self) -> str:
        """Return how many there are of each grade, and how many failed, in a line."""
        grades = [outcome.grade for outcome in self.done]
        counts = [f"{grades.count(grade)} {grade}" for grade in GRADES if grade in grades]
        failed = [f"{len(self.failures)} failed"] if self.failures else []
        waiting = [f"{self.total - len(self.outcomes)} to do"] if len(self.outcomes) < self.total else []
        return f"{len(grades)} of {self.total} results: {', '.join(counts + failed + waiting)}"

    def to_json(self) -> str:
        """The text of `fleet.json`."""
        content = {"total": self.total, "jobs": [asdict(outcome) for outcome in self.outcomes]}
        return json.dumps(content, indent=1)

    def page(self, *, running: bool) -> str:
        """The overview with a link to each report; while it is `running` it loads itself again."""
        tiles = [
            Tile("Results", f"{len(self.done)} of {self.total}", f"{len(self.failures)} failed"),
            *(Tile(grade.title(), str(sum(outcome.grade == grade for outcome in self.done))) for grade in GRADES),
        ]
        content: dict[str, Any] = {"fleet": self, "tiles": tiles, "report": REPORT_FILE}
        refresh = int(REFRESH) if running else 0
        return rendered("fleet_page", **content, refresh=refresh)

    def write(self, *, running: bool = False) -> None:
        """Write `fleet.json` and `report.html` into the folder."""
        texts = {FLEET_RESULT: self.to_json() + "\n", REPORT_FILE: self.page(running=running)}
        replace_files({self.folder / name: text for name, text in texts.items()})


def identify_fleet(
    file: str | PathLike[str],
    out: str | PathLike[str],
    *,
    workers: int | None = None,
    scheduler: str = "",
    history: str | PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Fleet:
    """Identify every recording of every arm of a fleet file with every method; what stands already is not repeated.

    In a script, call it below `if __name__ == "__main__":`, as workers import the script.

    Args:
        file: the fleet file (docs/fleet.md).
        out: folder of all results; of an earlier call, which goes on.
        workers: processes at once on this computer; one per core where None.
        scheduler: address of a Dask scheduler (tcp://host:8786) in place of them.
        history: database of `dynid history` that every result is added to.
        overwrite: replace the overview of a folder that is not a fleet's.
        progress: called after each job.

    Returns:
        Every outcome. A job that fails (a recording that cannot be read, a worker that dies) is among them.

    Raises:
        UsageError: the file is wrong, the folder holds something else, or Dask is not installed.
        ConnectionFailedError: no scheduler answers.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.identify_fleet("no-fleet.yaml", "results")
        ... except dynid.UsageError as error:
        ...     print(error)
        no-fleet.yaml: no such file
    """
    folder = path_of(out)
    count = (os.cpu_count() or 1) if workers is None else workers
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise UsageError(f"{workers!r} workers cannot do any work", where="--workers", hint="1 or more")
    written_to, inputs = (FLEET_RESULT, REPORT_FILE), [path_of(file)]
    earlier = _earlier_jobs(folder / FLEET_RESULT)
    check_output_folder(folder, written_to, inputs, overwrite=overwrite or earlier is not None)
    jobs = read_fleet(path_of(file))
    stages = [jobs, *merges(jobs)]
    names = [job.name for stage in stages for job in stage]
    if earlier and earlier.isdisjoint(names) and not overwrite:
        raise UsageError(
            "holds another fleet's results",
            where=str(folder),
            hint="choose another folder, or replace its overview: --force, in Python overwrite=True",
        )
    folder.mkdir(parents=True, exist_ok=True)
    by_name = {job.name: outcome for job in jobs if (outcome := finished(job, folder)) is not None}
    repeated = 0

    def fleet() -> Fleet:
        return Fleet(folder, tuple(by_name[name] for name in names if name in by_name), len(names), repeated)

    written = SYSTEM_CLOCK.now()
    fleet().write(running=True)
    progress(f"{len(jobs) - len(by_name)} of {len(jobs)} results to do")
    try:
        for stage in stages:
            standing = (_of_what_stands(job, by_name) for job in stage)
            missing = [job for job in standing if not _kept(job, folder, by_name)]
            repeated += len(missing)
            for outcome in outcomes(missing, str(folder.resolve()), count, scheduler):
                by_name[outcome.name] = outcome
                progress(f"{100 * len(by_name) // len(names)} %: {outcome.name} {outcome.failure or outcome.grade}")
                if SYSTEM_CLOCK.now() - written > REFRESH:
                    written = SYSTEM_CLOCK.now()
                    fleet().write(running=True)
    finally:  # Ctrl-C, too: the overview says what stands, and no longer loads itself again
        ended = fleet()
        ended.write()
    if history is not None and ended.done:
        History(history).add(*(folder / outcome.name for outcome in ended.done))
    return ended


def _of_what_stands(job: Job, by_name: Mapping[str, JobOutcome]) -> Job:
    """A merge of those parts that have a result; another job as it is."""
    if job.merged is None:
        return job
    return replace(job, merged=tuple(name for name in job.merged if name in by_name and not by_name[name].failure))


def _kept(job: Job, folder: Path, by_name: dict[str, JobOutcome]) -> bool:
    """Return whether an earlier call has done a job already; its outcome is then among those known."""
    outcome = by_name.get(job.name) or finished(job, folder)
    if outcome is not None:
        by_name[job.name] = outcome
    return outcome is not None


def _earlier_jobs(file: Path) -> set[str] | None:
    """Names of the jobs that an earlier call has done; None where a regular file is not what one has written."""
    try:
        content = parsed_json(file.read_text(encoding="utf-8")) if file.is_file() and not file.is_symlink() else None
        return None if content is None else {job["name"] for job in content["jobs"]}
    except (OSError, ValueError, TypeError, KeyError):
        return None
