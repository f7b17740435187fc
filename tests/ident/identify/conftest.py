"""Recordings of the simulated three-joint arm, which the tests of `identify` share."""

from __future__ import annotations

import functools

import pytest

from daq.recording.recording import Recording
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording


@pytest.fixture(scope="module")
def clean(recorded):
    """What `identify` makes of the usual recording."""
    return identify([recorded()], [], IdentifyChoices())


@pytest.fixture(scope="module")
def recorded(three_joint):
    """Factory of noisy recordings; another seed is another motion and another noise."""
    motion = functools.cache(functools.partial(random_fourier_motion, build_model(three_joint), 10.0))

    def make(seconds: float = 14.0, seed: int = 1) -> Recording:
        return simulate_recording(three_joint, motion(seed), seconds, seed)

    return make
