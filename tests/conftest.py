"""Fixtures that all tests share."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from simulated_clock import SimulatedClock, simulated_time

from drivers.clock import Clock

# A busy computer makes any single example slow: time is no property that a test of values may fail by.
settings.register_profile("dynid", deadline=None)
settings.load_profile("dynid")

# A shell's background job ignores Ctrl-C, and so would all programs that tests start and end by it.
signal.signal(signal.SIGINT, signal.default_int_handler)

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings (`DYNID_DATA`, default ../shared/data); skips where it is missing."""
    folder = Path(os.environ.get("DYNID_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}; set DYNID_DATA")
    return folder


@pytest.fixture
def clock() -> Iterator[SimulatedClock]:
    """Simulated time, see tests/support/simulated_clock.py."""
    with simulated_time() as clock:
        yield clock


@pytest.fixture(autouse=True)
def no_real_time(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse to wait in real time, or to start a thread there, in a test that is not marked `realtime`."""
    if request.node.get_closest_marker("realtime") is not None:
        return

    def refuse(*_: object) -> None:
        raise AssertionError("this test waits in real time: give a simulated clock to all that takes one")

    for name in ("sleep", "thread", "select"):
        monkeypatch.setattr(Clock, name, refuse)
