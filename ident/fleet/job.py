"""One job of a fleet, as a worker runs it: recordings in, a folder with result and report out."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from daq.output_files import RESULT_FILE, replace_files
from daq.recording.reader import read_recording
from drivers.core.cluster import peak_memory
from drivers.core.errors import DynidError, UsageError
from drivers.core.text import parsed_json
from ident.fleet.plan import Job, is_url

if TYPE_CHECKING:
    from ident.tasks.identification import IdentificationResult

JOB_FILE = "job.json"
"""Name of the outcome beside the result; written last, so that what is not whole is done again."""

BLOCK = 4 * 2**20
"""Bytes that are fetched at once from a URL."""


@dataclass(frozen=True)
class JobOutcome:
    """What became of a job."""

    # name, arm, method: of the job
    name: str
    arm: str
    method: str
    recordings: tuple[str, ...]  # their paths
    key: str  # of the job
    failure: str = ""  # why there is no result; empty where there is one
    grade: str = ""  # of the model for torque prediction, or for its purpose
    headline: str = ""  # the verdict in a sentence
    # held-out error of the delivered model over all samples, a ratio; None where it has none
    error: float | None = None
    worst_joint: str = ""  # by that error; empty where there is none
    seconds: float = 0.0  # CPU time [s]
    peak_memory: float = 0.0  # of the worker so far [MB]; nan where the system does not tell


def run_job(job: Job, out: str) -> JobOutcome:
    """Identify, and write result, report and outcome into the job's folder below `out`; a failure is an outcome, too.

    BLAS should run on one thread: the result then does not depend on the number of workers.
    """
    begun = time.process_time()
    folder = Path(out, job.name)
    key = job.key()
    failure, figures = "", {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        figures = _identified(job, folder)
    except DynidError as error:
        failure = str(error)
    except Exception as error:  # one recording must not end the fleet
        failure = f"{type(error).__name__}: {error}"
    outcome = JobOutcome(
        job.name,
        job.arm,
        job.method,
        job.recordings,
        key,
        failure=" ".join(failure.split()),
        seconds=time.process_time() - begun,
        peak_memory=peak_memory(),
        **figures,
    )
    if folder.is_dir():
        replace_files({folder / JOB_FILE: json.dumps(asdict(outcome), indent=1) + "\n"})
    return outcome


def finished(job: Job, out: Path) -> JobOutcome | None:
    """The outcome of a job whose result stands already; None where it failed, is not whole, or its inputs changed."""
    folder = out / job.name
    try:
        content = parsed_json((folder / JOB_FILE).read_text(encoding="utf-8"))
        outcome = JobOutcome(**{**content, "recordings": tuple(content["recordings"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None
    whole = not outcome.failure and (folder / RESULT_FILE).is_file()
    return outcome if whole and outcome.key == job.key() else None


def _identified(job: Job, folder: Path) -> dict[str, Any]:
    from ident.tasks.identification import identify

    if job.merged is not None:
        from ident.tasks.validation import merge

        top = folder.parents[job.name.count("/")]
        held_out = Path(job.validation[0]) if job.validation else None
        result = merge([top / name for name in job.merged], validation=held_out)
        result.save(folder, overwrite=True)
        return _figures(result)
    with local_copies((*job.recordings, *job.validation)) as paths:
        runs, validation = paths[: len(job.recordings)], paths[len(job.recordings) :]
        if job.method == "servo":
            from ident.tasks.servo import identify_servo

            if job.options:
                raise UsageError("a servo model has no options", where=job.options[0][0])
            servo = identify_servo(runs, validation=validation, robot=job.robot)
            servo.save(folder, overwrite=True)
            return {"grade": servo.result.verdict.grade, "headline": servo.verdict.split("\n")[0]}
        result = identify(
            runs if job.part is None else [read_recording(path, job.part) for path in runs],
            validation=validation,
            robot=job.robot,
            method=job.method,
            **dict(job.options),
        )
        result.save(folder, overwrite=True)
    return _figures(result)


def _figures(found: IdentificationResult) -> dict[str, Any]:
    verdict, errors = found.verdict, found.delivered.validation_all_samples
    return {
        "grade": verdict.purposes["torque_prediction"].grade,
        "headline": verdict.headline,
        "error": errors.relative_error if errors else None,
        "worst_joint": verdict.joints[0].joint if verdict.joints else "",
    }


@contextmanager
def local_copies(places: Sequence[str]) -> Iterator[list[Path]]:
    """Paths of the recordings; what has a URL is fetched into a folder of its own, block by block.

    Raises:
        UsageError: fsspec, or what it needs for this kind of URL, is not installed; or it cannot be fetched.
    """
    if not any(map(is_url, places)):  # no folder that a worker which is killed would leave behind
        yield [Path(place) for place in places]
        return
    with TemporaryDirectory(prefix="dynid-fleet-") as temporary:
        yield [
            _fetched(place, Path(temporary, f"{number}-{place.rpartition('/')[2]}")) if is_url(place) else Path(place)
            for number, place in enumerate(places)
        ]


def _fetched(url: str, path: Path) -> Path:
    try:
        import fsspec
    except ImportError as error:
        raise UsageError("URLs need fsspec", where=url, hint="pip install 'dynid[dask]'") from error
    try:
        with fsspec.open(url, "rb") as source, path.open("wb") as copy:
            while block := source.read(BLOCK):
                copy.write(block)
    except Exception as error:  # every kind of store has errors of its own
        raise UsageError(f"cannot be fetched: {type(error).__name__}: {error}", where=url) from error
    return path
