"""The player: every position once, in order and in time; the last one is held; errors are kept for the session."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_clock import SimulatedClock

from daq.motion.player import DRY_RUN, Player, dry_run, ticks
from daq.motion.trajectories import PointToPoint
from drivers.errors import ConnectionLostError, WorkError

RATE = 100.0
PERIOD = 1.0 / RATE


class Sent:
    """Takes positions of one joint and notes when they came, after the start."""

    def __init__(self, clock: SimulatedClock, takes: float = 0.0) -> None:
        self.numbers: list[int] = []
        self.times: list[float] = []
        self.noted: list[float] = []
        self._clock, self._takes, self._begun = clock, takes, clock.now()

    def note(self, now: float, position: np.ndarray) -> None:
        assert now == self._clock.now()
        self.noted.append(position[0])

    def take(self, position: np.ndarray) -> None:
        self.numbers.append(int(position[0]))
        self.times.append(self._clock.now() - self._begun)
        self._clock.sleep(self._takes)


def played(clock: SimulatedClock, sent: Sent, count: int) -> Player:
    """A player that has sent the last of so many positions."""
    player = Player(sent.take, sent.note, np.arange(float(count))[:, None], RATE, clock=clock)
    player.start()
    assert clock.wait(lambda: player.done, 10.0)
    return player


def test_positions_are_sent_by_absolute_times_and_the_last_is_held(clock: SimulatedClock) -> None:
    sent = Sent(clock)
    player = played(clock, sent, 40)
    assert sent.numbers == list(range(40))
    np.testing.assert_allclose(sent.times, PERIOD * np.arange(40), atol=1e-9)
    assert (player.index, player.elapsed, player.duration) == (39, pytest.approx(0.39), pytest.approx(0.39))
    clock.sleep(5.5 * PERIOD)
    assert sent.numbers[40:] == [39] * 5
    assert sent.noted == sent.numbers
    assert player.stop(1.0)
    clock.sleep(1.0)
    assert len(sent.numbers) == 45
    figures = player.punctuality()
    assert (figures.sent, figures.skipped, figures.delayed_ms) == (39, 0, 0.0)
    assert figures.max_ms < 1e-6


def test_a_late_player_skips_what_is_overdue(clock: SimulatedClock) -> None:
    """Each position takes 2.65 periods to send, so that two or three are due at its end; the newest of them is sent."""
    sent = Sent(clock, 2.65 * PERIOD)
    player = played(clock, sent, 30)
    player.stop(1.0)
    assert sent.numbers == [0, 1, 3, 6, 8, 11, 14, 16, 19, 22, 24, 27, 29, 29]
    figures = player.punctuality()
    assert (figures.skipped, figures.delayed_ms) == (30 - 13, 0.0)
    # Position 0 starts the clock where its sending has ended, and 1 is the last that is in time.
    np.testing.assert_allclose(np.array(sent.times[1:]) - sent.times[1], 2.65 * PERIOD * np.arange(13), atol=1e-9)


@pytest.mark.parametrize("overdue", [0, 1, 2, 3, 4, 25])
def test_a_stall_costs_the_positions_that_fell_into_it_or_delays_the_rest(clock: SimulatedClock, overdue: int) -> None:
    sent = Sent(clock)
    clock.call_at(clock.now() + 0.1001, lambda: clock.stall(0.0049 + overdue * PERIOD))
    player = played(clock, sent, 40)
    figures = player.punctuality()
    # Position 11 is sent at the stall's end, then the newest one due, unless too many are overdue by then.
    late = overdue - 1
    skipped, delayed = (0, late - 1) if late > 3 else (max(0, late - 1), 0)
    assert (figures.skipped, figures.delayed_ms) == (skipped, pytest.approx(1e3 * delayed * PERIOD))
    assert sent.numbers == [*range(12), *range(12 + skipped, 40)]
    assert max(np.diff(sent.numbers)) <= 3
    expected = PERIOD * (np.array(sent.numbers) + np.where(np.array(sent.numbers) > 11, delayed, 0))
    over = 0.105 + overdue * PERIOD
    np.testing.assert_allclose(sent.times, np.where(expected > 0.105, np.maximum(expected, over), expected), atol=1e-9)
    assert figures.max_ms == pytest.approx(1e3 * max(0.0, (overdue - 0.5) * PERIOD), abs=1e-6)
    player.stop(1.0)


@pytest.mark.parametrize(
    ("error", "kind"), [(ConnectionLostError("gone"), ConnectionLostError), (KeyError("x"), WorkError)]
)
def test_an_error_is_kept(clock: SimulatedClock, error: Exception, kind: type[Exception]) -> None:
    def broken(position: np.ndarray) -> None:
        if position[0] > 3:
            raise error

    begun = clock.now()
    player = Player(broken, lambda *_: None, np.arange(30.0)[:, None], RATE, clock=clock)
    player.start()
    assert clock.wait(lambda: player.failure is not None, 10.0)
    assert clock.now() == pytest.approx(begun + 4 * PERIOD)
    assert isinstance(player.failure, kind)
    assert player.stop(1.0)
    assert not player.done


def test_a_command_that_hangs_is_waited_for_only_so_long(clock: SimulatedClock) -> None:
    player = Player(lambda _: clock.sleep(3.0), lambda *_: None, np.zeros((9, 1)), RATE, clock=clock)
    begun = clock.now()
    player.start()
    assert not player.stop(0.1)
    assert clock.now() == pytest.approx(begun + 0.1)
    assert player.stop(10.0)
    assert clock.now() == pytest.approx(begun + 3.0)


def test_ticks_hold_both_ends() -> None:
    motion = PointToPoint(np.array([[0.0], [1.0]]), np.array([1.003]))
    positions = ticks(motion, RATE)
    assert positions.shape == (102, 1)
    assert positions[0, 0] == 0.0
    assert positions[-1, 0] == 1.0


class LateClock(SimulatedClock):
    """Of a computer on which every sleep ends this late [s]."""

    lateness = 0.0

    def sleep_until(self, moment: float) -> float:
        return super().sleep_until(moment + self.lateness) + self.lateness


@pytest.mark.parametrize(("periods", "refused"), [(0.0, False), (0.9, False), (4.9, False), (5.1, True)])
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
