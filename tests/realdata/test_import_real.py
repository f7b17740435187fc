"""A real ROS 2 bag against the same run as it was published in an .npz (shared/data/README.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ImportFileError

pytestmark = pytest.mark.realdata

UR10 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
TX40 = tuple(f"joint_{k}" for k in range(1, 7))
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
BAG = "ur10_exciting_trajectory.db3"


def robot(data_dir: Path, name: str, joints: tuple[str, ...]) -> RobotFile:
    limits = "\n".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}" for joint in joints)
    text = f"name: {name}\nmodel: {{urdf: {name}.urdf}}\njoints:\n{limits}\n"
    return parse_robot(text, where=name, folder=data_dir)


def test_the_bag_gives_the_published_arrays(data_dir: Path) -> None:
    """Same t, q, qd and torque; the bag's joint names matched, here to a robot that lists them backward."""
    published = np.load(data_dir / "ur10_unisa1.npz", allow_pickle=False)
    choices = ImportChoices(effort="torque")
    for joints, order in ((UR10, slice(None)), (UR10[::-1], slice(None, None, -1))):
        stream = import_file(data_dir / BAG, robot(data_dir, "ur10", joints), choices).streams[JOINTS_STREAM]
        np.testing.assert_allclose(stream.time, published["t"], rtol=0, atol=1e-9)
        assert set(stream.channels) == {"position", "velocity", "torque"}
        for quantity, key in (("position", "q"), ("velocity", "qd"), ("torque", "torque")):
            np.testing.assert_array_equal(stream.channels[quantity].values, published[key][:, order])
            assert stream.channels[quantity].columns == joints


def test_the_bag_does_not_say_what_effort_is(data_dir: Path) -> None:
    with pytest.raises(ImportFileError, match="--effort torque or --effort current"):
        import_file(data_dir / BAG, robot(data_dir, "ur10", UR10), ImportChoices())


@pytest.mark.parametrize(
    ("name", "file", "joints"),
    [("ur10", "ur10_unisa1.npz", UR10), ("tx40", "tx40_t1.npz", TX40), ("panda", "panda_gaz1.npz", PANDA)],
)
def test_published_npz_files_come_in_as_they_are(data_dir: Path, name: str, file: str, joints: tuple[str, ...]) -> None:
    published = np.load(data_dir / file, allow_pickle=False)
    recording = import_file(data_dir / file, robot(data_dir, name, joints), ImportChoices())
    stream = recording.streams[JOINTS_STREAM]
    np.testing.assert_array_equal(stream.time, published["t"])
    np.testing.assert_array_equal(stream.channels["position"].values, published["q"])
    np.testing.assert_array_equal(stream.channels["torque"].values, published["torque"])
    # Sound recordings raise no doubts.
    assert {event.level for event in recording.events} == {"info"}


def test_degrees_in_a_real_run_are_noticed(data_dir: Path, tmp_path: Path) -> None:
    published = np.load(data_dir / "panda_gaz1.npz", allow_pickle=False)
    degrees = np.degrees(published["q"])
    np.savez(tmp_path / "run.npz", t=published["t"], q=degrees, torque=published["torque"])
    arm = robot(data_dir, "panda", PANDA)
    with pytest.raises(ImportFileError, match="look like degrees"):
        import_file(tmp_path / "run.npz", arm, ImportChoices())
    np.savez(tmp_path / "run.npz", t=published["t"], q=published["q"], qd=np.degrees(published["qd"]))
    with pytest.raises(ImportFileError, match="position looks like radians, the velocity like degrees"):
        import_file(tmp_path / "run.npz", arm, ImportChoices())
