"""Scripted controllers for the drivers' tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import pytest
from scripted_rtde import ScriptedController
from simulated_clock import SimulatedClock


@pytest.fixture
def controller(clock: SimulatedClock) -> Iterator[Callable[..., ScriptedController]]:
    """Makes scripted controllers, and closes them in the end."""
    with ExitStack() as made:
        yield lambda *args, **keys: made.enter_context(closing(ScriptedController(clock, *args, **keys)))
