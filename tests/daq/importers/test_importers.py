"""Importers: the same samples in every format, names before order, and repairs only when asked for."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_state_bag import write_bag
from three_links import NAMES, Arrays, columns_of, content, make_robot, messages, samples, write_csv, write_npz

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.reader import read_recording
from daq.recording.recording import JOINTS_STREAM
from daq.recording.writer import write_recording
from daq.robot.loader import RobotFile
from drivers.core.errors import ImportFileError


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return make_robot()


def write_mat5(folder: Path, arrays: Arrays) -> Path:
    from scipy.io import savemat

    path = folder / "run.mat"
    savemat(path, arrays)
    return path


def write_mat73(folder: Path, arrays: Arrays) -> Path:
    """Write MATLAB's layout: a 512-byte header, matrices transposed, vectors as rows, the class as an attribute."""
    path = folder / "run73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            dataset = file.create_dataset(name, data=np.atleast_2d(values.T))
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def write_mcap(folder: Path, arrays: Arrays) -> Path:
    return write_bag(folder, arrays, mcap=True)


# --- the same samples in every format ------------------------------------------------------------------------------

NAMED = {"t": "time", "q": "position", "qd": "velocity", "torque": "torque", "current": "current"}


@pytest.mark.parametrize("write", [write_csv, write_npz, write_mat5, write_mat73, write_bag, write_mcap])
def test_every_format_gives_the_same_recording(
    tmp_path: Path, robot: RobotFile, write: Callable[[Path, Arrays], Path]
) -> None:
    arrays = samples()
    bag = write in (write_bag, write_mcap)
    path = write(tmp_path, {name: values for name, values in arrays.items() if not (bag and name == "current")})
    recording = import_file(path, robot, ImportChoices(effort="torque"))
    found = content(recording)
    expected = {NAMED[name]: values for name, values in arrays.items() if not (bag and name == "current")}
    assert set(found) == set(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-15, err_msg=name)
    channel = recording.streams[JOINTS_STREAM].channels["position"]
    assert channel.columns == NAMES
    assert channel.unit == "rad"
    assert ("matched by order" in messages(recording)) != bag
    assert path.name in recording.comment
    assert "SHA-256" in recording.comment
    # What was imported is an ordinary recording.
    write_recording(tmp_path / "run.h5", recording)
    back = read_recording(tmp_path / "run.h5")
    assert back.events == recording.events
    np.testing.assert_array_equal(content(back)["torque"], found["torque"])


@pytest.mark.parametrize("mcap", [False, True])
def test_a_bare_storage_file_reads_like_its_folder(tmp_path: Path, robot: RobotFile, mcap: bool) -> None:
    folder = write_bag(tmp_path, samples(), mcap=mcap)
    file = next(file for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
    bare = Path(shutil.copy(file, tmp_path / f"alone{file.suffix}"))
    choices = ImportChoices(effort="torque")
    expected = content(import_file(folder, robot, choices))
    (folder / "metadata.yaml").rename(tmp_path / "gone.yaml")
    for path in (bare, folder, file):
        found = content(import_file(path, robot, choices))
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)
    assert "no metadata.yaml" in messages(import_file(folder, robot, choices))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31), separator=st.sampled_from([",", ";", "\t", " "]))
def test_csv_columns_in_any_order_and_any_separator(seed: int, separator: str) -> None:
    arrays = samples(20)
    columns = columns_of(arrays)
    shuffled = np.random.default_rng(seed).permutation(list(columns))
    with tempfile.TemporaryDirectory() as folder:
        path = write_csv(Path(folder), {name: columns[name] for name in shuffled}, separator)
        found = content(import_file(path, make_robot(), ImportChoices()))
    for name, values in arrays.items():
        np.testing.assert_array_equal(found[NAMED[name]], values)


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_spreadsheets_decimal_commas_and_line_of_units_are_read(tmp_path: Path, line_end: str) -> None:
    """A byte order mark, semicolons, and degrees that only the line under the header states."""
    arrays = samples(20)
    columns = columns_of(arrays)
    degrees = {name: np.rad2deg(values) if name.startswith("q") else values for name, values in columns.items()}
    path = write_csv(tmp_path, degrees, ";")
    header, *rows = path.read_text().splitlines()
    kinds = {"t": "s", "q": "deg", "qd": "deg/s"}
    units = ";".join(kinds.get(name.rstrip("0123456789"), "") for name in header.split(";"))
    rows = [row.replace(".", ",") for row in rows]
    path.write_text(line_end.join(["\ufeff" + header, units, *rows]), newline="")
    recording = import_file(path, make_robot(), ImportChoices())
    for name, values in arrays.items():
        np.testing.assert_allclose(content(recording)[NAMED[name]], values, rtol=1e-12, atol=1e-15)
    assert "the units were taken from line 2" in messages(recording)
    assert "decimal commas were read" in messages(recording)


@pytest.mark.parametrize("ending", ["", "Z", "+02:00"])
def test_times_may_be_dates(tmp_path: Path, ending: str) -> None:
    columns = columns_of(samples(20))
    header, *rows = write_csv(tmp_path, columns, ",").read_text().splitlines()
    begin = datetime(2026, 3, 29, 0, 59, 59, 900000)
    dated = [
        ",".join([f"{(begin + timedelta(seconds=stamp)).isoformat()}{ending}", row.split(",", 1)[1]])
        for stamp, row in zip(columns["t"], rows, strict=True)
    ]
    path = tmp_path / "dated.csv"
    path.write_text("\n".join([header, *dated]))
    found = content(import_file(path, make_robot(), ImportChoices()))
    np.testing.assert_allclose(found["time"] - found["time"][0], columns["t"] - columns["t"][0], atol=1e-6)
    path.write_text("\n".join([header, *dated]).replace(dated[3].split(",")[0], "noon"))
    with pytest.raises(ImportFileError, match="'noon' is not a number"):
        import_file(path, make_robot(), ImportChoices())


# --- joints ---------------------------------------------------------------------------------------------------------


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_shuffled_joint_names_come_out_in_the_robots_order(seed: int) -> None:
    """Every message in its own order, with a gripper in between."""

    def names(index: int) -> tuple[str, ...]:
        order = np.random.default_rng(seed + index).permutation([*NAMES, "gripper"])
        return tuple(str(name) for name in order)

    arrays = samples(20)
    with tempfile.TemporaryDirectory() as folder:
        recording = import_file(
            write_bag(Path(folder), arrays, names=names), make_robot(), ImportChoices(effort="current")
        )
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"])
    np.testing.assert_array_equal(content(recording)["current"], arrays["torque"])
    assert "were dropped: gripper" in messages(recording)
    assert "order of the joints changes" in messages(recording)


def test_messages_of_another_device_on_the_topic_are_left_out(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    path = write_bag(tmp_path, arrays, names=lambda index: ("finger",) if index % 2 else NAMES)
    recording = import_file(path, robot, ImportChoices(effort="torque"))
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"][::2])
    assert "10 messages about other joints were dropped" in messages(recording)


def test_prefixes_on_either_side(tmp_path: Path) -> None:
    arrays = samples(20)

    def prefixed(_: int, fields: dict[str, Any]) -> None:
        fields["name"] = [f"left_{name}" for name in fields["name"]]

    path = write_bag(tmp_path, arrays, edit=prefixed)
    recording = import_file(path, make_robot(), ImportChoices(effort="torque"))
    assert "the file's joint names carry the prefix 'left_'" in messages(recording)
    own = make_robot(rename={name: f"arm_{name}" for name in NAMES})
    shutil.rmtree(path)
    recording = import_file(write_bag(tmp_path, arrays), own, ImportChoices(effort="torque"))
    assert "the robot's joint names carry the prefix 'arm_'" in messages(recording)
    assert recording.streams[JOINTS_STREAM].channels["position"].columns == ("arm_shoulder", "arm_elbow", "arm_wrist")


def test_joints_by_order_are_asked_for_and_recorded(tmp_path: Path) -> None:
    other = make_robot(rename=dict(zip(NAMES, ("j1", "j2", "j3"), strict=True)))
    path = write_bag(tmp_path, samples(20))
    with pytest.raises(ImportFileError, match=r"has no joint j1, j2, j3; it has: shoulder, elbow, wrist.*--by-order"):
        import_file(path, other, ImportChoices(effort="torque"))
    recording = import_file(path, other, ImportChoices(effort="torque", by_order=True))
    assert "warning: joints matched by order: shoulder → j1, elbow → j2, wrist → j3" in messages(recording)


def test_names_in_an_npz_are_matched(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    order = [2, 0, 1]
    mixed = {name: values if values.ndim == 1 else values[:, order] for name, values in arrays.items()}
    path = write_npz(tmp_path, {**mixed, "joint_names": np.array([NAMES[k] for k in order])})
    recording = import_file(path, robot, ImportChoices())
    np.testing.assert_array_equal(content(recording)["torque"], arrays["torque"])
    assert "by order" not in messages(recording)


def test_cells_of_names_in_matlab_files_are_matched(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    order = [1, 2, 0]
    mixed = {name: values if values.ndim == 1 else values[:, order] for name, values in arrays.items()}
    names = [NAMES[k] for k in order]
    path = write_mat5(tmp_path, {**mixed, "joint_names": np.array(names, dtype=object)})
    found = content(import_file(path, robot, ImportChoices()))
    np.testing.assert_array_equal(found["torque"], arrays["torque"])
    path = write_mat73(tmp_path, mixed)
    with h5py.File(path, "a") as file:
        store = file.create_group("#refs#")
        references = []
        for index, name in enumerate(names):
            cell = store.create_dataset(f"c{index}", data=np.array([[ord(letter)] for letter in name], dtype=np.uint16))
            references.append(cell.ref)
        cells = file.create_dataset("joint_names", data=np.array([references], dtype=h5py.ref_dtype))
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
    found = content(import_file(path, robot, ImportChoices()))
    np.testing.assert_array_equal(found["torque"], arrays["torque"])


def test_named_csv_columns_go_before_any_order(tmp_path: Path, robot: RobotFile) -> None:
    """The columns are those that PlotJuggler exports of a JointState topic."""
    arrays = samples(20)
    columns = {"__time": arrays["t"], "/joint_states/header/stamp": arrays["t"] + 5.0}
    for k in (2, 0, 1):
        columns[f"/joint_states/{NAMES[k]}/position"] = arrays["q"][:, k]
        columns[f"/joint_states/{NAMES[k]}/effort"] = arrays["torque"][:, k]
    columns["/joint_states/gripper/position"] = arrays["t"]
    recording = import_file(write_csv(tmp_path, columns), robot, ImportChoices(effort="torque"))
    np.testing.assert_array_equal(content(recording)["time"], arrays["t"])
    np.testing.assert_array_equal(content(recording)["position"], arrays["q"])
    assert "by order" not in messages(recording)
    assert "not imported: /joint_states/header/stamp, /joint_states/gripper/position" in messages(recording)


# --- stamps and gaps of drivers -------------------------------------------------------------------------------------


def test_bag_without_header_stamps_takes_the_receive_times(tmp_path: Path, robot: RobotFile) -> None:
    arrays = samples(20)
    path = write_bag(tmp_path, arrays, stamped=False, start=1_700_000_000_000_000_001)
    recording = import_file(path, robot, ImportChoices(effort="torque"))
    np.testing.assert_allclose(content(recording)["time"], arrays["t"], atol=1e-15)
    assert "warning: all header stamps are zero" in messages(recording)


def test_quantities_of_nan_alone_are_left_out_by_the_repair(tmp_path: Path, robot: RobotFile) -> None:
    """ros2_control publishes NaN for interfaces that the hardware doesn't have."""
    arrays = samples(20)
    path = write_bag(tmp_path, {**arrays, "qd": np.full((20, 3), np.nan)})
    with pytest.raises(ImportFileError, match=r"20 of 20 samples have NaN.*velocity of shoulder.*drop-nan"):
        import_file(path, robot, ImportChoices(effort="torque"))
    recording = import_file(path, robot, ImportChoices(effort="torque", repair=frozenset({"drop-nan"})))
    assert set(content(recording)) == {"time", "position", "torque"}
    assert "dropped, without any finite value: velocity" in messages(recording)
