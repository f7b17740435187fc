"""The session: every way out stops the arm and closes the recording with the reason."""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from kinematic_arm import RATE, ROBOT_FILE, KinematicArm

from daq import recorder as recorder_module
from daq.recorder import Recorder
from daq.recording import read_recording
from daq.safety import Limits, Supervisor
from daq.session import INTERRUPTED, TERMINATED, Play, load_driver, record
from daq.stream_quality import stream_quality
from daq.trajectories import FourierSeries, PointToPoint, RestToRest
from drivers.base import Notice
from drivers.errors import ConnectionLostError, SafetyStopError, UsageError, WorkError

pytestmark = pytest.mark.usefixtures("punctual")

MOTION = PointToPoint(np.array([[0.1, -0.1], [0.5, 0.3], [0.0, 0.0]]), np.array([1.2, 1.2]))


def run(path, arm, play=None, duration=None):
    arm.open()
    layouts = arm.streams()
    supervisor = Supervisor(Limits.of_robot(ROBOT_FILE.robot, tracking_error=0.05), layouts)
    return record(arm, Recorder(path, ROBOT_FILE, layouts), supervisor, play, duration)


def assert_closed(path, arm, reason):
    assert arm.stopped_at is not None
    assert arm.commands_after_stop == 0
    recording = read_recording(path)
    assert not recording.complete
    assert reason in recording.events[-1].message or any(reason in event.message for event in recording.events)
    assert len(recording.streams["joints"].time) > 0


def test_a_recording_without_motion_runs_to_its_end(tmp_path):
    path, arm = tmp_path / "run.h5", KinematicArm()
    report = run(path, arm, duration=0.7)
    assert report.stopped_by is None
    assert report.error is None
    recording = read_recording(path)
    assert recording.complete
    assert len(recording.streams["joints"].time) == report.samples["joints"] > 0.5 * RATE
    assert stream_quality(recording.streams["joints"].time).lost == 0
    assert arm.stopped_at is not None
    assert arm.commands == []


def test_a_motion_is_approached_played_and_recorded(tmp_path):
    path, arm = tmp_path / "run.h5", KinematicArm()
    motion = RestToRest(
        FourierSeries(1.0, np.array([0.1, -0.1]), np.array([[0.1], [0.05]]), np.array([[0.0], [0.1]])), 1, 0.5
    )
    report = run(path, arm, Play(motion, ROBOT_FILE.robot, RATE))
    assert report.stopped_by is None, report.stopped_by
    assert report.punctuality is not None
    assert report.punctuality.sent > RATE
    assert np.allclose(arm.commands[0], [0.1, -0.1])  # begins where the arm stands
    assert np.allclose(arm.commands[-1], motion.evaluate(np.array([motion.duration]))[0][:, 0])
    messages = [event.message for event in read_recording(path).events]
    assert "motion begins" in messages
    assert "motion ends" in messages
    assert arm.commands_after_stop == 0


@pytest.mark.parametrize(
    "fault",
    ["position", "velocity", "torque", "temperature", "tracking error", "stale data", "protective stop"],
)
def test_a_breach_stops_the_arm(tmp_path, fault):
    path, arm = tmp_path / "run.h5", KinematicArm(fault, after=0.8)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE), duration=5.0)
    assert isinstance(report.error, SafetyStopError)
    assert report.error.exit_status == 1
    assert fault in (report.stopped_by or "")
    assert_closed(path, arm, fault)


def test_a_driver_that_waits_too_long_cannot_hide_its_silence(tmp_path):
    class Slow(KinematicArm):
        def read(self, timeout):
            return super().read(timeout + 0.1 * self.faulty)

    path, arm = tmp_path / "run.h5", Slow("stale data")
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE), duration=5.0)
    assert "stale data" in (report.stopped_by or "")
    assert_closed(path, arm, "stale data")


def test_a_driver_that_knows_who_is_silent_is_asked(tmp_path):
    class Attributed(KinematicArm):
        def silence(self, stream, limit):
            return f"{stream} for {limit:g} s: no answer of elbow"

    path, arm = tmp_path / "run.h5", Attributed("stale data")
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE), duration=5.0)
    assert (report.stopped_by or "").endswith("passes 0.05 s (joints for 0.05 s: no answer of elbow)")
    assert_closed(path, arm, "no answer of elbow")


def test_silence_without_a_motion_is_an_event_and_no_end(tmp_path):
    """Nobody is in danger while the arm is only watched; the driver itself gives up a connection that stays silent."""
    path, arm = tmp_path / "run.h5", KinematicArm("stale data")
    report = run(path, arm, duration=1.5)
    assert report.stopped_by is None
    recording = read_recording(path)
    assert recording.complete
    told = [event for event in recording.events if "stale data" in event.message]
    assert [event.level for event in told] == ["warning"]  # one silence, one event


@pytest.mark.parametrize(
    ("fault", "kind", "reason"),
    [("lost connection", ConnectionLostError, "the connection broke"), ("bug", WorkError, "KeyError")],
)
def test_a_broken_driver_ends_in_order(tmp_path, fault, kind, reason):
    path, arm = tmp_path / "run.h5", KinematicArm(fault)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE))
    assert isinstance(report.error, kind)
    assert_closed(path, arm, reason)


@pytest.mark.parametrize(("number", "reason"), [(signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)])
def test_an_interrupt_stops_the_arm_first(tmp_path, number, reason):
    path, arm = tmp_path / "run.h5", KinematicArm()
    before = signal.getsignal(number)

    def interrupt_in_motion() -> None:
        patience = time.monotonic() + 20.0
        while len(arm.commands) < 50 and time.monotonic() < patience:
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    interrupter = threading.Thread(target=interrupt_in_motion)
    interrupter.start()
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE))
    interrupter.join()
    assert report.stopped_by == reason
    assert report.error is None
    assert_closed(path, arm, reason)
    assert signal.getsignal(number) is before


class SlowToStop(KinematicArm):
    """Needs a while to come to rest, as a real arm does."""

    def stop(self):
        time.sleep(0.5)
        super().stop()


@pytest.mark.parametrize(("fault", "level"), [("torque", "error"), ("protective stop", "error"), ("", "warning")])
def test_the_reason_has_the_time_of_the_breach_and_the_halt_its_own(tmp_path, fault, level):
    path, arm = tmp_path / "run.h5", SlowToStop(fault, after=0.8)
    if not fault:
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE), duration=5.0)
    recording = read_recording(path)
    joints = recording.streams["joints"]
    (stopped,) = (event for event in recording.events if event.source == "session")
    (halted,) = (event for event in recording.events if event.message == "arm halted")
    assert stopped.level == level
    if fault == "torque":
        torque = joints.channels["torque"].values
        assert stopped.time == joints.time[np.argmax(np.any(torque > 50.0, axis=1))]
    elif fault:
        assert stopped.time == 101.0  # of the driver's notice
    else:
        assert stopped.time == pytest.approx(joints.time[-1], abs=0.1)
    assert halted.level == "info"
    assert halted.time > joints.time[-1] + 0.4


def test_what_came_first_is_the_reason(tmp_path):
    """A protective stop brakes so hard that the torque may pass its limit: within one look at both, time decides."""

    class Braking(KinematicArm):
        def notices(self):
            if self.fault == "torque" and self.faulty and not self._noticed:
                self._noticed = True
                return (Notice(100.0, "error", "protective stop"),)
            return ()

    path, arm = tmp_path / "run.h5", Braking("torque")
    report = run(path, arm, duration=5.0)
    assert report.stopped_by == "protective stop"
    assert read_recording(path).events[-1].time == 100.0


def test_a_signal_while_the_arm_is_being_stopped_changes_nothing(tmp_path):
    class Interrupted(KinematicArm):
        def stop(self):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            super().stop()

    path, arm = tmp_path / "run.h5", Interrupted()
    report = run(path, arm, duration=0.3)
    assert report.stopped_by is None
    assert read_recording(path).complete


def test_a_full_disk_stops_the_arm(tmp_path, monkeypatch):
    path, arm = tmp_path / "run.h5", KinematicArm()
    usage = iter([SimpleNamespace(free=10**12)])
    full = SimpleNamespace(free=1000)
    disk = SimpleNamespace(disk_usage=lambda folder: next(usage, full))
    monkeypatch.setattr(recorder_module, "shutil", disk)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, RATE))
    assert "disk is full" in (report.stopped_by or "")
    assert_closed(path, arm, "disk is full")
    assert shutil.disk_usage(tmp_path).free > 1000


def test_a_motion_beyond_the_limits_never_starts(tmp_path):
    path, arm = tmp_path / "run.h5", KinematicArm()
    far = PointToPoint(np.array([[0.0, 0.0], [0.0, 2.5]]), np.array([5.0]))
    report = run(path, arm, Play(far, ROBOT_FILE.robot, RATE))
    assert isinstance(report.error, UsageError)
    assert arm.commands == []
    assert_closed(path, arm, "position")


def test_a_driver_is_found_by_name_or_refused():
    with pytest.raises(UsageError, match="no driver is called 'kinematic'"):
        load_driver(ROBOT_FILE.robot)
    with pytest.raises(UsageError, match="no connection is called 'can'"):
        load_driver(ROBOT_FILE.robot, "can")
