"""Delays that are known, in noise, are found; only one that lags and lowers the error on held-out blocks is used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ident.assessment.delay.delay import LONGEST_DELAY, WORTHWHILE_GAIN, delay_checks, search_delay
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import truth_vector
from ident.signals.filters import butterworth, chebyshev_decimation, no_filter
from ident.signals.resampling import shift_torque


@pytest.fixture(scope="module")
def search(three_joint, smooth_segment):
    """Searches the delay of torques that are late by `delay`, those of `late` joints by others, all later with time."""

    def run(
        delay: float,
        *,
        late: Mapping[int, float] = MappingProxyType({}),
        drift: float = 0.0,
        noise: float = 0.02,
        smoothing: float = 0.2,
        zero_phase=None,
        parts: int = 4,
        seed: int = 0,
    ):
        model = replace(build_model(three_joint), smoothing=smoothing)
        kernel = RegressorKernel(model, base_parameters(model).columns)
        segments = []
        for part in range(parts):
            segment = smooth_segment(
                model, 2500, parameters=truth_vector(three_joint), rate=200.0, seed=seed + part, delay=delay
            )
            torque = segment.torque
            for joint, of_joint in late.items():
                torque[joint] = shift_torque(torque[joint : joint + 1], 200.0, delay - of_joint)[0]
            if drift:
                segment = replace(segment, time=segment.time + 12.5 * part)
                middle = 12.5 * parts / 2
                clock = segment.time - drift * (segment.time - middle)
                torque = np.stack([CubicSpline(segment.time, row)(clock) for row in torque])
            scale = noise * np.std(segment.torque, axis=1, keepdims=True)
            added = scale * np.random.default_rng(seed + part).standard_normal(segment.torque.shape)
            used = np.ones(2500, dtype=bool)
            used[:100] = used[-100:] = False
            segments.append(replace(segment, torque=torque + added, used=used))
        return search_delay(kernel, segments, zero_phase or butterworth(10.0, 200.0))

    return run


@pytest.mark.parametrize("delay", [2e-3, 5e-3, 8e-3])
def test_a_known_delay_is_found_within_its_interval_and_used(search, delay):
    found = search(delay)
    assert found.best == pytest.approx(delay, abs=0.2e-3)
    assert found.interval < 0.4e-3
    assert found.used == found.best
    assert found.joint_delays is None
    assert WORTHWHILE_GAIN < found.gain < 1.0
    assert "lags" in found.note
    assert not found.leads
    assert delay_checks(found) == []


@pytest.mark.parametrize("lead", [2e-3, 8e-3])
def test_a_torque_ahead_of_its_motion_is_suspicious_and_not_compensated(search, lead):
    found = search(-lead)
    assert found.best == pytest.approx(-lead, abs=0.2e-3)
    assert found.leads
    assert found.used == 0.0
    assert found.joint_delays is None
    assert "leads" in found.note
    (check,) = delay_checks(found)
    assert check.name == "torque-ahead"
    assert f"{-1e3 * found.best:.2f} ± {1e3 * found.interval:.2f} ms" in check.text


@pytest.mark.parametrize(
    ("delay", "settings", "error"),
    [
        (7.3e-3, {"noise": 0.0}, 10e-6),
        # A reversal happens somewhere between two samples, 5 ms apart: no search can know better than on average.
        (4e-3, {"smoothing": 0.0}, 0.5e-3),
        (4e-3, {"zero_phase": no_filter()}, 0.3e-3),
        (4e-3, {"zero_phase": butterworth(10.0, 200.0, factor=5)}, 0.3e-3),
        (4e-3, {"zero_phase": chebyshev_decimation(8)}, 0.3e-3),
    ],
    ids=["no noise", "dry friction jumps", "no filter", "decimated", "Chebyshev"],
)
def test_the_delay_is_found_within_its_error(search, delay, settings, error):
    assert search(delay, **settings).best == pytest.approx(delay, abs=error)


@pytest.mark.parametrize("seed", range(0, 12, 4))
def test_without_a_delay_none_is_used(search, seed):
    found = search(0.0, seed=seed)
    assert abs(found.best) < 0.25e-3
    assert found.used == 0.0
    assert "none used" in found.note
    assert abs(found.best) < 4 * found.std
    assert not found.drifts


@pytest.mark.parametrize("delay", [40e-3, 150e-3])
def test_a_delay_that_no_drive_has_is_found_and_named(search, delay):
    found = search(delay)
    assert found.used == found.best == pytest.approx(delay, abs=0.5e-3)
    (check,) = delay_checks(found)
    assert (check.name, check.joints) == ("torque-late", ())
    assert f"{1e3 * found.best:.2f} ± {1e3 * found.interval:.2f} ms" in check.text


def test_a_single_torque_that_is_late_is_named_with_its_joint(search):
    (check,) = delay_checks(search(2e-3, late={2: 20e-3}))
    assert (check.name, check.joints) == ("torque-late", ("j3",))


def test_a_delay_beyond_what_filters_have_is_not_used(search):
    found = search(3 * LONGEST_DELAY)
    assert found.used == 0.0


@pytest.mark.parametrize("level", [0.0, 7.0])
def test_a_constant_torque_shows_no_delay(three_joint, smooth_segment, level):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = smooth_segment(model, 600)
    segment = replace(segment, torque=np.full_like(segment.torque, level))
    found = search_delay(kernel, [segment], butterworth(10.0, 100.0))
    assert found.used == 0.0
    assert found.best is None
    assert "does not change" in found.note


def test_joints_whose_delays_differ_get_their_own(search):
    found = search(3e-3, late={2: 9e-3})
    first, second, third = found.joint_delays
    assert (first, second) == pytest.approx((3e-3, 3e-3), abs=0.4e-3)
    assert found.used in (first, second)
    assert third == pytest.approx(9e-3, abs=0.4e-3)
    assert f"j3 {third * 1e3:.2f} ms" in found.note
    assert [joint.joint for joint in found.joints] == ["j1", "j2", "j3"]


def test_a_single_late_joint_leaves_the_others_alone(search):
    found = search(0.0, late={1: 6e-3})
    first, second, third = (joint.used for joint in found.joints)
    assert second == pytest.approx(6e-3, abs=0.4e-3)
    assert max(abs(first), abs(third)) < 0.5e-3


def test_a_joint_that_leads_is_not_compensated(search):
    found = search(3e-3, late={0: -4e-3})
    assert found.joints[0].best == pytest.approx(-4e-3, abs=0.5e-3)
    assert all(joint.used >= 0.0 for joint in found.joints)


def test_clocks_that_drift_apart_are_named_with_their_factor(search):
    found = search(3e-3, drift=2e-4)
    assert found.drift == pytest.approx(2e-4, abs=0.2e-4)
    assert found.drifts
    (check,) = delay_checks(found)
    assert check.name == "clocks-drift"
    assert "by the factor 1.0002" in check.text


def test_joints_that_are_left_out_have_no_delay(three_joint, smooth_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    segment = smooth_segment(model, 4000, parameters=truth_vector(three_joint), delay=5e-3)
    segment = replace(segment, torque=segment.torque + 0.05 * np.random.default_rng(0).standard_normal((3, 4000)))
    found = search_delay(kernel, [segment], butterworth(10.0, 100.0), torques_of=[0, 1])
    assert found.best == pytest.approx(5e-3, abs=1e-3)
    assert found.joints[2].best is None


def test_a_handful_of_samples_is_too_little(three_joint, smooth_segment):
    model = build_model(three_joint)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    found = search_delay(kernel, [smooth_segment(model, 18)], no_filter())
    assert found.used == 0.0
    assert "too few samples" in found.note
