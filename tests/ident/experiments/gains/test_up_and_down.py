"""Drive gains from slow up-and-down runs: what half sums tell, whatever the friction, and what they cannot."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.motion.trajectories import PointToPoint
from daq.motion.trajectory_file import parse_trajectory
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import DataError, IdentificationError
from ident.experiments.gains.drive_gains import identify_gains
from ident.experiments.gains.slow_passes import BINS, passes_of, sweeps_of
from ident.experiments.gains.up_and_down import SlowGainsResult, identify_slow_gains
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.signals.prepared import Segment
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.altered_arms import with_gains
from studies.synthetic.data_mistakes import with_values

LOAD = KnownLoad(2.0, (0.08, 0.03, 0.05), (0.004, 0.0, 0.0, 0.004, 0.0, 0.003))
HIDDEN = {"j1": 1.1, "j2": 0.9, "j3": 1.05}
TRUE = np.array([11.0, -7.2, 4.2])
ALL = (0, 1, 2)
POSES = ((0.0, 0.4, 0.9), (0.0, -0.5, -0.6), (0.0, 0.8, 2.0))


def passes(joints=ALL, poses=POSES, down=16.0, swing=1.2) -> PointToPoint:
    """Some joints there and back, one after the other, in every pose."""
    points, durations = [np.array(poses[0])], []
    for pose in poses:
        for joint in joints:
            for side, duration in ((0.0, 6.0), (-0.5, 8.0), (0.5, 16.0), (-0.5, down), (0.0, 8.0)):
                point = np.array(pose)
                point[joint] += side * swing
                points.append(point)
                durations.append(duration)
    return PointToPoint(np.array(points), np.array(durations), 0.5)


def rubbed(arm: RobotFile, recording: Recording, motion: PointToPoint, seed: int) -> Recording:
    """The recording with friction that the model does not know: Stribeck, with the load, and static at rest."""
    stream = recording.streams[JOINTS_STREAM]
    position, velocity, _ = motion.evaluate(stream.time)
    still = np.zeros_like(position)
    gravity = model_torque(build_model(arm), None, truth_vector(arm), position, still, still)
    coulomb = np.array([[6.0], [7.0], [2.0]])
    more = (0.5 * coulomb * np.exp(-((velocity / 0.05) ** 2)) + 0.1 * np.abs(gravity)) * np.sign(velocity)
    held = np.random.default_rng(seed).uniform(-1.0, 1.0, len(motion.durations) + 1)
    number = np.searchsorted(np.cumsum(motion.durations + motion.dwell), stream.time)
    more = np.where(velocity == 0.0, coulomb * held[np.minimum(number, len(held) - 1)], more)
    gains = np.array([arm.robot.drive(name).gain for name in arm.robot.joint_names])
    return with_values(recording, current=stream.channels["current"].values + (more / gains[:, None]).T)


def runs(robot_file: RobotFile, motion: PointToPoint, seed: int = 0, rate: float = 50.0) -> tuple[Recording, Recording]:
    arm = with_gains(robot_file, HIDDEN)
    loaded = with_load(arm, LOAD.mass, LOAD.com or (), LOAD.inertia or ())
    return tuple(  # type: ignore[return-value]
        rubbed(
            each, simulate_recording(each, motion, motion.duration, 2 * seed + number, rate), motion, 2 * seed + number
        )
        for number, each in enumerate((arm, loaded))
    )


@pytest.fixture(scope="module")
def recordings(three_joint):
    return runs(three_joint, passes())


@pytest.fixture(scope="module")
def found(recordings) -> SlowGainsResult:
    return identify_slow_gains(*recordings, KnownLoad(LOAD.mass, LOAD.com))


def test_gains_whatever_the_friction(found):
    assert found.values[1:] == pytest.approx(TRUE[1:], rel=0.01)
    assert np.all(np.abs(found.values - TRUE)[1:] < 4.0 * found.std[1:])
    assert [gain.sweeps for gain in found.gains] == [3, 3, 3]
    assert all(gain.positions > 0.8 * 3 * BINS for gain in found.gains)


def test_the_vertical_axis_tells_nothing(found):
    assert np.isnan(found.values[0])
    assert np.isinf(found.std[0])
    assert "does not exceed the noise" in found.gains[0].reason
    assert any("j1" in warning for warning in found.warnings)


def test_half_the_difference_is_friction(found):
    """Coulomb, Stribeck, viscous and a tenth of what the joint bears: more of it with the load."""
    for gain, coulomb in zip(found.gains[1:], (7.0, 2.0), strict=True):
        assert coulomb < gain.friction_free < 2.0 * coulomb
        assert gain.friction_loaded > gain.friction_free


def test_an_unknown_centre_of_mass_is_found_beside_the_gains(recordings):
    each = identify_slow_gains(*recordings, KnownLoad(LOAD.mass))
    assert each.values[1:] == pytest.approx(TRUE[1:], rel=0.03)
    moments, std = (np.array([getattr(row, name) for row in each.load[:2]]) for name in ("value", "std"))
    assert moments == pytest.approx([0.16, 0.06], abs=0.01)
    assert each.load[2].value is None  # along the axes, which are parallel: no torque about them
    assert np.all(np.abs(moments - [0.16, 0.06]) < 4.0 * std)
    assert each.gap > 2.0
    assert any("MZ" in warning for warning in each.warnings)


def test_one_joint_needs_the_centre_of_mass(three_joint):
    recordings = runs(three_joint, passes(joints=(1,), poses=POSES[:1]))
    with pytest.raises(IdentificationError, match="centre of mass") as error:
        identify_slow_gains(*recordings, KnownLoad(LOAD.mass))
    assert "--com" in str(error.value.hint)
    each = identify_slow_gains(*recordings, KnownLoad(LOAD.mass, LOAD.com))
    assert each.values[1] == pytest.approx(TRUE[1], rel=0.01)
    assert "no slow passes" in each.gains[2].reason


def test_intervals_hold_the_truth(three_joint):
    """Six seeds, two gains, com known and unknown; every other sample."""
    errors = []
    for seed in range(6):
        recordings = runs(three_joint, passes(), seed, rate=25.0)
        for known in (KnownLoad(LOAD.mass, LOAD.com), KnownLoad(LOAD.mass)):
            each = identify_slow_gains(*recordings, known)
            errors.append((each.values[1:] - TRUE[1:]) / each.std[1:])
    assert np.mean(np.abs(errors) < 1.96) > 0.8
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_the_other_method_says_that_such_runs_are_not_for_it(three_joint):
    """Here with nothing but the model's friction, or it might not even find a value."""
    motion = passes()
    arm = with_gains(three_joint, HIDDEN)
    loaded = with_load(arm, LOAD.mass, LOAD.com or (), LOAD.inertia or ())
    each = identify_gains(
        *(simulate_recording(one, motion, motion.duration, seed, 50.0) for seed, one in enumerate((arm, loaded))), LOAD
    )
    assert any("--up-and-down" in warning for warning in each.warnings)


def test_twice_the_mass_twice_the_gain(recordings, found):
    double = identify_slow_gains(*recordings, KnownLoad(2.0 * LOAD.mass, LOAD.com))
    assert double.values[1:] == pytest.approx(2.0 * found.values[1:], rel=1e-6)


def test_unequal_speeds_do_not_count(three_joint):
    """Viscous friction would be taken for gravity."""
    with pytest.raises(DataError, match="both ways at the same speed"):
        identify_slow_gains(*runs(three_joint, passes(down=10.0)), KnownLoad(LOAD.mass, LOAD.com))


def test_a_motion_of_all_joints_has_no_passes(three_joint):
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 3))
    motion = PointToPoint(points, np.full(5, 10.0))
    with pytest.raises(DataError, match="no joint passes") as error:
        identify_slow_gains(*runs(three_joint, motion), KnownLoad(LOAD.mass))
    assert "one joint after the other back and forth" in str(error.value.hint)


def test_without_a_load_nothing_shows(three_joint):
    free, _ = runs(three_joint, passes())
    again, _ = runs(three_joint, passes(), seed=5)
    with pytest.raises(DataError, match="does not exceed the noise"):
        identify_slow_gains(free, again, KnownLoad(LOAD.mass, LOAD.com))


def test_the_text_is_for_the_robot_file(found, three_joint):
    text = three_joint.text
    start, stop = text.index("drives:"), text.index("truth:")
    robot = parse_robot(text[:start] + found.robot_file_text + "\n" + text[stop:], where="new", folder=None).robot
    assert [robot.drive(name).gain for name in ("j2", "j3")] == pytest.approx(found.values[1:], rel=1e-4)
    assert robot.drive("j1").gain == 10.0
    content = found.model_dump()
    assert content["gains"][0]["reason"]
    assert content["gains"][1]["reason"] is None


@settings(max_examples=40, deadline=None)
@given(
    gravity=st.floats(-20.0, 20.0), friction=st.floats(0.1, 20.0), low=st.floats(-2.0, 0.0), length=st.floats(0.2, 3.0)
)
def test_half_sum_and_difference_of_any_line(gravity, friction, low, length):
    """Signals gravity·q ± friction·speed come apart exactly, whatever the range."""
    time = np.arange(0.0, 40.0, 0.02)
    back = time > 20.0
    u = np.where(back, 40.0 - time, time) / 20.0
    q = low + length * u
    v = np.where(back, -1.0, 1.0) * length / 20.0
    position, velocity = np.vstack([q, np.zeros_like(q)]), np.vstack([v, np.zeros_like(q)])
    signal = np.vstack([gravity * q + friction * np.abs(v) * np.sign(v), np.ones_like(q)])
    segment = Segment(time, position, velocity, np.zeros_like(q) * position, signal, 50.0, np.ones(len(time), bool))
    found = passes_of([segment], 1e-3)
    assert [(each.joint, each.upward) for each in found] == [(0, True), (0, False)]
    sweep, *others = sweeps_of(found, found)
    assert others == []
    assert sweep.half_sum[0] == pytest.approx(
        gravity * sweep.pose[0], rel=1e-2, abs=1e-2 * (abs(gravity) + friction) * length
    )
    assert sweep.half_difference == pytest.approx(
        np.full((2, sweep.pose.shape[1]), friction * length / 20.0), abs=1e-2 * (abs(gravity) + friction) * length
    )


def test_the_motion_of_the_docs_has_passes():
    text = (Path(__file__).resolve().parents[4] / "docs" / "gains.md").read_text(encoding="utf-8")
    block = next(each for each in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL) if "kind: points" in each)
    robot = load_robot("ur10e").robot
    motion = parse_trajectory(block, robot, where="docs", folder=None).motion
    time = np.arange(0.0, motion.duration, 0.02)
    position, velocity, acceleration = motion.evaluate(time)
    segment = Segment(time, position, velocity, acceleration, position, 50.0, np.ones(len(time), bool))
    found = passes_of([segment], 1e-3)
    assert {each.joint for each in found} == {1}
    assert sweeps_of(found, found)[0].pose.shape[1] > 0.8 * BINS


@pytest.fixture(scope="module")
def folder(tmp_path_factory, recordings) -> Path:
    folder = tmp_path_factory.mktemp("slow")
    for name, recording in zip(("free", "loaded"), recordings, strict=True):
        write_recording(folder / f"{name}.h5", recording)
    return folder


def test_the_command(folder, run_dynid, monkeypatch):
    monkeypatch.chdir(folder)
    arguments = ["gains", "free.h5", "loaded.h5", "--up-and-down", "--mass", "2"]
    status, out, err = run_dynid(*arguments, "--verbose")
    assert (status, err) == (0, "")
    for expected in ("half sums", "friction free", "Centre of mass of the load [m]", "for the robot file:\ndrives:"):
        assert expected in out
    known = (*arguments, "--com", "0.08,0.03,0.05", "--force")
    status, out, err = run_dynid(*known)
    assert (status, err) == (0, "")
    assert "null vector" not in out  # each gain is identified by itself
    status, out, _ = run_dynid(*known, "--json")
    content = json.loads(out)
    assert content["gap"] is None
    assert content["kind"] == "gains-up-and-down"
    assert content["gains"][0]["gain"] is None
    assert content["gains"][2]["gain"] == pytest.approx(4.2, rel=0.01)
    status, out, err = run_dynid("gains", "free.h5", "loaded.h5", "--up-and-down")
    assert (status, out) == (2, "")
    assert "without the load's mass" in err
    status, out, _ = run_dynid("gains", "--help")
    assert status == 0
    assert "[kg]" in out  # brackets are no markup


def test_the_example_runs(capsys, monkeypatch):
    """One seed, one friction: half sums are right where the load adds friction; the other method is left out."""

    def refuse(*_):
        raise DataError("left out by this test", where="")

    example = importlib.import_module("studies.payload.up_and_down")
    monkeypatch.setattr(example, "FRICTIONS", {"load": example.FRICTIONS["and 5 % of the load"]})
    monkeypatch.setattr(example, "RATE", 25.0)
    monkeypatch.setattr(example, "MOVE", 12.0)
    monkeypatch.setattr(example, "SLOW_DURATION", 1.0)
    monkeypatch.setattr(example, "identify_gains", refuse)
    example.main(1)
    out = capsys.readouterr().out
    half_sums = next(line for line in out.splitlines() if "half sums, `--com`" in line)
    errors = [float(each) for each in re.findall(r"(\d+\.\d\d)", half_sums)]
    assert len(errors) == 5
    assert max(errors[:4]) < 1.0
