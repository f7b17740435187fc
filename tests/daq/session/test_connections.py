"""What drivers are told about a robot, and whose connection an error about keys is of."""

from __future__ import annotations

import numpy as np
import pytest

from daq.robot.loader import load_robot
from daq.session.connections import driver_settings
from daq.session.session import load_driver
from drivers.core.errors import UsageError


def test_an_error_about_keys_says_which_connection_of_which_robot() -> None:
    robot = load_robot("ur5e").robot
    wrong = robot.connections["rtde"].model_copy(update={"rate": "fast"})
    changed = robot.model_copy(update={"connections": {"rtde": wrong}})
    with pytest.raises(UsageError, match="key 'rate' of the RTDE connection is 'fast'") as caught:
        load_driver(changed)
    assert caught.value.where == "ur5e: connections.rtde"


def test_drivers_are_told_the_coupling_of_the_motors() -> None:
    assert driver_settings(load_robot("ur5e").robot, {}).coupling is None
    coupling = np.eye(6)
    coupling[4, 3] = 1.0  # q_m6 = q_6 + q_5; j3 and j8 are passive
    told = driver_settings(load_robot("sr400").robot, {}).coupling
    assert told is not None
    assert np.array_equal(told, coupling)
