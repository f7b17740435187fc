"""One simulated identification that all tests of the front door share."""

from __future__ import annotations

import pytest

import dynid


@pytest.fixture(scope="session")
def run() -> dynid.Recording:
    """Ten seconds of a simulated UR5e."""
    return dynid.simulate("ur5e", duration=10.0, seed=1, rate=100.0)


@pytest.fixture(scope="session")
def other() -> dynid.Recording:
    """Another motion of the same arm."""
    return dynid.simulate("ur5e", duration=10.0, seed=2, rate=100.0)


@pytest.fixture(scope="session")
def result(run, other) -> dynid.IdentificationResult:
    """Identified from the one, validated on the other."""
    return dynid.identify(run, validation=other)
