"""Delays that are known, in noise, are found; where none can be seen none is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.assessment.delay import LONGEST, search_delay
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import truth_vector
from ident.signals.filters import butterworth, chebyshev_decimation, no_filter


@pytest.fixture(scope="module")
def search(three_joint, smooth_segment):
    def run(
        delay: float, *, noise: float = 0.02, smoothing: float = 0.2, zero_phase=None, parts: int = 4, seed: int = 0
    ):
        model = replace(build_model(three_joint), smoothing=smoothing)
        kernel = RegressorKernel(model, base_parameters(model).columns)
        segments = []
        for part in range(parts):
            segment = smooth_segment(
                model, 2500, parameters=truth_vector(three_joint), rate=200.0, seed=seed + part, delay=delay
            )
            scale = noise * np.std(segment.torque, axis=1, keepdims=True)
            added = scale * np.random.default_rng(seed + part).standard_normal(segment.torque.shape)
            used = np.ones(2500, dtype=bool)
            used[:100] = used[-100:] = False
            segments.append(replace(segment, torque=segment.torque + added, used=used))
        return search_delay(kernel, segments, zero_phase or butterworth(10.0, 200.0))

    return run


@pytest.mark.parametrize("delay", [-8e-3, -5e-3, -2e-3, 3e-3, 5e-3, 8e-3])
def test_a_known_delay_is_found_within_a_fifth_of_a_millisecond(search, delay):
    found = search(delay)
    assert found.best == pytest.approx(delay, abs=0.2e-3)
    assert found.used == found.best
    assert 0.0 < found.gain < 1.0
    assert ("lags" if delay > 0 else "leads") in found.note


def test_without_noise_a_smooth_torque_gives_the_delay_to_microseconds(search):
    assert search(7.3e-3, noise=0.0).best == pytest.approx(7.3e-3, abs=10e-6)


def test_jumps_of_dry_friction_are_known_to_a_fraction_of_a_sample(search):
    """A reversal happens somewhere between two samples, 5 ms apart: no search can know better than on average."""
    assert search(4e-3, smoothing=0.0).best == pytest.approx(4e-3, abs=0.5e-3)


@pytest.mark.parametrize(
    "zero_phase",
    [no_filter(), butterworth(10.0, 200.0, factor=5), chebyshev_decimation(8)],
    ids=lambda f: f.description,
)
def test_other_filters_find_the_same_delay(search, zero_phase):
    assert search(4e-3, zero_phase=zero_phase).best == pytest.approx(4e-3, abs=0.3e-3)


@pytest.mark.parametrize("seed", range(0, 12, 4))
def test_without_a_delay_none_is_used(search, seed):
    found = search(0.0, seed=seed)
    assert abs(found.best) < 0.25e-3
    assert found.used == 0.0
    assert "none used" in found.note
    assert abs(found.best) < 4 * found.std


def test_a_delay_of_many_samples_is_found(search):
    assert search(40e-3).best == pytest.approx(40e-3, abs=0.5e-3)


def test_a_delay_beyond_what_drives_have_is_not_used(search):
    found = search(3 * LONGEST)
    assert found.used == 0.0


@pytest.mark.parametrize("level", [0.0, 7.0])
def test_a_constant_torque_shows_no_delay(three_joint, smooth_segment, level):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = smooth_segment(model, 600)
    segment = replace(segment, torque=np.full_like(segment.torque, level))
    found = search_delay(kernel, [segment], butterworth(10.0, 100.0))
    assert found.used == 0.0
    assert np.isnan(found.best)
    assert "does not change" in found.note
