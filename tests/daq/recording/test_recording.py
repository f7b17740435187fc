"""The recording: what was written is read, and what is broken says how."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from each import each
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from daq.recording.reader import read_recording, recording_seconds
from daq.recording.recording import JOINTS_STREAM, SCHEMA_VERSION, Channel, Event, Recording, Stream
from daq.recording.writer import RecordingWriter, write_recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import RecordingError, UsageError
from drivers.core.ranges import STAMP
from drivers.streams import ChannelLayout, StreamLayout

NAMES = ("shoulder", "elbow")
ROBOT_TEXT = """
name: two-links
model:
  mdh:
    - {joint: shoulder, alpha: 0, d: 0, r: 0.3, antecedent: base}
    - {joint: elbow, alpha: pi/2, d: 0.4, r: 0, antecedent: shoulder}
joints:
  - {name: shoulder, position: [-3, 3], velocity: 2}
  - {name: elbow, position: [-2, 2], velocity: 2}
"""


@pytest.fixture(scope="module")
def robot() -> RobotFile:
    return parse_robot(ROBOT_TEXT, where="test", folder=None)


def make_recording(count: int = 20, **changes: object) -> Recording:
    time = np.arange(count, dtype=np.float64) * 0.002
    values = np.sin(time)[:, None] * np.array([1.0, 2.0])
    channels = {
        quantity: Channel(quantity, values * scale, unit, NAMES, "test")
        for scale, (quantity, unit) in enumerate((("position", "rad"), ("current", "A")), start=1)
    }
    stream = Stream(JOINTS_STREAM, time, time + 100.0, channels)
    recording = Recording(
        robot_text=ROBOT_TEXT,
        streams={JOINTS_STREAM: stream},
        events=(Event(0.5, "warning", "test", "τ > 1 N·m"),),
        created="2024-05-06T07:08:09+00:00",
        versions={"dynid": "0.0.1"},
        trajectory="harmonics: 5",
        host="bench",
        comment="first run",
    )
    return replace(recording, **changes)  # type: ignore[arg-type]


def assert_equal(first: Recording, second: Recording) -> None:
    assert replace(first, streams={}, path=None) == replace(second, streams={}, path=None)
    assert set(first.streams) == set(second.streams)
    for name, stream in first.streams.items():
        other = second.streams[name]
        np.testing.assert_array_equal(stream.time, other.time)
        np.testing.assert_array_equal(stream.host_time, other.host_time)
        assert set(stream.channels) == set(other.channels)
        for quantity, channel in stream.channels.items():
            np.testing.assert_array_equal(channel.values, other.channels[quantity].values)
            assert replace(channel, values=time_free) == replace(other.channels[quantity], values=time_free)


time_free = np.zeros(0)

FLOATS = st.floats(width=64, allow_nan=True, allow_infinity=True)
TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    streams = {}
    for name in draw(st.lists(st.sampled_from(["joints", "thermometer", "ft"]), min_size=1, unique=True)):
        count = draw(st.integers(0, 5))
        clock = hnp.arrays(np.float64, (count,), elements=st.floats(STAMP.least, STAMP.most))
        channels = {}
        for quantity in draw(st.lists(st.sampled_from(["position", "voltage", "force"]), unique=True)):
            width = draw(st.integers(1, 3))
            columns = tuple(f"c{k}" for k in range(width))
            values = draw(hnp.arrays(np.float64, (count, width), elements=FLOATS))
            channels[quantity] = Channel(quantity, values, draw(st.sampled_from(["rad", "N"])), columns, draw(TEXT))
        streams[name] = Stream(name, draw(clock), draw(clock), channels)
    events = st.builds(Event, st.floats(allow_nan=False), st.sampled_from(["info", "warning", "error"]), TEXT, TEXT)
    return make_recording(
        streams=streams,
        events=tuple(draw(st.lists(events, max_size=3))),
        complete=draw(st.booleans()),
        comment=draw(TEXT),
        trajectory=draw(TEXT),
    )


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(recording=recordings())
def test_what_is_written_is_read(recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        write_recording(path, recording)
        assert_equal(recording, read_recording(path))


def test_robot_comes_back_with_its_urdf(tmp_path: Path) -> None:
    """A URDF of 300 kB is more than HDF5 stores in a compact attribute."""
    text = "name: r\nmodel: {urdf: gone.urdf}\njoints: [{name: a, position: [-1, 1], velocity: 1}]\n"
    urdf = f"<robot name='r'><!-- {'x' * 300_000} --></robot>"
    write_recording(tmp_path / "run.h5", make_recording(robot_text=text, urdf_text=urdf))
    back = read_recording(tmp_path / "run.h5").robot()
    assert back.urdf_text == urdf
    assert back.robot.joint_names == ("a",)


def test_writer_refuses_to_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_recording(path, make_recording(comment="first"))
    with pytest.raises(UsageError, match="exists already"):
        write_recording(path, make_recording(comment="second"))
    assert read_recording(path).comment == "first"
    write_recording(path, make_recording(comment="second"), overwrite=True)
    assert read_recording(path).comment == "second"


def test_writer_without_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"missing: there is no such folder"):
        write_recording(tmp_path / "missing" / "run.h5", make_recording())


def test_writer_without_robot(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"carries no robot file.*--robot"):
        write_recording(tmp_path / "run.h5", make_recording(robot_text=""))
    assert not (tmp_path / "run.h5").exists()


def test_exception_leaves_an_incomplete_recording_with_its_reason(tmp_path: Path, robot: RobotFile) -> None:
    path = tmp_path / "run.h5"
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),), rate=500)

    def fail() -> None:
        with RecordingWriter(path, robot, [layout]) as writer:
            writer.append("joints", np.arange(3.0), np.arange(3.0), {"position": np.ones((3, 2))})
            raise RuntimeError("the cable\0 came off")

    with pytest.raises(RuntimeError):
        fail()
    recording = read_recording(path)
    assert not recording.complete
    assert recording.events[-1].level == "error"
    assert recording.events[-1].message == "the cable  came off"
    assert recording.streams["joints"].channels["position"].values.shape == (3, 2)


def test_writer_checks_its_caller(tmp_path: Path, robot: RobotFile) -> None:
    layout = StreamLayout("joints", (ChannelLayout("position", NAMES),))
    with RecordingWriter(tmp_path / "run.h5", robot, [layout]) as writer:
        with pytest.raises(ValueError, match="position"):
            writer.append("joints", np.arange(3.0), np.arange(3.0), {})
        with pytest.raises(ValueError, match="shape"):
            writer.append("joints", np.arange(3.0), np.arange(3.0), {"position": np.ones((3, 5))})
    with pytest.raises(ValueError, match="needs a unit"):
        ChannelLayout("humidity", NAMES)


def test_dimension_scales_and_units_are_readable_without_us(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_recording(path, make_recording())
    with h5py.File(path, "r") as file:
        position = file["streams/joints/position"]
        assert position.dims[0].label == "time"
        assert position.dims[0].keys() == ["time"]
        np.testing.assert_array_equal(position.dims[0]["time"][:], file["streams/joints/time"][:])
        assert position.attrs["unit"] == "rad"
        assert list(position.attrs["joints"]) == list(NAMES)
        assert file["streams/joints/time"].attrs["unit"] == "s"
        assert file.attrs["dynid_schema"] == SCHEMA_VERSION
        assert json.loads(file.attrs["versions"]) == {"dynid": "0.0.1"}


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-700])


def text_file(path: Path) -> None:
    path.write_text("t,q1\n0,1\n")


def empty_file(path: Path) -> None:
    path.write_bytes(b"")


def directory(path: Path) -> None:
    path.unlink()
    path.mkdir()


def without(name: str, instead: np.ndarray | None = None) -> Callable[[h5py.File], None]:
    """Take a group or dataset away, and put another one in its place."""

    def damage(file: h5py.File) -> None:
        del file[name]
        if instead is not None:
            file[name] = instead

    return damage


NOT_UTF8 = np.array(b"Gel\xe9nk", dtype=h5py.string_dtype())


def with_attribute(name: str, key: str, value: object) -> Callable[[h5py.File], None]:
    return lambda file: file[name].attrs.__setitem__(key, value)


JOINTS = f"streams/{JOINTS_STREAM}"


@each(
    ("damage", "message"),
    [
        (truncate, "truncated or still open in a writer.*copy it again"),
        (text_file, "is not an HDF5 file.*dynid import"),
        (empty_file, r"is empty \(0 bytes\)"),
        (directory, "is a folder, not a file"),
        (Path.unlink, "no such file"),
    ],
)
def test_what_is_no_whole_file_is_refused(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    path = Path(tempfile.mkdtemp(dir=tmp_path)) / "run.h5"
    write_recording(path, make_recording())
    damage(path)
    assert_refused(path, message)


@each(
    ("damage", "message"),
    [
        (lambda file: file.attrs.pop("dynid_schema"), "not a dynid recording.*dynid import"),
        (
            with_attribute("/", "dynid_schema", SCHEMA_VERSION + 1),
            "schema version 2, this version of dynid reads up to 1.*update dynid",
        ),
        (with_attribute("/", "dynid_schema", "one"), "unreadable schema version 'one'"),
        (without("streams"), "contains no stream"),
        (without(f"{JOINTS}/time"), "/streams/joints: has no dataset 'time'"),
        (
            lambda file: file[f"{JOINTS}/current"].resize(0, axis=0),
            "/streams/joints: is half-written: rows per dataset .*'current': 0",
        ),
        (lambda file: file[JOINTS].create_group("more"), "'more' is not a dataset"),
        (without(f"{JOINTS}/host_time", np.zeros((20, 2))), r"'host_time' has shape \(20, 2\)"),
        (
            lambda file: file[f"{JOINTS}/host_time"].__setitem__(7, -1e256),
            "/streams/joints: the 'host_time' of sample 7, -1e\\+256 s, is not within",
        ),
        (
            with_attribute(f"{JOINTS}/position", "joints", ["shoulder"]),
            "'position' has 2 columns, but its attribute 'joints' names 1",
        ),
        (
            with_attribute(f"{JOINTS}/position", "joints", ["shoulder", "shoulder"]),
            "'position' names a column twice: shoulder, shoulder",
        ),
        (
            with_attribute(f"{JOINTS}/position", "unit", "°"),
            "'position' is in °; values of a recording are in SI units",
        ),
        (lambda file: file.create_dataset(f"{JOINTS}/force", data=np.zeros(20)), r"'force' has shape \(20,\)"),
        (
            lambda file: file.create_dataset(f"{JOINTS}/force", data=np.zeros((20, 2), dtype=np.complex128)),
            r"'force' has .* type complex128",
        ),
        (without("events", np.zeros(3)), "is damaged"),
        *(
            (with_attribute(place, key, text), r"holds text that is not UTF-8: b?'Gel\\\w+nk' .write its names")
            for place, keys in {"/": ("robot", "versions"), f"/{JOINTS}/position": ("unit",)}.items()
            for key in keys
            for text in (np.bytes_(b"Gel\xe9nk"), NOT_UTF8)
        ),
        (lambda file: file.move(JOINTS, b"streams/\xe9"), r"holds text that is not UTF-8: b'\\xe9' .write its names"),
        (
            with_attribute(f"{JOINTS}/position", "joints", np.stack([NOT_UTF8, NOT_UTF8])),
            r"'Gel.*' holds the character \\udce9",
        ),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, damage: Callable[[h5py.File], None], message: str) -> None:
    path = tmp_path / "run.h5"
    path.unlink(missing_ok=True)
    write_recording(path, make_recording())
    with h5py.File(path, "a") as file:
        damage(file)
    assert_refused(path, message)


def assert_refused(path: Path, message: str) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(path)
    assert caught.value.where.startswith(str(path))
    assert caught.value.exit_status == 2


def test_crash_between_two_appends_keeps_the_common_part(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_recording(path, make_recording())
    with h5py.File(path, "a") as file:
        file["streams/joints/current"].resize(17, axis=0)
    stream = read_recording(path).streams["joints"]
    assert len(stream.time) == len(stream.host_time) == 17
    assert {channel.values.shape for channel in stream.channels.values()} == {(17, 2)}


@settings(max_examples=20, deadline=None)
@given(share=st.floats(0.0, 0.999), tail=st.binary(max_size=40))
def test_recordings_cut_anywhere_are_refused_in_our_words(share: float, tail: bytes) -> None:
    """Only cuts: on bytes flipped within its global heap the HDF5 library itself can loop for ever."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        write_recording(path, make_recording())
        content = path.read_bytes()
        # Longer than the tail, so that the file is shorter than its superblock says.
        path.write_bytes(content[: int(share * (len(content) - 41))] + tail)
        with pytest.raises(RecordingError, match=r"is truncated|is not an HDF5 file|is empty") as caught:
            read_recording(path)
        assert caught.value.where == str(path)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(borders=st.lists(st.integers(0, 40), min_size=2, max_size=2, unique=True).map(sorted))
def test_a_part_of_a_recording_is_that_part_of_the_whole(tmp_path: Path, borders: list[int]) -> None:
    path = tmp_path / "run.h5"
    if not path.exists():
        recording = make_recording(20, events=tuple(Event(t, "info", "test", "") for t in (0.0, 0.02, 0.5)))
        stream = recording.streams[JOINTS_STREAM]
        later = replace(stream, time=stream.time + 7.0)  # stamps begin anywhere
        write_recording(path, replace(recording, streams={JOINTS_STREAM: later}))
    begin, end = (0.001 * border for border in borders)
    inside = (np.arange(20) * 0.002 >= begin - 1e-9) & (np.arange(20) * 0.002 < end - 1e-9)
    if not np.any(inside):
        with pytest.raises(RecordingError, match="has no sample from"):
            read_recording(path, (begin, end))
        return
    whole, part = read_recording(path), read_recording(path, (begin, end))
    for name, channel in whole.streams[JOINTS_STREAM].channels.items():
        assert np.array_equal(part.streams[JOINTS_STREAM].channels[name].values, channel.values[inside])
    assert np.array_equal(part.time, whole.time[inside])
    assert part.events == ()
    assert part.label == f"{path}, {begin:g} to {end:g} s"
    assert recording_seconds(path) == pytest.approx(0.038)
