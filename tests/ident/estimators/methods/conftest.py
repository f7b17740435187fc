"""Recordings with faults."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Recording
from studies.synthetic.data_mistakes import with_values


def contacts(recording: Recording, share: float = 0.05) -> Recording:
    """Bursts of 50 ms, of up to the motor signal's own size, at one joint at a time."""
    stream = recording.streams[JOINTS_STREAM]
    generator = np.random.default_rng(0)
    values = stream.channels["current"].values.copy()
    size = np.sqrt(np.mean(values**2, axis=0))
    for _ in range(int(share * len(values) / 10)):
        start, joint = int(generator.integers(len(values) - 10)), int(generator.integers(values.shape[1]))
        values[start : start + 10, joint] += generator.uniform(0.3, 1.0) * size[joint] * generator.choice([-1.0, 1.0])
    return with_values(recording, current=values)


@pytest.fixture(scope="session")
def with_contacts() -> Callable[[Recording], Recording]:
    """Adds contacts to a recording."""
    return contacts
