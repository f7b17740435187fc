"""Where a simulated arm stands at first."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from sim_drivers.served import SimOptions
from sim_drivers.serving import simulate, start_position


def test_a_position_is_a_number_for_each_joint() -> None:
    position = start_position(load_robot("ur5e"), "0.1,-1.5,1e-1,0,0,-0.25")
    np.testing.assert_array_equal(position, [0.1, -1.5, 0.1, 0.0, 0.0, -0.25])


@each(
    ("text", "said"),
    [
        ("", "is not a position"),
        ("0,0,0,0,0,x", "is not a position"),
        ("0,0,0,0,0", "5 numbers for 6 joints"),
        ("0,0,0,0,0,0,0", "7 numbers for 6 joints"),
        ("0,0,4,0,0,0", "4 of elbow_joint is not within"),
        ("nan,0,0,0,0,0", "nan of shoulder_pan_joint is not within"),
        ("0,0,0,0,0,-inf", "-inf of wrist_3_joint is not within"),
    ],
)
def test_what_is_no_position_is_refused_before_anything_is_served(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        simulate(SimOptions(robot="ur5e", wire="rtde", host="127.0.0.9", position=text), live=False)
