"""Ready-made excitations keep the limits between their grid points, too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_kinds import ARM_KINDS
from each import each

from daq.robot.loader import load_robot
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, motion_factor
from sim_drivers.synthetic.measurement import LIMIT_SHARE, random_fourier_motion

DENSE = 4000  # points a period, ten times what the motion was scaled on


@each("name", ARM_KINDS)
@each("period", [3.0, 20.0])
def test_limits_hold_on_a_dense_grid(name, period):
    model = build_model(load_robot(name))
    motion = random_fourier_motion(model, period, seed=1, candidates=2)
    position, velocity, acceleration = motion.evaluate(np.linspace(0.0, period, DENSE))
    for joint, limits in enumerate(model.limits):
        low, high = limits.position
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        assert np.max(np.abs(position[joint] - middle)) <= LIMIT_SHARE * half * 1.001
        assert np.max(np.abs(velocity[joint])) <= LIMIT_SHARE * limits.velocity * 1.001
        assert np.max(np.abs(acceleration[joint])) <= LIMIT_SHARE * limits.acceleration * 1.001


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_every_joint_reaches_one_of_its_limits(name):
    model = build_model(load_robot(name))
    motion = random_fourier_motion(model, 10.0, seed=3, candidates=2)
    position, velocity, acceleration = motion.evaluate(np.linspace(0.0, 10.0, DENSE))
    for joint, limits in enumerate(model.limits):
        used = max(
            np.ptp(position[joint]) / (limits.position[1] - limits.position[0]),
            np.ptp(position[joint]) / (2 * np.pi),
            np.max(np.abs(velocity[joint])) / limits.velocity,
            np.max(np.abs(acceleration[joint])) / limits.acceleration,
        )
        assert used == pytest.approx(LIMIT_SHARE, rel=2e-3)


def test_the_seed_decides():
    model = build_model(load_robot("ur5e"))
    one, same, other = (random_fourier_motion(model, 10.0, seed, candidates=3) for seed in (1, 1, 2))
    assert np.array_equal(one.sine, same.sine)
    assert np.array_equal(one.cosine, same.cosine)
    assert not np.array_equal(one.sine, other.sine)


def test_more_candidates_are_never_worse():
    model = build_model(load_robot("ur5e"))
    kernel = RegressorKernel(model, base_parameters(model).columns)
    time = np.linspace(0.0, 10.0, 400, endpoint=False)
    conditions = [
        scaled_condition(motion_factor(kernel, *random_fourier_motion(model, 10.0, 1, count).evaluate(time)))
        for count in (1, 5, 20)
    ]
    assert conditions == sorted(conditions, reverse=True)
    assert conditions[-1] < conditions[0]


def test_a_narrow_joint_stays_in_its_range():
    model = build_model(load_robot("ur5e"))
    narrow = model.limits[2].model_copy(update={"position": (1.0, 1.2)})
    model = replace(model, limits=(*model.limits[:2], narrow, *model.limits[3:]))
    position, _, _ = random_fourier_motion(model, 10.0, seed=1, candidates=2).evaluate(np.linspace(0.0, 10.0, DENSE))
    assert 1.0 < position[2].min() < position[2].max() < 1.2


def test_no_candidates_is_a_programming_error():
    with pytest.raises(ValueError, match="candidates"):
        random_fourier_motion(build_model(load_robot("ur5e")), 10.0, seed=1, candidates=0)
