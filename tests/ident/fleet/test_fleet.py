"""A fleet: what its file means, what is done again, and what a failure costs."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import threading
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
from each import each

import dynid
from drivers.core import cluster
from drivers.core.errors import ConnectionFailedError, UsageError
from ident.fleet import fleet as running
from ident.fleet.fleet import FLEET_RESULT, identify_fleet
from ident.fleet.job import local_copies, run_job
from ident.fleet.plan import FAN_IN, Job, merges, read_fleet

FLEET = """
arms:
  - {name: cell-1, recordings: ["run*.h5"]}
  - {name: cell-2, recordings: [bad.h5, gone.h5, "s3://store/week.h5"], robot: ur10e}
methods: [ols, "energy:window=0.5"]
"""


def written(folder: Path, text: str) -> Path:
    (folder / "fleet.yaml").write_text(text)
    return folder / "fleet.yaml"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fleet") / "run.h5"
    dynid.simulate("up6", duration=4.0, seed=1, rate=100.0).save(path)
    return path


@pytest.fixture
def in_this_process(monkeypatch) -> None:
    monkeypatch.setattr("ident.fleet.fleet.outcomes", lambda jobs, out, *_: (run_job(job, out) for job in jobs))


def test_each_recording_with_each_method_is_a_job(tmp_path):
    for name in ("run1.h5", "run2.h5"):
        (tmp_path / name).touch()
    jobs = read_fleet(written(tmp_path, FLEET))
    assert [job.name for job in jobs[:4]] == [
        "cell-1/run1/ols", "cell-1/run1/energy-window-0.5", "cell-1/run2/ols", "cell-1/run2/energy-window-0.5",
    ]  # fmt: skip
    assert jobs[-1].recordings == ("s3://store/week.h5",)
    assert {job.robot for job in jobs} == {None, "ur10e"}
    assert [job.key() for job in jobs] == [job.key() for job in read_fleet(tmp_path / "fleet.yaml")]
    limits = read_fleet(written(tmp_path, FLEET + "options: {accept: limits.yaml}"))[0]
    assert dict(limits.options)["accept"] == str(tmp_path / "limits.yaml")
    before = limits.key()
    (tmp_path / "limits.yaml").write_text("relative_error: 0.1")
    assert limits.key() != before
    together = FLEET.replace('["run*.h5"]', '["run*.h5"], together: true')
    assert [len(job.recordings) for job in read_fleet(written(tmp_path, together))][:2] == [2, 2]


@each(
    ("text", "said"),
    [
        ("arms: []", "arms"),
        ("arms: [{name: ../x, recordings: [a.h5]}]", "name"),
        ("arms: [{name: a, recordings: [none*.h5]}]", "no file is named like"),
        ("arms: [{name: a, recordings: [strange*.h5]}]", "not UTF-8"),
        ("arms: [{name: a, recordings: [a.h5, a.h5]}]", "two results would be written to a/a/wls"),
        ("arms: [{name: a, recordings: [a.h5]}]\noptions: {decimat: 2}", "did you mean 'decimate'"),
        ("arms: [{name: a, recordings: [a.h5]}]\noptions: {runs: 2}", "not an option of identify"),
        ("arms: [{name: a, recordings: [a.h5]}]\noptions: {decimate: -2}", "decimate"),
        (
            "arms: [{name: a, recordings: [a.h5]}, {name: a, recordings: [b/a.h5]}]",
            "two results would be written to a/a/wls",
        ),
        ("arms: [{name: a, recordings: [a.h5], parts: 5}]", "parts"),
        ("arms: [{name: a, recordings: [a.h5], parts: .inf}]", "parts"),
        ("arms: [{name: a, recordings: [a.h5], parts: nan}]", "parts"),
        ("arms: [{name: a, recordings: [a.h5, b.h5], parts: 60, together: true}]", "omit 'together'"),
        ("arms: [{name: a, recordings: ['s3://x/a.h5'], parts: 60}]", "parts need files"),
        ("- 1", "mapping"),
    ],
)
def test_a_wrong_fleet_file_is_refused_before_any_work(tmp_path, text, said):
    (tmp_path / "strange\udcff.h5").touch()
    with pytest.raises(UsageError, match=said):
        identify_fleet(written(tmp_path, text), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("estimate_alone", "in_this_process")
def test_a_failure_costs_its_own_job_and_a_second_call_does_what_is_missing(tmp_path, run):
    (tmp_path / "run1.h5").write_bytes(run.read_bytes())
    (tmp_path / "bad.h5").write_text("no HDF5")
    text = "arms: [{name: a, recordings: [run1.h5, bad.h5, gone.h5]}]\nmethods: [ols]\noptions: {friction: coulomb}"
    file, out = written(tmp_path, text), tmp_path / "out"
    fleet = identify_fleet(file, out, history=tmp_path / "a.db")
    assert [bool(outcome.failure) for outcome in fleet.outcomes] == [False, True, True]
    assert "no such file" in fleet.failures[1].failure
    assert fleet.results.names == ("a/run1/ols",)
    assert json.loads((out / FLEET_RESULT).read_text())["total"] == 3
    page = (out / "report.html").read_text()
    assert 'href="a/run1/ols/report.html"' in page
    assert "no such file" in page
    assert 'http-equiv="refresh"' not in page
    assert dynid.History(tmp_path / "a.db").arms == ("up6",)

    (tmp_path / "gone.h5").write_bytes(run.read_bytes())
    again = identify_fleet(file, out)
    assert (again.repeated, [bool(outcome.failure) for outcome in again.outcomes]) == (2, [False, True, False])
    assert again.outcomes[0] == fleet.outcomes[0]
    (out / "a" / "gone" / "ols" / "job.json").write_text("{")  # a kill while it was written
    os.utime(tmp_path / "run1.h5", ns=(1, 1))
    assert identify_fleet(file, out).repeated == 3


def test_an_interrupted_fleet_says_what_stands(tmp_path, monkeypatch):
    def one_then_ctrl_c(jobs, out, *_):
        yield run_job(jobs[0], out)
        raise KeyboardInterrupt

    monkeypatch.setattr("ident.fleet.fleet.outcomes", one_then_ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        identify_fleet(written(tmp_path, "arms: [{name: a, recordings: [a.h5, b.h5]}]"), tmp_path / "out")
    overview = json.loads((tmp_path / "out" / FLEET_RESULT).read_text())
    assert ([job["name"] for job in overview["jobs"]], overview["total"]) == (["a/a/wls"], 2)
    assert 'http-equiv="refresh"' not in (tmp_path / "out" / "report.html").read_text()


def test_an_interrupted_worker_is_silent(tmp_path, monkeypatch, capfd):
    def ctrl_c(*_):
        raise KeyboardInterrupt

    (job,) = read_fleet(written(tmp_path, "arms: [{name: a, recordings: [a.h5]}]"))
    monkeypatch.setattr(running, "run_job", ctrl_c)
    assert "process died" in running._in_a_process(multiprocessing.get_context("fork"), job, str(tmp_path)).failure
    assert capfd.readouterr().err == ""


def test_a_worker_that_dies_is_an_outcome(tmp_path, monkeypatch):
    (job,) = read_fleet(written(tmp_path, "arms: [{name: a, recordings: [a.h5]}]"))
    monkeypatch.setattr(running, "run_job", lambda *_: os._exit(9))
    outcome = running._in_a_process(multiprocessing.get_context("fork"), job, str(tmp_path))
    assert outcome.failure.startswith("its process died (exit status 9)")


def test_a_worker_of_another_version_is_an_outcome(tmp_path):
    (job,) = read_fleet(written(tmp_path, "arms: [{name: a, recordings: [a.h5]}]"))
    future = Future()
    future.set_result(replace(run_job(job, str(tmp_path)), key="of another version", failure=""))
    assert "another version" in running._outcome(future, job).failure


def test_a_dask_cluster_does_the_same(tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
    jobs = read_fleet(written(tmp_path, "arms: [{name: a, recordings: [a.h5, b.h5]}]"))
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as local:
        ended = list(running.outcomes(jobs, str(tmp_path), 1, local.scheduler_address))
    assert sorted(outcome.name for outcome in ended) == ["a/a/wls", "a/b/wls"]
    assert all("no such file" in outcome.failure for outcome in ended)


def test_a_result_that_a_lost_scheduler_keeps_ends_its_future():
    class Lost:
        def add_done_callback(self, call):
            call(self)

        def result(self):
            raise OSError("stream is closed")

    executor = cluster.ClusterExecutor(SimpleNamespace(submit=lambda *_, **__: Lost()))
    with pytest.raises(OSError, match="stream is closed"):
        executor.submit(abs, 1).result(0)


def test_a_scheduler_that_is_not_there_is_named(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra 'dask'")
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.2)
    with pytest.raises(ConnectionFailedError, match="no Dask scheduler answers"):
        list(running.outcomes((), str(tmp_path), 1, "tcp://127.0.0.1:9"))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="needs Dask"):
        list(running.outcomes((), str(tmp_path), 1, "tcp://127.0.0.1:9"))


def assert_fetched(there: str, recording: Path, folder: Path) -> None:
    """What a server of this computer holds is fetched and removed again; what it does not hold fails its own job."""
    present, gone = read_fleet(written(folder, f"arms: [{{name: a, recordings: ['{there}', '{there}.gone']}}]"))
    with local_copies(present.recordings) as (path,):
        assert path.read_bytes() == recording.read_bytes()
    assert not path.exists()
    assert "FileNotFoundError" in run_job(gone, str(folder / "out")).failure


@pytest.mark.realtime
def test_a_recording_behind_a_web_address_is_fetched_by_the_worker(tmp_path, run):
    pytest.importorskip("aiohttp", reason="needs aiohttp")
    handler = partial(SimpleHTTPRequestHandler, directory=str(run.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        assert_fetched(f"http://127.0.0.1:{server.server_port}/{run.name}", run, tmp_path)
        server.shutdown()


@pytest.mark.realtime
def test_a_recording_in_an_object_store_is_fetched_by_the_worker(tmp_path, run, monkeypatch):
    """A server of moto, 100 MB with its client and so not among the tests' packages, answers as S3 does."""
    server = pytest.importorskip("moto.server", reason="needs moto[server]").ThreadedMotoServer(port=0, verbose=False)
    s3fs = pytest.importorskip("s3fs", reason="needs s3fs")
    server.start()
    try:
        host, port = server.get_host_and_port()
        settings = {"key": "k", "secret": "s", "endpoint_url": f"http://{host}:{port}"}
        monkeypatch.setitem(sys.modules["fsspec"].config.conf, "s3", settings)
        store = s3fs.S3FileSystem()
        store.mkdir("lab")
        store.put(str(run), "lab/week.h5")
        assert_fetched("s3://lab/week.h5", run, tmp_path)
    finally:
        server.stop()


@pytest.mark.usefixtures("in_this_process")
def test_the_results_of_another_fleet_are_left_alone(tmp_path):
    arms = ["arms: [{name: a, recordings: [a.h5]}]", "arms: [{name: b, recordings: [a.h5]}]"]
    identify_fleet(written(tmp_path, arms[0]), tmp_path / "out")
    with pytest.raises(UsageError, match="another fleet's results"):
        identify_fleet(written(tmp_path, arms[1]), tmp_path / "out")
    assert len(identify_fleet(written(tmp_path, arms[0]), tmp_path / "out").outcomes) == 1


def test_a_folder_of_another_kind_is_left_alone(tmp_path, run):
    (tmp_path / "report.html").write_text("of something else")
    with pytest.raises(UsageError, match="exists already"):
        identify_fleet(written(tmp_path, f"arms: [{{name: a, recordings: [{run}]}}]"), tmp_path)


@pytest.mark.usefixtures("estimate_alone", "in_this_process")
def test_a_long_recording_is_identified_in_parts_that_are_merged(tmp_path, three_joint):
    dynid.simulate(three_joint, duration=34.0, rate=50.0, seed=1).save(tmp_path / "week.h5")
    out = tmp_path / "out"
    options = "{friction: coulomb-viscous, delay: 0}"
    text = f"arms: [{{name: a, recordings: [week.h5], parts: 11}}]\nmethods: [ols]\noptions: {options}"
    fleet = identify_fleet(written(tmp_path, text), out)
    assert [outcome.name for outcome in fleet.outcomes] == [
        *(f"a/week-part-000{number}/ols" for number in (1, 2, 3)), "a/merged/ols",
    ]  # fmt: skip
    assert not fleet.failures
    assert (fleet.total, fleet.repeated) == (4, 4)
    used = dynid.load_model(out / "a" / "merged" / "ols").result.recordings
    assert [use.file for use in used if use.role == "identification"] == [
        "week.h5, 0 to 11.3267 s", "week.h5, 11.3267 to 22.6533 s", "week.h5, 22.6533 to 34 s",
    ]  # fmt: skip
    assert identify_fleet(tmp_path / "fleet.yaml", out).repeated == 0
    # A part that is lost is done again, and the merge that it belongs to.
    (out / "a" / "week-part-0002" / "ols" / "job.json").unlink()
    assert identify_fleet(tmp_path / "fleet.yaml", out).repeated == 1
    (out / "a" / "week-part-0002" / "ols" / "job.json").unlink()
    (out / "a" / "merged" / "ols" / "job.json").unlink()
    assert identify_fleet(tmp_path / "fleet.yaml", out).repeated == 2


def test_merging_is_a_tree_of_which_every_part_is_a_leaf(tmp_path):
    part = Job("a/x-part-0001/wls", "a", ("x.h5",), (), None, "wls", (), (0.0, 1.0))
    for count in (1, 2, FAN_IN, FAN_IN + 1, 3 * FAN_IN, FAN_IN**2 + 1):
        parts = [replace(part, name=f"a/x-part-{number:04d}/wls") for number in range(count)]
        levels = list(merges(parts))
        below = [job.name for job in parts]
        for level in levels:
            assert sorted(name for job in level for name in job.merged or ()) == sorted(below)
            assert all(2 <= len(job.merged or ()) <= FAN_IN for job in level)
            below = [job.name for job in level]
        assert below == (["a/merged/wls"] if count > 1 else ["a/x-part-0000/wls"])
    whole = Job("a/x/wls", "a", ("x.h5",), (), None, "wls", ())
    assert list(merges([whole])) == []


def test_where_no_part_has_a_result_nothing_else_is_identified_in_their_place(tmp_path, run):
    job = Job("a/merged/wls", "a", (str(run),), (), None, "wls", (), merged=())
    assert "merging needs at least two models" in run_job(job, str(tmp_path)).failure


def test_a_long_recording_that_cannot_be_read_is_its_own_jobs_failure(tmp_path):
    (tmp_path / "bad.h5").write_text("no HDF5")
    text = "arms: [{name: a, recordings: [bad.h5, gone.h5], parts: 60}]"
    jobs = read_fleet(written(tmp_path, text))
    assert [job.name for job in jobs] == ["a/bad/wls", "a/gone/wls"]
    assert ["is not an HDF5 file" in run_job(jobs[0], str(tmp_path)).failure, list(merges(jobs))] == [True, []]
