"""Recorded target positions as instruments: what they repair, and when they are refused."""

from __future__ import annotations

import numpy as np
import pytest

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.core.errors import IdentificationError
from ident.estimators.methods.iv import first_stage_f
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.linear_algebra.triangular import triangular
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.signals.options import PreprocessChoices
from sim_drivers.plant.plant import Plant, PlantSettings
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.synthetic.controlled_run import record_plant
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("estimates_alone", "stated_friction")

POOR = PreprocessChoices(position_cutoff=60.0, torque_cutoff=30.0)
"""Far above the motion's band: W is full of noise."""


@pytest.fixture(scope="module")
def tracked(three_joint) -> Recording:
    """An arm that follows its targets once along a motion, with noisy positions."""
    motion = random_fourier_motion(build_model(three_joint), 12.5, seed=1, candidates=5)
    plant = Plant(three_joint, PlantSettings(step=2.5e-3), seed=1, position=motion.evaluate(np.zeros(1))[0][:, 0])
    recording = record_plant(three_joint, plant, motion, 200.0)
    position = recording.streams[JOINTS_STREAM].channels["position"].values
    return with_values(recording, position=position + 2e-4 * np.random.default_rng(1).standard_normal(position.shape))


def target(recording: Recording) -> np.ndarray:
    return recording.streams[JOINTS_STREAM].channels["target_position"].values


def identified(recording: Recording, method: str) -> Identification:
    return identify([recording], [], IdentifyChoices(method, preprocess=POOR, search_delay=False, split=10.0))


def words(found: Identification) -> str:
    step, _ = found.estimation.steps
    assert step.name == "instruments"
    return step.text


def test_targets_take_the_bias_away(tracked, three_joint):
    def deviation(found: Identification) -> float:
        truth = found.base.projection @ truth_vector(three_joint)
        return float(np.sqrt(np.mean(((found.solution.parameters - truth) / found.std) ** 2)))

    assert deviation(identified(tracked, "iv:instruments=target")) < 0.75 * deviation(identified(tracked, "wls"))


def test_auto_finds_the_targets(tracked):
    found, automatic = (identified(tracked, method) for method in ("iv:instruments=target", "iv"))
    np.testing.assert_array_equal(automatic.solution.parameters, found.solution.parameters)
    assert "target positions" in words(automatic)


@pytest.mark.parametrize("kind", ["still", "another joint's", "half a second late"])
def test_targets_that_do_not_follow_the_motion_are_weak_instruments(tracked, kind):
    real = target(tracked)
    others = {
        "still": np.full_like(real, 0.3),
        "another joint's": real[:, ::-1],
        "half a second late": np.vstack([np.repeat(real[:1], 100, axis=0), real[:-100]]),
    }
    weak = with_values(tracked, target_position=others[kind])
    with pytest.raises(IdentificationError, match="weak instruments"):
        identified(weak, "iv:instruments=target")


def test_auto_says_why_nothing_can_be_an_instrument(tracked):
    with pytest.raises(IdentificationError, match=r"does not repeat itself .* target positions make weak instruments"):
        identified(with_values(tracked, target_position=np.zeros_like(target(tracked))), "iv")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_value_that_is_no_target_hinders_no_other_method(tracked, value):
    broken = target(tracked).copy()
    broken[1000, 1] = value
    hostile = with_values(tracked, target_position=broken)
    with pytest.raises(IdentificationError, match="no target positions"):
        identified(hostile, "iv:instruments=target")
    plain = identified(tracked, "wls").solution.parameters
    np.testing.assert_array_equal(identified(hostile, "wls").solution.parameters, plain)


def test_positions_copied_as_targets_are_no_instruments(tracked):
    copied = with_values(tracked, target_position=tracked.streams[JOINTS_STREAM].channels["position"].values)
    with pytest.raises(IdentificationError, match="no target positions"):
        identified(copied, "iv:instruments=target")


def test_first_stage_f_of_one_column_is_the_textbooks():
    """F = explained variance over the residual's, (r − 1) times; 0 for an instrument that is none."""
    generator = np.random.default_rng(0)
    instrument = generator.standard_normal(500)
    column = 0.3 * instrument + generator.standard_normal(500)
    slope = instrument @ column / (instrument @ instrument)
    rest = column - slope * instrument
    expected = slope**2 * (instrument @ instrument) / (rest @ rest) * 499
    factor = triangular(np.column_stack([instrument, column]))
    assert first_stage_f(factor, 1, 500.0) == pytest.approx(expected)
    assert first_stage_f(triangular(np.column_stack([np.zeros(500), column])), 1, 500.0) == 0.0
    twice = np.column_stack([instrument, 2 * instrument, column, generator.standard_normal(500)])
    assert first_stage_f(triangular(twice), 2, 500.0) == 0.0
