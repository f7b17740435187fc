"""Families of excitation motions: paths, their derivatives, random members, files, and the way back from a motion."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from each import each

from daq.motion.limits import check_limits
from daq.motion.trajectories import RestToRest
from daq.motion.trajectory_file import dump_trajectory, parse_trajectory
from daq.robot.loader import load_robot
from daq.robot.schema import JointLimits
from drivers.core.errors import UsageError
from ident.excite.families.fourier import FourierFamily, FourierQuinticFamily
from ident.excite.families.moving_joints import MovingJoints
from ident.excite.families.points import PointsFamily
from ident.excite.families.sines import SinesFamily
from ident.excite.path import trajectory_of

ROBOT = load_robot("ur5e").robot
LIMITS = ROBOT.joints
MOVING = (0, 1, 2, 4, 5)
REST = np.array([0.0, -1.0, 0.5, 0.7, -0.3, 0.0])
JOINTS = MovingJoints(LIMITS, MOVING, REST)
FAMILIES = {
    "fourier": FourierFamily(JOINTS, 8.0, 4, 2, 1.5),
    "fourier-quintic": FourierQuinticFamily(JOINTS, 8.0, 4, 2),
    "sines": SinesFamily(JOINTS, 9.0, 3, 1.5),
    "points": PointsFamily(JOINTS, 12.0, 7),
    "points-dwell": PointsFamily(JOINTS, 12.0, 7, 0.3),
}
UNLIMITED = tuple(
    SimpleNamespace(name=f"j{number}", position=position, velocity=velocity, acceleration=acceleration)
    for number, (position, velocity, acceleration) in enumerate(
        [((-np.inf, np.inf), 2.0, np.inf), ((-np.inf, 5.0), np.inf, 3.0), ((-1.0, np.inf), np.inf, np.inf)]
    )
)


@pytest.fixture(params=FAMILIES)
def family(request):
    return FAMILIES[request.param]


def random_of(family, seed=0):
    return family.random(np.random.default_rng(seed))


def stacked(path):
    return np.stack([path.position, path.velocity, path.acceleration])


def test_pull_back_is_the_derivative_of_weighted_sums(family):
    generator = np.random.default_rng(1)
    variables = random_of(family) + generator.normal(scale=0.05, size=family.size)
    time = family.grid(61)
    weights = generator.normal(size=(2, 4, 3, len(LIMITS), time.size))
    found = family.pull_back(variables, time, weights)
    assert found.shape == (2, 4, family.size)

    def sums(x):
        return np.einsum("abcjt,cjt->ab", weights, stacked(family.path(x, time)))

    step = 1e-6
    expected = np.stack(
        [(sums(variables + step * one) - sums(variables - step * one)) / (2 * step) for one in np.eye(family.size)],
        axis=-1,
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    alone = family.pull_back(variables, time, weights[0, 1])
    np.testing.assert_allclose(alone, found[0, 1], rtol=1e-12, atol=1e-12 * np.abs(found).max())


def test_the_path_is_the_motion_at_full_pace(family):
    variables = random_of(family)
    motion = family.motion(variables)
    late = motion.ramp if isinstance(motion, RestToRest) else 0.0
    length = motion.motion.duration if late else motion.duration / getattr(motion, "periods", 1)
    time = np.linspace(0.0, length, 333)
    path = family.path(variables, time)
    for ours, played in zip(stacked(path), motion.evaluate(time + late), strict=True):
        np.testing.assert_allclose(ours, played, atol=1e-9)


def test_the_grid_covers_what_is_played(family):
    variables = random_of(family)
    time = family.grid(4000)
    assert 0.5 * 4000 < time.size < 2 * 4000
    motion = family.motion(variables)
    played, *_ = motion.evaluate(np.linspace(0.0, motion.duration, 5000))
    planned = family.path(variables, time).position
    assert np.all(played.min(axis=1) > planned.min(axis=1) - 1e-3)
    assert np.all(played.max(axis=1) < planned.max(axis=1) + 1e-3)


def test_motions_begin_and_end_at_rest(family):
    motion = family.motion(random_of(family))
    position, velocity, acceleration = motion.evaluate(np.array([0.0, motion.duration]))
    np.testing.assert_allclose(velocity, 0.0, atol=1e-10)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-9)
    if not isinstance(family, SinesFamily | PointsFamily | FourierFamily):
        np.testing.assert_allclose(position[:, 0], position[:, 1], atol=1e-12)


def test_encoding_is_the_way_back(family):
    variables = random_of(family, 3)
    np.testing.assert_allclose(family.encode(family.motion(variables)), variables, rtol=1e-9, atol=1e-9)


def test_random_members_keep_the_limits_and_use_them(family):
    paths = [family.path(random_of(family, seed), family.grid(400)) for seed in range(20)]
    for (seed, path), joint in itertools.product(enumerate(paths), MOVING):
        limit = LIMITS[joint]
        low, high = limit.position
        uses = (
            np.ptp(path.position[joint]) / min(high - low, 2 * np.pi),
            np.abs(path.velocity[joint]).max() / limit.velocity,
            np.abs(path.acceleration[joint]).max() / limit.acceleration,
        )
        assert low < path.position[joint].min(), seed
        assert path.position[joint].max() < high, seed
        assert 0.49 < max(uses) < 0.96, seed


def test_the_file_holds_the_same_motion(family):
    variables = random_of(family, 5)
    text = dump_trajectory(trajectory_of(family.motion(variables), "ur5e", "a comment"))
    motion = family.motion(variables)
    if not isinstance(motion, RestToRest):  # ramps may pass limits that full pace keeps; the design lengthens them
        check_limits(motion, LIMITS, "here")
    relaxed = ROBOT.model_copy(
        update={"joints": tuple(joint.model_copy(update={"acceleration": 1e3, "velocity": 1e3}) for joint in LIMITS)}
    )
    read = parse_trajectory(text, relaxed, where="there", folder=None)
    assert read.trajectory.comment == "a comment"
    time = np.linspace(0.0, motion.duration, 500)
    for ours, theirs in zip(motion.evaluate(time), read.motion.evaluate(time), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_allclose(family.encode(read.motion), variables, rtol=1e-9, atol=1e-9)


def test_a_joint_that_does_not_move_stays(family):
    path = family.path(random_of(family), family.grid(50))
    np.testing.assert_array_equal(path.position[3], REST[3])
    assert not path.velocity[3].any()
    assert not path.acceleration[3].any()


def test_a_longer_ramp_leaves_the_variables_their_meaning(family):
    longer, variables = family.with_longer_ramp(1.5), random_of(family)
    time = np.linspace(0.0, 7.0, 99)
    np.testing.assert_array_equal(longer.path(variables, time).position, family.path(variables, time).position)
    assert longer.motion(variables).duration == family.motion(variables).duration + 2 * 0.5 * getattr(family, "ramp", 0)


@each(
    "build",
    [
        lambda limits: FourierFamily(MovingJoints(limits, (0, 1, 2), np.zeros(3)), 5.0, 3, 1, 1.0),
        lambda limits: FourierQuinticFamily(MovingJoints(limits, (0, 1, 2), np.zeros(3)), 5.0, 3, 1),
        lambda limits: SinesFamily(MovingJoints(limits, (0, 1, 2), np.zeros(3)), 5.0, 3, 1.0),
        lambda limits: PointsFamily(MovingJoints(limits, (0, 1, 2), np.zeros(3)), 5.0, 6),
    ],
)
def test_infinite_limits_leave_finite_motions(build):
    family = build(UNLIMITED)
    variables = random_of(family)
    assert np.abs(variables).max() < 10
    path = family.path(variables, family.grid(300))
    assert np.all(np.isfinite(stacked(path)))
    assert np.all(np.ptp(path.position, axis=1) <= 2 * np.pi)
    for rows, limit in zip(stacked(path).swapaxes(0, 1), UNLIMITED, strict=True):
        low, high = limit.position
        assert low < rows[0].min()
        assert rows[0].max() < high
        assert np.abs(rows[1]).max() < limit.velocity
        assert np.abs(rows[2]).max() < limit.acceleration


@each("kind", ["fourier", "fourier-quintic", "sines"])
def test_what_an_earlier_motion_lacks_is_zero(kind):
    family = FAMILIES[kind]
    fewer = (
        replace(family, sines=2, band=(0.5, 2.0)) if kind == "sines" else replace(family, harmonics=2)  # both in band
    )
    motion = fewer.motion(random_of(fewer, 7))
    again = family.motion(family.encode(motion))
    time = np.linspace(0.0, motion.duration, 300)
    for one, other in zip(motion.evaluate(time), again.evaluate(time), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)
    with pytest.raises(UsageError, match="more than 2"):
        fewer.encode(family.motion(random_of(family)))


def test_other_kinds_are_refused(family):
    for other in FAMILIES.values():
        if type(other) is not type(family):
            with pytest.raises(UsageError, match="earlier motion"):
                family.encode(other.motion(random_of(other)))


def test_other_joints_are_refused(family):
    motion = family.motion(random_of(family))
    with pytest.raises(UsageError, match="is one of 6 joints, the robot has 5"):
        replace(family, joints=MovingJoints(LIMITS[:5], (0, 1), REST[:5])).encode(motion)
    with pytest.raises(UsageError, match=f"joint {LIMITS[4].name} must stay"):
        replace(family, joints=MovingJoints(LIMITS, (0, 1, 2, 5), REST)).encode(motion)
    with pytest.raises(UsageError, match=f"joint {LIMITS[3].name} must stay"):
        replace(family, joints=MovingJoints(LIMITS, MOVING, REST + 0.1)).encode(motion)


def test_other_lengths_are_refused():
    for kind, hint in (("fourier", "--period 8"), ("fourier-quintic", "--period 8"), ("points", "--points 7")):
        family = FAMILIES[kind]
        other = replace(family, points=6) if kind == "points" else replace(family, period=9.0)
        with pytest.raises(UsageError, match=hint):
            other.encode(family.motion(random_of(family)))
    sines = FAMILIES["sines"]
    with pytest.raises(UsageError, match="--period 9"):
        replace(sines, duration=8.0).encode(sines.motion(random_of(sines)))
    with pytest.raises(UsageError, match="the band is"):
        replace(sines, band=(0.1, 0.5)).encode(sines.motion(random_of(sines)))
    points = FAMILIES["points"]
    narrow = tuple(limit.model_copy(update={"position": (-0.1, 0.1)}) for limit in LIMITS)
    with pytest.raises(UsageError, match="out of its range"):
        replace(points, joints=MovingJoints(narrow, MOVING, REST)).encode(points.motion(random_of(points)))


IMPOSSIBLE = [
    *((kind, {"period": bad}) for kind in ("fourier", "fourier-quintic") for bad in (0.0, -1.0, np.nan, np.inf)),
    *((kind, {"harmonics": 0}) for kind in ("fourier", "fourier-quintic")),
    *((kind, {"periods": 0}) for kind in ("fourier", "fourier-quintic")),
    *((kind, {"ramp": bad}) for kind in ("fourier", "sines") for bad in (0.0, -2.0)),
    *((kind, {"duration": bad}) for kind in ("sines", "points") for bad in (0.0, -1.0, np.nan)),
    ("sines", {"sines": 0}),
    ("sines", {"band": (2.0, 1.0)}),
    ("points", {"points": 1}),
    ("points", {"dwell": -0.1}),
    ("points", {"dwell": 2.0}),
]


def test_impossible_families_are_refused():
    for kind, changed in IMPOSSIBLE:
        with pytest.raises(UsageError):
            pytest.fail(f"{kind} takes {changed}: {replace(FAMILIES[kind], **changed)}")
    with pytest.raises(UsageError, match="no joint moves"):
        MovingJoints(LIMITS, (), REST)


def test_moves_share_the_time_so_that_all_use_their_limits_alike():
    family = FAMILIES["points"]
    points = np.array([[0.0] * 5, [0.1] * 5, [1.5] * 5, [-1.5] * 5, [0.0] * 5, [0.0, 0.2, 0.0, 0.0, 0.0], [0.5] * 5])
    durations = family.durations(points)
    assert durations.sum() == pytest.approx(family.duration)
    ways = np.abs(np.diff(points, axis=0))
    assert [durations[a] < durations[b] for a, b in ((0, 1), (1, 2), (3, 2), (4, 3))] == [True, True, True, True]
    speeds = (ways / durations[:, None]).max(axis=1)
    equal = (ways / durations.mean()).max(axis=1)
    assert speeds.max() / speeds.min() < 0.5 * equal.max() / equal.min()


def test_one_unit_of_a_coefficient_uses_a_limit_fully():
    limits = tuple(
        JointLimits(name=name, position=(-2.0, 2.0), velocity=v, acceleration=a)
        for name, v, a in (("slow", 0.1, 10.0), ("weak", 3.0, 0.1), ("short", 75.0, 1000.0))
    )
    family = FourierFamily(MovingJoints(limits, (0, 1, 2), np.zeros(3)), 6.0, 2, 1, 1.0)
    for number in range(1, 5):
        variables = np.zeros((3, 5))
        variables[:, number] = 1.0
        path = family.path(variables.ravel(), family.grid(2000))
        largest = np.abs(stacked(path)).max(axis=2)
        np.testing.assert_allclose(largest[[1, 2, 0], [0, 1, 2]], [0.1, 0.1, 2.0], rtol=1e-2)


@each("seed", range(5))
def test_a_series_can_begin_elsewhere_on_the_same_path(seed):
    family = FAMILIES["fourier"]
    variables = random_of(family, seed)
    later = family.begun_near_middle(variables)
    time = family.grid(4000)
    before, after = stacked(family.path(variables, time)), stacked(family.path(later, time))
    shift = int(np.argmin(np.abs(before[0] - after[0][:, :1]).sum(axis=0)))
    np.testing.assert_allclose(np.roll(before, -shift, axis=2), after, atol=0.02 * np.abs(before).max())
    middle = np.array([0.5 * sum(limits.position) for limits in LIMITS])[list(MOVING)]
    speed = np.array([limits.velocity for limits in LIMITS])[list(MOVING)]
    away = np.max(np.abs(after[0][list(MOVING)] - middle[:, None]) / speed[:, None], axis=0)
    assert away[0] <= away.min() + 0.02
    again = family.begun_near_middle(later)
    np.testing.assert_allclose(again, later, atol=1e-9)


@each("name", ["fourier-quintic", "sines", "points"])
def test_other_paths_have_a_beginning_of_their_own(name):
    variables = random_of(FAMILIES[name])
    assert np.array_equal(FAMILIES[name].begun_near_middle(variables), variables)
