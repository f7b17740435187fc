"""The way to the start pose: straight where that passes the check, else some joints first; refused where none does."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.motion import motion_check
from daq.motion.approach import TimeScaled, approaches, checked_approach
from daq.motion.limits import check_rest, motion_extremes
from daq.motion.motion_check import load_motion_check
from daq.motion.trajectories import FourierSeries, PointToPoint, RestToRest
from daq.robot.loader import load_robot
from drivers.core.errors import MotionRefusedError, UsageError

ROBOT = load_robot("up6").robot
HERE, START = np.array([0.2, -0.5, 1.0]), np.array([-1.0, 1.2, 0.1])


class Passes:
    """A check that looks at positions only."""

    def __init__(self, allowed):
        self.allowed = allowed
        self.asked = 0

    def approach(self, motion):
        self.asked += 1
        position, _, _ = motion.evaluate(np.linspace(0.0, motion.duration, 400))
        if not all(self.allowed(q) for q in position.T):
            raise MotionRefusedError("too near", where="the approach to the start pose")
        return "figures"


def test_every_way_leads_there_slowly_and_no_two_are_the_same():
    ways = list(approaches(HERE, START, ROBOT.joints))
    assert len(ways) == 1 + 3 + 3
    for way in ways:
        ends, _, _ = way.evaluate(np.array([0.0, way.duration]))
        np.testing.assert_allclose(ends.T, [HERE, START], atol=1e-12)
        check_rest(way, ROBOT.joints, "way")
        limits = np.array([joint.velocity for joint in ROBOT.joints])
        assert np.all(motion_extremes(way).velocity <= 0.1 * limits * (1 + 1e-9))
    middles = [tuple(way.evaluate(np.array([0.5 * way.duration]))[0][:, 0].round(6)) for way in ways]
    assert len(set(middles)) == len(ways)


def test_a_joint_that_is_there_already_is_not_moved_apart():
    assert len(list(approaches(HERE, HERE, ROBOT.joints))) == 1
    assert len(list(approaches(HERE, np.array([0.2, 0.5, 1.0]), ROBOT.joints))) == 1


def test_the_straight_way_is_taken_where_it_is_free():
    check = Passes(lambda q: True)
    way, figures = checked_approach(HERE, START, ROBOT.joints, check)
    assert (check.asked, figures, len(way.points)) == (1, "figures", 2)


def test_a_way_around_is_found():
    # The second joint must be up before the first one turns.
    way, _ = checked_approach(HERE, START, ROBOT.joints, Passes(lambda q: q[1] > 1.0 or q[0] > 0.1))
    assert len(way.points) == 3
    assert all(np.any(before != after) for before, after in pairwise(way.points))


def test_where_none_is_free_the_straight_one_is_refused_with_what_to_do():
    with pytest.raises(MotionRefusedError, match=r"approach to the start pose: too near \(move the arm nearer"):
        checked_approach(HERE, START, ROBOT.joints, Passes(lambda q: q[0] > 0.0))


def test_a_position_beyond_the_limits_is_refused():
    with pytest.raises(MotionRefusedError, match="joint S: position"):
        checked_approach(np.array([3.5, 0.0, 0.0]), START, ROBOT.joints, Passes(lambda q: True))


@pytest.mark.parametrize(("installed", "found"), [([], "none"), (["a:A", "b:B"], "a:A, b:B")])
def test_without_exactly_one_check_no_motion_is_played(monkeypatch, installed, found):
    entries = [SimpleNamespace(value=value) for value in installed]
    monkeypatch.setattr(motion_check, "entry_points", lambda group: entries)
    with pytest.raises(MotionRefusedError, match=f"found: {found}"):
        load_motion_check(load_robot("up6"))


def test_the_installed_check_is_that_of_the_arms_geometry():
    assert type(load_motion_check(load_robot("up6"))).__name__ == "ArmMotionCheck"


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


@each("scale", [0.0, -0.5, 1.01, np.nan, np.inf])
def test_a_motion_is_never_played_faster(scale):
    with pytest.raises(UsageError, match="above 0 and at most 1"):
        TimeScaled(POINTS, scale)
