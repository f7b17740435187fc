"""The motion error of a simulated arm beside a recorded motion."""

from __future__ import annotations

import numpy as np
import pytest
from true_results import true_result

import dynid
from daq.robot.loader import load_robot
from drivers.core.errors import ModelError
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.result.result_file import stored_model
from ident.signals.prepared import Segment
from ident.simulation.tracking import LONGEST, NATURAL_FREQUENCY, tracking_error

pytestmark = pytest.mark.usefixtures("whole_simulations")


def inverse_of(name: str, **changes: float) -> InverseDynamics:
    """The true arm, some base parameters changed."""
    result = true_result(load_robot(name), changes)
    stored = stored_model(result)
    values = {parameter.name: parameter.value for parameter in result.base_parameters}
    return InverseDynamics(stored.model, stored.base, np.array([values[name] for name in stored.base.names]))


def segment_of(name: str, duration: float) -> Segment:
    """A sine of every joint with the torque that it takes, without noise."""
    rate, inverse = 250.0, inverse_of(name)
    time = np.arange(0.0, duration, 1.0 / rate)
    frequency = np.linspace(1.0, 2.0, inverse.model.dof)[:, None]
    position, velocity, acceleration = (
        0.4 * frequency**power * signal(frequency * time)
        for power, signal in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
    )
    torque = np.linalg.solve(inverse.coupling.T, inverse.torque(position, velocity, acceleration))
    return Segment(time, position, velocity, acceleration, torque, rate, np.ones(len(time), dtype=bool))


@pytest.mark.parametrize("name", ["ur5e", "panda", "up6"])
def test_the_true_arm_follows_its_own_motion(name):
    error = tracking_error(inverse_of(name), segment_of(name, 3.0))
    assert error.duration == pytest.approx(3.0 - 1 / 250)
    assert max(error.position_rmse) < 1e-3
    assert np.all(np.array(error.max_position_error) >= error.position_rmse)


def test_a_torque_error_moves_a_joint_as_far_as_the_controllers_stiffness_says():
    segment = segment_of("ur5e", 4.0)
    still = Segment(
        segment.time,
        0 * segment.position,
        0 * segment.position,
        0 * segment.position,
        segment.torque,
        segment.rate,
        segment.used,
    )
    arm = inverse_of("ur5e")
    friction = {name: 0.0 for name in arm.base.names if name.startswith("Fs")}
    arm = inverse_of("ur5e", **friction)
    zero = np.zeros((6, 1))
    missing = np.array([3.0, -4.0, 2.0, 0.5, 0.5, 0.2])[:, None]
    holding = np.tile(arm.torque(zero, zero, zero) + missing, len(segment.time))
    error = tracking_error(arm, Segment(**{**vars(still), "torque": holding}))
    expected = np.abs(missing[:, 0]) / (NATURAL_FREQUENCY**2 * np.diagonal(arm.inertia(zero)[0]))
    np.testing.assert_allclose(error.max_position_error, expected, rtol=0.2)


def test_only_the_beginning_of_a_long_motion_is_simulated():
    assert tracking_error(inverse_of("up6"), segment_of("up6", 2 * LONGEST)).duration == LONGEST


def test_a_model_that_cannot_be_simulated_says_so():
    with pytest.raises(ModelError, match="negative Coulomb friction"):
        tracking_error(inverse_of("ur5e", Fs1=-1.0), segment_of("ur5e", 1.0))


def test_identify_reports_the_motion_error_beside_the_torque_error():
    run, other = (dynid.simulate("up6", duration=10.0, seed=seed, rate=100.0) for seed in (1, 2))
    result = dynid.identify(run, validation=other)
    simulation = result.result.consistent.simulation
    assert 5.0 < simulation.duration <= LONGEST
    assert simulation.natural_frequency == NATURAL_FREQUENCY
    assert len(simulation.position_rmse) == len(result.result.joints)
    assert 0.0 < max(simulation.position_rmse) < 0.01
    assert all(
        largest >= rmse for largest, rmse in zip(simulation.max_position_error, simulation.position_rmse, strict=True)
    )
