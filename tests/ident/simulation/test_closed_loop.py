"""The simulated position loop follows a reference, and not what is above its bandwidth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.simulation.closed_loop import simulated_segment


@pytest.fixture(scope="module")
def inverse(three_joint):
    model = build_model(three_joint)
    base = base_parameters(model)
    return InverseDynamics(model, base, base.projection @ truth_vector(three_joint))


def test_the_motion_is_followed_and_noise_is_not(inverse, smooth_segment):
    reference = smooth_segment(inverse.model, 1000, rate=200.0)
    followed = simulated_segment(inverse, reference, 60.0)
    assert np.max(np.abs(followed.position - reference.position)) < 0.01
    size = np.linalg.norm(reference.acceleration)
    assert np.linalg.norm(followed.acceleration - reference.acceleration) < 0.1 * size
    wobble = 0.01 * np.sin(2 * np.pi * 50.0 * reference.time)
    noisy = replace(reference, position=reference.position + wobble)
    other = simulated_segment(inverse, noisy, 20.0)
    assert np.std(other.position - simulated_segment(inverse, reference, 20.0).position) < 0.1 * np.std(wobble)


def test_other_parameters_hardly_change_the_motion(inverse, smooth_segment):
    """Gains follow the model: what makes Gauss-Newton of DIDIM least squares."""
    reference = smooth_segment(inverse.model, 400, rate=200.0)
    doubled = InverseDynamics(inverse.model, inverse.base, 2.0 * inverse.parameters)
    first, second = (simulated_segment(arm, reference, 60.0) for arm in (inverse, doubled))
    assert np.max(np.abs(first.position - second.position)) < 1e-6
