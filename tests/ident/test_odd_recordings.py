"""No recording, however odd, makes `info`, `identify` or `friction` end in a traceback or a warning of NumPy."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from odd_recordings import DAMAGES, MOTIONS, odd_recording

import dynid
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import DynidError
from studies.synthetic.data_mistakes import with_values
from tests.ident.conftest import THREE_JOINT

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

Task = Callable[[Recording, Path], None]

CASES = [
    *((motion, "none") for motion in MOTIONS),
    *(("together", damage) for damage in DAMAGES if damage != "none"),
    *(("second joint forth and back in 1 s", damage) for damage in ("torque held", "a torque zero", "coarse encoder")),
    *(("one after the other", damage) for damage in ("a torque zero", "segments of 17 samples", "rows repeated")),
    *(("nothing", damage) for damage in ("positions jitter", "torque zero", "60 samples")),
]


@pytest.fixture(scope="module")
def arm() -> RobotFile:
    """Three joints whose torque is recorded."""
    return parse_robot(re.sub(r"drives:\n.*?truth:", "truth:", THREE_JOINT, flags=re.DOTALL), where="arm", folder=None)


def look(recording: Recording, folder: Path) -> None:
    found = dynid.info(recording, wanted_rsd=5.0)
    assert str(found)
    assert found.to_json()
    found.save(folder / "info")


def identify(recording: Recording, folder: Path) -> None:
    found = dynid.identify(recording)
    assert str(found)
    found.save(folder / "model")


def friction(recording: Recording, folder: Path) -> None:
    found = dynid.friction(recording, friction="coulomb-viscous")
    assert str(found)
    found.save(folder / "friction")


def answered(task: Task, recording: Recording, folder: Path) -> str:
    """Why the task refuses the recording; empty where it does not. Any other exception is a bug."""
    try:
        task(recording, folder)
    except DynidError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("task", [look, identify, friction])
@pytest.mark.parametrize(("motion", "damage"), CASES)
def test_an_odd_recording_is_answered(arm: RobotFile, tmp_path: Path, motion: str, damage: str, task: Task) -> None:
    refusal = answered(task, odd_recording(arm, motion, damage, seconds=8.0, rate=50.0), tmp_path)
    assert "\n" not in refusal


@pytest.mark.realdata
@pytest.mark.parametrize("task", [look, identify, friction])
def test_a_recording_that_supervision_stopped_is_answered(data_dir: Path, tmp_path: Path, task: Task) -> None:
    assert "\n" not in answered(task, dynid.read_recording(data_dir / "stopped.h5"), tmp_path)


def test_a_torque_that_was_not_measured_is_named(arm: RobotFile) -> None:
    with pytest.raises(DynidError, match=r'the torque of j2 does not change.*torques_of=\["j1", "j3"\]'):
        dynid.identify(odd_recording(arm, "together", "a torque zero", seconds=8.0, rate=50.0))


def test_a_joint_that_toggles_an_encoder_step_is_at_rest(arm: RobotFile) -> None:
    recording = odd_recording(arm, "one after the other", "none", seconds=18.0, rate=100.0)
    stream = recording.streams["joints"]
    noise = 0.1e-3 * np.random.default_rng(0).standard_normal((len(stream.time), 3))
    values = np.round((stream.channels["position"].values + 0.5e-3 + noise) / 1e-3) * 1e-3
    found = dynid.friction(with_values(recording, position=values), friction="coulomb-viscous").result
    assert [joint.joint for joint in found.joints] == ["j1", "j2", "j3"]
    assert [joint.coulomb for joint in found.joints] == pytest.approx([6.0, 7.0, 2.0], rel=0.03)
    assert all(joint.offset_std is not None and joint.offset_std > 0.0 for joint in found.joints)


def test_recordings_of_different_rates_go_together(arm: RobotFile) -> None:
    fast, slow = (odd_recording(arm, "one after the other", "none", seconds=18.0, rate=rate) for rate in (200.0, 20.0))
    for recordings in ([fast, slow], [slow, fast]):
        found = dynid.friction(recordings, friction="coulomb-viscous").result
        assert [joint.coulomb for joint in found.joints] == pytest.approx([6.0, 7.0, 2.0], rel=0.03)
