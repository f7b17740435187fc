"""The played motion within a recording that also holds the way to its start pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Event
from drivers.core.errors import DataError
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.identify.revalidate import revalidate
from ident.model.dynamic_model import build_model
from ident.regression.options import ExperimentChoices
from ident.signals.joint_signals import read_joint_signals
from ident.signals.pipeline import PreprocessChoices, prepare_with_rest
from ident.signals.segments import MOTION_BEGINS, MOTION_ENDS, played_window
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

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
    events = (Event(100.0 + APPROACH, "info", "player", MOTION_BEGINS), Event(128.0, "info", "player", MOTION_ENDS))
    return replace(recording, streams={JOINTS_STREAM: stream}, events=events)


def test_the_motion_is_taken_out_of_its_approach(approached):
    assert played_window(approached) == pytest.approx((APPROACH, 28.0))
    found = identify([approached], [], IdentifyChoices(experiment=ExperimentChoices(locked=("j2",))))
    assert found.experiment.locked == (1,)
    assert found.runs[0].choices.start == pytest.approx(APPROACH)
    assert found.validation_runs[0].choices.stop == pytest.approx(28.0)
    assert found.validation.relative_error < 0.05
    (window,) = [step for step in found.runs[0].prepared.steps if step.name == "window"]
    assert "without the approach" in window.text
    again = revalidate(found.result, approached)
    assert again.full.rmse[1] is None
    assert again.full.relative_error < 0.05


def test_joints_that_all_move_are_cut_too(approached):
    """A hold with a torque that no model explains, outside the motion, changes nothing."""
    stream = approached.streams[JOINTS_STREAM]
    outside = (stream.time < 100.0 + APPROACH) | (stream.time >= 128.0)
    (signal,) = set(stream.channels) & {"current", "torque", "voltage"}
    disturbed = with_values(approached, **{signal: stream.channels[signal].values + 50.0 * outside[:, None]})
    found, expected = (identify([run], [], IdentifyChoices(search_delay=False)) for run in (disturbed, approached))
    assert np.array_equal(found.solution.parameters, expected.solution.parameters)
    assert found.validation.relative_error == expected.validation.relative_error


def test_friction_at_rest_knows_the_approach(approached, three_joint):
    signals = read_joint_signals(approached, three_joint.robot)
    for played in (True, False):
        prepared = prepare_with_rest(signals, PreprocessChoices(start=APPROACH, stop=28.0), played=played)
        (segment,) = prepared.segments
        counted = segment.time[segment.used]
        assert 100.0 + APPROACH <= counted[0] < 101.0 + APPROACH
        assert counted[-1] < 128.0
        assert (segment.time[0] < 101.0) == played


def test_without_an_end_it_lasts_to_the_recording_s(approached):
    assert played_window(replace(approached, events=approached.events[:1])) == (pytest.approx(APPROACH), None)


def test_without_events_of_the_player_the_whole_recording_counts(approached):
    assert played_window(replace(approached, events=())) == (None, None)
    others = tuple(replace(event, source="import") for event in approached.events)
    assert played_window(replace(approached, events=others)) == (None, None)
    late = tuple(replace(event, time=event.time + 1e6) for event in approached.events)
    assert played_window(replace(approached, events=late)) == (None, None)


def test_a_window_of_the_user_s_goes_before(approached):
    choices = IdentifyChoices(
        preprocess=PreprocessChoices(start=1.0), experiment=ExperimentChoices(locked=("j2",)), search_delay=False
    )
    with pytest.raises(DataError, match="declared locked but moves"):
        identify([approached], [], choices)
