"""Datasets that LeRobot's own package wrote (tests/support/lerobot/write.py): an episode is a recording."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_episodes, import_file
from daq.recording.commanded_motion import commanded_motion
from daq.recording.reader import read_recording
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import load_robot
from drivers.core.errors import ImportFileError, UsageError
from dynid.command import build_app

pytest.importorskip("pyarrow", reason="the extra dynid[lerobot] is not installed")
DATASETS = Path(__file__).parents[2] / "support" / "lerobot"
CALIBRATION = DATASETS / "calibration.json"
ROBOT = load_robot("so101")
DEGREES = ImportChoices(degrees=True)


def state(time: np.ndarray) -> np.ndarray:
    """What write.py put into the datasets: (N, 5) of joints, (N,) of the gripper."""
    joints = np.arange(5)
    return 30 * np.sin(time[:, None] + joints) + 2 * joints, 50 + 30 * np.sin(time)


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_every_episode_is_a_recording_in_radians(version: str) -> None:
    recordings = import_episodes(DATASETS / version, ROBOT, DEGREES)
    assert list(recordings) == [0, 1]
    for number, (first, last) in enumerate([(0, 40), (40, 75)]):
        motion = commanded_motion(recordings[number], ROBOT.robot)
        time = np.arange(last - first) / 30
        np.testing.assert_allclose(motion.time, time, atol=1e-12)
        for given, then in ((motion.position, -0.06), (motion.commands["target_position"], 0.0)):
            joints, gripper = state(time + first / 30 + then)
            np.testing.assert_allclose(given[:, :5], np.deg2rad(joints), atol=1e-6)
            low, high = ROBOT.robot.joints[5].position
            np.testing.assert_allclose(given[:, 5], low + gripper / 100 * (high - low), atol=1e-6)
        assert f"{version}, episode {number}" in recordings[number].comment


def test_normalised_values_become_radians_by_the_calibration() -> None:
    choices = ImportChoices(calibration=CALIBRATION, episode=1)
    recording = import_file(DATASETS / "v3.0", ROBOT, choices)
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    joints, gripper = state((np.arange(35) + 40) / 30 - 0.06)
    entries = json.loads(CALIBRATION.read_text())
    for column, joint in enumerate(ROBOT.robot.joint_names[:5]):
        # As LeRobot has it: counts of the motor from -100 to 100, and degrees from counts.
        least, most = entries[joint]["range_min"], entries[joint]["range_max"]
        counts = (joints[:, column] + 100) / 200 * (most - least) + least
        degrees = (counts - (least + most) / 2) * 360 / 4095
        np.testing.assert_allclose(position[:, column], np.deg2rad(degrees), atol=1e-6)
    span = (entries["gripper"]["range_max"] - entries["gripper"]["range_min"]) * 2 * np.pi / 4095
    np.testing.assert_allclose(position[:, 5], ROBOT.robot.joints[5].position[0] + gripper / 100 * span, atol=1e-6)


def test_the_command_writes_a_folder_or_one_episode(tmp_path: Path) -> None:
    run = CliRunner()
    dataset = ["import", str(DATASETS / "v2.1"), "--robot", "so101", "--degrees"]
    done = run.invoke(build_app(), [*dataset, "-o", str(tmp_path / "runs"), "--json"])
    assert done.exit_code == 0, done.output
    files = [Path(entry["file"]) for entry in json.loads(done.stdout)["recordings"]]
    assert [file.name for file in files] == ["episode_000000.h5", "episode_000001.h5"]
    assert len(read_recording(files[1]).streams[JOINTS_STREAM].time) == 35
    assert run.invoke(build_app(), [*dataset, "-o", str(tmp_path / "one.h5")]).exit_code != 0
    assert not (tmp_path / "one.h5").exists()
    assert run.invoke(build_app(), [*dataset, "-o", str(tmp_path / "one.h5"), "--episode", "1"]).exit_code == 0
    assert len(read_recording(tmp_path / "one.h5").streams[JOINTS_STREAM].time) == 35


def damaged(folder: Path, **changes: object) -> Path:
    """A copy of the dataset with other entries of info.json."""
    shutil.copytree(DATASETS / "v2.1", folder)
    path = folder / "meta" / "info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return folder


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"codebase_version": "v1.6"}, "v2.x and v3.x are read"),
        ({"codebase_version": None}, "v2.x and v3.x are read"),
        ({"fps": -3}, "fps is -3"),
        ({"fps": "many"}, "fps is many"),
        ({"features": None}, "has no 'features'"),
        ({"features": {}}, "has no feature 'observation.state'"),
        ({"features": {"observation.state": {"shape": [6, 2]}}}, "a vector is needed"),
        ({"features": {"observation.state": {"shape": [5], "names": None}}}, "is expected"),
        ({"features": {"observation.state": {"shape": [6], "names": list("abcdef")}}}, "has no joint"),
        ({"features": {"observation.state": {"shape": [6]}, "action.x": {}, "action": 3}}, "a vector is needed"),
    ],
)
def test_what_the_description_says_wrong_is_named(tmp_path: Path, changes: dict[str, object], said: str) -> None:
    with pytest.raises(ImportFileError) as refusal:
        import_episodes(damaged(tmp_path / "set", **changes), ROBOT, DEGREES)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_dataset_without_names_is_matched_by_order(tmp_path: Path) -> None:
    info = json.loads((DATASETS / "v2.1" / "meta" / "info.json").read_text())
    for feature in info["features"].values():
        feature["names"] = None
    folder = damaged(tmp_path / "set", features=info["features"])
    limits = load_robot("so101")
    recording = import_episodes(folder, limits, DEGREES)[0]
    assert "matched by order" in "".join(event.message for event in recording.events)


def test_the_rest_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = DATASETS / "v3.0"
    with pytest.raises(ImportFileError, match="it does not say which"):
        import_episodes(dataset, ROBOT, ImportChoices())
    with pytest.raises(UsageError, match="holds 2 episodes"):
        import_file(dataset, ROBOT, DEGREES)
    with pytest.raises(ImportFileError, match="has no episode 7"):
        import_file(dataset, ROBOT, ImportChoices(degrees=True, episode=7))
    with pytest.raises(UsageError, match="no columns to map"):
        import_file(dataset, ROBOT, ImportChoices(columns={"q": "x"}))
    wrong = tmp_path / "calibration.json"
    unreadable = ("{", "is not JSON"), ("[]", "has no motor"), ('{"shoulder_pan": {"range_min": 5}}', "not a range of")
    for text, said in unreadable:
        wrong.write_text(text)
        with pytest.raises(ImportFileError, match=said):
            import_episodes(dataset, ROBOT, ImportChoices(calibration=wrong))
    broken = damaged(tmp_path / "set")
    file = next(broken.rglob("*.parquet"))
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(ImportFileError, match="cannot be read as a Parquet file"):
        import_episodes(broken, ROBOT, DEGREES)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(UsageError, match="needs the package pyarrow"):
        import_episodes(dataset, ROBOT, DEGREES)
