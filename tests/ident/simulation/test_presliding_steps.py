"""Presliding in a simulated motion: the states of prediction, dissipation, and Coulomb's law for a short travel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from true_results import true_result

import dynid
from daq.robot.loader import load_robot, parse_robot
from ident.model.base_parameters import base_parameters
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.presliding import dahl_states
from ident.model.true_parameters import true_model, truth_vector
from ident.result.schema import Presliding, PreslidingTravel
from ident.simulation import time_stepping
from ident.simulation.forward_arm import ForwardArm

MASS, COULOMB = 2.0, 3.0
SLIDE = parse_robot(
    f"""\
name: slide
model: {{mdh: [{{joint: slide, type: prismatic, alpha: pi/2, d: 0, r: 0}}]}}
joints: [{{name: slide, position: [-9, 9], velocity: 9, acceleration: 9, torque: 99}}]
drives: [{{joint: slide, gain: 1, signal: torque, inertia: false}}]
truth:
  links: {{slide: {{mass: {MASS}, com: [0, 0, 0], inertia: [0.01, 0, 0, 0.01, 0, 0.01]}}}}
  joints: {{slide: {{coulomb: {COULOMB}}}}}
""",
    where="slide.yaml",
    folder=None,
)


def moved(travel: float, step: float, force, speed: float = 0.5, duration: float = 2.0) -> time_stepping.SteppedMotion:
    """A block on a level slide whose friction has a travel [m]; 0 for none."""
    model = replace(true_model(SLIDE), presliding=(("Fs1", travel),) if travel else ())
    base = base_parameters(model)
    arm = ForwardArm(InverseDynamics(model, base, base.projection @ truth_vector(SLIDE, model)))
    steps = round(duration / step)
    return time_stepping.integrate(
        arm, np.zeros(1), np.array([speed]), lambda t, *_: np.array([force(t)]), steps * step, steps
    )


@given(
    travel=st.floats(1e-4, 3e-2),
    step=st.sampled_from([1e-3, 4e-3]),
    size=st.floats(0.5, 4.0),
    turns=st.floats(0.5, 4.0),
)
def test_the_state_is_that_of_prediction(travel: float, step: float, size: float, turns: float) -> None:
    motion = moved(travel, step, lambda t: size * COULOMB * np.cos(2 * np.pi * turns * t), duration=1.0)
    (state,) = dahl_states(motion.velocity[:, 0], 1.0 / step, [travel])
    accelerating = MASS * np.diff(motion.velocity[:, 0]) / step
    assert accelerating + COULOMB * state[1:] == pytest.approx(motion.torque[:-1, 0], abs=1e-4 * COULOMB)


@given(travel=st.floats(1e-6, 0.1), step=st.sampled_from([1e-3, 4e-3, 2e-2]), speed=st.floats(0.1, 3.0))
def test_friction_dissipates_whatever_the_step(travel: float, step: float, speed: float) -> None:
    """A block that is let go never has more energy than at first and what its contacts can give back."""
    motion = moved(travel, step, lambda t: 0.0, speed)
    kinetic = 0.5 * MASS * motion.velocity[:, 0] ** 2
    # From z = 1 back to z = 0 over δ·ln 2, once the block has stopped.
    given_back = COULOMB * travel * (1.0 - np.log(2.0))
    stopped = np.flatnonzero(motion.velocity[:, 0] <= 0.0)
    assert np.all(np.diff(kinetic[: stopped[0]] if len(stopped) else kinetic) <= 0.0)
    assert np.all(kinetic[stopped[0] :] <= 1.001 * given_back) if len(stopped) else travel > 0.02


def test_a_short_travel_is_coulombs_friction() -> None:
    def distance(travel: float) -> float:
        motion, plain = (moved(value, 1e-3, lambda t: 8.0 * np.sin(5.0 * t)) for value in (travel, 0.0))
        return float(np.abs(motion.position - plain.position).max())

    far, near, nearest = distance(1e-3), distance(1e-5), distance(1e-7)
    assert far > 1e-2  # breaking away takes longer
    assert near < 0.1 * far
    assert nearest < 1e-4


def test_the_torque_that_moves_an_arm_is_the_one_predicted() -> None:
    """Prediction along the simulated motion, presliding included, gives back the torque that drove it."""
    result = true_result(load_robot("ur5e"))
    names = [entry.name for entry in result.base_parameters if entry.kind == "coulomb"]
    travels = [PreslidingTravel(parameter=name, travel=4e-3, std=1e-4) for name in names]
    result = result.model_copy(update={"presliding": Presliding(travels=travels, static_error=0.1, error=0.05)})
    model = dynid.Model(result, "full")
    gains = 400.0 * np.diag(model.mass_matrix(np.zeros(6)))

    def follow(t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return model.gravity(q) + gains * (0.2 * np.sin(8.0 * t + np.arange(6)) - q) - 0.1 * gains * dq

    motion = model.simulate(np.zeros(6), np.full(6, 0.5), follow, 1.0)
    rate = 1.0 / (motion.time[1] - motion.time[0])
    change = np.gradient(motion.velocity, motion.time, axis=0)
    static = model.torque(motion.position, motion.velocity, change)
    gradual = static + model.presliding_torque(motion.position, motion.velocity, rate)
    applied = motion.torque.copy()
    applied[1:] = 0.5 * (motion.torque[1:] + motion.torque[:-1])  # of the steps before and after a sample
    errors = [np.sqrt(np.mean((torque - applied)[2:-2] ** 2)) for torque in (static, gradual)]
    assert np.any(np.diff(np.sign(motion.velocity), axis=0) != 0, axis=0).all()  # every joint reverses
    assert errors[1] < 0.05 * errors[0]
