"""Methods against the noise of positions: what each recovers, refuses and says of itself."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import parse_robot
from drivers.core.errors import IdentificationError, UsageError
from ident.estimators.method_choice import chosen_method
from ident.estimators.methods.iv import repeated_segment
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.signals.options import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

DEFAULT = PreprocessChoices()
POOR = PreprocessChoices(position_cutoff=60.0, torque_cutoff=30.0)
"""Far above the motion's band: W is full of noise."""
METHODS = ("wls", "tls", "iv:instruments=repetition")


def arm(text: str):
    return parse_robot(text, where="three_joint", folder=None)


@functools.cache
def recorded(text: str, seed: int, std: float, period: float = 4.0, seconds: float = 12.5) -> Recording:
    robot_file = arm(text)
    motion = random_fourier_motion(build_model(robot_file), period, seed=1, candidates=5)
    recording = simulate_recording(robot_file, motion, seconds, seed)
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    return with_values(recording, position=position + std * np.random.default_rng(seed).standard_normal(position.shape))


@functools.cache
def identified(text: str, method: str, std: float, choices: PreprocessChoices = DEFAULT) -> Identification:
    choice = IdentifyChoices(method, preprocess=choices, search_delay=False, split=10.0)
    return identify([recorded(text, 1, std)], [], choice)


def deviations(robot_file, found: Identification):
    truth = found.base.projection @ truth_vector(robot_file)
    return (found.solution.parameters - truth) / found.std


@pytest.mark.parametrize("method", METHODS)
def test_little_noise_leaves_every_method_near_the_truth(method, three_joint):
    found = identified(three_joint.text, method, 1e-5)
    off = deviations(three_joint, found)
    assert np.mean(np.abs(off) < 1.96) > 0.7
    assert np.max(np.abs(off)) < 5.0
    assert found.validation.relative_error < 1.05 * identified(three_joint.text, "wls", 1e-5).validation.relative_error
    assert all(loop.settled and loop.values for loop in found.estimation.loops)
    assert found.consistent is not None
    assert len(found.pruned.solution.active) > 10
    result = found.result
    assert result.method == method.split(":")[0]


@pytest.mark.usefixtures("with_checks")
def test_the_output_error_predicts_held_out_torques(three_joint):
    """Its errors last so long that ten seconds hold few independent ones: its intervals are not asked."""
    found = identified(three_joint.text, "output-error", 1e-5)
    plain = identified(three_joint.text, "wls", 1e-5)
    assert found.validation.relative_error < 1.3 * plain.validation.relative_error
    (loop,) = found.estimation.loops
    assert loop.settled
    assert any(check.name == "few-independent-samples" for check in found.checks)
    assert len(found.pruned.solution.active) > 10


@pytest.mark.parametrize("method", ["tls", "iv:instruments=repetition"])
def test_noise_of_the_positions_biases_least_squares_and_not_these(method, three_joint):
    biased = deviations(three_joint, identified(three_joint.text, "wls", 2e-4, POOR))
    off = deviations(three_joint, identified(three_joint.text, method, 2e-4, POOR))
    assert np.sqrt(np.mean(off**2)) < 0.75 * np.sqrt(np.mean(biased**2))


def test_two_runs_and_a_gap(three_joint):
    """Several recordings, one of them cut into segments by a gap."""
    runs = [recorded(three_joint.text, seed, 1e-5) for seed in (1, 2)]
    stream = runs[1].streams[JOINTS_STREAM]
    keep = np.ones(len(stream.time), dtype=bool)
    keep[1200:1300] = False
    cut = replace(
        stream,
        time=stream.time[keep],
        host_time=stream.host_time[keep],
        channels={name: replace(channel, values=channel.values[keep]) for name, channel in stream.channels.items()},
    )
    runs[1] = replace(runs[1], streams={JOINTS_STREAM: cut})
    choices = functools.partial(IdentifyChoices, search_delay=False)
    found = identify(runs, [recorded(three_joint.text, 3, 1e-5)], choices("tls"))
    assert np.mean(np.abs(deviations(three_joint, found)) < 1.96) > 0.75


def test_what_cannot_be_done_is_refused(three_joint):
    once = recorded(three_joint.text, 1, 1e-5, 20.0, 12.0)
    choices = functools.partial(IdentifyChoices, search_delay=False)
    with pytest.raises(IdentificationError, match="does not repeat itself"):
        identify([once], [], choices("iv:instruments=repetition"))
    with pytest.raises(IdentificationError, match="show no noise beyond a motion"):
        identify([once], [], choices("tls", preprocess=PreprocessChoices(position_cutoff=2.0, torque_cutoff=2.0)))
    stream = once.streams[JOINTS_STREAM]
    position = stream.channels["position"]
    still = position.values.copy()
    still[:, 0] = still[0, 0]
    held = replace(stream, channels={**stream.channels, "position": replace(position, values=still)})
    with pytest.raises(IdentificationError, match="not all joints moved"):
        identify([replace(once, streams={JOINTS_STREAM: held})], [], choices("output-error"))
    with pytest.raises(UsageError):
        chosen_method("iv:instruments=others")


def test_a_repetition_is_the_same_motion_with_other_noise(three_joint):
    found = identified(three_joint.text, "iv", 2e-4, POOR)
    (segment,) = found.runs[0].prepared.segments
    other = repeated_segment(segment)
    assert other is not None
    apart = np.std(other.acceleration - segment.acceleration, axis=1)
    noise = np.std(segment.acceleration - np.roll(segment.acceleration, 1, axis=1), axis=1)
    assert np.all(apart > 0.2 * noise)
    assert np.all(np.abs(other.position - segment.position)[:, other.used] < 0.02)
    assert other.used.sum() > 0.9 * segment.used.sum()


def test_least_squares_beside_instruments_shows_noise_of_the_regressor(three_joint):
    """Durbin, Wu and Hausman's H0 holds with cut-offs from the data, and not where W is full of noise."""
    p_values = []
    for choices in ((2e-4, POOR), (1e-5, DEFAULT)):
        found = identified(three_joint.text, "iv:instruments=repetition", *choices)
        (step,) = (one for one in found.estimation.steps if one.name == "exogeneity")
        p_values.append(step.settings["p_value"])
    assert p_values[0] < 0.05 < p_values[1]


def test_every_arm_has_its_parameters(three_joint):
    """The truth has as many base parameters as were found; the tests above compare all of them."""
    found = identified(three_joint.text, "tls", 1e-5)
    assert len(found.solution.active) == base_parameters(build_model(three_joint)).count
