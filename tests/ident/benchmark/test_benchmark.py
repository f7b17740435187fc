"""The benchmark: what its judge measures of predictors whose errors are known, and what it refuses."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import re
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from daq.recording.reader import read_recording
from daq.recording.recording import Recording
from daq.recording.writer import write_recording
from daq.robot.loader import load_robot
from drivers.core.errors import DataError, UsageError, WorkError
from ident.benchmark import dataset as datasets
from ident.benchmark import run
from ident.benchmark.dataset import (
    Dataset,
    chosen_datasets,
    load_dataset,
    missing_files,
    parse_dataset,
    part,
    registered,
)
from ident.benchmark.entries import mujoco_sysid
from ident.benchmark.entry import (
    METHODS,
    SERVO_METHODS,
    ServoPredictor,
    TorquePredictor,
    Training,
    chosen_methods,
    kind_of,
    load_method,
    torque_predictor,
)
from ident.benchmark.judge import agreement, forward_error, judge_servo, judge_torques
from ident.benchmark.motion import motions
from ident.benchmark.results import Benchmark, Entry
from ident.benchmark.run import judge_method, run_benchmark
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from sim_drivers.synthetic.measurement import random_fourier_motion
from sim_drivers.synthetic.servo import simulate_servo

ROBOT = load_robot("up6")
MODEL, TRUTH = build_model(ROBOT), truth_vector(ROBOT)
REPOSITORY = Path(__file__).resolve().parents[3]


def truth(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    return model_torque(MODEL, None, TRUTH, q.T, dq.T, ddq.T).T


@pytest.fixture(scope="module")
def mirror(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two exact recordings, torques without noise, and their data set."""
    folder = tmp_path_factory.mktemp("mirror")
    listed = {}
    for number in (1, 2):
        time = np.arange(0.0, 10.0, 0.01)
        states = random_fourier_motion(MODEL, 10.0, seed=number).evaluate(time)
        q, dq, ddq = (values.T for values in states)
        write_recording(
            folder / f"run{number}.h5", Recording.from_arrays(ROBOT, time=time, position=q, torque=truth(q, dq, ddq))
        )
        listed[f"run{number}.h5"] = {"sha256": hashlib.sha256((folder / f"run{number}.h5").read_bytes()).hexdigest()}
    content = {
        "name": "exact",
        "title": "Exact",
        "source": {"repository": "example.org/arm", "commit": "1", "path": "runs", "licence": "CC0-1.0"},
        "files": listed,
        "robot": "up6",
        "units": {"torque": "N·m"},
        "runs": [{"file": "run1.h5", "role": "train"}, {"file": "run2.h5", "role": "test"}],
    }
    (folder / "exact.yaml").write_text(yaml.safe_dump(content))
    return folder


@pytest.fixture(scope="module")
def exact(mirror: Path) -> Dataset:
    (dataset,) = chosen_datasets([str(mirror / "exact.yaml")])
    return dataset


@pytest.fixture(scope="module")
def held_out(mirror: Path, exact: Dataset):
    (recording,) = load_dataset(exact, mirror).test
    return motions(recording, ROBOT, 500.0, 10.0, 5.0)


def test_the_truth_has_no_error_and_simulates(held_out):
    score = judge_torques(TorquePredictor(truth), held_out, ROBOT)
    assert score.relative_error < 1.0
    assert score.forward is not None
    assert score.forward.ratio < 0.2
    assert score.forward.diverged == 0.0
    assert score.positive_inertia == 100.0


def test_errors_are_the_ones_that_were_made(held_out):
    half = judge_torques(TorquePredictor(lambda q, dq, ddq: 0.5 * truth(q, dq, ddq)), held_out, ROBOT)
    assert half.relative_error == pytest.approx(50.0, abs=1.0)
    offset = np.array([1.0, 0.0, 3.0])
    moved = judge_torques(TorquePredictor(lambda q, dq, ddq: truth(q, dq, ddq) + offset), held_out, ROBOT)
    assert [joint.band for joint in moved.joints] == pytest.approx(offset, abs=0.5)
    opposite = forward_error(TorquePredictor(lambda q, dq, ddq: truth(q, dq, -ddq)), held_out)
    assert opposite is not None
    assert opposite.ratio > 1.0


def test_a_delay_is_the_methods_to_find(held_out):
    (motion,) = held_out
    late = replace(motion, torque=np.roll(motion.torque, 5, axis=0))  # 50 ms at 100 Hz
    assert judge_torques(TorquePredictor(truth, delay=0.05), [late], ROBOT).relative_error < 1.0
    assert judge_torques(TorquePredictor(truth), [late], ROBOT).relative_error > 2.0


def test_bodies_and_intervals(held_out):
    sound, impossible = [0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0, 1.0], [0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0, -1.0]
    score = judge_torques(TorquePredictor(truth, bodies=np.array([sound, impossible, sound])), held_out, ROBOT)
    assert (score.consistent_links, score.links) == (2, 3)
    first = TorquePredictor(truth, parameters={"a": (1.0, 0.1), "b": (1.0, 0.1), "c": (0.0, 1.0)})
    assert agreement(first, replace(first, parameters={"a": (1.2, 0.1), "b": (1.5, 0.1)})) == (2, 1)
    assert agreement(first, TorquePredictor(truth)) is None


@pytest.mark.parametrize("name", ["pinocchio-lstsq", "ridge", "nearest-neighbour"])
def test_the_plain_methods_learn(mirror, exact, name):
    score = judge_method(exact, name, METHODS[name], mirror).score
    limit = {"pinocchio-lstsq": 2.0}.get(name, 100.0)
    assert score.relative_error < limit


def test_losses_come_first_and_failures_are_named(mirror, exact, held_out, tmp_path):
    close, closer = (
        judge_torques(TorquePredictor(lambda q, dq, ddq, by=by: by * truth(q, dq, ddq)), held_out, ROBOT)
        for by in (0.8, 0.9)
    )
    listed = (Entry("exact", "dynid", close), Entry("exact", "peer", closer), Entry("exact", "other", failure="broke"))
    benchmark = Benchmark((exact,), listed, (), {"numpy": "2"})
    (row, *_) = list(benchmark.losses)
    assert (row["entry"], row["significant"]) == ("peer", "yes")
    assert benchmark.tables[0].names == ("peer", "dynid")
    assert benchmark.failures == ("exact, other: broke",)
    benchmark.save(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "benchmark.json").read_text())["losses"][0]["entry"] == "peer"
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("Where dynid loses") < page.index('id="exact"')
    none = Benchmark((exact,), (Entry("exact", "dynid", closer), Entry("exact", "peer", close)), (), {})
    assert len(none.losses) == 0


class Elsewhere(ThreadPoolExecutor):
    """A worker in another folder, which finds what has a whole path; of the second task the scheduler is lost."""

    def submit(self, fn, dataset, name, place, folder):
        assert folder.is_absolute()
        lost = Future()
        lost.set_exception(CancelledError())
        return super().submit(fn, dataset, name, place, folder) if place.startswith("documented") else lost


def test_the_method_of_the_docs_runs_from_the_current_folder(mirror, exact, monkeypatch, tmp_path):
    text = (REPOSITORY / "docs" / "benchmark.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert block is not None
    (tmp_path / "documented_method.py").write_text(f"{block[1]}\n\ndef leave(training):\n    raise SystemExit(0)\n")
    monkeypatch.chdir(tmp_path)
    # Threads in place of processes, which take seconds to start; what goes to them and comes back must be picklable.
    monkeypatch.setattr(run, "ProcessPoolExecutor", lambda workers, **_: ThreadPoolExecutor(workers))
    places = ("documented_method:leave", "documented_method:fit", "no_such_module:fit")
    result = run_benchmark([exact], chosen_methods(places), mirror)
    left, entry, lost = pickle.loads(pickle.dumps(result.entries))
    assert pickle.loads(pickle.dumps(exact)) == exact
    assert (left.failure, entry.failure) == ("SystemExit: 0", "")
    assert 5.0 < entry.error < 120.0
    assert entry.memory > 10.0
    assert "cannot be imported" in lost.failure
    monkeypatch.setattr(run, "cluster_executor", lambda _: Elsewhere(1))
    methods, place = chosen_methods(("documented_method:fit", "other:fit")), Path(os.path.relpath(mirror))
    far = run_benchmark([exact], methods, place, scheduler="tcp://elsewhere")
    assert far.entries[1].failure == "the scheduler was lost before it was done"
    assert [(one.method, one.score) for one in far.entries[:1]] == [(entry.method, entry.score)]


def test_the_data_set_of_the_docs_is_valid():
    text = (REPOSITORY / "docs" / "benchmark.md").read_text(encoding="utf-8")
    block = re.search(r"```yaml\n(.*?)```", text, re.DOTALL)
    assert block is not None
    assert parse_dataset(block[1], "docs").name == "mine"


def test_registered_data_sets_and_methods_are_whole():
    assert {"tx40", "ur10", "panda", "so101"} <= set(registered())
    for name, place in METHODS.items():
        assert kind_of(load_method(place)) == ("servo" if name in SERVO_METHODS else "torque")


@pytest.mark.realdata
def test_the_registered_files_are_those_of_the_mirror(data_dir):
    for dataset in registered().values():
        assert missing_files(dataset, data_dir) == []
        for name, file in dataset.files.items():
            assert hashlib.sha256((data_dir / name).read_bytes()).hexdigest() == file.sha256
    data = load_dataset(registered()["ur10"], data_dir)
    assert [len(run.time) for run in (*data.train, *data.test)] == pytest.approx([2376, 1065], abs=2)


def test_what_does_not_fit_is_refused_in_words(mirror, exact, tmp_path):
    content = yaml.safe_load((mirror / "exact.yaml").read_text())
    wrong = {
        "overlap": {"runs": [{"file": "run1.h5", "role": role} for role in ("train", "test")]},
        "leaves the mirror": {"files": {"../run1.h5": {"sha256": "0" * 64}}},
        "https": {"files": {"run1.h5": {"sha256": "0" * 64, "url": "file:///etc/passwd"}}},
        "not among the files": {"runs": [{"file": "other.h5", "role": "train"}]},
        "role test": {"runs": [{"file": "run1.h5", "role": "train"}]},
        "is not after": {"runs": [{"file": "run1.h5", "role": "train", "start": 2.0, "stop": 1.0}]},
    }
    for words, change in wrong.items():
        with pytest.raises(UsageError, match=words):
            parse_dataset(yaml.safe_dump(content | change), "wrong")
    with pytest.raises(DataError, match=r"run1\.h5, run2\.h5 is missing"):
        load_dataset(exact, tmp_path)
    for name in exact.files:
        (tmp_path / name).write_bytes(b"another")
    with pytest.raises(DataError, match="SHA-256 differs"):
        load_dataset(exact, tmp_path)
    with pytest.raises(UsageError, match=r"has no option 'column'.*columns"):
        load_dataset(exact.model_copy(update={"reading": {"column": {}}}), mirror)
    with pytest.raises(UsageError, match="no data set is called"):
        chosen_datasets(["ur11"])
    with pytest.raises(UsageError, match="no method is called"):
        chosen_methods(("dynod",))
    with pytest.raises(UsageError, match="no such function"):
        load_method("ident.benchmark.entry:none")
    with pytest.raises(UsageError, match="cannot be imported"):
        load_method("no_such_module:fit")
    with pytest.raises(UsageError, match="torque"):
        torque_predictor(SimpleNamespace(), "mine:fit")


def test_predictions_that_cannot_be_compared_are_refused(held_out):
    for words, torque in {
        "not finite": lambda q, dq, ddq: np.full_like(q, np.nan),
        "expected": lambda q, dq, ddq: q[:, :2],
    }.items():
        with pytest.raises(DataError, match=words):
            judge_torques(TorquePredictor(torque), held_out, ROBOT)


def test_mujoco_sysid_learns_a_servo_arm(monkeypatch):
    pytest.importorskip("mujoco.sysid._src.optimize", reason="needs the extra 'bench'")
    monkeypatch.setattr(mujoco_sysid, "ITERATIONS", 1)
    monkeypatch.setattr(mujoco_sysid, "DECIMATION", 5)
    robot = load_robot("so101")
    learnt, held_out = (simulate_servo(robot, duration=3.0, seed=seed) for seed in (1, 2))
    fitted = mujoco_sysid.mujoco_sysid(Training(robot, (learnt,)))
    errors = [judge_servo(of, (held_out,), robot, None).rollout_error for of in (fitted, ServoPredictor(follow))]
    assert errors[0] < 0.7 * errors[1]


def follow(time, command, start):
    """Positions of an arm that is where its commands are."""
    return command


def test_a_download_is_kept_only_with_its_checksum(exact, monkeypatch, tmp_path):
    content = b"samples"

    class Answer:
        def __enter__(self):
            return SimpleNamespace(read=lambda: content)

        def __exit__(self, *_):
            return None

    monkeypatch.setattr(datasets, "urlopen", lambda address, timeout: Answer())
    (name, file), *_ = exact.files.items()
    address = "https://example.org/run"
    sound = file.model_copy(update={"sha256": hashlib.sha256(content).hexdigest(), "url": address})
    datasets.download(exact.model_copy(update={"files": {name: sound}}), tmp_path / "new")
    assert (tmp_path / "new" / name).read_bytes() == content
    other = file.model_copy(update={"url": address})
    with pytest.raises(WorkError, match="SHA-256"):
        datasets.download(exact.model_copy(update={"files": {name: other}}), tmp_path / "other")
    assert not (tmp_path / "other" / name).exists()


def test_parts_of_a_recording(mirror):
    recording = read_recording(mirror / "run1.h5")
    first, second = part(recording, 0.0, 4.0), part(recording, 4.0, None)
    assert len(first.time) + len(second.time) == len(recording.time)
    with pytest.raises(DataError, match="no sample"):
        part(recording, 11.0, None)
