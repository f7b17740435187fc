"""Commanded positions beside measured ones: their own stamps, what a magnitude is, and the SO-101's names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from three_links import NAMES, Arrays, columns_of, make_robot, messages, samples, write_csv, write_npz

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.commanded_motion import commanded_motion
from daq.recording.reader import read_recording
from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.errors import DataError, ImportFileError


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return make_robot()


def servo_samples(command_rate: float = 50.0) -> tuple[Arrays, Arrays]:
    """Positions 40 ms behind their commands, and the commands at their own rate."""
    arrays = samples()
    stamps = np.arange(0.0, arrays["t"][-1], 1 / command_rate) + 1e-3
    phase = np.array([0.0, 1.0, 2.0])
    commands = {"command_time": stamps, "command": np.sin(2.0 * (stamps[:, None] + 0.04) + phase)}
    return {name: arrays[name] for name in ("t", "q")}, commands


def write_padded_csv(folder: Path, arrays: Arrays) -> Path:
    """Write two streams side by side, as spreadsheets do: the shorter one's cells stay empty."""
    columns = columns_of(arrays)
    longest = max(map(len, columns.values()))
    cells = {name: [repr(float(value)) for value in values] for name, values in columns.items()}
    cells = {name: [*values, *[""] * (longest - len(values))] for name, values in cells.items()}
    path = folder / "run.csv"
    path.write_text("\n".join([",".join(cells), *(",".join(row) for row in zip(*cells.values(), strict=True))]))
    return path


@pytest.mark.parametrize("write", [write_npz, write_padded_csv])
def test_commands_keep_their_own_stamps_and_are_held_between_them(tmp_path: Path, robot: RobotFile, write) -> None:
    measured, told = servo_samples()
    recording = import_file(write(tmp_path, measured | told), robot, ImportChoices())
    write_recording(tmp_path / "run.h5", recording)
    recording = read_recording(tmp_path / "run.h5")
    stream = recording.streams[COMMANDS_STREAM]
    np.testing.assert_array_equal(stream.time, told["command_time"])
    np.testing.assert_array_equal(stream.channels["target_position"].values, told["command"])
    assert len(recording.streams[JOINTS_STREAM].time) == len(measured["t"])
    assert "warning" not in messages(recording)
    motion = commanded_motion(recording, robot.robot)
    times = np.sort(np.random.default_rng(0).uniform(-0.1, 2.0, 200))
    latest = [max(0, np.count_nonzero(told["command_time"] <= time) - 1) for time in times]
    np.testing.assert_array_equal(motion.held(times), told["command"][latest])


def test_commands_with_the_samples_stamps_stay_beside_them(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    given = {"t": arrays["t"], "q": arrays["q"], "goal": arrays["q"] + 0.01, "sent": arrays["t"], "kp": 5 + arrays["q"]}
    columns = {"target_position": "goal", "target_time": "sent", "gain_p": "kp"}
    recording = import_file(write_npz(tmp_path, given), robot, ImportChoices(columns=columns))
    assert set(recording.streams) == {JOINTS_STREAM}
    channels = recording.streams[JOINTS_STREAM].channels
    assert channels["gain_p"].unit == "N*m/rad"
    motion = commanded_motion(recording, robot.robot)
    np.testing.assert_array_equal(motion.held(arrays["t"]), arrays["q"] + 0.01)
    np.testing.assert_array_equal(motion.held(arrays["t"], "gain_p"), given["kp"])


def test_numbered_columns_in_degrees_and_milliseconds_become_si(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    names = ["t [ms]", *(f"q{k} [deg]" for k in (1, 2, 3)), *(f"target_position{k} [deg]" for k in (1, 2, 3))]
    degrees = np.rad2deg(np.column_stack([arrays["q"], arrays["q"] + 0.1]))
    columns = dict(zip(names, [1e3 * arrays["t"], *degrees.T], strict=True))
    recording = import_file(write_csv(tmp_path, columns), robot, ImportChoices())
    channels = recording.streams[JOINTS_STREAM].channels
    np.testing.assert_allclose(channels["target_position"].values - channels["position"].values, 0.1, atol=1e-12)


def test_stamps_since_1970_are_counted_from_one_moment(tmp_path: Path, robot: RobotFile) -> None:
    measured, told = servo_samples()
    start = 1_700_000_000_000_000_000
    for arrays, name in ((measured, "t"), (told, "command_time")):
        arrays[name] = start + np.round(1e9 * arrays[name]).astype(np.int64)
    recording = import_file(write_npz(tmp_path, measured | told), robot, ImportChoices(time_unit="ns"))
    assert recording.streams[JOINTS_STREAM].time[0] == 0.0
    assert recording.streams[COMMANDS_STREAM].time[0] == pytest.approx(1e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda told: {"command_time": told["command_time"][::-1]}, ["commands", "goes backward", "--repair sort"]),
        (lambda told: {"command_time": np.floor(told["command_time"] * 25) / 25}, ["repeat the stamp", "drop-duplic"]),
        (lambda told: {"command_time": told["command_time"] + 1e3}, ["commands", "outside those of the samples"]),
        (lambda told: {"command": np.where(told["command"] > 0.99, np.nan, told["command"])}, ["NaN", "--repair drop"]),
        (lambda told: {"command": told["command"][:-3]}, ["differ in length", "target_time"]),
        (lambda told: {"command_time": np.array(["late"])}, ["real numbers"]),
        (lambda told: {"command_time": 1e3 * told["command_time"]}, ["commands", "look like ms"]),
        (lambda told: {"command": np.rad2deg(told["command"])}, ["the command looks like degrees"]),
    ],
)
def test_hostile_commands_are_refused_in_one_line(tmp_path: Path, robot: RobotFile, change, said: list[str]) -> None:
    measured, told = servo_samples()
    path = write_npz(tmp_path, measured | told | change(told))
    with pytest.raises(ImportFileError) as refusal:
        import_file(path, robot, ImportChoices())
    assert "\n" not in str(refusal.value)
    for word in said:
        assert word in f"{refusal.value} {refusal.value.hint}"


def test_commands_of_another_length_need_stamps(tmp_path: Path, robot: RobotFile) -> None:
    measured, told = servo_samples()
    del told["command_time"]
    with pytest.raises(ImportFileError, match="target_time=NAME"):
        import_file(write_npz(tmp_path, measured | told), robot, ImportChoices())


def test_requested_repairs_reach_the_commands(tmp_path: Path, robot: RobotFile) -> None:
    measured, told = servo_samples()
    order = np.random.default_rng(0).permutation(len(told["command_time"]))
    shuffled = {name: values[order] for name, values in told.items()}
    path = write_npz(tmp_path, measured | shuffled)
    recording = import_file(path, robot, ImportChoices(repair=("sort",)))
    np.testing.assert_array_equal(recording.streams[COMMANDS_STREAM].time, told["command_time"])
    assert "commands: sort" in messages(recording)


def test_a_recording_without_commands_says_how_to_import_them(tmp_path: Path, robot: RobotFile) -> None:
    recording = import_file(write_npz(tmp_path, servo_samples()[0]), robot, ImportChoices())
    assert "neither torque nor current" in messages(recording)
    with pytest.raises(DataError, match="target_position=NAME"):
        commanded_motion(recording, robot.robot)


def so101_arrays() -> Arrays:
    """Arrays like those of SAGE's SO-101: counts without a sign, the source's joint names."""
    time = np.arange(300) / 50.0
    q = 0.3 * np.sin(time[:, None] + np.arange(6)) + 0.5
    return {
        "time": time,
        "position": q,
        "current_magnitude": np.round(np.abs(100 * np.cos(time[:, None] + np.arange(6)))),
        "command_time": time,
        "command": q + 0.02,
        "joints": np.array(["Rotation", "Pitch", "Elbow", "Wrist_Pitch", "Wrist_Roll", "Jaw"]),
    }


def test_so101_recordings_need_no_option(tmp_path: Path) -> None:
    robot, arrays = load_robot("so101"), so101_arrays()
    write_recording(tmp_path / "run.h5", import_file(write_npz(tmp_path, arrays), robot, ImportChoices()))
    recording = read_recording(tmp_path / "run.h5")
    assert "Jaw → gripper" in messages(recording)
    current = recording.streams[JOINTS_STREAM].channels["current"]
    assert current.magnitude
    assert current.columns == robot.robot.joint_names
    np.testing.assert_allclose(current.values, 0.0065 * arrays["current_magnitude"])
    assert not recording.streams[JOINTS_STREAM].channels["position"].magnitude
    assert recording.robot().urdf_text == robot.urdf_text


def test_a_magnitude_with_negative_values_is_none(tmp_path: Path) -> None:
    arrays = so101_arrays() | {"current_magnitude": np.linspace(-1.5, 1.5, 300)[:, None] * np.ones(6)}
    recording = import_file(write_npz(tmp_path, arrays), load_robot("so101"), ImportChoices())
    assert "it is not a magnitude" in messages(recording)
    assert not recording.streams[JOINTS_STREAM].channels["current"].magnitude


def test_names_say_a_magnitude_where_the_robot_file_does_not(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples()
    given = {"t": arrays["t"], "q": arrays["q"], "torque_magnitude": np.abs(arrays["torque"])}
    recording = import_file(write_npz(tmp_path, given), robot, ImportChoices())
    torque = recording.streams[JOINTS_STREAM].channels["torque"]
    assert torque.magnitude
    assert torque.columns == NAMES


def write_bag(folder: Path, kind: str, measured: Arrays, told: Arrays, order: tuple[int, ...] = (0, 1, 2)) -> Path:
    """Joint states with stamps, and commands of one of three types, sent when `command_time` says."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = {name.split("/")[-1]: kind for name, kind in store.types.items()}

    def header(time: float) -> object:
        seconds, rest = divmod(round(time * 1e9), 10**9)
        return types["Header"](stamp=types["Time"](sec=seconds, nanosec=rest), frame_id="")

    names, empty = [NAMES[place] for place in order], np.zeros(0)

    def command(time: float, values: np.ndarray) -> object:
        values = values[list(order)]
        if kind == "Float64MultiArray":
            return types[kind](layout=types["MultiArrayLayout"](dim=[], data_offset=0), data=values)
        if kind == "JointState":
            return types[kind](header=header(time), name=names, position=values, velocity=empty, effort=empty)
        span = types["Duration"](sec=0, nanosec=0)
        point = types["JointTrajectoryPoint"](
            positions=values, velocities=empty, accelerations=empty, effort=empty, time_from_start=span
        )
        return types[kind](header=header(time), joint_names=names, points=[point])

    state = types["JointState"]
    sent = [
        (time, "/joint_states", state(header=header(time), name=list(NAMES), position=q, velocity=empty, effort=empty))
        for time, q in zip(measured["t"] + 5.0, measured["q"], strict=True)
    ]
    sent += [
        (time, "/told", command(time, values))
        for time, values in zip(told["command_time"] + 5.0, told["command"], strict=True)
    ]
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {"/joint_states": state.__msgtype__, "/told": types[kind].__msgtype__}
        opened = {name: writer.add_connection(name, type_name, typestore=store) for name, type_name in topics.items()}
        for time, topic, message in sorted(sent, key=lambda one: one[0]):
            writer.write(opened[topic], round(time * 1e9), store.serialize_cdr(message, topics[topic]))
    return folder / "bag"


@pytest.mark.parametrize("kind", ["JointState", "JointTrajectory", "Float64MultiArray"])
def test_a_bag_s_commands_come_from_the_topic_that_is_named(tmp_path: Path, robot: RobotFile, kind: str) -> None:
    measured, told = servo_samples()
    path = write_bag(tmp_path, kind, measured, told, (0, 1, 2) if kind == "Float64MultiArray" else (2, 0, 1))
    recording = import_file(path, robot, ImportChoices(columns={"target_position": "/told"}))
    stream = recording.streams[COMMANDS_STREAM]
    np.testing.assert_allclose(stream.time, told["command_time"], atol=1e-9)
    np.testing.assert_array_equal(stream.channels["target_position"].values, told["command"])
    with pytest.raises(ImportFileError, match=r"is not in the bag; .*: /joint_states, /told"):
        import_file(path, robot, ImportChoices(columns={"target_position": "/tolled"}, topic="/joint_states"))
    if kind != "JointState":
        assert "/told" in messages(import_file(path, robot, ImportChoices()))
    if kind != "Float64MultiArray":
        with pytest.raises(ImportFileError, match="0 values of target_velocity for 3 joints"):
            import_file(path, robot, ImportChoices(columns={"target_velocity": "/told"}))
