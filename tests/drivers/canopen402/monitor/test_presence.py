"""Whether a drive counts as present, from what it says of itself; in times of the test's own."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen402.monitor.presence import HEARTBEATS_MISSED, Heartbeats, NodeGuarding

PERIOD = 0.1


def asked(guarding: NodeGuarding, answers: list[int | None]) -> list[str]:
    """What is missing half a period after each request; an answer comes after a millisecond, None is none."""
    said = []
    for number, answer in enumerate(answers):
        moment = number * PERIOD
        guarding.ask(0, moment)
        if answer is not None:
            guarding.take(0, answer, moment + 1e-3)
        said.append(guarding.missing(0, moment + 0.5 * PERIOD))
    return said


def test_a_drive_counts_as_gone_after_so_many_periods_without_a_heartbeat() -> None:
    beats = Heartbeats(2, PERIOD)
    beats.start(5.0)
    limit = HEARTBEATS_MISSED * PERIOD
    assert beats.missing(0, 5.0 + 0.99 * limit) == ""
    beats.take(0, 0x05, 5.2)
    assert beats.missing(0, 5.2 + 0.99 * limit) == ""
    assert beats.missing(1, 5.2 + 0.99 * limit) == "no heartbeat for 0.50 s"
    assert beats.missing(0, 5.2 + 1.1 * limit) == "no heartbeat for 0.33 s"


@given(st.integers(2, 6), st.booleans(), st.integers(1, 30))
def test_answers_that_alternate_keep_a_drive_present(factor: int, first: bool, count: int) -> None:
    bits = itertools.cycle((0x80, 0x00) if first else (0x00, 0x80))
    assert not any(asked(NodeGuarding(1, PERIOD, factor), [next(bits) | 0x05 for _ in range(count)]))


@given(st.integers(2, 6), st.integers(0, 5))
def test_as_many_requests_without_an_answer_as_the_factor_are_a_loss(factor: int, before: int) -> None:
    guarding = NodeGuarding(1, PERIOD, factor)
    said = asked(guarding, [0x80 * (number % 2) | 5 for number in range(before)] + [None] * (factor + 1))
    assert not any(said[:-1])  # the last of them still has its period
    assert said[-1] == f"no answer to {factor} requests of node guarding"
    guarding.take(0, 0x80 * (before % 2) | 5, 1e3)
    assert guarding.missing(0, 1e3) == ""


def test_a_lost_answer_costs_the_next_one_too_and_is_survived() -> None:
    # The drive alternates whether its answer arrives or not.
    assert not any(asked(NodeGuarding(1, PERIOD, 3), [0x05, 0x85, None, 0x85, 0x05, 0x85]))


def test_a_bit_that_stays_is_told_as_such() -> None:
    said = asked(NodeGuarding(1, PERIOD, 3), [0x05] * 5)
    assert not any(said[:4])
    assert "toggle bit" in said[4]
    assert "another master" in said[4]


def test_a_drive_that_booted_begins_anew() -> None:
    guarding = NodeGuarding(1, PERIOD, 2)
    assert not any(asked(guarding, [0x05, 0x85, 0x05]))
    guarding.take(0, 0x00, 1.0)
    assert not any(asked(guarding, [0x7F, 0xFF]))


def test_a_stall_of_this_computer_is_no_loss() -> None:
    guarding = NodeGuarding(1, PERIOD, 3)
    assert not any(asked(guarding, [0x05, 0x85]))
    # Nobody asked for ten seconds: no request, no answer to miss.
    assert guarding.missing(0, 10.0) == ""
    guarding.ask(0, 10.0)
    assert guarding.missing(0, 10.5) == ""
