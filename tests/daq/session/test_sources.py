"""Several sources in one session: all are read, none keeps another waiting, and the arm stops whatever one does."""

from __future__ import annotations

import re

import numpy as np
import pytest
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm
from recorded_session import record_session
from unchecked import unchecked_play

from daq.motion.trajectories import PointToPoint
from daq.recording.reader import read_recording
from daq.session.play import Play
from daq.session.sources import Sources
from drivers.base import Notice
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.streams import Batch, ChannelLayout, StreamLayout

MOTION = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([0.8, 0.8]))
PERIOD = 0.0225
"""Period of the thermometer's rows [s]; five of them end between two samples of the arm."""
STAMP = 5000.0
"""Reading of the thermometer's own clock when it starts [s]."""
CYCLE = 1.0 / RATE


class Thermometer:
    """A scripted source: a row every `PERIOD`; from `after` [s] on, the method called `fault` fails."""

    def __init__(
        self,
        clock,
        fault: str = "",
        *,
        after: float = 0.913,
        heat: float = 30.0,
        essential: bool = False,
        drift: float = 0.0,
    ) -> None:
        self.clock, self.fault, self.after, self.heat = clock, fault, after, heat
        self.essential, self.drift = essential, drift
        self.calls: list[str] = []
        self.timeouts: list[float] = []
        self.begun = float("nan")
        self.rows = 0
        self._notices: list[Notice] = []

    @property
    def faulty(self) -> bool:
        return self.clock.now() - self.begun > self.after

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if self.fault == name:
            raise {"open": ConnectionFailedError, "start": ConnectionLostError}.get(name, RuntimeError)(f"no {name}")

    def open(self):
        self._called("open")

    def streams(self):
        layout = ChannelLayout("temperature", ("elbow",))
        return (StreamLayout("thermometer", (layout,), 1.0 / PERIOD, essential=self.essential),)

    def start(self):
        self._called("start")
        self.begun = self.clock.now()

    def read(self, timeout):
        self.timeouts.append(timeout)
        if self.fault == "read" and self.faulty:
            raise ConnectionLostError("the wire is off", where="/dev/ttyUSB0")
        due = self.begun + (self.rows + 1) * PERIOD
        if (self.fault == "silence" and self.faulty) or self.clock.now() < due - 1e-9:
            return ()
        self.rows += 1
        stamp = STAMP + (1.0 - self.drift) * (due - self.begun)
        if self.fault == "notice" and self.faulty:
            self._notices.append(Notice(stamp, "warning", "rather warm"))
            self.fault = ""
        values = {"temperature": np.full((1, 1), self.heat if self.faulty else 30.0)}
        return (Batch("thermometer", np.array([stamp]), np.array([due]), values),)

    def notices(self):
        taken, self._notices = self._notices, []
        return taken

    def command(self, position):
        raise AssertionError("only the arm is commanded")

    def stop(self):
        self._called("stop")

    def close(self):
        self._called("close")


def run(path, clock, sources, play=None, duration=None):
    sources.open()
    return record_session(path, ROBOT_FILE, sources, play, duration, tracking_error=0.05, clock=clock)


def motion() -> Play:
    return unchecked_play(MOTION, ROBOT_FILE.robot)


def test_both_are_in_one_recording(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock)
    sources = Sources("bench", arm, {"oven/sensor": thermometer})
    report = run(tmp_path / "run.h5", clock, sources, motion())
    sources.close()
    assert report.stopped_by is None, report.stopped_by
    recording = read_recording(tmp_path / "run.h5")
    assert recording.complete
    assert set(recording.streams) == {"joints", "oven_sensor"}
    joints, heat = recording.streams["joints"], recording.streams["oven_sensor"]
    np.testing.assert_array_equal(joints.channels["position"].values, arm.positions)
    assert report.samples == {"joints": arm.count, "oven_sensor": thermometer.rows}
    assert heat.channels["temperature"].columns == ("elbow",)
    # Each keeps its own clock, and none of its samples waits for the other's.
    np.testing.assert_allclose(heat.time, STAMP + PERIOD * np.arange(1, thermometer.rows + 1), rtol=0, atol=1e-9)
    assert thermometer.rows == int(arm.count * CYCLE / PERIOD + 1e-6)
    assert set(thermometer.timeouts) == {0.0}  # only the arm is waited for
    assert thermometer.calls == ["open", "start", "stop", "close"]
    assert arm.calls == ["open", "start", "take_control", "stop", "close"]
    np.testing.assert_allclose(arm.position, [0.0, 0.0], atol=1e-12)


def test_the_clocks_of_all_are_compared_with_the_hosts(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, drift=2e-4)
    sources = Sources("bench", arm, {"oven": thermometer})
    report = run(tmp_path / "run.h5", clock, sources, duration=10.0)
    assert report.stopped_by is None
    told = {event.message for event in read_recording(tmp_path / "run.h5").events if event.source == "clocks"}
    (of_oven,) = (message for message in told if message.startswith("clock of oven: "))
    (of_arm,) = told - {of_oven}
    assert of_arm.startswith("clock of joints: the host's own, shifted by")
    offset, reference, drift = re.match(
        r".*offset (\S+) s ± \S+ s at (\S+) s, drift (\S+) ppm ± \S+ ppm over 10 s", of_oven
    ).groups()
    assert float(drift) == pytest.approx(200.0, abs=0.1)
    since = (float(reference) - STAMP) / (1.0 - 2e-4)
    assert float(reference) + float(offset) == pytest.approx(thermometer.begun + since, abs=2e-6)


def test_names_stay_apart(clock):
    sources = Sources(
        "arm",
        KinematicArm(clock=clock),
        {"thermometer": Thermometer(clock), "joints": Thermometer(clock), "b": KinematicArm(clock=clock)},
    )
    sources.open()
    assert [layout.name for layout in sources.streams()] == ["joints", "thermometer", "joints_2", "b"]


def test_where_one_cannot_be_opened_the_others_are_closed(clock):
    arm, first, second = KinematicArm(clock=clock), Thermometer(clock), Thermometer(clock, "open")
    with pytest.raises(ConnectionFailedError, match="second: no open"):
        Sources("arm", arm, {"first": first, "second": second}).open()
    assert arm.calls == first.calls == second.calls == ["open", "close"]


def test_where_one_does_not_start_all_are_stopped(tmp_path, clock):
    arm, first, second = KinematicArm(clock=clock), Thermometer(clock), Thermometer(clock, "start")
    report = run(tmp_path / "run.h5", clock, Sources("arm", arm, {"first": first, "second": second}), motion())
    assert "second: no start" in (report.stopped_by or "")
    assert "stop" in arm.calls
    assert "stop" in first.calls
    assert arm.commands == []


def test_what_breaks_stops_the_arm_at_once_and_loses_nothing_of_it(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, "read")
    report = run(tmp_path / "run.h5", clock, Sources("arm", arm, {"oven": thermometer}), motion())
    assert isinstance(report.error, ConnectionLostError)
    assert report.stopped_by == "oven: /dev/ttyUSB0: the wire is off"
    # It is noticed with the first sample of the arm after the loss; the player ends at its next period.
    assert arm.command_times[-1] - arm.begun == pytest.approx(0.915, abs=1e-9)
    assert arm.stopped_at - arm.begun == pytest.approx(0.915 + CYCLE, abs=1e-9)
    recording = read_recording(tmp_path / "run.h5")
    np.testing.assert_array_equal(recording.streams["joints"].channels["position"].values, arm.positions)
    assert arm.count == 183
    (stopped,) = (event for event in recording.events if event.source == "session")
    assert stopped.message == "stopped: oven: /dev/ttyUSB0: the wire is off"
    assert stopped.time == pytest.approx(arm.stamp(arm.begun + 0.915), abs=1e-9)


@pytest.mark.parametrize("essential", [False, True])
def test_a_silent_thermometer_does_not_stop_the_arm_unless_it_is_required(tmp_path, clock, essential):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, "silence", essential=essential)
    report = run(tmp_path / "run.h5", clock, Sources("arm", arm, {"oven": thermometer}), motion())
    assert thermometer.rows == 40
    if essential:  # five periods after the row at 0.9 s
        assert str(report.stopped_by).startswith("stale data of stream oven: 0.115 s passes 0.1125 s (check cables")
        assert arm.command_times[-1] - arm.begun == pytest.approx(0.9 + 0.115, abs=1e-9)
    else:
        assert report.stopped_by is None
        np.testing.assert_allclose(arm.position, [0.0, 0.0], atol=1e-12)


def test_the_source_of_a_silent_stream_is_asked_who_is_silent(clock):
    class Attributed(Thermometer):
        def silence(self, stream, limit):
            return f"{stream} {limit:g}"

        def losses(self, stream):
            return f"{stream} too hot"

    sources = Sources("arm", KinematicArm(clock=clock), {"oven": Attributed(clock)})
    sources.open()
    assert sources.silence("oven", 0.25) == "thermometer 0.25"  # under the source's own name of it
    assert sources.losses("oven") == "thermometer too hot"
    assert sources.silence("joints", 0.05) == sources.losses("joints") == ""
    sources.close()


def test_its_temperature_stops_the_arm(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, heat=71.0)
    report = run(tmp_path / "run.h5", clock, Sources("arm", arm, {"oven": thermometer}), motion())
    assert str(report.stopped_by).startswith("temperature of elbow: 71 °C passes 70 °C (let it")
    assert arm.command_times[-1] - arm.begun == pytest.approx(0.925, abs=1e-9)
    recording = read_recording(tmp_path / "run.h5")
    (stopped,) = (event for event in recording.events if event.source == "session")
    # The reason has the time of the hot sample, told on the joints' clock.
    assert stopped.time == pytest.approx(arm.stamp(arm.begun + 41 * PERIOD), abs=1e-9)
    assert len(recording.streams["oven"].time) == 41


def test_notices_bear_their_sources_name_and_the_arms_time(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, "notice")
    report = run(tmp_path / "run.h5", clock, Sources("arm", arm, {"oven": thermometer}), motion())
    assert report.stopped_by is None
    (event,) = (event for event in read_recording(tmp_path / "run.h5").events if "rather warm" in event.message)
    assert event.message == "oven: rather warm"
    assert event.time == pytest.approx(arm.stamp(arm.begun + 41 * PERIOD), abs=1e-9)


def test_a_source_that_cannot_be_stopped_is_told_and_the_arm_is_stopped_first(tmp_path, clock):
    arm, thermometer = KinematicArm(clock=clock), Thermometer(clock, "stop")
    sources = Sources("arm", arm, {"oven": thermometer})
    report = run(tmp_path / "run.h5", clock, sources, duration=0.3)
    assert report.stopped_by is None
    assert arm.stopped_at - arm.begun == pytest.approx(0.3, abs=CYCLE + 1e-9)
    messages = [event.message for event in read_recording(tmp_path / "run.h5").events]
    assert "oven: could not be stopped: RuntimeError: no stop" in messages


def test_all_are_closed_even_where_one_refuses(clock):
    first, second = Thermometer(clock, "close"), Thermometer(clock)
    sources = Sources("arm", KinematicArm(clock=clock), {"first": first, "second": second})
    sources.open()
    with pytest.raises(RuntimeError, match="no close"):
        sources.close()
    assert second.calls[-1] == "close"


def test_only_the_main_one_is_commanded(clock):
    class Watcher(KinematicArm):
        def command(self, position):
            raise DriverStateError("this one cannot move an arm")

    arm = KinematicArm(clock=clock)
    Sources("arm", arm, {"oven": Thermometer(clock)}).command(np.array([0.1, 0.2]))
    assert arm.position.tolist() == [0.1, 0.2]
    with pytest.raises(DriverStateError):
        Sources("watcher", Watcher(clock=clock), {"arm": arm}).command(np.zeros(2))
