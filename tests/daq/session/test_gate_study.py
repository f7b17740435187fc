"""Some random cases of `studies/safety/command_gate.py`: nothing above a limit at the sender, nothing sound refused."""

from __future__ import annotations

import numpy as np
import pytest

from studies.safety import command_gate as study


@pytest.mark.parametrize("number", range(6))
def test_random_plans_stalls_and_rates_pass_no_limit_at_the_sender(number: int) -> None:
    _, _, playable, outcome = study.tried(7, number)
    assert np.max(outcome.sender) <= 1.0 + study.MARGIN
    assert outcome.moved <= 1.0 + study.MARGIN
    assert not (playable and outcome.refused)


@pytest.mark.parametrize("name", ["plan jump for one command", "clock jumps back 0.5 s", "stall of 0.3 s, turn"])
@pytest.mark.parametrize("bus", ["RTDE", "CiA 402", "signal table"])
def test_what_no_check_has_seen_is_not_sent(name: str, bus: str) -> None:
    case = study.Case(bus, 250.0, **{"motion": study.WAY, **study.named_cases()[name]})
    outcome = study.played(case, study.START)
    assert outcome.refused
    assert max(np.max(outcome.sender), outcome.moved) < 0.82


@pytest.mark.parametrize("periods", [1.2, 1.9])
@pytest.mark.parametrize("slow_from", [0.0, 0.62, 0.8])
def test_an_arm_whose_bus_takes_commands_slowly_is_ended_before_it_feels_it(periods: float, slow_from: float) -> None:
    outcome = study.played(
        study.Case("signal table", 100.0, study.WAY, take=0.01 * periods, slow_from=slow_from), study.START
    )
    assert "does not keep up" in outcome.refused
    assert np.max(outcome.fed) < 0.82


def test_a_sync_that_is_sent_late_is_smoothed_by_the_drives() -> None:
    stalls = tuple((0.4 + 0.1 * index, 0.004) for index in range(10))
    outcome = study.played(study.Case("CiA 402", 100.0, study.WAY, stalls=stalls), study.START)
    assert not outcome.refused
    assert np.max(outcome.arm) < 0.9
