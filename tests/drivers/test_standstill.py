"""Rest is shown by positions that stay within a narrow band for long enough."""

from __future__ import annotations

import numpy as np
from each import each

from drivers.standstill import REST_SPEED, REST_WINDOW, StandstillWatch

PERIOD = 0.004


def watched(speed: float, seconds: float, watch: StandstillWatch | None = None, begin: float = 0.0) -> StandstillWatch:
    watch = watch or StandstillWatch(0.5 * REST_WINDOW)
    for time in np.arange(begin, begin + seconds, PERIOD):
        watch.add(float(time), np.array([0.3, speed * time]))
    return watch


@each(("seconds", "at_rest"), [(0.0, False), (0.9 * REST_WINDOW, False), (1.1 * REST_WINDOW, True)])
def test_rest_takes_its_time(seconds: float, at_rest: bool) -> None:
    assert watched(0.0, seconds).at_rest == at_rest
    assert not watched(2.0 * REST_SPEED, seconds).at_rest


def test_a_motion_ends_rest_at_once() -> None:
    watch = watched(0.0, 1.0)
    assert watch.at_rest
    assert not watched(0.5, 0.01, watch, begin=1.0).at_rest


def test_nothing_is_known_of_a_gap() -> None:
    watch = watched(0.0, 1.0)
    assert not watched(0.0, 0.5 * REST_WINDOW, watch, begin=2.0).at_rest
    assert watched(0.0, 1.1 * REST_WINDOW, watch, begin=2.0 + 0.5 * REST_WINDOW).at_rest


def test_positions_that_are_no_numbers_are_no_rest() -> None:
    watch = StandstillWatch(0.5 * REST_WINDOW)
    for time in np.arange(0.0, 1.0, PERIOD):
        watch.add(float(time), np.array([0.3, np.nan]))
    assert not watch.at_rest


def test_an_encoder_that_flickers_between_two_steps_is_at_rest():
    watch = StandstillWatch(0.1)
    for number in range(30):
        watch.add(0.01 * number, np.array([0.5, (number % 3 == 0) * 2.0 * np.pi / 4096]))
    assert watch.at_rest


def test_rows_together_are_judged_as_one_by_one():
    generator = np.random.default_rng(1)
    one, together = StandstillWatch(0.05, 0.1), StandstillWatch(0.05, 0.1)
    answers = set()
    end, place = 0.0, np.zeros(2)
    for _ in range(300):
        count = generator.integers(1, 9)
        steps = np.where(generator.random(count) < 0.02, 0.06, PERIOD)
        moves = (generator.random((count, 1)) < 0.03) * generator.normal(0.0, 1e-3, (count, 2))
        times, rows = end + np.cumsum(steps), place + np.cumsum(moves, axis=0)
        end, place = times[-1], rows[-1]
        together.add_rows(times, rows)
        for time, row in zip(times, rows, strict=True):
            one.add(float(time), row)
        assert together.at_rest == one.at_rest
        answers.add(one.at_rest)
    assert answers == {True, False}
