"""Scripted controllers for the drivers' tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from scripted_rtde import ScriptedController
from simulated_clock import SimulatedClock


@pytest.fixture
def controller(clock: SimulatedClock) -> Iterator[Callable[..., ScriptedController]]:
    """Makes scripted controllers, and closes them in the end."""
    made: list[ScriptedController] = []

    def make(*args: Any, **kwargs: Any) -> ScriptedController:
        made.append(ScriptedController(clock, *args, **kwargs))
        return made[-1]

    yield make
    for one in made:
        one.close()
