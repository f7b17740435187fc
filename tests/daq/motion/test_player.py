"""The player: every position once, in order and in time; the last one is held; a stall is gone on from, or ends it."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from simulated_clock import SimulatedClock

from daq.motion.player import DRY_RUN, STALL_LIMIT, MotionSequence, Player, dry_run, skip_limit
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest
from drivers.core.errors import ConnectionLostError, SafetyStopError, WorkError

RATE = 100.0
PERIOD = 1.0 / RATE
ACCELERATION = np.array([20.0])
RAMP = PointToPoint(np.array([[0.0], [1.0]]), np.array([0.39]))
"""It reaches 4.8 rad/s; its tick k is that of the path."""


class Sent:
    """Takes positions of one joint and notes when they came and when they were due, after the start."""

    def __init__(self, clock: SimulatedClock, takes: float = 0.0, every: int = 1) -> None:
        self.positions: list[float] = []
        self.times: list[float] = []
        self.due: list[float] = []
        self._clock, self._takes, self._every, self._begun = clock, takes, every, clock.now()

    def take(self, position: np.ndarray, due: float) -> None:
        self.positions.append(float(position[0]))
        self.times.append(self._clock.now() - self._begun)
        self.due.append(due - self._begun)
        if len(self.positions) % self._every == 0:
            self._clock.sleep(self._takes)


def made(clock: SimulatedClock, sent: Sent, *motions: PointToPoint, acceleration: float = 400.0) -> Player:
    return Player(sent.take, MotionSequence(motions or (RAMP,), RATE), np.array([acceleration]), clock)


def played(clock: SimulatedClock, player: Player) -> Player:
    player.start()
    assert clock.wait(lambda: player.done or player.failure is not None, 20.0)
    return player


def planned(ticks: np.ndarray) -> np.ndarray:
    return RAMP.evaluate(np.minimum(ticks * PERIOD, RAMP.duration))[0][0]


def test_positions_are_sent_by_absolute_times_and_the_last_is_held(clock: SimulatedClock) -> None:
    sent = Sent(clock)
    player = played(clock, made(clock, sent))
    np.testing.assert_allclose(sent.positions, planned(np.arange(40)), atol=1e-15)
    np.testing.assert_allclose(sent.times, PERIOD * np.arange(40), atol=1e-9)
    np.testing.assert_allclose(sent.due, sent.times, atol=1e-9)
    assert (player.elapsed, player.duration) == (pytest.approx(0.39), pytest.approx(0.39))
    clock.sleep(5.5 * PERIOD)
    assert sent.positions[40:] == [1.0] * 5
    clock.stall(3.0)  # at rest a stall does not matter
    clock.sleep(5.5 * PERIOD)
    assert player.failure is None
    assert player.stop(1.0)
    count = len(sent.positions)
    clock.sleep(1.0)
    assert len(sent.positions) == count
    figures = player.punctuality()
    assert (figures.sent, figures.skipped, figures.delayed_ms) == (39, 0, 0.0)
    assert figures.max_ms < 1e-6


@each(("rate", "skipped"), [(500.0, 3), (250.0, 2), (125.0, 1), (100.0, 1)])
def test_few_overdue_positions_are_skipped(rate: float, skipped: int) -> None:
    assert skip_limit(1.0 / rate) == skipped


def test_a_late_player_skips_what_is_overdue(clock: SimulatedClock) -> None:
    """Each sixth position takes 2.3 periods to send: two are due at its end, and the newer one is sent."""
    sent = Sent(clock, 2.3 * PERIOD, every=6)
    player = played(clock, made(clock, sent))
    ticks = np.rint(np.array(sent.due) / PERIOD)
    assert set(np.diff(ticks)) == {1.0, 2.0}
    np.testing.assert_allclose(sent.positions, planned(ticks), atol=1e-15)
    assert np.all(np.array(sent.times) >= np.array(sent.due) - 1e-9)
    figures = player.punctuality()
    assert (figures.sent + figures.skipped, figures.delayed_ms) == (39, 0.0)
    assert figures.skipped == 39 - np.sum(ticks[1:] <= 39)
    player.stop(1.0)


@pytest.mark.parametrize("overdue", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("when", [0.0949, 0.1949, 0.2949])
def test_after_a_stall_the_motion_goes_on_from_rest_within_its_acceleration(
    clock: SimulatedClock, overdue: int, when: float
) -> None:
    sent = Sent(clock)
    clock.call_at(clock.now() + when + 0.0002, lambda: clock.stall(0.0049 + overdue * PERIOD))
    player = played(clock, made(clock, sent, acceleration=60.0))
    assert player.stop(1.0)
    assert player.failure is None
    due, positions = np.array(sent.due), np.array(sent.positions)
    np.testing.assert_allclose(positions[-1], 1.0)
    gap = int(np.argmax(np.diff(due) > 1.5 * PERIOD)) if overdue > 1 else -1
    if overdue <= 1:
        np.testing.assert_allclose(positions, planned(np.rint(due / PERIOD)), atol=1e-15)
        assert player.punctuality().delayed_ms == 0.0
        return
    assert due[gap + 1] - due[gap] == pytest.approx((overdue + 1) * PERIOD)
    # The arm was held: what follows starts there from rest, and keeps the limit.
    after = np.concatenate([[positions[gap]], positions[gap:]])
    acceleration = np.diff(after, 2) / PERIOD**2
    assert np.max(np.abs(acceleration)) <= 60.0 * 1.01
    assert player.punctuality().delayed_ms > 1e3 * overdue * PERIOD
    assert player.duration == pytest.approx(0.39)


@pytest.mark.parametrize("stall", [0.019, 0.049, 0.075])
def test_where_commands_are_buffered_every_position_is_sent_however_late_until_the_buffer_is_empty(
    clock: SimulatedClock, stall: float
) -> None:
    sent = Sent(clock)
    clock.call_at(clock.now() + 0.1951, lambda: clock.stall(stall))
    path = MotionSequence([RAMP], RATE)
    player = played(clock, Player(sent.take, path, ACCELERATION, clock, held=False, buffered=0.05))
    player.stop(1.0)
    if stall > 0.05:
        assert str(player.failure).startswith("this computer stalled for 0.070 s in the motion, more than 0.05 s")
        assert len(sent.positions) == 20
        return
    assert player.failure is None
    np.testing.assert_allclose(sent.due, PERIOD * np.arange(40), atol=1e-9)
    np.testing.assert_allclose(sent.positions, planned(np.arange(40)), atol=1e-15)
    assert (player.punctuality().skipped, player.punctuality().delayed_ms) == (0, 0.0)


def test_going_on_from_rest_adds_little_to_the_accelerations_of_the_path(clock: SimulatedClock) -> None:
    """At an even speed, where the path itself has none: their torque was not planned."""
    path = MotionSequence([PointToPoint(np.array([[0.0], [4.0]]), np.array([4.0]))], RATE)
    sent = Sent(clock)
    clock.call_at(clock.now() + 1.9951, lambda: clock.stall(0.035))
    player = played(clock, Player(sent.take, path, np.array([8.0]), clock))
    assert player.failure is None
    positions = np.array(sent.positions).ravel()
    gap = int(np.argmax(np.diff(sent.due)))
    acceleration = np.abs(np.diff(np.concatenate([[positions[gap]], positions[gap:]]), 2)) / PERIOD**2
    assert np.max(acceleration[:20]) <= 2.0 * 1.01
    player.stop(1.0)


@pytest.mark.parametrize(("held", "takes", "slow"), [(True, 2.1, 20), (False, 1.1, 10)])
def test_a_motion_that_the_computer_does_not_keep_up_with_ends(
    clock: SimulatedClock, held: bool, takes: float, slow: int
) -> None:
    """Each position takes so many periods to send: a held arm would go on from rest again and again."""
    sent = Sent(clock, takes * PERIOD)
    player = Player(sent.take, MotionSequence([RAMP], RATE), np.array([400.0]), clock, held=held)
    assert isinstance(played(clock, player).failure, SafetyStopError)
    assert f"took longer than {slow} ms to send" in str(player.failure)
    assert sent.times[-1] < 0.3


def test_sends_that_a_held_arm_does_not_feel_do_not_end_its_motion(clock: SimulatedClock) -> None:
    """At 500 Hz: each takes up to three periods; in 0.1 s of a busy computer ten take 7 ms; four stall for 30 ms.

    More than a quarter of 25 positions took longer than 4 ms near the end of motions of two minutes, and ended them.
    """
    path = MotionSequence([PointToPoint(np.array([[0.0], [1.0]]), np.array([3.0]))], 500.0)
    for takes, first, end in ((0.0059, 0, 9999), (0.007, 300, 310), (0.03, 300, 304)):
        sent, begun = Sent(clock), clock.now()

        def take(
            position: np.ndarray, due: float, sent: Sent = sent, takes: float = takes, slow: range = range(first, end)
        ) -> None:
            sent.take(position, due)
            clock.sleep(takes if len(sent.positions) in slow else 2e-4)

        player = played(clock, Player(take, path, np.array([20.0]), clock))
        assert player.failure is None, takes
        assert player.punctuality().sent + player.punctuality().skipped >= 1500
        assert sent.positions[-1] == pytest.approx(1.0)
        velocity = np.diff(sent.positions) / np.diff(sent.due)
        assert np.max(np.abs(velocity)) <= 0.625 * 1.01
        assert clock.now() - begun < 3.5
        player.stop(1.0)


def test_a_long_stall_ends_the_motion(clock: SimulatedClock) -> None:
    sent = Sent(clock)
    clock.call_at(clock.now() + 0.1951, lambda: clock.stall(0.3))
    player = played(clock, made(clock, sent))
    assert isinstance(player.failure, SafetyStopError)
    assert "this computer stalled for 0.290 s in the motion" in str(player.failure)
    assert len(sent.positions) == 20  # none was sent after it
    assert STALL_LIMIT < 0.3


def test_a_motion_that_uses_its_whole_acceleration_goes_on_by_a_longer_ramp(clock: SimulatedClock) -> None:
    series = FourierSeries(0.8, np.zeros(1), np.array([[0.3]]), np.array([[0.0]]))
    motion = RestToRest(series, 2, 0.6)
    limit = float(np.max(np.abs(motion.evaluate(np.linspace(0.0, motion.duration, 2000))[2])))
    sent = Sent(clock)
    clock.call_at(clock.now() + 0.9951, lambda: clock.stall(0.035))
    player = Player(sent.take, MotionSequence([motion], RATE), np.array([limit * 1.05]), clock)
    assert played(clock, player).failure is None
    due, positions = np.array(sent.due), np.array(sent.positions)
    gap = int(np.argmax(np.diff(due)))
    acceleration = np.diff(np.concatenate([[positions[gap]], positions[gap:]]), 2) / PERIOD**2
    assert np.max(np.abs(acceleration)) <= limit * 1.06
    player.stop(1.0)


@pytest.mark.parametrize(
    ("error", "kind"), [(ConnectionLostError("gone"), ConnectionLostError), (KeyError("x"), WorkError)]
)
def test_an_error_is_kept(clock: SimulatedClock, error: Exception, kind: type[Exception]) -> None:
    def broken(position: np.ndarray, due: float) -> None:
        if due > begun + 3.5 * PERIOD:
            raise error

    begun = clock.now()
    player = Player(broken, MotionSequence([RAMP], RATE), ACCELERATION, clock)
    player.start()
    assert clock.wait(lambda: player.failure is not None, 10.0)
    assert clock.now() == pytest.approx(begun + 4 * PERIOD)
    assert isinstance(player.failure, kind)
    assert player.stop(1.0)
    assert not player.done


def test_a_command_that_hangs_is_waited_for_only_so_long(clock: SimulatedClock) -> None:
    player = Player(lambda *_: clock.sleep(3.0), MotionSequence([RAMP], RATE), ACCELERATION, clock)
    begun = clock.now()
    player.start()
    assert not player.stop(0.1)
    assert clock.now() == pytest.approx(begun + 0.1)
    assert player.stop(10.0)
    assert clock.now() == pytest.approx(begun + 3.0)


def test_a_path_joins_motions_at_its_ticks() -> None:
    first = PointToPoint(np.array([[0.0], [1.0]]), np.array([1.003]))
    second = PointToPoint(np.array([[1.0], [0.5]]), np.array([0.5]))
    path = MotionSequence([first, second], RATE)
    np.testing.assert_allclose(path.starts, [0.0, 1.01, 1.51])
    times = np.arange(152) * PERIOD
    position, velocity, acceleration = path.evaluate(times)
    assert position.shape == (152, 1)
    np.testing.assert_allclose(position[:101, 0], first.evaluate(times[:101])[0][0])
    assert position[101, 0] == 1.0
    np.testing.assert_allclose(position[101:, 0], second.evaluate(times[101:] - 1.01)[0][0], atol=1e-12)
    assert velocity[101, 0] == acceleration[101, 0] == 0.0
    assert path.positions(np.array([9.0]))[0, 0] == 0.5


class LateClock(SimulatedClock):
    """Clock of a computer on which every sleep ends `lateness` [s] late."""

    lateness = 0.0

    def sleep_until(self, moment: float) -> float:
        return super().sleep_until(moment + self.lateness) + self.lateness


@each(("periods", "refused"), [(0.0, False), (0.9, False), (4.9, False), (5.1, True)])
def test_a_dry_run_refuses_a_computer_that_is_too_slow(periods: float, refused: bool) -> None:
    clock = LateClock()
    clock.lateness = periods * PERIOD
    begun = clock.now()
    if refused:
        with pytest.raises(WorkError, match=r"this computer is \d+\.\d ms late at 100 Hz"):
            dry_run(RATE, clock)
    else:
        figures = dry_run(RATE, clock)
        assert figures.sent == round(DRY_RUN * RATE) - 1
        if periods < 1.0:
            assert figures.p50_ms == pytest.approx(1e3 * clock.lateness, abs=1e-6)
            assert clock.now() == pytest.approx(begun + DRY_RUN - PERIOD + clock.lateness)
