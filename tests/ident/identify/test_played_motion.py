"""The played motion within a recording that also holds the way to its start pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Event
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.identify.played_motion import MOTION_BEGINS, MOTION_ENDS, played_window
from ident.identify.revalidate import revalidate
from ident.identify.summary import summarise
from ident.model.dynamic_model import build_model
from ident.regression.observability import ExperimentChoices
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion

APPROACH = 4.0


@pytest.fixture(scope="module")
def approached(three_joint):
    """Joint 2 moves on its way to the start pose only; the recorder's clock starts at 100 s."""
    motion = random_fourier_motion(build_model(three_joint), 10.0, 1)
    motion.sine[1] = motion.cosine[1] = 0.0

    class Course:
        def evaluate(self, time):
            position, velocity, acceleration = motion.evaluate(time)
            phase = np.clip(time / APPROACH, 0.0, 1.0)
            way = 0.3 * (1.0 - phase) ** 3
            position[1] += way
            velocity[1] += -0.9 / APPROACH * (1.0 - phase) ** 2
            acceleration[1] += 1.8 / APPROACH**2 * (1.0 - phase)
            return position, velocity, acceleration

        duration = 30.0
        period = None

    recording = simulate_recording(three_joint, Course(), 30.0, seed=1)
    stream = recording.streams[JOINTS_STREAM]
    stream = replace(stream, time=stream.time + 100.0)
    events = (
        Event(100.0 + APPROACH, "info", "player", MOTION_BEGINS),
        Event(128.0, "info", "player", MOTION_ENDS),
    )
    return replace(recording, streams={JOINTS_STREAM: stream}, events=events)


def test_the_motion_is_taken_out_of_its_approach(approached):
    position = approached.streams[JOINTS_STREAM].channels["position"].values
    assert played_window(approached, position) == pytest.approx((APPROACH, 28.0))
    found = identify([approached], [], IdentifyChoices(experiment=ExperimentChoices(locked=("j2",))))
    assert found.experiment.locked == (1,)
    assert found.runs[0].choices.start == pytest.approx(APPROACH)
    assert found.validation_runs[0].choices.stop == pytest.approx(28.0)
    assert found.validation.relative_error < 0.05
    again = revalidate(summarise(found, [approached], []), approached)
    assert np.isnan(again.full.rmse[1])
    assert again.full.relative_error < 0.05


def test_without_an_end_it_lasts_to_the_recording_s(approached):
    position = approached.streams[JOINTS_STREAM].channels["position"].values
    cut = replace(approached, events=approached.events[:1])
    assert played_window(cut, position) == (pytest.approx(APPROACH), None)


def test_where_it_makes_no_difference_the_whole_recording_counts(approached):
    position = approached.streams[JOINTS_STREAM].channels["position"].values
    moving = position.copy()
    moving[:, 1] += 0.1 * np.sin(np.arange(len(moving)) / 50.0)
    assert played_window(approached, moving) == (None, None)
    assert played_window(replace(approached, events=()), position) == (None, None)
    late = tuple(replace(event, time=event.time + 1e6) for event in approached.events)
    assert played_window(replace(approached, events=late), position) == (None, None)


def test_a_window_of_the_user_s_goes_before(approached):
    from drivers.errors import DataError
    from ident.signals.pipeline import PreprocessChoices

    choices = IdentifyChoices(
        preprocess=PreprocessChoices(start=1.0), experiment=ExperimentChoices(locked=("j2",)), search_delay=False
    )
    with pytest.raises(DataError, match="said to be locked and moves"):
        identify([approached], [], choices)
