"""Whether a recording is long enough, and how much longer it would take."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from each import each

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import UsageError
from ident.assessment.excitation import recorded_motion
from ident.excite.sufficiency import OWN_TORQUE, Sufficiency, motion_sufficiency, times_needed
from ident.model.dynamic_model import build_model
from ident.regression.options import SIGNIFICANT_RSD
from ident.tasks.options import InfoOptions
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording


def recording_of(robot_file: RobotFile, seconds: float, seed: int = 1) -> Recording:
    motion = random_fourier_motion(build_model(robot_file), 10.0, seed=1)
    return simulate_recording(robot_file, motion, seconds, seed=seed)


def sufficiency_of(recording: Recording, robot_file: RobotFile) -> Sufficiency:
    motion = recorded_motion(recording, robot_file)
    assert motion is not None
    found = motion_sufficiency(motion)
    assert found is not None
    return found


def without_torque(recording: Recording) -> Recording:
    stream = recording.streams[JOINTS_STREAM]
    channels = {"position": stream.channels["position"]}
    return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})


def deviations(found) -> np.ndarray:
    return np.array([parameter.std for parameter in found.forecast.parameters])


@pytest.mark.parametrize("torque", [True, False])
def test_twice_the_duration_gives_one_over_root_two(three_joint, torque):
    recordings = [recording_of(three_joint, seconds) for seconds in (21.0, 41.0)]
    found = [
        sufficiency_of(recording if torque else without_torque(recording), three_joint) for recording in recordings
    ]
    assert found[0].source == (OWN_TORQUE if torque else "the robot file's truth")
    ratio = np.sqrt(found[0].seconds / found[1].seconds)
    assert ratio == pytest.approx(np.sqrt(0.5), rel=0.02)
    # With torque the noise is estimated, each time from another stretch; without, it is known.
    assert deviations(found[1]) / deviations(found[0]) == pytest.approx(ratio, rel=0.25 if torque else 0.05)
    assert found[1].forecast.scaled_condition == pytest.approx(found[0].forecast.scaled_condition, rel=0.05)
    assert found[0].repetitions == (pytest.approx(2.0, abs=0.3) if torque else 1.0)


def test_predicted_from_torque_is_what_repeated_recordings_show(three_joint):
    found = [sufficiency_of(recording_of(three_joint, 21.0, seed), three_joint) for seed in range(12)]
    values = np.array([[parameter.value for parameter in each.forecast.parameters] for each in found])
    spread = values.std(axis=0, ddof=1)
    predicted = np.median([deviations(each) for each in found], axis=0)
    assert np.median(spread / predicted) == pytest.approx(1.0, abs=0.25)


def test_time_grows_with_the_square_of_what_is_wanted(three_joint):
    found = sufficiency_of(recording_of(three_joint, 21.0), three_joint)
    coarse, fine = times_needed(found, 4.0), times_needed(found, 2.0)
    assert [entry.name for entry in coarse.parameters] == [entry.name for entry in fine.parameters]
    for one, four in zip(coarse.parameters, fine.parameters, strict=True):
        assert four.seconds == pytest.approx(4.0 * one.seconds)
        assert one.seconds == pytest.approx(found.seconds * (one.rsd_percent / 4.0) ** 2)
    significant = {p.name for p in found.forecast.parameters if p.rsd_percent < SIGNIFICANT_RSD}
    assert {entry.name for entry in fine.parameters} == significant
    assert len(significant) > 10
    assert [entry.seconds for entry in fine.parameters] == sorted((e.seconds for e in fine.parameters), reverse=True)
    longest = fine.parameters[0]
    assert longest.name in fine.sentence
    assert f"{int(np.ceil(longest.seconds))} s" in fine.sentence
    assert "a different motion" in fine.sentence  # two repetitions
    enough = times_needed(found, SIGNIFICANT_RSD)
    assert "enough" in enough.sentence


def test_without_values_nothing_can_be_told(three_joint):
    text = three_joint.text.split("truth:")[0]
    unknown = parse_robot(text, where="unknown", folder=None)
    found = sufficiency_of(without_torque(recording_of(three_joint, 12.0)), unknown)
    assert "assumed" in found.source
    assert np.all(deviations(found) > 0)
    times = times_needed(found, 5.0)
    assert times.parameters == ()
    assert "parameter values are unknown" in times.sentence


def test_nothing_significant_is_said(three_joint):
    found = sufficiency_of(recording_of(three_joint, 12.0), three_joint)
    vague = tuple(replace(parameter, rsd_percent=80.0) for parameter in found.forecast.parameters)
    found = replace(found, forecast=replace(found.forecast, parameters=vague))
    assert "None of 25 base parameters is significant" in times_needed(found, 5.0).sentence


@each("value", [0.0, -1.0, 100.1, float("nan"), float("inf")])
def test_a_wanted_rsd_that_is_none_is_refused(value):
    with pytest.raises(UsageError, match="--wanted-rsd"):
        InfoOptions("run.h5", wanted_rsd=value)


@pytest.fixture(scope="module")
def file(tmp_path_factory, three_joint) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "run.h5"
    write_recording(path, recording_of(three_joint, 12.0))
    return path


def test_info_tells_it(run_dynid, file):
    status, out, _ = run_dynid("info", str(file))
    assert status == 0
    assert "predicted RSD below 15 %" in out
    assert "Time needed" not in out
    status, out, _ = run_dynid("info", str(file), "--wanted-rsd", "3")
    assert status == 0
    assert "Time needed for an RSD of 3 %" in out
    assert "For an RSD of 3 %" in out


def test_info_tells_it_as_json(run_dynid, file, three_joint):
    status, out, _ = run_dynid("info", str(file), "--json")
    told = json.loads(out)["sufficiency"]
    assert status == 0
    assert "needed" not in told
    assert {"condition", "scaled_condition", "log_det", "unexcited", "seconds", "source"} <= set(told)
    assert len(told["parameters"]) == 25
    status, out, _ = run_dynid("info", str(file), "--json", "--wanted-rsd", "3")
    assert json.loads(out)["sufficiency"]["needed"]["wanted_rsd_percent"] == 3.0
    status, out, err = run_dynid("info", str(file), "--wanted-rsd", "0")
    assert (status, out) == (2, "")
    assert "--wanted-rsd 0 is not within 0.001 to 100 %" in err
