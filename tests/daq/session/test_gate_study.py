"""Some random cases of `studies/safety/command_gate.py`: nothing above a limit at the sender, nothing sound refused."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

STUDY = Path(__file__).parents[3] / "studies" / "safety" / "command_gate.py"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    spec = importlib.util.spec_from_file_location("command_gate_study", STUDY)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("number", range(6))
def test_random_plans_stalls_and_rates_pass_no_limit_at_the_sender(study: ModuleType, number: int) -> None:
    _, _, playable, outcome = study.tried(7, number)
    assert np.max(outcome.sender) <= 1.0 + study.MARGIN
    assert outcome.moved <= 1.0 + study.MARGIN
    assert not (playable and outcome.refused)


@pytest.mark.parametrize("name", ["plan jump for one command", "clock jumps back 0.5 s", "stall of 0.3 s, turn"])
@pytest.mark.parametrize("bus", ["RTDE", "CiA 402", "signal table"])
def test_what_no_check_has_seen_is_not_sent(study: ModuleType, name: str, bus: str) -> None:
    case = study.Case(bus, 250.0, **{"motion": study.WAY, **study.named_cases()[name]})
    outcome = study.played(case, study.START)
    assert outcome.refused
    assert max(np.max(outcome.sender), outcome.moved) < 0.82
