"""The player: every position once, in order and in time; the last one is held; errors are kept for the session."""

from __future__ import annotations

import time

import numpy as np
import pytest

from daq.player import SKIP_LIMIT, Player, dry_run, ticks
from daq.trajectories import PointToPoint
from drivers.errors import ConnectionLostError, WorkError

RATE = 100.0


def wait_for(condition):
    end = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_positions_are_sent_by_absolute_times_and_the_last_is_held():
    sent, noted = [], []
    positions = np.arange(40.0)[:, None]
    player = Player(
        lambda position: sent.append((time.monotonic(), position[0])), lambda *note: noted.append(note), positions, RATE
    )
    player.start()
    wait_for(lambda: player.done)
    time.sleep(0.05)
    assert player.stop(1.0)
    figures = player.punctuality()
    numbers = [number for _, number in sent]
    assert sorted(numbers) == numbers
    assert numbers[0] == 0.0
    assert numbers[-2:] == [39.0, 39.0]
    assert len(set(numbers)) + figures.skipped == 40
    assert len(noted) == len(sent)
    start, end = sent[0][0], next(moment for moment, number in sent if number == 39.0)
    assert end - start >= 39 / RATE - 1e-4  # never early
    assert 0.0 <= figures.p50_ms <= figures.p99_ms <= figures.max_ms
    count = len(sent)
    time.sleep(0.05)
    assert len(sent) == count


def test_a_late_player_skips_what_is_overdue():
    sent = []

    def slow(position):
        sent.append(position[0])
        time.sleep(0.035)

    player = Player(slow, lambda *_: None, np.arange(30.0)[:, None], RATE)
    player.start()
    wait_for(lambda: player.done)
    player.stop(1.0)
    assert player.punctuality().skipped >= 10
    assert sent[-1] == 29.0


def test_after_a_stall_the_motion_goes_on_where_it_was():
    sent = []

    def stalls_once(position):
        sent.append(position[0])
        if position[0] == 10.0:
            time.sleep(0.25)

    player = Player(stalls_once, lambda *_: None, np.arange(40.0)[:, None], RATE)
    player.start()
    wait_for(lambda: player.done)
    player.stop(1.0)
    assert max(np.diff(sent)) <= SKIP_LIMIT + 1
    figures = player.punctuality()
    assert figures.delayed_ms == pytest.approx(250.0 - 1e3 / RATE, abs=40.0)
    assert sent[-1] == 39.0


@pytest.mark.parametrize(
    ("error", "kind"), [(ConnectionLostError("gone"), ConnectionLostError), (KeyError("x"), WorkError)]
)
def test_an_error_is_kept(error, kind):
    def broken(position):
        if position[0] > 3:
            raise error

    player = Player(broken, lambda *_: None, np.arange(30.0)[:, None], RATE)
    player.start()
    wait_for(lambda: player.failure is not None)
    assert isinstance(player.failure, kind)
    assert player.stop(1.0)
    assert not player.done


def test_ticks_hold_both_ends():
    motion = PointToPoint(np.array([[0.0], [1.0]]), np.array([1.003]))
    positions = ticks(motion, RATE)
    assert positions.shape == (102, 1)
    assert positions[0, 0] == 0.0
    assert positions[-1, 0] == 1.0


def test_a_dry_run_refuses_a_computer_that_is_too_slow(monkeypatch):
    assert dry_run(RATE).sent > 20
    monkeypatch.setattr("daq.player.sleep_until", lambda moment: 6.0 / RATE)
    with pytest.raises(WorkError, match="ms late at 100 Hz"):
        dry_run(RATE)
