"""A motion that is played more slowly: the same path, smaller velocities."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq.motion.approach import TimeScaled
from daq.motion.limits import check_rest, motion_extremes
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest
from daq.robot.loader import load_robot
from drivers.core.errors import UsageError

POINTS = PointToPoint(np.array([[0.1, -0.1], [0.3, 0.1], [0.0, 0.0]]), np.array([0.8, 0.5]), dwell=0.1)
SERIES = RestToRest(FourierSeries(4.0, np.zeros(2), np.array([[0.3], [0.1]]), np.array([[0.0], [0.2]])), 2, 1.0)


@given(scale=st.floats(0.01, 1.0), motion=st.sampled_from([POINTS, SERIES]))
def test_the_path_stays_and_velocities_are_divided(scale, motion):
    slow, time = TimeScaled(motion, scale), np.linspace(0.0, motion.duration, 57)
    assert slow.duration == pytest.approx(motion.duration / scale)
    for power, (fast, scaled) in enumerate(zip(motion.evaluate(time), slow.evaluate(time / scale), strict=True)):
        np.testing.assert_allclose(scaled, fast * scale**power, atol=1e-9)
    fast, scaled = motion_extremes(motion), motion_extremes(slow)
    np.testing.assert_allclose(scaled.velocity, scale * fast.velocity, rtol=1e-4)
    np.testing.assert_allclose(scaled.acceleration, scale**2 * fast.acceleration, rtol=1e-3)
    check_rest(slow, load_robot("up6").robot.joints[:2], "slow")


@pytest.mark.parametrize("scale", [0.0, -0.5, 1.01, np.nan, np.inf])
def test_a_motion_is_never_played_faster(scale):
    with pytest.raises(UsageError, match="above 0 and at most 1"):
        TimeScaled(POINTS, scale)
