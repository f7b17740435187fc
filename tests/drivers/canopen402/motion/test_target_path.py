from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen402.motion.target_path import BRIDGED, CATCH_UP, RETURN_TIME, TargetPath, delay_periods

PERIOD = 0.008
DELAY = delay_periods(PERIOD)
SPEED = 1000
"""Counts a period."""


def test_before_a_command_the_drives_hold() -> None:
    path = TargetPath([5, -7], PERIOD)
    assert path.at(1.0) == path.at(2.0) == (5, -7)


@given(st.lists(st.floats(0.0, 0.98), min_size=60, max_size=60), st.floats(0.0, 0.999))
def test_commands_late_by_less_than_a_period_still_give_an_even_motion(late: list[float], phase: float) -> None:
    path = TargetPath([0], PERIOD)
    events = [((tick + (0.0 if tick == 0 else late[tick])) * PERIOD, 0, tick) for tick in range(60)]
    events += [((tick + phase) * PERIOD, 1, tick) for tick in range(60)]
    targets = []
    for moment, kind, tick in sorted(events):
        if kind == 0:
            path.put(moment, [SPEED * tick])
        else:
            targets.append(path.at(moment)[0])
    steps = np.diff(targets[DELAY + 1 :])
    assert np.all(np.abs(steps - SPEED) <= 1)


@given(st.sets(st.integers(10, 50), max_size=20))
def test_commands_left_out_are_bridged(gone: set[int]) -> None:
    path = TargetPath([0], PERIOD)
    targets = []
    for tick in range(60):
        if tick not in gone:
            path.put(tick * PERIOD, [SPEED * tick])
        targets.append(path.at(tick * PERIOD)[0])
    steps = np.diff(targets)
    assert np.all(steps >= 0)
    assert targets[-1] == SPEED * (59 - DELAY)
    if not any({*range(tick, tick + BRIDGED + 1)} <= gone for tick in gone):  # few in a row leave no trace
        assert np.all(np.abs(steps[DELAY + 1 :] - SPEED) <= 1)


@given(st.lists(st.floats(0.0, 0.05), min_size=60, max_size=60), st.floats(0.0, 0.999))
def test_commands_with_their_due_times_may_be_50_ms_late(late: list[float], phase: float) -> None:
    path = TargetPath([0], PERIOD)
    events, sent = [((tick + phase) * PERIOD, 1, tick) for tick in range(60)], 0.0
    for tick in range(60):
        sent = max(sent, tick * PERIOD + (late[tick] if tick else 0.0))
        events.append((sent, 0, tick))
    targets = []
    for moment, kind, tick in sorted(events):
        if kind == 0:
            path.put(tick * PERIOD, [SPEED * tick])
        else:
            targets.append(path.at(moment)[0])
    assert np.all(np.abs(np.diff(targets[DELAY + 1 :]) - SPEED) <= 1)
    assert not path.run_out


@given(st.integers(1, BRIDGED), st.integers(20, 40), st.integers(1, 6))
def test_after_syncs_left_out_targets_return_gently_from_where_drives_went_on_to(
    count: int, when: int, apart: int
) -> None:
    """At a steady acceleration, of 1000 counts a period squared; twice, so many SYNCs apart."""
    path = TargetPath([0], PERIOD)
    applied: list[int] = []
    begins = (when, when + count + apart)
    for tick in range(200):
        path.put(tick * PERIOD, [500 * tick**2])
        if any(begin <= tick < begin + count for begin in begins):
            continue  # what was given before it is not applied
        if tick - count in begins:
            (found,) = path.at((tick - 1) * PERIOD, count)
            applied.pop()
            speed = applied[-1] - applied[-2]
            applied += [applied[-1] + speed * (place + 1) for place in range(count)]
            applied.append(found)
        applied.append(path.at(tick * PERIOD)[0])
    commanded = 500.0 * np.maximum(np.arange(len(applied)) - DELAY, 0) ** 2
    assert np.max(np.abs(np.diff(applied[DELAY + 2 :], 2))) <= 1000.0 * (1.0 + 2.0 * (count + 2) * PERIOD / RETURN_TIME)
    astray = np.abs(np.array(applied) - commanded)
    assert np.max(astray[: when - 1]) <= 1000.0
    assert np.max(astray[-60:]) <= 1001.0


def test_the_last_command_is_reached_and_held() -> None:
    path = TargetPath([0], PERIOD)
    path.put(0.0, [1000])
    reached = [path.at(tick * PERIOD)[0] for tick in range(DELAY + 4)]
    way = [1000 * tick // DELAY for tick in range(DELAY + 1)]
    assert reached == [*way, 1000, 1000, 1000]
    for tick in range(DELAY + 4, 100):
        assert path.at(tick * PERIOD) == (1000,)
    path.put(100 * PERIOD, [3000])  # after a pause: not at one stroke
    later = [path.at(tick * PERIOD)[0] for tick in range(100, 102 + DELAY)]
    assert later == [*(1000 + 2 * place for place in way), 3000]


def played(gone: set[int]) -> list[int]:
    """Targets of an even motion at every SYNC that is not left out."""
    path = TargetPath([0], PERIOD)
    targets = []
    for tick in range(90):
        path.put(tick * PERIOD, [SPEED * tick])
        if tick not in gone:
            targets.append(path.at(tick * PERIOD)[0])
    return targets


@given(st.sets(st.integers(10, 80), max_size=40))
def test_after_few_syncs_left_out_the_target_is_the_present_one(gone: set[int]) -> None:
    allowed = {tick for tick in gone if not {*range(tick - BRIDGED, tick)} <= gone}
    sent = [tick for tick in range(90) if tick not in allowed]
    evenly = [max(0, SPEED * (tick - DELAY)) for tick in sent]
    assert np.all(np.abs(np.array(played(allowed)) - evenly) <= 1)


@given(st.integers(BRIDGED + 1, 6))
def test_after_a_longer_pause_of_sync_the_drives_catch_up_gently(count: int) -> None:
    targets = played({*range(20, 20 + count)})
    steps = np.diff(targets[DELAY + 1 :])
    assert np.sum(steps > (1 + CATCH_UP) * SPEED + 1) == 1  # those that drives bridge, at one stroke
    assert np.max(steps) <= (1 + BRIDGED + CATCH_UP) * SPEED + 1
    assert targets[-1] == SPEED * (89 - DELAY)


@given(st.lists(st.tuples(st.floats(0, 0.1), st.integers(-(2**31), 2**31 - 1)), max_size=30), st.floats(0, 5))
def test_targets_never_leave_what_was_commanded(commands: list[tuple[float, int]], moment: float) -> None:
    path = TargetPath([0], PERIOD)
    now = 0.0
    for pause, value in commands:
        now += pause
        path.put(now, [value])
    values = [0, *(value for _, value in commands)]
    assert min(values) <= path.at(moment)[0] <= max(values)


def test_commands_that_cease_in_motion_are_noticed_before_the_target_stands_still() -> None:
    path = TargetPath([0], PERIOD)
    for tick in range(20):
        path.put(tick * PERIOD, [500 * tick])
        path.at(tick * PERIOD)
    for tick in range(20, 20 + DELAY - 1):
        assert path.at(tick * PERIOD)[0] == 500 * (tick - DELAY)
        assert not path.run_out
    path.at((20 + DELAY) * PERIOD)
    assert path.run_out
