"""Friction: the papers' formula when sliding, a joint that neither creeps nor chatters at rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_drivers.plant.friction import FrictionParameters, SimulatedFriction
from sim_drivers.plant.plant import Plant, PlantSettings

FREE = PlantSettings(controller="none")
WEIGHT = 2 * 0.25 * 9.81
BETAS = "temperature: [20.0, -0.06, 1.0e+7]"


def parameters(**changes):
    values = {field: np.zeros(1) for field in ("coulomb", "viscous", "load", "offset", "stribeck")}
    values |= {"alpha": np.ones(1), "stribeck_velocity": np.full(1, 0.05), "pre_sliding": np.full(1, 5e-5)}
    values["temperature"] = np.zeros((3, 1))
    return FrictionParameters(**{**values, **{key: np.array(value) for key, value in changes.items()}})


def amount(limit):
    return st.floats(0.0, limit)


@settings(max_examples=60, deadline=None)
def sliding_friction(truth, velocity, celsius, load_torque):
    """Friction torque (n,) [N·m] of joints that slide, term by term (AUBO eq. 3-6)."""
    speed = np.abs(velocity)
    beta1, beta2, beta3 = truth.temperature
    kelvin = celsius + 273.15
    dry = truth.coulomb + truth.stribeck * np.exp(-((speed / truth.stribeck_velocity) ** 2))
    wet = truth.viscous * speed**truth.alpha + np.sqrt(speed) * (beta1 + beta2 * kelvin + beta3 / kelvin**3)
    return np.sign(velocity) * (dry + truth.load * load_torque**2 + np.maximum(wet, 0.0)) + truth.offset


@given(
    coulomb=amount(10), viscous=amount(10), alpha=st.floats(0.3, 2.0), beta=st.floats(-5, 5),
    beta2=st.floats(-0.1, 0.1), load=amount(0.1), offset=st.floats(-2, 2), stribeck=amount(3),
    velocity=st.floats(0.05, 3.0), negative=st.booleans(), celsius=st.floats(-20, 90), load_torque=st.floats(-50, 50),
)  # fmt: skip
def test_a_sliding_joint_has_the_papers_friction(
    coulomb, viscous, alpha, beta, beta2, load, offset, stribeck, velocity, negative, celsius, load_torque
):
    truth = parameters(
        coulomb=[coulomb], viscous=[viscous], alpha=[alpha], load=[load], offset=[offset], stribeck=[stribeck],
        temperature=[[beta], [beta2], [1e6]],
    )  # fmt: skip
    friction = SimulatedFriction(truth, np.full(1, 1e5), np.full(1, 300.0))
    conditions = np.array([celsius]), np.array([load_torque])
    friction.set_conditions(*conditions)
    speed = np.array([-velocity if negative else velocity])
    for _ in range(400):
        torque = friction.torque(speed, speed * 0.05)
    assert torque == pytest.approx(sliding_friction(truth, speed, *conditions), rel=1e-9, abs=1e-9)


def test_the_terms_are_those_of_equations_4_to_6():
    truth = parameters(
        coulomb=[2.0], viscous=[3.0], alpha=[0.5], load=[0.01], offset=[0.4], temperature=[[5.0], [-0.01], [2e7]]
    )
    friction = SimulatedFriction(truth, np.full(1, 1e5), np.full(1, 300.0))
    # T = 300 K: β1 + β2·T + β3·T⁻³ = 5 − 3 + 20/27.
    friction.set_conditions(np.array([300.0 - 273.15]), np.array([10.0]))
    for sign in (1.0, -1.0):
        speed = np.array([sign * 0.49])
        for _ in range(400):
            torque = friction.torque(speed, speed * 0.05)
        expected = sign * (2.0 + 3.0 * 0.7 + 0.7 * (2.0 + 20.0 / 27.0) + 0.01 * 100.0) + 0.4
        assert torque == pytest.approx(expected)


@pytest.mark.parametrize("extra", ["", ", stribeck: 1.5", ", viscous: 2", ", alpha: 0.5, viscous: 2"])
def test_a_joint_at_rest_holds_its_load_without_creep(pendulum, extra):
    plant = Plant(pendulum(f"coulomb: 6{extra}"), FREE, position=np.zeros(1))
    plant.advance(1.0)
    settled = plant.position[0]
    plant.advance(5.0)
    assert abs(settled) < 1e-4
    assert abs(plant.position[0] - settled) < 1e-9
    assert abs(plant.velocity[0]) < 1e-9
    assert plant.friction_torque == pytest.approx(-WEIGHT, abs=1e-6)


def test_a_joint_with_too_little_friction_falls(pendulum):
    plant = Plant(pendulum("coulomb: 4"), FREE, position=np.zeros(1))
    plant.advance(0.5)
    # (weight − Coulomb)/inertia, less the gravity that the fall takes away; inertia 0.3 + 0.01 + 2·0.25².
    assert plant.position[0] == pytest.approx(-0.5 * (WEIGHT - 4) / 0.435 * 0.25, rel=0.05)
    assert plant.velocity[0] < -0.5


def test_static_friction_above_coulomb_delays_the_break_away(pendulum):
    held = Plant(pendulum("coulomb: 4, stribeck: 1.5"), FREE, position=np.zeros(1))
    held.advance(2.0)
    assert abs(held.position[0]) < 1e-3


def test_it_does_not_chatter_when_it_comes_to_rest(pendulum):
    plant = Plant(pendulum("coulomb: 5.5, viscous: 0.5"), FREE, position=np.array([0.5]))
    plant.velocity = np.array([1.0])
    velocities = []
    for _ in range(2000):
        plant.advance(0.001)
        velocities.append(plant.velocity[0])
    turns = np.flatnonzero(np.diff(np.sign(velocities)))
    assert np.max(np.abs(velocities[1500:])) < 1e-8
    # The last swing on the bristle dies out within a few reversals of micrometres.
    assert np.max(np.abs(np.array(velocities)[turns[0] :])) < 0.05


def test_stiff_viscous_friction_of_a_light_joint_is_stable(pendulum):
    robot_file = pendulum("viscous: 900, coulomb: 5")
    plant = Plant(robot_file, FREE, position=np.array([0.0]))
    plant.velocity = np.array([2.0])
    plant.advance(0.5)
    assert abs(plant.velocity[0]) < 1e-3
    assert np.isfinite(plant.acceleration).all()


def constant_speed_torque(plant, speed=0.8, seconds=1.5):
    """Mean drive torque against friction: forwards and backwards over the same place, gravity cancels."""
    means = []
    for direction in (1.0, -1.0):
        start = plant.position.copy()
        seen = []
        for sample in range(round(seconds * 500)):
            plant.set_target(start + direction * speed * sample / 500, np.array([direction * speed]))
            plant.advance(0.002)
            if sample > 0.3 * seconds * 500:
                seen.append(plant.friction_torque[0])
        means.append(np.mean(seen))
    return 0.5 * (means[0] - means[1])


def test_a_warmer_joint_rubs_less_as_its_betas_say(pendulum):
    robot_file = pendulum(f"coulomb: 2, viscous: 3, {BETAS}", thermal="copper_loss: {swing: 0}")
    cold, warm = Plant(robot_file, position=np.zeros(1)), Plant(robot_file, position=np.zeros(1))
    warm.heat(0, 25.0)
    difference = constant_speed_torque(cold) - constant_speed_torque(warm)
    kelvin = 23.0 + 273.15
    expected = np.sqrt(0.8) * (0.06 * 25.0 + 1e7 * (kelvin**-3 - (kelvin + 25.0) ** -3))
    assert difference == pytest.approx(expected, rel=0.05)
    assert expected > 1.0


def test_load_adds_friction_where_gravity_pulls(pendulum):
    # Horizontal (full weight) and hanging (none), the same speed.
    speeds = []
    for position in (0.0, -np.pi / 2):
        plant = Plant(pendulum("coulomb: 1, load: 0.1"), position=np.array([position]))
        for sample in range(200):
            plant.set_target(np.array([position - 0.04 + 0.2 * sample / 500]), np.array([0.2]))
            plant.advance(0.002)
            if sample == 101:
                speeds.append(plant.friction_torque[0])
    assert speeds[0] == pytest.approx(1.0 + 0.1 * WEIGHT**2, rel=0.02)
    assert speeds[1] == pytest.approx(1.0, rel=0.02)
