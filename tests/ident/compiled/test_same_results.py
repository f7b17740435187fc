"""The compiled kernels compute what NumPy and Pinocchio compute."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exported_arms import random_parameters
from loop_arms import four_bar_arm, spatial_arm, spherical_arm
from random_arms import random_arm

from daq.robot.loader import load_robot
from drivers.core.errors import ModelError
from ident.compiled.library import kernels
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.regressor import RegressorKernel, model_torque
from ident.simulation import time_stepping
from ident.simulation.forward_arm import ForwardArm

pytestmark = pytest.mark.skipif(kernels().quick is None, reason=f"compiled kernels: {kernels().said}")

NAMED = {
    "sr400": lambda: load_robot("sr400"),
    "up6": lambda: load_robot("up6"),
    "rocr6": lambda: load_robot("rocr6"),
    "four_bar": four_bar_arm,
    "spatial": spatial_arm,
    "spherical": spherical_arm,
} | {f"random {seed}": (lambda seed=seed: random_arm(seed, joints=seed)) for seed in range(1, 8)}


@pytest.fixture(scope="module")
def models():
    return {name: build_model(make()) for name, make in NAMED.items()}


def test_the_rows_are_numpys(models) -> None:
    generator = np.random.default_rng(0)
    for name, model in models.items():
        count = int(generator.integers(1, 40))
        states = random_states(model, count, int(generator.integers(1000)))
        every = range(len(model.parameters))
        kernel = RegressorKernel(model, [column for column in every if generator.random() < 0.8] or every)
        compiled, numpy = np.full((2, kernel.row_count, count), np.nan)
        kernel.evaluate(*states, compiled)
        frames = [frame.linear[:, :count].copy() for frame in kernel.frames]
        kernel._compiled = None
        kernel.evaluate(*states, numpy)
        scale = np.abs(numpy).max()
        assert np.abs(compiled - numpy).max() <= 1e-12 * scale, name
        assert all(np.array_equal(a, b.linear[:, :count]) for a, b in zip(frames, kernel.frames, strict=True)), name


def test_the_torques_are_numpys(models, monkeypatch) -> None:
    for name, model in models.items():
        values, motion = random_parameters(model), random_states(model, 21, 3)
        compiled = model_torque(model, None, values, *motion)
        with monkeypatch.context() as patch:
            patch.setattr("ident.model.regressor.compiled_torques", lambda *_: None)
            numpy = model_torque(model, None, values, *motion)
        assert np.abs(compiled - numpy).max() <= 1e-12 * np.abs(numpy).max(), name


def test_sine_and_cosine_of_any_angle() -> None:
    model = build_model(random_arm(0, joints=1, sliding=0.0))
    generator = np.random.default_rng(0)
    small = generator.uniform(-7.0, 7.0, 2000)
    angles = np.concatenate(
        [small, 10.0 ** np.abs(small) * np.sign(small), np.arange(-40, 40) * np.pi / 4, [0.0, -0.0]]
    )
    kernel, still = RegressorKernel(model), np.zeros((1, len(angles)))
    compiled, numpy = np.empty((2, kernel.row_count, len(angles)))
    kernel.evaluate(angles[None], still, still, compiled)
    kernel._compiled = None
    kernel.evaluate(angles[None], still, still, numpy)
    np.testing.assert_allclose(compiled, numpy, rtol=0, atol=1e-13 * np.abs(model.gravity).max())


def test_the_steps_are_pythons(models, monkeypatch) -> None:
    generator = np.random.default_rng(1)
    for name, plain in models.items():
        gradual = [p.name for p in plain.parameters if p.kind == "coulomb"][::2]  # presliding in every other joint
        model = replace(plain, presliding=tuple((name, 10.0 ** generator.uniform(-5, -2)) for name in gradual))
        base = base_parameters(model)
        arm = ForwardArm(InverseDynamics(model, base, base.projection @ random_parameters(model)))
        position, velocity = (part[:, 0] for part in random_states(model, 1, int(generator.integers(1000)))[:2])
        push = arm.bias(position, velocity) + generator.normal(size=model.dof)

        def motion(arm=arm, start=(0.5 * position, 0.5 * velocity), push=push):
            return time_stepping.integrate(arm, *start, lambda *_: push, 0.005, 5)

        with monkeypatch.context() as patch:
            patch.delattr(time_stepping._Stepping, "next")
            compiled = motion()
        with monkeypatch.context() as patch:
            patch.setattr(time_stepping, "compiled_stepping", lambda *_: None)
            python = motion()
        for ours, theirs in ((compiled.velocity, python.velocity), (compiled.position, python.position)):
            assert np.abs(ours - theirs).max() <= 1e-12 * max(1.0, np.abs(theirs).max()), name


def test_a_step_that_fails_says_why_in_python(models) -> None:
    model = models["four_bar"]
    base = base_parameters(model)
    arm = ForwardArm(InverseDynamics(model, base, base.projection @ random_parameters(model)))
    far = np.full(model.dof, 1e9)
    with pytest.raises(ModelError, match=r"at 0 s the loop|diverges at"):
        time_stepping.integrate(arm, np.zeros(model.dof), far, lambda *_: far, 0.01, 10)
