"""Whole designs: every kind and criterion, limits on a dense grid, refusals."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from arm_kinds import ARM_KINDS
from each import each

from daq.motion.limits import check_limits, check_rest
from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from ident.excite.choices import DesignChoices
from ident.excite.criteria import RegressorCriterion
from ident.excite.design import Design, build_problem, design
from ident.excite.path import JointPath
from ident.excite.prior import find_prior
from ident.excite.search.acceptance import DENSER
from ident.excite.search.search import SearchChoices
from ident.excite.search.start import random_start, solve, tighten

QUICK = SearchChoices(seed=1, starts=1, workers=1)
UP6 = load_robot("up6")
KINDS = ("fourier", "fourier-quintic", "sines", "points")
EVERY_ARM = {(name, kind) for name, kind in zip(ARM_KINDS, KINDS * len(ARM_KINDS), strict=False)}
EVERY_KIND = {("sr400", kind) for kind in KINDS}
"""An arm with a closed loop; `studies/excitation/excite_robots.py` designs for all arms, and for longer."""
FIRST = ("S", "L", "U")
"""Joints of `UP6` that a shorter design moves."""
CRITERIA = ("condition", "plain-condition", "moments", "d-optimal", "e-optimal", "deviations", "motion-size")


def made(robot_file, search=QUICK, **choices):
    return design(robot_file, find_prior(robot_file), DesignChoices(**choices), search)


def short(**choices) -> DesignChoices:
    """Choices of a period in which a design takes half of the time."""
    return DesignChoices(period=5.0, **choices)


def designed(**choices) -> Design:
    """Designs for `UP6`, each made once."""
    return _designed(short(**choices))


@functools.cache
def _designed(choices: DesignChoices) -> Design:
    return design(UP6, find_prior(UP6), choices, QUICK)


def with_joint(robot_file, number, **changes):
    joints = list(robot_file.robot.joints)
    joints[number] = joints[number].model_copy(update=changes)
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"joints": tuple(joints)})})


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_keeps_every_limit_from_rest_to_rest(kind):
    found = designed(kind=kind, harmonics=2, **({"points": 4} if kind == "points" else {}))
    assert found.use.max() <= 1.0
    assert len(found.use) == len(found.limits)
    check_limits(found.motion, UP6.robot.joints, kind)
    check_rest(found.motion, UP6.robot.joints, kind)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_is_improved(criterion):
    choices = short(criterion=criterion, harmonics=1, joints=FIRST)
    problem = build_problem(UP6, find_prior(UP6), choices)
    begin = problem.family.random(np.random.default_rng([1, 0]))
    assert _designed(choices).cost < np.exp(problem.cost(begin))


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_of_whole_problems_equal_finite_differences(kind):
    problem = build_problem(UP6, find_prior(UP6), DesignChoices(kind=kind, harmonics=3, points=5))
    generator = np.random.default_rng(3)
    x = problem.family.random(generator)
    direction = generator.standard_normal(problem.family.size)
    _, gradient = problem.smooth_cost(x, 4.0)
    _, rows = problem.smooth_use(x, 30.0)
    step = 1e-6
    costs = [problem.smooth_cost(x + sign * step * direction, 4.0)[0] for sign in (1, -1)]
    uses = [problem.smooth_use(x + sign * step * direction, 30.0)[0] for sign in (1, -1)]
    assert gradient @ direction == pytest.approx((costs[0] - costs[1]) / (2 * step), rel=1e-4, abs=1e-6)
    assert rows @ direction == pytest.approx((uses[0] - uses[1]) / (2 * step), rel=1e-3, abs=1e-4)


def test_the_design_beats_the_best_of_many_random_motions():
    problem = build_problem(UP6, find_prior(UP6), short(harmonics=2))
    generator = np.random.default_rng(0)
    random = min(problem.cost(problem.family.random(generator)) for _ in range(100))
    assert designed(harmonics=2).cost < np.exp(random)


def test_the_same_seed_gives_the_same_trajectory_and_one_process_builds_the_problem_once(monkeypatch):
    first, built = designed(harmonics=1, joints=FIRST), []

    def counted(*arguments):
        built.append(build_problem(*arguments))
        return built[-1]

    monkeypatch.setattr("ident.excite.design.build_problem", counted)
    again = made(UP6, harmonics=1, period=5.0, joints=FIRST)
    time = np.linspace(0.0, first.motion.duration, 200)
    np.testing.assert_array_equal(again.motion.evaluate(time), first.motion.evaluate(time))
    assert len(built) == 1


def test_a_narrow_margin_is_made_up_for_between_the_points(monkeypatch):
    narrowed = []

    def counted(*arguments):
        narrowed.append(arguments)
        return tighten(*arguments)

    monkeypatch.setattr("ident.excite.search.start.tighten", counted)
    assert made(UP6, kind="fourier-quintic", harmonics=1, margin=0.0).use.max() <= 1.0
    assert narrowed  # on the design's own grid it kept to them already


@pytest.mark.parametrize("margin", [0.1, 0.25])
def test_the_margin_is_left(margin):
    found = designed(harmonics=1, margin=margin, joints=FIRST)
    of_joints = [use for use, name in zip(found.use, found.limits, strict=True) if not name.startswith("clearance")]
    assert max(of_joints) <= 1.0 - margin + 0.02  # what lies between the grid's points
    assert found.use.max() <= 1.0 - margin + 0.1  # 1 cm of a clearance, within which links move far from point to point


def test_an_earlier_motion_is_refined():
    earlier = designed(harmonics=2)
    again = design(UP6, find_prior(UP6), short(harmonics=2), QUICK, earlier=earlier.motion)
    assert again.cost <= earlier.cost * 1.01


def test_an_earlier_motion_of_another_kind_is_refused():
    earlier = designed(kind="points", harmonics=2, points=4)
    with pytest.raises(UsageError):
        design(UP6, find_prior(UP6), DesignChoices(), QUICK, earlier=earlier.motion)


def test_some_joints_can_move_alone():
    found = designed(harmonics=1, joints=("L", "U"))
    time = np.linspace(0.0, found.motion.duration, 500)
    position, _, _ = found.motion.evaluate(time)
    assert np.ptp(position[0]) == 0.0
    assert np.ptp(position[1]) > 0.5
    problem = build_problem(UP6, find_prior(UP6), DesignChoices(joints=("L", "U")))
    everything = build_problem(UP6, find_prior(UP6), DesignChoices())
    assert isinstance(problem.criterion, RegressorCriterion)
    assert isinstance(everything.criterion, RegressorCriterion)
    assert set(problem.criterion.columns) < set(everything.criterion.columns)


def test_a_payload_is_designed_for_by_the_last_links_parameters():
    ur = load_robot("ur5e")
    problem = build_problem(ur, find_prior(ur), DesignChoices(loaded=True))
    assert isinstance(problem.criterion, RegressorCriterion)
    assert set(problem.criterion.columns) <= set(range(50, 60))
    assert len(problem.criterion.columns) == 10


def test_torque_limits_are_kept_where_a_prior_is_known():
    free = designed(kind="sines", harmonics=2)
    tight = with_joint(UP6, 1, torque=400.0)
    found = made(tight, kind="sines", harmonics=1, period=5.0, joints=FIRST)
    assert any(name.startswith("torque") for name in found.limits)
    assert found.use.max() <= 1.0
    check = build_problem(tight, find_prior(tight), short(kind="sines", harmonics=2))
    torque = next(c for c in check.constraints if c.names[0].startswith("torque of L"))
    time = np.linspace(0.0, free.motion.duration, 2000)
    assert (
        torque.use(JointPath(time, *free.motion.evaluate(time)))[0] > 1.0
    )  # otherwise the limit would not have mattered


@each(
    ("choices", "message"),
    [
        ({"period": 0.0}, "period"),
        ({"period": float("nan")}, "period"),
        ({"ramp": -1.0}, "ramp"),
        ({"harmonics": 0}, "harmonics"),
        ({"periods": 0}, "periods"),
        ({"kind": "points", "points": 1}, "points"),
        ({"margin": 1.0}, "margin"),
        ({"joints": ("elbow",)}, "elbow"),
        ({"joints": ()}, "joint"),
        ({"criterion": "deviations", "loaded": True}, "payload"),
    ],
)
def test_impossible_choices_are_refused_with_the_reason(choices, message):
    with pytest.raises(UsageError, match=message):
        made(UP6, **choices)


def test_deviations_need_a_prior():
    bare = UP6.model_copy(
        update={"robot": UP6.robot.model_copy(update={"truth": UP6.robot.truth.model_copy(update={"links": {}})})}
    )
    with pytest.raises(UsageError, match="prior"):
        made(bare, criterion="deviations")


def test_limits_that_exclude_every_motion_are_named():
    with pytest.raises(UsageError, match="torque of L"):
        made(with_joint(UP6, 1, torque=5.0), harmonics=1, joints=("S",))


@pytest.mark.parametrize(("name", "kind"), sorted(EVERY_ARM | EVERY_KIND))
def test_every_robot_has_a_feasible_motion_of_every_kind_however_short_the_time(name, kind):
    robot_file = load_robot(name)
    found = made(robot_file, SearchChoices(starts=None, time=1e-3, workers=1), kind=kind)
    assert found.use.max() <= 1.0
    check_limits(found.motion, robot_file.robot.joints, kind)
    check_rest(found.motion, robot_file.robot.joints, kind)
    assert found.cost < np.inf


def test_a_narrow_room_leaves_a_small_motion():
    """A low ceiling and a floor: random motions leave the room, so they are shrunk towards a pose within it.

    How each kind shrinks is the next test's.
    """
    robot_file = load_robot("ur10")
    workspace = robot_file.robot.workspace.model_copy(update={"height": (0.05, 0.9)})
    robot = robot_file.robot.model_copy(update={"workspace": workspace})
    narrow = robot_file.model_copy(update={"robot": robot})
    problem = build_problem(narrow, find_prior(narrow), DesignChoices())
    begin = random_start(problem, [0, 0])
    assert problem.use(begin).max() > problem.allowed
    found = made(narrow, SearchChoices(starts=None, time=1e-3, workers=1))
    assert found.use.max() <= 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_about_another_pose_keeps_its_form(kind):
    family = build_problem(UP6, find_prior(UP6), DesignChoices(kind=kind, harmonics=3, points=5)).family
    x = family.random(np.random.default_rng(0))
    same = family.about(x, family.middle(x), 1.0)
    assert same == pytest.approx(x, abs=1e-9)
    pose = 0.5 * family.middle(x)
    smaller = family.about(x, pose, 0.25)
    assert family.middle(smaller) == pytest.approx(pose, abs=1e-6)
    time = family.grid(500)
    spans = [np.ptp(family.path(variables, time).position, axis=1) for variables in (x, smaller)]
    assert spans[1] == pytest.approx(0.25 * spans[0], rel=1e-2)
    still = family.about(x, pose, 0.0)
    assert np.ptp(family.path(still, time).position, axis=1) == pytest.approx(0.0, abs=1e-12)


def test_the_dense_grid_is_denser_than_the_designs():
    problem = build_problem(UP6, find_prior(UP6), DesignChoices(harmonics=1))
    *_, x = solve(problem, problem.family.random(np.random.default_rng(0)))
    dense = problem.family.grid(DENSER * len(problem.time))
    assert len(dense) >= 10 * len(problem.time)
    path = problem.family.path(x, dense)
    assert isinstance(path, JointPath)
    assert max(float(c.use(path).max()) for c in problem.constraints) <= 1.0
