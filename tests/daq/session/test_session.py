"""The session: every way out stops the arm, at the cycle that the rules say, and closes the file with the reason."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from kinematic_arm import FIRST_STAMP, RATE, ROBOT_FILE, KinematicArm
from session_bench import (
    AFTER,
    MOTION,
    PERIOD,
    PLAY,
    PLAYED,
    SEEN,
    STALE,
    TRACKING_ERROR,
    WAITED,
    assert_closed,
    recorded,
    run,
    session_event,
    stopped,
)
from simulated_clock import SimulatedClock
from unchecked import Unchecked, unchecked_play

from daq.motion.player import MotionSequence
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest, slow_move
from daq.recording import recorder as recorder_module
from daq.recording.reader import read_recording
from daq.recording.recorder import Recorder
from daq.session.play import FIRST_SAMPLE_LIMIT, Play
from daq.session.session import ENDED_BY, INTERRUPTED, READ_TIMEOUT, load_driver
from drivers.base import Notice
from drivers.core.errors import ConnectionLostError, MotionRefusedError, SafetyStopError, UsageError, WorkError
from drivers.standstill import REST_WINDOW
from drivers.streams import Batch, StreamLayout


def test_a_recording_without_motion_ends_at_the_first_cycle_after_its_time(
    tmp_path: Path, clock: SimulatedClock
) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    report = run(path, arm, duration=0.702)
    assert (report.stopped_by, report.error, report.punctuality) == (None, None, None)
    assert (report.samples, report.lost, report.overflow) == ({"joints": 141}, {"joints": 0}, 0)
    assert stopped(arm) == pytest.approx(141 * PERIOD)
    assert recorded(path, arm).complete
    assert arm.commands == []


def test_a_motion_is_approached_played_and_recorded(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    motion = RestToRest(
        FourierSeries(1.0, np.array([0.1, -0.1]), np.array([[0.1], [0.05]]), np.array([[0.0], [0.1]])), 1, 0.5
    )
    report = run(path, arm, unchecked_play(motion, ROBOT_FILE.robot))
    assert report.stopped_by is None
    here = np.array([0.1, -0.1])
    way = slow_move(here, motion.evaluate(np.zeros(1))[0][:, 0], ROBOT_FILE.robot.joints)
    whole = MotionSequence([way, motion], RATE)
    positions = whole.positions(np.arange(round(whole.duration * RATE) + 1) * PERIOD)
    np.testing.assert_array_equal(arm.commands[: len(positions)], positions)
    np.testing.assert_array_equal(np.diff(arm.commands[len(positions) - 1 :], axis=0), 0.0)
    times = np.array(arm.command_times) - arm.begun
    np.testing.assert_allclose(times, PLAYED + PERIOD * np.arange(len(times)), atol=1e-9)
    assert report.punctuality is not None
    assert (report.punctuality.sent, report.punctuality.skipped) == (len(positions) - 1, 0)
    assert report.punctuality.max_ms < 1e-6
    recording = recorded(path, arm)
    assert recording.complete
    begins, ends = (
        next(event for event in recording.events if event.message == f"motion {what}").time - FIRST_STAMP + PERIOD
        for what in ("begins", "ends")
    )
    assert begins == pytest.approx(PLAYED + whole.starts[1], abs=1.01 * PERIOD)
    assert ends == pytest.approx(PLAYED + whole.duration, abs=1.01 * PERIOD)
    # It is held until the arm has come to rest.
    assert times[-1] == pytest.approx(PLAYED + whole.duration + REST_WINDOW, abs=2.01 * PERIOD)
    assert arm.commands_after_stop == 0


@pytest.mark.parametrize("fault", ["position", "velocity", "torque", "temperature"])
def test_a_limit_that_is_passed_stops_the_arm_in_the_cycle_that_shows_it(
    tmp_path: Path, clock: SimulatedClock, fault: str
) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(fault, AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert isinstance(report.error, SafetyStopError)
    assert report.error.exit_status == 1
    assert (report.stopped_by or "").startswith(f"{fault} of elbow: 1000 ")
    assert stopped(arm) + 1e-9 >= SEEN
    assert stopped(arm) <= SEEN + PERIOD + 1e-9  # what the player needs to end
    recording = assert_closed(path, arm, report)
    values = recording.streams["joints"].channels[fault].values
    assert np.argwhere(values == 1000.0).tolist() == [[160, 1]]
    assert session_event(recording).time == recording.streams["joints"].time[160]


def test_an_arm_that_does_not_follow_is_stopped_as_soon_as_nothing_commanded_lately_explains_it(
    tmp_path: Path, clock: SimulatedClock
) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm("tracking error", AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert (report.stopped_by or "").startswith("tracking error of ")
    recording = assert_closed(path, arm, report)
    stuck, times = arm.position, np.array(arm.command_times)
    last = recording.streams["joints"].host_time[-1]

    def distance(now: float) -> float:
        """From what was commanded within a quarter of a second, and the position before that."""
        first = np.searchsorted(times, now - 0.25) - 1
        window = np.array(arm.commands)[max(first, 0) : np.searchsorted(times, now + 1e-9, side="right")]
        return float(np.max(np.maximum(window.min(0) - stuck, stuck - window.max(0))))

    assert distance(last) > TRACKING_ERROR >= distance(last - 2.0 * PERIOD)
    assert stopped(arm) == pytest.approx(last - arm.begun, abs=1.01 * PERIOD)


@pytest.mark.parametrize("wait", [0.0, 0.1])
def test_silence_stops_a_motion_after_five_periods_and_50_ms(
    tmp_path: Path, clock: SimulatedClock, wait: float
) -> None:
    """Also where the driver waits for longer than it was asked to; then it is asked once more, as after a stall."""

    class Slow(KinematicArm):
        def read(self, timeout: float) -> Sequence[Batch]:
            return super().read(timeout + wait * self.faulty)

        def silence(self, stream: str, limit: float) -> str:
            return f"{stream} for {limit:g} s: no answer of elbow"

        def losses(self, stream: str) -> str:
            return ""

    path, arm = tmp_path / "run.h5", Slow("stale data", AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert (report.stopped_by or "").startswith("stale data of stream joints: ")
    assert " passes 0.05 s (joints for 0.05 s: no answer of elbow) (check cables " in (report.stopped_by or "")
    assert_closed(path, arm, report)
    assert arm.count == 160
    silent = stopped(arm) - 160 * PERIOD
    looks = 2 if wait else 1
    assert STALE < silent <= STALE + looks * (READ_TIMEOUT + wait) + PERIOD + 1e-9


@pytest.mark.parametrize(
    ("lost", "said"), [(1, ""), (2, "2 of 122 samples of joints were lost (joints: a loose plug)")]
)
def test_a_recording_that_lost_more_than_one_percent_says_so(
    tmp_path: Path, clock: SimulatedClock, lost: int, said: str
) -> None:
    class Lossy(KinematicArm):
        def read(self, timeout: float) -> Sequence[Batch]:
            first = self.count == 0
            return tuple(replace(block, lost=lost if first else 0) for block in super().read(timeout))

        def silence(self, stream: str, limit: float) -> str:
            return ""

        def losses(self, stream: str) -> str:
            return f"{stream}: a loose plug"

    report = run(tmp_path / "run.h5", Lossy(clock=clock), duration=119.5 * PERIOD)
    assert report.samples == {"joints": 120}
    assert report.heavy_loss == said
    assert report.light_loss == ("" if said else "1 of 121 samples of joints were lost (joints: a loose plug)")
    assert report.stopped_by is None
    recording = read_recording(tmp_path / "run.h5")
    assert recording.complete
    assert [event.message for event in recording.events if event.source == "session"] == ([said] if said else [])


def test_a_motion_is_refused_where_it_cannot_be_supervised(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(rate=50.0, clock=clock)
    report = run(path, arm, unchecked_play(MOTION, ROBOT_FILE.robot))
    assert isinstance(report.error, UsageError)
    assert "positions would be sent at 50 Hz, and a motion needs 100 Hz" in (report.stopped_by or "")
    assert arm.commands == []


@pytest.mark.parametrize("receiver_stalls", [False, True])
@pytest.mark.parametrize("stall", [0.02, 0.04, 0.2, 0.24])
def test_a_stall_of_this_computer_is_no_silence_of_the_arm(
    tmp_path: Path, clock: SimulatedClock, stall: float, receiver_stalls: bool
) -> None:
    """Nor where the thread that receives was stalled as well: what it has is there at the second look.

    The motion goes on from rest after a short one, and ends after a long one, with that as the reason.
    """

    class Received(KinematicArm):
        held: Sequence[Batch] = ()

        def read(self, timeout: float) -> Sequence[Batch]:
            before = clock.now()
            blocks = (*self.held, *super().read(timeout))
            late = receiver_stalls and clock.now() - before > READ_TIMEOUT
            self.held = blocks if late else ()
            return () if late else blocks

    path, arm = tmp_path / "run.h5", Received(clock=clock)
    clock.call_at(clock.now() + AFTER, lambda: clock.stall(stall))
    report = run(path, arm, PLAY)
    assert report.punctuality is not None
    if stall > 0.05:
        assert isinstance(report.error, SafetyStopError)
        assert (report.stopped_by or "").startswith(f"this computer stalled for {stall - PERIOD:.3f} s in the motion")
        assert_closed(path, arm, report)
        return
    assert report.stopped_by is None
    assert report.punctuality.delayed_ms > 1e3 * (stall - PERIOD)
    assert recorded(path, arm).complete
    assert arm.count == pytest.approx(stopped(arm) * RATE, abs=1.01)  # nothing is lost
    # Where the arm was held it starts from rest, and nowhere does it pass the limits.
    gap = int(np.argmax(np.diff(arm.command_times)))
    sent = np.array(arm.commands)
    after = np.concatenate([sent[gap : gap + 1], sent[gap:]])
    for part in (sent[: gap + 1], after):
        speed, acceleration = np.diff(part, axis=0) / PERIOD, np.diff(part, 2, axis=0) / PERIOD**2
        assert np.max(np.abs(speed)) <= 2.0
        assert np.max(np.abs(acceleration)) <= ROBOT_FILE.robot.joints[0].acceleration * 1.01


def test_silence_without_a_motion_is_an_event_and_no_end(tmp_path: Path, clock: SimulatedClock) -> None:
    """Nobody is in danger while the arm is only watched; the driver itself gives up a connection that stays silent."""
    path, arm = tmp_path / "run.h5", KinematicArm("stale data", AFTER, clock=clock)
    report = run(path, arm, duration=2.0)
    assert report.stopped_by is None
    assert stopped(arm) == pytest.approx(2.0, abs=READ_TIMEOUT)
    recording = recorded(path, arm)
    assert recording.complete
    told = [event for event in recording.events if "stale data" in event.message]
    assert [event.level for event in told] == ["warning"]  # one silence, one event
    # Of a source that says nothing the host's clock tells what its own would say.
    assert told[0].time - recording.streams["joints"].time[-1] == pytest.approx(STALE, abs=READ_TIMEOUT + 1e-9)


def test_an_arm_that_never_says_where_it_is_is_not_moved(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm("stale data", -1.0, clock=clock)
    report = run(path, arm, PLAY)
    assert isinstance(report.error, ConnectionLostError)
    assert report.stopped_by == "no joint position within 5 s"
    assert stopped(arm) == pytest.approx(WAITED + FIRST_SAMPLE_LIMIT, abs=READ_TIMEOUT + 1e-9)
    assert arm.commands == []


@pytest.mark.parametrize(
    ("fault", "kind", "reason"),
    [
        ("lost connection", ConnectionLostError, "the connection broke"),
        ("bug", WorkError, "the session failed: KeyError: 'a bug'"),
        ("protective stop", SafetyStopError, "protective stop"),
    ],
)
def test_what_the_driver_says_ends_a_motion_at_once(
    tmp_path: Path, clock: SimulatedClock, fault: str, kind: type[Exception], reason: str
) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(fault, AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert isinstance(report.error, kind)
    assert report.stopped_by == reason
    assert stopped(arm) + 1e-9 >= SEEN
    assert stopped(arm) <= SEEN + PERIOD + 1e-9
    assert_closed(path, arm, report)


def test_a_thread_that_breaks_ends_the_motion(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, path = KinematicArm(clock=clock), tmp_path / "run.h5"

    def work() -> None:
        clock.sleep(AFTER)
        raise KeyError("0x581")

    clock.thread(work, "temperatures").start()
    report = run(path, arm, PLAY)
    assert isinstance(report.error, WorkError)
    assert report.stopped_by == "the thread 'temperatures' broke: KeyError: '0x581'"
    assert stopped(arm) == pytest.approx(SEEN, abs=2 * PERIOD)
    assert_closed(path, arm, report)


class Feeling:
    """A watch that notices a contact at a sample of the motion."""

    def __init__(self, sample: int) -> None:
        self.sample, self.samples, self.told = sample, 0, False

    def begin(self, layouts: Sequence[StreamLayout]) -> None:
        raise AssertionError("the command's, not the session's")

    def add(self, batch: Batch) -> None:
        self.samples += len(batch.time)

    def events(self) -> list[tuple[float, str]]:
        if self.told or self.samples < self.sample:
            return []
        self.told = True
        return [(FIRST_STAMP + self.sample * PERIOD, "contact: elbow")]

    def stop_reason(self) -> str:
        return "contact: elbow" if self.told else ""

    def lines(self) -> list[str]:
        return []


def test_a_contact_ends_a_motion_at_once_and_a_recording_not(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    report = run(path, arm, PLAY, watch=Feeling(161))
    assert isinstance(report.error, SafetyStopError)
    assert stopped(arm) <= SEEN + PERIOD
    recording = assert_closed(path, arm, report)
    assert session_event(recording).time == pytest.approx(FIRST_STAMP + 161 * PERIOD)
    assert [event.message for event in recording.events if event.source == "monitor"] == ["contact: elbow"]
    path, arm = tmp_path / "rest.h5", KinematicArm(clock=clock)
    report = run(path, arm, duration=0.702, watch=Feeling(50))
    assert report.error is None
    assert [event.message for event in read_recording(path).events if event.source == "monitor"] == ["contact: elbow"]


def test_a_recorder_that_breaks_ends_the_motion(
    tmp_path: Path, clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, path = KinematicArm(clock=clock), tmp_path / "run.h5"
    hold = Recorder._hold

    def broken(self: Recorder, batch: Batch) -> None:
        if clock.now() - arm.begun > AFTER:
            raise ZeroDivisionError("a bug")
        hold(self, batch)

    monkeypatch.setattr(Recorder, "_hold", broken)
    report = run(path, arm, PLAY)
    assert "recorder run.h5' broke: ZeroDivisionError: a bug" in str(report.stopped_by)
    assert stopped(arm) < AFTER + 1.0
    assert isinstance(report.error, WorkError)


def test_a_thread_that_breaks_while_the_arm_is_stopped_is_an_event(tmp_path: Path, clock: SimulatedClock) -> None:
    arm, path = KinematicArm(clock=clock), tmp_path / "run.h5"
    stop = arm.stop

    def work() -> None:
        raise KeyError("late")

    def stop_and_break() -> None:
        stop()
        thread = clock.thread(work, "late")
        thread.start()
        thread.join()

    arm.stop = stop_and_break  # type: ignore[method-assign]
    assert run(path, arm, duration=0.3).error is None
    events = [event for event in read_recording(path).events if event.level == "error"]
    assert [event.message for event in events] == ["the thread 'late' broke: KeyError: 'late'"]


def test_a_command_that_breaks_ends_the_motion(tmp_path: Path, clock: SimulatedClock) -> None:
    class Deaf(KinematicArm):
        def command(self, position: np.ndarray) -> None:
            if self.faulty:
                raise ConnectionLostError("nobody listens")
            super().command(position)

    path, arm = tmp_path / "run.h5", Deaf(after=AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert report.stopped_by == "nobody listens"
    assert stopped(arm) == pytest.approx(SEEN, abs=1.01 * PERIOD)
    assert_closed(path, arm, report)


def test_a_command_that_hangs_keeps_nobody_from_stopping_the_arm(tmp_path: Path, clock: SimulatedClock) -> None:
    stops: list[float] = []

    class Hanging(KinematicArm):
        def command(self, position: np.ndarray) -> None:
            super().command(position)
            if self.faulty:
                clock.sleep(3.0)

        def stop(self) -> None:
            stops.append(clock.now() - self.begun)
            super().stop()

    path, arm = tmp_path / "run.h5", Hanging("torque", AFTER, clock=clock)
    report = run(path, arm, PLAY)
    assert "torque" in (report.stopped_by or "")
    assert stops == pytest.approx([SEEN + 0.1, arm.command_times[-1] - arm.begun + 3.0])  # and again when it is over
    assert_closed(path, arm, report)


@pytest.mark.parametrize(("number", "reason"), list(ENDED_BY.items()))
def test_an_interrupt_stops_the_arm_first(
    tmp_path: Path, clock: SimulatedClock, number: signal.Signals, reason: str
) -> None:
    class Interrupted(KinematicArm):
        def read(self, timeout: float) -> Sequence[Batch]:
            if self.faulty:
                signal.raise_signal(number)
            return super().read(timeout)

    path, arm = tmp_path / "run.h5", Interrupted(after=AFTER, clock=clock)
    before = signal.getsignal(number)
    report = run(path, arm, PLAY)
    assert report.stopped_by == reason
    assert report.error is None
    assert stopped(arm) == pytest.approx(SEEN, abs=2.01 * PERIOD)
    assert_closed(path, arm, report)
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(("fault", "level"), [("torque", "error"), ("protective stop", "error"), ("", "warning")])
def test_the_reason_has_the_time_of_the_breach_and_the_halt_its_own(
    tmp_path: Path, clock: SimulatedClock, fault: str, level: str
) -> None:
    class SlowToStop(KinematicArm):
        """Needs a while to come to rest, as a real arm does."""

        def read(self, timeout: float) -> Sequence[Batch]:
            if not self.fault and self.faulty:
                signal.raise_signal(signal.SIGINT)
            return super().read(timeout)

        def stop(self) -> None:
            clock.sleep(0.5)
            super().stop()

    path, arm = tmp_path / "run.h5", SlowToStop(fault, AFTER, clock=clock)
    recording = assert_closed(path, arm, run(path, arm, PLAY))
    joints = recording.streams["joints"]
    (halted,) = (event for event in recording.events if event.message == "arm halted")
    event = session_event(recording)
    assert event.level == level
    if fault == "torque":
        assert event.time == joints.time[160]
    elif fault:
        assert event.time == 101.0  # of the driver's notice
    else:
        assert event.time == pytest.approx(joints.time[-1])
    assert halted.level == "info"
    assert halted.time == pytest.approx(stopped(arm) - PERIOD + FIRST_STAMP)
    assert halted.time - joints.time[-1] + 1e-9 >= 0.5


def test_what_came_first_is_the_reason(tmp_path: Path, clock: SimulatedClock) -> None:
    """A protective stop brakes so hard that the torque may pass its limit: within one look at both, time decides."""

    class Braking(KinematicArm):
        def notices(self) -> Sequence[Notice]:
            return (Notice(100.0, "error", "protective stop"),) if self.faulty else ()

    path, arm = tmp_path / "run.h5", Braking("torque", clock=clock)
    report = run(path, arm, duration=5.0)
    assert report.stopped_by == "protective stop"
    assert session_event(recorded(path, arm)).time == 100.0


def test_a_signal_while_the_arm_is_being_stopped_changes_nothing(tmp_path: Path, clock: SimulatedClock) -> None:
    class Interrupted(KinematicArm):
        def stop(self) -> None:
            signal.raise_signal(signal.SIGINT)
            super().stop()

    path, arm = tmp_path / "run.h5", Interrupted(clock=clock)
    report = run(path, arm, duration=0.3)
    assert report.stopped_by is None
    assert recorded(path, arm).complete


def test_a_full_disk_stops_the_arm(tmp_path: Path, clock: SimulatedClock, monkeypatch: pytest.MonkeyPatch) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    usage = iter([SimpleNamespace(free=10**12)])
    full = SimpleNamespace(free=1000)
    disk = SimpleNamespace(disk_usage=lambda folder: next(usage, full))
    monkeypatch.setattr(recorder_module, "shutil", disk)
    report = run(path, arm, PLAY)
    assert "disk is full" in (report.stopped_by or "")
    assert arm.commands_after_stop == 0
    # The first chunk of half a second is written; for the second one there is the space that the file owns.
    assert stopped(arm) == pytest.approx(1.0, abs=2.01 * PERIOD)
    recording = read_recording(path)
    np.testing.assert_array_equal(
        recording.streams["joints"].time, np.concatenate([block.time for block in arm.samples])[:200]
    )
    assert not recording.complete
    assert "disk is full" in recording.events[-1].message
    assert shutil.disk_usage(tmp_path).free > 1000


def test_a_motion_beyond_the_limits_never_starts(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    far = PointToPoint(np.array([[0.0, 0.0], [0.0, 2.5]]), np.array([5.0]))
    report = run(path, arm, unchecked_play(far, ROBOT_FILE.robot))
    assert isinstance(report.error, UsageError)
    assert "position" in (report.stopped_by or "")
    assert arm.commands == []
    assert_closed(path, arm, report)


def test_a_driver_is_found_by_name_or_refused() -> None:
    with pytest.raises(UsageError, match="no driver is called 'kinematic'"):
        load_driver(ROBOT_FILE.robot)
    with pytest.raises(UsageError, match="no connection is called 'can'"):
        load_driver(ROBOT_FILE.robot, "can")


class Hesitates(Unchecked):
    """Answers at its n-th look, and does something to the arm at one of them."""

    def __init__(self, says: bool, looks: int = 40, meanwhile=lambda look: None) -> None:
        super().__init__(MOTION, ROBOT_FILE.robot)
        self.says, self.looks, self.meanwhile = says, looks, meanwhile
        self.asked = self.looked = 0
        self.planned: list[np.ndarray] = []

    def approach(self, position):
        self.planned.append(np.array(position))
        return super().approach(position)

    def ask(self):
        self.asked += 1

    def answer(self):
        self.looked += 1
        self.meanwhile(self.looked)
        return self.says if self.looked > self.looks else None


def test_nothing_moves_until_the_answer_is_yes(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    asked: list[int] = []
    permission = Hesitates(True, meanwhile=lambda look: asked.append(len(arm.commands)))
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, permission))
    assert (report.stopped_by, permission.asked) == (None, 1)
    assert set(asked) == {0}
    recording = recorded(path, arm)  # what arrived meanwhile is in it
    assert recording.complete
    begun = next(event.time for event in recording.events if event.message == "motion begins")
    assert begun - FIRST_STAMP > permission.looks * 0.5 * READ_TIMEOUT
    np.testing.assert_allclose(arm.commands[-1], [0.0, 0.0], atol=1e-12)


def test_a_no_moves_nothing(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, Hesitates(False)))
    assert isinstance(report.error, MotionRefusedError)
    assert (arm.commands, report.punctuality, report.file) == ([], None, None)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("way", "refused"), [(0.015, False), (0.03, True)])
def test_an_arm_that_moved_meanwhile_is_somewhere_else(
    tmp_path: Path, clock: SimulatedClock, way: float, refused: bool
) -> None:
    arm = KinematicArm(clock=clock)

    def push(look: int) -> None:
        if look == 20:
            arm.position = arm.position + way

    permission = Hesitates(True, meanwhile=push)
    report = run(tmp_path / "run.h5", arm, Play(MOTION, ROBOT_FILE.robot, permission))
    assert isinstance(report.error, MotionRefusedError) == refused
    if refused:
        assert "moved before the motion was confirmed" in str(report.stopped_by)
        assert arm.commands == []
    else:
        np.testing.assert_allclose(permission.planned[-1] - permission.planned[0], way)
        np.testing.assert_allclose(arm.commands[0], permission.planned[-1])


def test_ctrl_c_while_the_answer_is_awaited_moves_nothing(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm(clock=clock)
    permission = Hesitates(True, meanwhile=lambda look: signal.raise_signal(signal.SIGINT) if look == 5 else None)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, permission))
    assert (report.stopped_by, arm.commands, permission.looked) == (INTERRUPTED, [], 5)
    assert report.file is None
    assert list(tmp_path.iterdir()) == []


def test_an_arm_that_reports_an_error_meanwhile_is_not_moved(tmp_path: Path, clock: SimulatedClock) -> None:
    path, arm = tmp_path / "run.h5", KinematicArm("protective stop", 0.5, clock=clock)
    report = run(path, arm, Play(MOTION, ROBOT_FILE.robot, Hesitates(True, looks=1000)))
    assert isinstance(report.error, SafetyStopError)
    assert arm.commands == []
    assert_closed(path, arm, report)
