"""The demonstration leaves what it promises, and its truth lies where its error bars say."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from each import each
from servoed_plant import in_simulated_time

import sim_drivers.rtde.demo
from daq.motion.trajectory_file import load_trajectory
from daq.recording.reader import read_recording
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import RobotFile
from drivers.core.errors import ConnectionFailedError, RobotFileError, UsageError, WorkError
from ident.excite.choices import DesignChoices
from ident.excite.design import Design, design
from ident.excite.prior import PriorKnowledge
from ident.excite.search.search import SearchChoices, SearchResult
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.result_file import read_result
from sim_drivers.rtde.demo import ATTEMPTS, _recorded, print_demo, run_demo
from sim_drivers.served import DemoOptions
from sim_drivers.simulated_arm import Recorded, record_over_wire, simulated_arm

DESIGNED = Path(__file__).parent / "designed"
STEPS: list[str] = []


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sim_drivers.rtde.demo, "design", designed_before)
        return run_demo(DemoOptions(out=folder, duration=8.0), progress=STEPS.append, arm=in_simulated_time)


def designed_before(
    robot_file: RobotFile,
    prior: PriorKnowledge,
    choices: DesignChoices,
    search: SearchChoices,
    progress: Callable[[SearchResult], None],
) -> Design:
    """What the same design, which takes half a minute, once came to: `python tests/sim_drivers/designed` makes it."""
    earlier = load_trajectory(DESIGNED / f"{search.seed}.yaml", robot_file.robot).motion
    return design(robot_file, prior, choices, SearchChoices(starts=None, time=1e-3, workers=1), earlier, progress)


@pytest.mark.slow
def test_files_are_there_and_can_be_read(demo):
    assert {path.name for path in demo.folder.iterdir()} == {
        "identification.yaml", "identification.h5", "validation.yaml", "validation.h5", "result.json", "report.html",
    }  # fmt: skip
    result = read_result(demo.folder / "result.json")
    assert result == demo.identification.result
    assert [use.file for use in result.recordings] == ["identification.h5", "validation.h5"]
    recordings = [read_recording(demo.folder / f"{name}.h5") for name in ("identification", "validation")]
    for recording in recordings:
        assert recording.robot().robot.name == "ur5e"
        assert recording.complete
        assert "kind: fourier" in recording.trajectory
    assert demo.samples == sum(len(recording.streams[JOINTS_STREAM].time) for recording in recordings)
    assert demo.lost == 0
    assert "Fs1" in (demo.folder / "report.html").read_text(encoding="utf-8")
    assert [step for step in STEPS if " of search" not in step][:3] == [
        "designing an excitation trajectory, and another one to validate with",
        "recording 12 s for identification over RTDE",
        "recording 12 s for validation over RTDE",
    ]


@pytest.mark.slow
def test_truth_is_projected_and_lies_inside(demo):
    robot_file = demo.identification.robot_file
    assert np.allclose(demo.truth, demo.identification.base.projection @ truth_vector(robot_file))
    assert build_model(robot_file).dof == 6
    error = np.abs(demo.identification.solution.parameters - demo.truth)
    assert demo.inside == np.sum(error <= WITHIN_95_PERCENT * demo.identification.std)
    assert demo.inside >= 0.9 * len(demo.truth)
    assert np.all(error < 4.0 * demo.identification.std)
    assert demo.identification.validation.relative_error < 0.03
    assert demo.identification.result.verdict.purposes["torque_prediction"].grade == "good"
    # A note may say that errors are larger near standstill, where the plant's bristles are no function of velocity.
    assert "overfitting" not in {check.name for check in demo.identification.checks}


@pytest.mark.slow
def test_the_arm_stands_where_each_motion_starts(demo):
    for name in ("identification", "validation"):
        recording = read_recording(demo.folder / f"{name}.h5")
        (approach,) = [event.message for event in recording.events if "approach" in event.message]
        assert approach == "approach to the start pose, 0.10 s"


@pytest.mark.slow
def test_json_is_one_strict_object(demo, capsys):
    print_demo(demo, as_json=True)
    shown = json.loads(capsys.readouterr().out)
    assert shown["robot"] == "ur5e"
    assert shown["inside_95_percent"] == demo.inside
    assert (shown["samples"], shown["lost"]) == (demo.samples, 0)
    assert [p["truth"] for p in shown["base_parameters"]] == pytest.approx(list(demo.truth))
    assert shown["validation_relative_error"] == demo.identification.validation.relative_error


@pytest.mark.slow
def test_table_shows_truth_beside_estimate(demo, capsys):
    print_demo(demo, as_json=False, verbose=True)
    text = capsys.readouterr().out
    for name in demo.identification.base.names:
        assert name in text
    assert f"{demo.inside} of {len(demo.truth)} true values" in text
    assert str(demo.identification.result.verdict) in text
    assert "report.html" in text


@pytest.mark.parametrize(
    ("output", "errors", "reason"),
    [
        ('{"stopped_by": "this computer stalled"}', "", "this computer stalled"),
        ('{"error": "no such robot"}', "", "no such robot"),
        ("", "Killed", "Killed"),
        ("", "", "it ended without a message"),
    ],
)
def test_why_the_recorder_stopped_is_told(tmp_path, monkeypatch, output, errors, reason):
    ended = subprocess.CompletedProcess([], 1, output, errors)
    monkeypatch.setattr("sim_drivers.simulated_arm.subprocess.run", lambda *_, **__: ended)
    with pytest.raises(WorkError, match=f"the recording stopped: {reason}"):
        record_over_wire("ur5e", "127.0.0.1", tmp_path / "motion.yaml", tmp_path / "run.h5")


@pytest.mark.parametrize("fails", [0, 2, 3])
def test_a_motion_that_a_busy_computer_ended_is_recorded_again(tmp_path, fails):
    served, told = [], []

    @contextmanager
    def arm():
        def record(trajectory, out):
            if len(served) <= fails:
                raise WorkError("the recording stopped: this computer stalled")
            return Recorded(100, 0)

        served.append(record)
        yield record

    def recorded():
        return _recorded(arm, tmp_path / "motion.yaml", tmp_path / "run.h5", told.append)

    if fails < ATTEMPTS:
        assert recorded() == Recorded(100, 0)
    else:
        with pytest.raises(WorkError, match="this computer stalled"):
            recorded()
    assert len(served) == min(fails + 1, ATTEMPTS)
    assert told == ["the recording stopped: this computer stalled; recording again"] * (len(served) - 1)


@each("duration", [0.0, -5.0, 1.9, 1e9, float("nan")])
def test_a_duration_that_makes_no_sense_is_refused(duration):
    with pytest.raises(UsageError, match="--duration"):
        DemoOptions(duration=duration)


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(UsageError, match="is a file"):
        run_demo(DemoOptions(out=tmp_path / "out", robot="ur5e", duration=10.0))
    assert (tmp_path / "out").read_text() == "mine"


def test_a_robot_without_a_truth_leaves_no_folder(tmp_path):
    robot = tmp_path / "real.yaml"
    robot.write_text(
        "name: real\nmodel: {mdh: [{joint: a, alpha: 0, d: 0, r: 0}]}\n"
        "joints: [{name: a, position: [-1, 1], velocity: 1}]\n"
        "connections: {rtde: {driver: rtde, host: 127.0.0.1}}\n"
    )
    with pytest.raises(RobotFileError, match="no true link"):
        run_demo(DemoOptions(out=tmp_path / "out", robot=str(robot), duration=10.0))
    assert not (tmp_path / "out").exists()


def test_an_arm_on_another_wire_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no RTDE connection"):
        run_demo(DemoOptions(out=tmp_path / "out", robot="panda", duration=10.0))


@pytest.mark.realtime
def test_a_simulator_that_cannot_start_is_told():
    with pytest.raises(ConnectionFailedError, match="did not start"), simulated_arm("no_such_robot", 1, ("127.0.0.9",)):
        pytest.fail("it must not get here")
