"""Heat: steady states and time constants of the two-mass model, and what heats it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daq.robot.loader import parse_robot
from daq.robot.schema import TruthThermal
from drivers.core.errors import RobotFileError
from sim_drivers.plant.friction import JointHeat
from sim_drivers.plant.plant import Plant, PlantSettings

THERMAL = TruthThermal(
    ambient=20.0, winding_capacity=100.0, housing_capacity=1000.0, winding_to_housing=4.0, housing_to_ambient=2.0
)


def test_steady_state_is_loss_over_conductance():
    heat = JointHeat(THERMAL, 2, 10.0)
    copper, friction = np.array([40.0, 0.0]), np.array([10.0, 30.0])
    for _ in range(1000):
        heat.advance(copper, friction)
    assert heat.housing == pytest.approx(20.0 + (copper + friction) / 2.0)
    assert heat.winding == pytest.approx(heat.housing + copper / 4.0)


def test_it_is_the_solution_of_its_differential_equations():
    heat = JointHeat(THERMAL, 1, 7.0)
    for _ in range(30):
        heat.advance(np.array([50.0]), np.array([20.0]))

    def slope(_, state):
        winding, housing = state
        across = 4.0 * (winding - housing)
        return [(50.0 - across) / 100.0, (20.0 + across - 2.0 * (housing - 20.0)) / 1000.0]

    exact = solve_ivp(slope, (0.0, 210.0), [20.0, 20.0], rtol=1e-10, atol=1e-10).y[:, -1]
    assert [heat.winding[0], heat.housing[0]] == pytest.approx(exact, abs=1e-6)


def test_holding_a_load_heats_the_winding(pendulum):
    robot_file = pendulum("coulomb: 0", thermal="copper_loss: {swing: 2.0}, winding_to_housing: 5.0")
    plant = Plant(robot_file, position=np.zeros(1))
    plant.advance(30.0)
    torque = 2 * 0.25 * 9.81
    expected = JointHeat(robot_file.robot.truth.thermal, 1, 30.0)
    expected.advance(np.array([2.0 * torque**2]), np.zeros(1))
    assert plant.thermal.winding == pytest.approx(expected.winding, abs=0.05)
    assert plant.thermal.winding > plant.thermal.housing + 5.0
    assert plant.measure().temperature == pytest.approx(plant.thermal.housing)


def test_rubbing_heats_the_housing(pendulum):
    robot_file = pendulum("viscous: 10", thermal="copper_loss: {swing: 0}, housing_capacity: 50")
    plant = Plant(robot_file, PlantSettings(controller="pid"), position=np.zeros(1))
    speed, seconds = 2.0, 5.0
    for sample in range(round(seconds * 500)):
        plant.set_target(np.array([speed * sample / 500]), np.array([speed]))
        plant.advance(0.002)
    expected = JointHeat(robot_file.robot.truth.thermal, 1, seconds)
    expected.advance(np.zeros(1), np.array([10.0 * speed**2]))
    assert plant.thermal.housing - 23.0 == pytest.approx(expected.housing - 23.0, rel=0.05)


def test_a_joint_can_be_heated_and_cools(pendulum):
    plant = Plant(pendulum(noise="temperature_resolution: 0.5"), PlantSettings(controller="none"))
    assert plant.measure().temperature == pytest.approx(23.0)
    plant.heat(0, 10.2)
    assert plant.measure().temperature == pytest.approx(33.0)
    hot = plant.thermal.housing[0]
    plant.advance(20.0)
    assert plant.thermal.housing < hot - 0.1


def test_the_robot_file_says_what_is_wrong(pendulum):
    with pytest.raises(RobotFileError, match=r"truth\.thermal\.copper_loss.*'elbow'"):
        pendulum(thermal="copper_loss: {elbow: 1}")
    with pytest.raises(RobotFileError) as caught:
        parse_robot(pendulum().text.replace("thermal: {", "thermal: {housing_capacity: 0"), where="cold", folder=None)
    assert "housing_capacity" in caught.value.where
