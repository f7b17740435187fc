"""Deliberate mistakes in the data: each is named, none is taken for another; sound data raise no such check.

Each mistake on one of two arms; all on all arms, public recordings too: `studies/checks/data_mistakes.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from random_arms import random_arm

import dynid
from daq.recording.recording import Recording
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.identify.checks.residual_bursts import REVERSAL, _away_from_gaps
from ident.identify.data_split import PreparedRun, RunWindow, check_motion
from ident.model.dynamic_model import build_model
from ident.regression.comparison import TorqueSeries
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.data_mistakes import (
    contact,
    filled_with_zeros,
    jittering_position,
    repeated_rows,
    stuck_encoder,
    with_velocity,
)

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")

DATA_CHECKS = {"encoder-stuck", "rows-repeated", "filled-with-zeros", "residual-bursts", "positions-jitter"}
MODEL_CHECKS = {
    "gravity-opposite",
    "gravity-other-axis",
    "gravity-tilted",
    "torque-sign",
    "torques-exchanged",
    "inconsistent-gain",
    "inconsistent-length",
    "wrong-time-axis",
    "clocks-drift",
}
"""Checks that these mistakes used to raise."""

Mistake = Callable[[Recording], Recording]


@cache
def sound(arm: str) -> Recording:
    """A motion of 12 s at 200 Hz with its velocity; of the random arm 20 s at 100 Hz, one burst of no weight."""
    if arm == "random":
        robot_file = random_arm(9032)
        motion = random_fourier_motion(build_model(robot_file), 10.0, 1, candidates=20)
        return with_velocity(simulate_recording(robot_file, motion, 20.0, 1, rate=100.0))
    return with_velocity(dynid.simulate(arm, duration=12.0, seed=1, rate=200.0))


def checks(result: dynid.IdentificationResult) -> set[str]:
    return {check.name for check in result.verdict.checks}


@pytest.mark.usefixtures("with_friction_search")
@pytest.mark.parametrize("arm", ["ur5e", "rocr6", "random"])
def test_sound_data_raise_none(arm: str) -> None:
    assert not checks(dynid.identify(sound(arm))) & (DATA_CHECKS | MODEL_CHECKS)


@pytest.mark.parametrize(
    ("name", "arm", "mistake", "largest"),
    [
        ("encoder-stuck", "rocr6", lambda run: stuck_encoder(run, 1, 3.0, 1.0), 0.04),
        ("rows-repeated", "ur5e", lambda run: repeated_rows(run, 0.13, 1), 0.04),
        ("rows-repeated", "rocr6", lambda run: repeated_rows(run, 0.3, 1, ("position",)), 0.04),
        ("positions-jitter", "ur5e", lambda run: jittering_position(run, 0.015, 1), 0.06),
    ],
    ids=["encoder", "rows", "positions", "jitter"],
)
def test_a_mistake_that_can_be_repaired_is_named_and_repaired(
    name: str, arm: str, mistake: Mistake, largest: float
) -> None:
    result = dynid.identify(mistake(sound(arm)))
    assert checks(result) & DATA_CHECKS == {name}
    assert not checks(result) & MODEL_CHECKS
    assert result.validation is not None
    assert result.validation.relative_error < largest
    if name == "encoder-stuck":
        (check,) = (check for check in result.verdict.checks if check.name == name)
        joint = sound(arm).streams["joints"].channels["position"].columns[1]
        assert check.joints == (joint,)
        assert f"{joint} from 3.00 to 4.00 s while its velocity goes on" in check.text


def test_contacts_are_named_by_their_times() -> None:
    result = dynid.identify(contact(sound("ur5e"), 0.1, 1.0, 2))
    (check,) = (check for check in result.verdict.checks if check.name in DATA_CHECKS)
    assert check.name == "residual-bursts"
    assert "--method irls" in check.text
    assert not checks(result) & MODEL_CHECKS


def test_what_is_interpolated_where_several_rows_are_missing_is_no_burst() -> None:
    time = np.delete(np.arange(200) / 50.0, [50, 51, 120])
    signals = SimpleNamespace(time=time, stale=object())
    run = cast("PreparedRun", SimpleNamespace(signals=signals, prepared=SimpleNamespace(segments=[None])))
    grid = np.arange(200) / 50.0
    zeros = np.zeros((1, 200))
    (part,) = _away_from_gaps([run], [TorqueSeries(grid, zeros, zeros, zeros, np.ones(200, dtype=np.bool_))])
    near = (grid >= 49 / 50 - REVERSAL) & (grid <= 52 / 50 + REVERSAL)
    assert np.array_equal(part.used, ~near)
    signals.stale = None
    (part,) = _away_from_gaps([run], [part])
    assert np.array_equal(part.used, ~near)


def test_drop_outs_that_were_filled_with_zeros_are_named() -> None:
    result = dynid.identify(filled_with_zeros(sound("rocr6"), 0.5, 1))
    assert checks(result) & (DATA_CHECKS | MODEL_CHECKS) == {"filled-with-zeros"}
    assert "poor" in result.verdict.headline.lower()


@pytest.mark.parametrize("rate", [5.0, 8.0, 20.0, 100.0, 500.0])
def test_rows_are_refused_in_disorder_only_however_slowly_they_were_sampled(rate: float) -> None:
    generator = np.random.default_rng(int(rate))
    time, periods, sorted_ones = np.arange(300) / rate, generator.uniform(1.6, 5.0, 20), 0
    for period in periods:
        angles = 2.0 * np.pi / period * np.arange(1, 6)[:, None] * time[:, None, None]
        angles = angles + generator.uniform(0.0, 2.0 * np.pi, (5, 3))
        position = np.einsum("hj,thj->tj", generator.standard_normal((5, 3)), np.sin(angles))
        assert not out_of_order(time, position)
        assert out_of_order(time, position[generator.permutation(300)])
        torque = position[:, 0] + 0.1 * generator.standard_normal(300)
        sorted_ones += out_of_order(time, position[np.argsort(torque)])
    assert sorted_ones >= 0.9 * len(periods) or time[-1] < max(periods)  # within a period few rows have like torques


def out_of_order(time: FloatArray, position: FloatArray) -> bool:
    """Whether `check_motion` refuses rows whose stamps rise."""
    run = SimpleNamespace(time=time, position=position, signals=SimpleNamespace(label="run"))
    try:
        check_motion([cast("RunWindow", run)], ["a1", "a2", "a3"])
    except DataError as error:
        return "order of time" in error.hint
    return False
