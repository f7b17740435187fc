"""A recording's motion, prepared once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import load_robot
from drivers.core.errors import InputError
from ident.assessment.delay.delay import search_delay
from ident.assessment.excitation import excitation_reached, recorded_motion
from ident.checks.recording_check import recording_info
from ident.excite.sufficiency import OWN_TORQUE, motion_sufficiency
from ident.model.dynamic_model import build_model
from ident.regression.observation_matrix import reduce_segments
from ident.signals.pipeline import prepare
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values


@pytest.fixture(scope="module")
def recording(three_joint) -> Recording:
    return simulate_recording(three_joint, random_fourier_motion(build_model(three_joint), 10.0, seed=1), 12.0, seed=1)


def test_torque_that_is_no_number_leaves_the_motion(recording, three_joint):
    (quantity,) = set(recording.streams[JOINTS_STREAM].channels) & {"torque", "current"}
    spoilt = recording.streams[JOINTS_STREAM].channels[quantity].values.copy()
    spoilt[5, 1] = np.nan
    whole = recorded_motion(recording, three_joint)
    motion = recorded_motion(with_values(recording, **{quantity: spoilt}), three_joint)
    assert whole.measured is not None
    assert motion.measured is None
    assert not np.any(motion.prepared.segments[0].torque)
    reached, expected = excitation_reached(motion), excitation_reached(whole)
    assert reached.scaled_condition == pytest.approx(expected.scaled_condition, rel=1e-9)
    assert reached.velocity_reached == expected.velocity_reached
    assert motion_sufficiency(whole).source == OWN_TORQUE
    assert motion_sufficiency(motion).source == "the robot file's truth"


def test_nothing_to_analyse_is_refused_with_the_reason(recording, three_joint):
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    short = simulate_recording(three_joint, random_fourier_motion(build_model(three_joint), 10.0, seed=1), 0.02, seed=1)
    for without, robot, reason in (
        (with_values(recording, position=np.zeros_like(position)), three_joint, "nothing moves"),
        (short, three_joint, "samples are too few"),
        (recording, load_robot("ur5e"), "has no column for joint"),
        (replace(recording, streams={}), three_joint, "has no stream"),
    ):
        with pytest.raises(InputError, match=reason):
            recorded_motion(without, robot)


@pytest.mark.parametrize("late", [False, True])
def test_a_recording_is_prepared_and_reduced_once(recording, three_joint, monkeypatch, late):
    if late:  # by 8 ms, which the search finds and uses
        (quantity,) = set(recording.streams[JOINTS_STREAM].channels) & {"torque", "current"}
        values = recording.streams[JOINTS_STREAM].channels[quantity].values
        recording = with_values(recording, **{quantity: np.roll(values, 4, axis=0)})
    calls = []

    def counted(name, function):
        def call(*arguments, **named):
            calls.append(name)
            return function(*arguments, **named)

        return call

    monkeypatch.setattr("ident.assessment.excitation.prepare", counted("prepare", prepare))
    monkeypatch.setattr("ident.excite.sufficiency.prepare", counted("prepare", prepare))
    monkeypatch.setattr("ident.assessment.excitation.reduce_segments", counted("reduce", reduce_segments))
    monkeypatch.setattr("ident.checks.recording_check.search_delay", counted("delay", search_delay))
    info = recording_info(recording, three_joint)
    assert info.sufficiency.source == OWN_TORQUE
    assert (info.delay.used != 0.0) == late
    # With its torque shifted it is another one.
    assert sorted(calls) == sorted(["delay", *(2 if late else 1) * ["prepare", "reduce"]])
