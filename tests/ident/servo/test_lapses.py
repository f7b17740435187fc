"""Times at which a servo arm does not follow its commands: each is named with its joint, and sound motion with none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.commanded_motion import TARGET, CommandedMotion
from ident.servo.lapses import lapses

LAG = 0.08
TIME = np.arange(0.0, 30.0, 0.02)
STEP = 1.5e-3


def motion(seed: int) -> CommandedMotion:
    """Two joints that follow sums of sines 0.08 s late, in steps of their encoders."""
    generator = np.random.default_rng(seed)
    rates, phases = generator.uniform(0.5, 6.0, (2, 4)), generator.uniform(0.0, 6.0, (2, 4))
    asked, gone = (
        0.25 * np.sin(rates * times[:, None, None] + phases).sum(axis=2)
        for times in (TIME, np.maximum(TIME - LAG, 0.0))
    )
    return CommandedMotion(("one", "two"), TIME, np.rint(gone / STEP) * STEP, TIME, {TARGET: asked})


def frozen(sound: CommandedMotion) -> CommandedMotion:
    position = sound.position.copy()
    position[600:900, 1] = position[600, 1]
    return replace(sound, position=position)


def clipped(sound: CommandedMotion) -> CommandedMotion:
    position = sound.position.copy()
    position[:, 1] = np.minimum(position[:, 1], np.quantile(position[:, 1], 0.6))
    return replace(sound, position=position)


def drifting(sound: CommandedMotion) -> CommandedMotion:
    return replace(sound, time=1.01 * sound.time)


def without_commands(sound: CommandedMotion) -> CommandedMotion:
    target = sound.commands[TARGET].copy()
    target[750:770] = target[750]
    return replace(sound, commands={TARGET: target})


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (frozen, "position of two does not change from 12.0 to 18.0 s"),
        (clipped, "two stays at"),
        (drifting, "clocks of both drift apart"),
        (without_commands, "stand still from 15.00 to 15.38 s"),
    ],
)
def test_a_lapse_is_named_alone(mistake, words):
    sound = motion(seed=1)
    assert lapses(sound) == []
    assert [words in text for text in lapses(mistake(sound))] == [True]
