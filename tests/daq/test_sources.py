"""Several sources in one session: all are read, none keeps another waiting, and the arm stops whatever one does."""

from __future__ import annotations

import time

import numpy as np
import pytest
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm

from daq.recorder import Recorder
from daq.recording import read_recording
from daq.safety import Limits, Supervisor
from daq.session import Play, record
from daq.sources import Sources
from daq.trajectories import PointToPoint
from drivers.base import Notice
from drivers.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.streams import Block, ChannelLayout, StreamLayout

MOTION = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([0.8, 0.8]))


class Thermometer:
    """A scripted source: a row every 20 ms of a clock that began at 5000; `fault` names the method that fails."""

    def __init__(self, fault: str = "", *, after: float = 0.3, heat: float = 30.0, essential: bool = False) -> None:
        self.fault, self.after, self.heat, self.essential = fault, after, heat, essential
        self.calls: list[str] = []
        self.timeouts: list[float] = []
        self._begun = self._last = 0.0
        self._notices: list[Notice] = []

    @property
    def faulty(self) -> bool:
        return time.monotonic() - self._begun > self.after

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if self.fault == name:
            raise {"open": ConnectionFailedError, "start": ConnectionLostError}.get(name, RuntimeError)(f"no {name}")

    def open(self):
        self._called("open")

    def streams(self):
        layout = ChannelLayout("temperature", ("elbow",))
        return (StreamLayout("thermometer", (layout,), 50.0, essential=self.essential),)

    def start(self):
        self._called("start")
        self._begun = self._last = time.monotonic()

    def read(self, timeout):
        self.timeouts.append(timeout)
        now = time.monotonic()
        if self.fault == "read" and self.faulty:
            raise ConnectionLostError("the wire is off", where="/dev/ttyUSB0")
        if (self.fault == "silence" and self.faulty) or now - self._last < 0.02:
            return ()
        if self.fault == "notice" and self.faulty and not self._notices:
            self._notices.append(Notice(5000.0 + now - self._begun, "warning", "rather warm"))
        self._last = now
        hot = self.heat if self.faulty else 30.0
        stamp = np.array([5000.0 + now - self._begun])
        return (Block("thermometer", stamp, np.array([now]), {"temperature": np.full((1, 1), hot)}),)

    def notices(self):
        taken, self._notices = [n for n in self._notices if n.message], [Notice(0.0, "info", "")] * bool(self._notices)
        return taken

    def command(self, position):
        raise AssertionError("only the arm is commanded")

    def stop(self):
        self._called("stop")

    def close(self):
        self._called("close")


class SafeArm(KinematicArm):
    """Notes the order of its calls."""

    def __init__(self, *arguments, **keys):
        super().__init__(*arguments, **keys)
        self.calls: list[str] = []

    def close(self):
        self.calls.append("close")
        super().close()


def run(path, sources, play=None, duration=None):
    sources.open()
    layouts = sources.streams()
    supervisor = Supervisor(Limits.of_robot(ROBOT_FILE.robot, tracking_error=0.05), layouts)
    return record(sources, Recorder(path, ROBOT_FILE, layouts), supervisor, play, duration)


def motion() -> Play:
    return Play(MOTION, ROBOT_FILE.robot, RATE)


def test_both_are_in_one_recording(tmp_path):
    arm, thermometer = SafeArm(), Thermometer()
    sources = Sources("bench", arm, {"oven/sensor": thermometer})
    report = run(tmp_path / "run.h5", sources, motion())
    sources.close()
    assert report.stopped_by is None, report.stopped_by
    recording = read_recording(tmp_path / "run.h5")
    assert recording.complete
    assert set(recording.streams) == {"joints", "oven_sensor"}
    heat = recording.streams["oven_sensor"]
    assert heat.channels["temperature"].columns == ("elbow",)
    assert len(heat.time) == report.samples["oven_sensor"] > 20
    assert heat.time[0] > 5000.0  # each keeps its own clock
    assert arm.commands
    assert set(thermometer.timeouts) == {0.0}  # only the arm is waited for
    assert thermometer.calls == ["open", "start", "stop", "close"]


def test_names_stay_apart():
    sources = Sources(
        "arm", KinematicArm(), {"thermometer": Thermometer(), "joints": Thermometer(), "b": KinematicArm()}
    )
    sources.open()
    assert [layout.name for layout in sources.streams()] == ["joints", "thermometer", "joints_2", "b"]


def test_where_one_cannot_be_opened_the_others_are_closed():
    arm, first, second = SafeArm(), Thermometer(), Thermometer("open")
    with pytest.raises(ConnectionFailedError, match="second: no open"):
        Sources("arm", arm, {"first": first, "second": second}).open()
    assert arm.calls == ["close"]
    assert first.calls == ["open", "close"]
    assert second.calls == ["open", "close"]


def test_where_one_does_not_start_all_are_stopped(tmp_path):
    arm, first, second = SafeArm(), Thermometer(), Thermometer("start")
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"first": first, "second": second}), motion())
    assert "second: no start" in (report.stopped_by or "")
    assert arm.stopped_at is not None
    assert "stop" in first.calls
    assert arm.commands == []


def test_what_breaks_stops_the_arm_and_loses_nothing_of_it(tmp_path):
    arm, thermometer = SafeArm(), Thermometer("read")
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), motion())
    assert isinstance(report.error, ConnectionLostError)
    assert report.stopped_by == "oven: /dev/ttyUSB0: the wire is off"
    assert arm.stopped_at is not None
    assert arm.commands_after_stop == 0
    joints = read_recording(tmp_path / "run.h5").streams["joints"]
    assert np.allclose(np.diff(joints.time), 1.0 / RATE)
    assert len(joints.time) == arm._count


def test_a_silent_thermometer_does_not_stop_the_arm_unless_it_is_required(tmp_path):
    for essential in (False, True):
        arm = SafeArm()
        path = tmp_path / f"{essential}.h5"
        report = run(path, Sources("arm", arm, {"oven": Thermometer("silence", essential=essential)}), motion())
        assert ("stale data of stream oven" in (report.stopped_by or "")) == essential


def test_the_source_of_a_silent_stream_is_asked_who_is_silent():
    class Attributed(Thermometer):
        def silence(self, stream, limit):
            return f"{stream} {limit:g}"

    sources = Sources("arm", SafeArm(), {"oven": Attributed()})
    sources.open()
    assert sources.silence("oven", 0.25) == "thermometer 0.25"  # under the source's own name of it
    assert sources.silence("joints", 0.05) == ""
    sources.close()


def test_its_temperature_stops_the_arm(tmp_path):
    arm, thermometer = SafeArm(), Thermometer(heat=71.0)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), motion())
    assert report.stopped_by == "temperature of elbow: 71 °C passes 70 °C"
    recording = read_recording(tmp_path / "run.h5")
    (stopped,) = (event for event in recording.events if event.source == "session")
    # The reason has the time of the hot sample, told on the joints' clock.
    hot = recording.streams["oven"].host_time[-1]
    joints = recording.streams["joints"]
    assert stopped.time == pytest.approx(np.interp(hot, joints.host_time, joints.time), abs=0.1)


def test_notices_bear_their_sources_name_and_the_arms_time(tmp_path):
    arm, thermometer = SafeArm(), Thermometer("notice")
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), motion())
    assert report.stopped_by is None
    recording = read_recording(tmp_path / "run.h5")
    (event,) = (event for event in recording.events if "rather warm" in event.message)
    assert event.message == "oven: rather warm"
    first, last = recording.streams["joints"].time[[0, -1]]
    assert first < event.time < last


def test_a_source_that_cannot_be_stopped_is_told_and_the_arm_is_stopped_first(tmp_path):
    arm, thermometer = SafeArm(), Thermometer("stop")
    sources = Sources("arm", arm, {"oven": thermometer})
    report = run(tmp_path / "run.h5", sources, duration=0.3)
    assert report.stopped_by is None
    assert arm.stopped_at is not None
    messages = [event.message for event in read_recording(tmp_path / "run.h5").events]
    assert "oven: could not be stopped: RuntimeError: no stop" in messages


def test_all_are_closed_even_where_one_refuses():
    first, second = Thermometer("close"), Thermometer()
    sources = Sources("arm", SafeArm(), {"first": first, "second": second})
    sources.open()
    with pytest.raises(RuntimeError, match="no close"):
        sources.close()
    assert second.calls[-1] == "close"


def test_only_the_main_one_is_commanded():
    class Watcher(KinematicArm):
        def command(self, position):
            raise DriverStateError("this one cannot move an arm")

    arm = KinematicArm()
    sources = Sources("arm", arm, {"oven": Thermometer()})
    sources.command(np.array([0.1, 0.2]))
    assert arm.commands[-1].tolist() == [0.1, 0.2]
    with pytest.raises(DriverStateError):
        Sources("watcher", Watcher(), {"arm": arm}).command(np.zeros(2))
