"""What is graded is what is delivered, on data that are held out; identify and validate say the same."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dynid
from daq.recording.recording import JOINTS_STREAM, Recording, Stream
from drivers.core.errors import UsageError
from ident.assessment.validation import Fit
from ident.identify.held_out import COSTLY_RATIO, consistency_cost
from ident.model.dynamic_model import build_model
from ident.result.delivered import delivered_parameters
from ident.verdict.catalogue import CATALOGUE
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("stated_friction")


def with_stream(recording: Recording, change: Callable[[Stream], Stream]) -> Recording:
    return replace(recording, streams={JOINTS_STREAM: change(recording.streams[JOINTS_STREAM])}, path=None)


def rows(recording: Recording, kept: slice) -> Recording:
    """A part of a recording, or every n-th sample."""

    def change(stream: Stream) -> Stream:
        channels = {name: replace(one, values=one.values[kept]) for name, one in stream.channels.items()}
        return replace(stream, time=stream.time[kept], host_time=stream.host_time[kept], channels=channels)

    return with_stream(recording, change)


def rounded(recording: Recording) -> Recording:
    """Return the recording in single precision."""

    def change(stream: Stream) -> Stream:
        channels = {
            name: replace(one, values=one.values.astype(np.float32).astype(np.float64))
            for name, one in stream.channels.items()
        }
        return replace(stream, channels=channels)

    return with_stream(recording, change)


def at_rest(recording: Recording, seconds: float, load: float) -> Recording:
    """The recording, and then the arm at rest, held by currents that stiction changes by a share of the current."""

    def change(stream: Stream) -> Stream:
        step = float(stream.time[1] - stream.time[0])
        count = round(seconds / step)
        noise = np.random.default_rng(1).standard_normal
        channels = {}
        for name, one in stream.channels.items():
            last = np.repeat(one.values[-1:], count, axis=0)
            if name == "current":
                last = last * (1.0 + load) + 0.01 * noise(last.shape)
            channels[name] = replace(one, values=np.concatenate([one.values, last]))
        time = np.concatenate([stream.time, stream.time[-1] + step * np.arange(1, count + 1)])
        return replace(stream, time=time, host_time=time, channels=channels)

    return with_stream(recording, change)


@pytest.fixture(scope="module")
def runs(three_joint) -> list[Recording]:
    model = build_model(three_joint)
    recorded = [
        simulate_recording(three_joint, random_fourier_motion(model, 10.0, seed), seconds, seed)
        for seed, seconds in ((1, 14.0), (2, 9.0), (3, 9.0))
    ]
    return [*recorded[:2], at_rest(recorded[2], 4.0, 0.4)]


@pytest.fixture(scope="module")
def identified(runs) -> dynid.IdentificationResult:
    return dynid.identify(runs[0], validation=runs[1:])


def test_identify_and_validate_give_the_same_verdict(runs, identified):
    again = dynid.validate(identified, runs[1:])
    assert again.verdict == identified.verdict
    assert [one.recording for one in again.delivered.runs] == [
        one.recording for one in identified.result.delivered.runs
    ]
    for run, other in zip(again.delivered.runs, identified.result.delivered.runs, strict=True):
        assert run.all_samples.relative_error == pytest.approx(other.all_samples.relative_error, rel=1e-9)


def test_several_recordings_are_as_bad_as_the_worst_which_is_named(runs, identified):
    order = ("good", "usable", "poor")
    apart = [dynid.validate(identified, run) for run in runs[1:]]
    for purpose, judged in identified.verdict.purposes.items():
        grades = [one.verdict.purposes[purpose].grade for one in apart]
        assert judged.grade == max(grades, key=order.index)
        assert judged.because.startswith("on ")


def test_rest_is_part_of_what_is_graded(runs, identified):
    moving, resting = identified.result.delivered.runs
    assert moving.at_rest < 0.02 < 0.2 < resting.at_rest
    assert resting.all_samples.relative_error > 1.5 * resting.in_motion.relative_error
    assert moving.all_samples.relative_error < 1.05 * moving.in_motion.relative_error
    judged = dynid.validate(identified, runs[2]).verdict.purposes["torque_prediction"]
    assert judged.grade != "good"
    assert "over all samples" in judged.because
    assert "motors at rest" in identified.verdict.basis


def test_the_error_over_all_samples_is_what_predict_leaves(runs, identified):
    """`predict` keeps every sample of the motion's low-pass; the verdict's are decimated, and end a little earlier."""
    prediction = dynid.predict(identified, runs[2])
    graded = identified.result.delivered.runs[1].all_samples
    rms = np.sqrt(np.mean(np.square(prediction.residual), axis=0))
    assert np.allclose(rms, graded.rmse, rtol=0.05)


def test_one_model_everywhere(identified, tmp_path):
    identified.save(tmp_path)
    kind = delivered_parameters(identified.result.consistent)
    assert dynid.load_model(tmp_path).kind == identified.model.kind == identified.result.delivered.parameters == kind
    without = dynid.IdentificationResult(identified.result.model_copy(update={"consistent": None}))
    assert without.model.kind == "full"


@pytest.mark.parametrize(
    "copied",
    [lambda run: run, rounded, lambda run: rows(run, slice(600, 1500)), lambda run: rows(run, slice(None, None, 2))],
    ids=["the same", "single precision", "a part", "decimated"],
)
def test_data_of_the_identification_are_refused_as_held_out(runs, copied):
    other = replace(copied(runs[0]), path=None)
    with pytest.raises(UsageError, match="contains the data of the identification") as refused:
        dynid.identify(runs[0], validation=[runs[1], other])
    assert refused.value.hint
    with pytest.raises(UsageError, match="would count twice"):
        dynid.identify([runs[0], runs[1], other])


def test_data_of_which_a_part_was_used_are_labelled(runs):
    result = dynid.identify(runs[0], validation=runs[0], stop=9.0).result
    assert result.validation.held_out is result.delivered.validation.held_out is False
    assert result.delivered.runs[0].overlap == pytest.approx(9.0 / 14.0, abs=0.08)
    assert "not-held-out" in {check.name for check in result.verdict.checks}
    assert all(judged.grade != "good" for judged in result.verdict.purposes.values())


def test_disjoint_parts_of_one_recording_are_held_out(runs):
    result = dynid.identify(runs[0], split=9.0).result
    assert result.validation.held_out is True
    later = rows(runs[0], slice(int(9.5 * 200), None))
    assert dynid.validate(dynid.IdentificationResult(result), later).delivered.runs[0].overlap == 0.0


def test_a_verdict_never_rests_on_data_of_the_identification(runs, identified):
    alone = dynid.validate(identified, runs[0])
    assert alone.delivered.runs[0].overlap == 1.0
    assert alone.delivered.validation.held_out is False
    assert all(judged.grade != "good" for judged in alone.verdict.purposes.values())
    assert CATALOGUE["not-held-out"].meaning in alone.verdict.headline
    beside = dynid.validate(identified, [runs[1], runs[0]])
    assert beside.verdict.purposes == dynid.validate(identified, runs[1]).verdict.purposes
    accepted = dynid.validate(identified, runs[0], accept={"relative_error": 0.9}).acceptance
    assert not accepted.passed


def errors(whole: float, joint: float) -> Fit:
    return Fit(
        relative_error=whole,
        joint_relative_error=[joint],
        rmse=[1.0],
        low_speed_rmse=[1.0],
        high_speed_rmse=[1.0],
        max_error=[1.0],
        samples=1,
    )


@given(st.floats(1e-4, 1.0), st.floats(1e-4, 1.0), st.floats(0.1, 10.0))
def test_a_costly_consistent_model_says_which_to_take(whole: float, joint: float, ratio: float) -> None:
    found = consistency_cost(["j1"], errors(whole * ratio, joint * ratio), errors(whole, joint))
    if ratio <= 1.0:
        assert not found  # a better one is simply what is graded
    elif ratio > COSTLY_RATIO and max(whole, joint) * (ratio - 1.0) > 0.021:
        assert 'parameters="full"' in found[0].text
