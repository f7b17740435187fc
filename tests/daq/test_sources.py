"""Several sources in one session: all are read, none keeps another waiting, and the arm stops whatever one does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from kinematic_arm import FIRST_STAMP, RATE, ROBOT_FILE, KinematicArm
from simulated_clock import SimulatedClock

from daq.recorder import Recorder
from daq.recording import Recording, read_recording
from daq.safety import Limits, Supervisor
from daq.session import READ_TIMEOUT, Play, SessionReport, record
from daq.sources import Sources
from daq.trajectories import PointToPoint
from drivers.base import Notice
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import ConnectionFailedError, ConnectionLostError, DriverStateError
from drivers.streams import Block, ChannelLayout, StreamLayout

MOTION = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([0.8, 0.8]))
PLAY = Play(MOTION, ROBOT_FILE.robot, RATE)
PERIOD = 1.0 / RATE
HEAT_PERIOD = 0.02
FIRST_HEAT_STAMP = 5000.0


class Thermometer:
    """A scripted source: row k is taken k + 1 periods after `start`; its clock begins at 5000 s.

    Args:
        fault: the method that fails, or what else goes wrong.
        after: how long after `start` a fault begins, and the heat [s].
        heat: temperature from then on [°C].
        essential: whether the arm must not move without it.
        clock: the host's.
    """

    def __init__(
        self,
        fault: str = "",
        after: float = 0.702,
        heat: float = 30.0,
        essential: bool = False,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self.fault, self.after, self.heat, self.essential = fault, after, heat, essential
        self.calls: list[str] = []
        self.timeouts: list[float] = []
        self._clock = clock
        self._begun, self._count, self._noticed = 0.0, 0, False

    @property
    def faulty(self) -> bool:
        return self._clock.now() - self._begun > self.after

    def _called(self, name: str) -> None:
        self.calls.append(name)
        if self.fault == name:
            raise {"open": ConnectionFailedError, "start": ConnectionLostError}.get(name, RuntimeError)(f"no {name}")

    def open(self) -> None:
        self._called("open")

    def streams(self) -> tuple[StreamLayout, ...]:
        layout = ChannelLayout("temperature", ("elbow",))
        return (StreamLayout("thermometer", (layout,), 1.0 / HEAT_PERIOD, essential=self.essential),)

    def start(self) -> None:
        self._called("start")
        self._begun = self._clock.now()

    def read(self, timeout: float) -> Sequence[Block]:
        self.timeouts.append(timeout)
        if self.fault == "read" and self.faulty:
            raise ConnectionLostError("the wire is off", where="/dev/ttyUSB0")
        due = int((self._clock.now() - self._begun) / HEAT_PERIOD + 1e-6)
        if (self.fault == "silence" and self.faulty) or due == self._count:
            return ()
        passed = HEAT_PERIOD * np.arange(self._count + 1, due + 1)
        self._count = due
        values = np.where(passed > self.after, self.heat, 30.0)[:, None]
        return (Block("thermometer", FIRST_HEAT_STAMP + passed, self._begun + passed, {"temperature": values}),)

    def notices(self) -> Sequence[Notice]:
        if self.fault == "notice" and self.faulty and not self._noticed:
            self._noticed = True
            return [Notice(FIRST_HEAT_STAMP + self._clock.now() - self._begun, "warning", "rather warm")]
        return []

    def command(self, position: np.ndarray) -> None:
        raise AssertionError("only the arm is commanded")

    def stop(self) -> None:
        self._called("stop")

    def close(self) -> None:
        self._called("close")


class SafeArm(KinematicArm):
    """Notes that it was closed."""

    def __init__(self, fault: str = "", after: float = 0.3, rate: float = RATE, clock: Clock = SYSTEM_CLOCK) -> None:
        super().__init__(fault, after, rate, clock)
        self.calls: list[str] = []

    def close(self) -> None:
        self.calls.append("close")
        super().close()


def run(
    path: Path, sources: Sources, clock: Clock, play: Play | None = None, duration: float | None = None
) -> SessionReport:
    sources.open()
    layouts = sources.streams()
    supervisor = Supervisor(Limits.of_robot(ROBOT_FILE.robot, tracking_error=0.05), layouts)
    recorder = Recorder(path, ROBOT_FILE, layouts, clock=clock)
    return record(sources, recorder, supervisor, play, duration, clock=clock)


def recorded(path: Path, arm: KinematicArm) -> Recording:
    """The recording; all that the arm handed out is in it."""
    recording = read_recording(path)
    np.testing.assert_array_equal(
        recording.streams["joints"].time, np.concatenate([block.time for block in arm.samples])
    )
    np.testing.assert_allclose(recording.streams["joints"].time, FIRST_STAMP + PERIOD * np.arange(arm.count))
    return recording


def stopped(arm: KinematicArm) -> float:
    """When the arm was stopped, after its start [s]."""
    assert arm.stopped_at is not None
    return arm.stopped_at - arm.begun


def test_both_are_in_one_recording(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer(heat=31.0, clock=clock)
    sources = Sources("bench", arm, {"oven/sensor": thermometer})
    report = run(tmp_path / "run.h5", sources, clock, PLAY)
    sources.close()
    assert report.stopped_by is None
    recording = recorded(tmp_path / "run.h5", arm)
    assert recording.complete
    assert set(recording.streams) == {"joints", "oven_sensor"}
    heat = recording.streams["oven_sensor"]
    assert heat.channels["temperature"].columns == ("elbow",)
    passed = HEAT_PERIOD * np.arange(1, int(arm.count * PERIOD / HEAT_PERIOD + 1e-6) + 1)
    np.testing.assert_array_equal(heat.time, FIRST_HEAT_STAMP + passed)  # each keeps its own clock
    np.testing.assert_array_equal(heat.host_time, arm.begun + passed)
    np.testing.assert_array_equal(heat.channels["temperature"].values[:, 0], np.where(passed > 0.702, 31.0, 30.0))
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


def test_where_one_does_not_start_all_are_stopped(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, first, second = SafeArm(clock=clock), Thermometer(clock=clock), Thermometer("start", clock=clock)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"first": first, "second": second}), clock, PLAY)
    assert "second: no start" in (report.stopped_by or "")
    assert arm.stopped_at is not None
    assert "stop" in first.calls
    assert arm.commands == []


def test_what_breaks_stops_the_arm_and_loses_nothing_of_it(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer("read", clock=clock)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), clock, PLAY)
    assert isinstance(report.error, ConnectionLostError)
    assert report.stopped_by == "oven: /dev/ttyUSB0: the wire is off"
    # In the cycle of the arm's first sample after it; what that cycle read is handed on before the error.
    assert stopped(arm) == pytest.approx(0.705 + PERIOD, abs=1.01 * PERIOD)
    assert arm.commands_after_stop == 0
    recorded(tmp_path / "run.h5", arm)


@pytest.mark.parametrize("essential", [False, True])
def test_a_silent_thermometer_does_not_stop_the_arm_unless_it_is_required(
    tmp_path: Path, clock: SimulatedClock, essential: bool
) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer("silence", essential=essential, clock=clock)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), clock, PLAY)
    recording = recorded(tmp_path / "run.h5", arm)
    assert recording.complete == (not essential)
    assert len(recording.streams["oven"].time) == 35
    if essential:
        assert "stale data of stream oven" in (report.stopped_by or "")
        assert "passes 0.1 s" in (report.stopped_by or "")
        silent = stopped(arm) - 35 * HEAT_PERIOD
        assert 5 * HEAT_PERIOD < silent <= 5 * HEAT_PERIOD + READ_TIMEOUT + PERIOD
    else:
        assert report.stopped_by is None


def test_the_source_of_a_silent_stream_is_asked_who_is_silent():
    class Attributed(Thermometer):
        def silence(self, stream, limit):
            return f"{stream} {limit:g}"

    sources = Sources("arm", SafeArm(), {"oven": Attributed()})
    sources.open()
    assert sources.silence("oven", 0.25) == "thermometer 0.25"  # under the source's own name of it
    assert sources.silence("joints", 0.05) == ""
    sources.close()


def test_its_temperature_stops_the_arm(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer(heat=71.0, clock=clock)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), clock, PLAY)
    assert report.stopped_by == "temperature of elbow: 71 °C passes 70 °C"
    assert stopped(arm) == pytest.approx(0.72, abs=1.01 * PERIOD)
    recording = recorded(tmp_path / "run.h5", arm)
    assert recording.streams["oven"].channels["temperature"].values[:, 0].tolist() == [30.0] * 35 + [71.0]
    (event,) = (event for event in recording.events if event.source == "session")
    # The reason has the time of the hot sample, told on the joints' clock, which says 100 s at its first sample.
    assert event.time == pytest.approx(FIRST_STAMP - PERIOD + 0.72)


def test_notices_bear_their_sources_name_and_the_arms_time(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer("notice", clock=clock)
    report = run(tmp_path / "run.h5", Sources("arm", arm, {"oven": thermometer}), clock, PLAY)
    assert report.stopped_by is None
    (event,) = (event for event in recorded(tmp_path / "run.h5", arm).events if "rather warm" in event.message)
    assert event.message == "oven: rather warm"
    assert event.time == pytest.approx(FIRST_STAMP - PERIOD + 0.705)


def test_a_source_that_cannot_be_stopped_is_told_and_the_arm_is_stopped_first(
    tmp_path: Path, clock: SimulatedClock
) -> None:
    arm, thermometer = SafeArm(clock=clock), Thermometer("stop", clock=clock)
    sources = Sources("arm", arm, {"oven": thermometer})
    report = run(tmp_path / "run.h5", sources, clock, duration=0.3)
    assert report.stopped_by is None
    assert arm.stopped_at is not None
    messages = [event.message for event in recorded(tmp_path / "run.h5", arm).events]
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
