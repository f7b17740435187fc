"""Workers of a fleet's jobs: processes of this computer, one per job, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.blas import one_blas_thread
from drivers.core.child_process import started_without_main
from drivers.core.cluster import cluster_executor, why_lost
from ident.fleet.job import JobOutcome, run_job
from ident.fleet.plan import Job

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
    """Run a job in a process of its own, which gives its memory back and takes nobody with it when it dies."""
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
    with sending, one_blas_thread(), suppress(KeyboardInterrupt):  # Ctrl-C comes to every process of a terminal
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
