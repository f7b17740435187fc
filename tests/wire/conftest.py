"""Every test on a wire runs beside its own simulator: both need the processor in time."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def in_time(punctual: None) -> None:
    """Real-time priority for all tests of this folder."""
