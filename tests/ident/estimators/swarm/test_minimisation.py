from __future__ import annotations

import numpy as np
import pytest
from each import each

from drivers.core.arrays import FloatArray
from drivers.core.errors import IdentificationError, UsageError
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.minimisation import Optimiser, SearchBox, SearchBudget, minimise
from ident.estimators.swarm.particle_swarm import ParticleSwarm, RandomWeight

OPTIMISERS: list[Optimiser] = [
    FrogLeaping(frogs=30, memeplexes=5, random="coordinate"),
    ParticleSwarm(particles=30),
    ParticleSwarm(particles=30, weight=RandomWeight()),
]
BOX = SearchBox(np.array([-1.0, 0.0, 10.0]), np.array([3.0, 1e-3, 1e4]))
INSIDE = np.array([0.5, 3e-4, 7e3])


def bowl(points: FloatArray) -> FloatArray:
    """A quadratic cost in units of the box, least at INSIDE."""
    return np.asarray(np.sum(((points - INSIDE) / BOX.width) ** 2, axis=1))


every = pytest.mark.parametrize("optimiser", OPTIMISERS, ids=["frogs", "particles", "random-weight"])


@every
def test_the_minimum_of_a_bowl_is_found_in_any_units(optimiser: Optimiser) -> None:
    found = minimise(optimiser, bowl, BOX, SearchBudget(150), seed=1)
    assert np.all(np.abs(found.point - INSIDE) < 0.02 * BOX.width)
    assert np.all(np.diff(found.history) <= 0.0)
    assert found.history[-1] == found.cost == bowl(found.point[None])[0]
    assert np.all(np.diff(found.evaluations) >= 0)


@every
def test_a_minimum_outside_the_box_is_found_on_its_face(optimiser: Optimiser) -> None:
    def cost(points: FloatArray) -> FloatArray:
        assert np.all((points >= BOX.lower) & (points <= BOX.upper))
        return np.asarray(bowl(points) + points[:, 0])

    found = minimise(optimiser, cost, BOX, SearchBudget(60), seed=2)
    assert found.point[0] == pytest.approx(-1.0, abs=0.05)


@every
def test_a_seed_gives_one_search(optimiser: Optimiser) -> None:
    runs = [minimise(optimiser, bowl, BOX, SearchBudget(5), seed=seed) for seed in (3, 3, 4)]
    assert np.array_equal(runs[0].point, runs[1].point)
    assert not np.array_equal(runs[0].point, runs[2].point)


@each(("random", "longest"), [("leap", 0.02), ("coordinate", 0.1)])
def test_no_leap_is_longer_than_the_longest_one(random, longest):
    """D_max of the UP6 paper, in widths of the box: a point is drawn at random, or so near to one before."""
    drawn: list[FloatArray] = []
    seen: list[FloatArray] = []

    class Box(SearchBox):
        def draw(self, generator: np.random.Generator, count: int) -> FloatArray:
            drawn.extend(points := super().draw(generator, count))
            return points

    def cost(points: FloatArray) -> FloatArray:
        seen.extend(points.copy())
        return bowl(points)

    frogs = FrogLeaping(frogs=12, memeplexes=3, random=random, largest_leap=longest)
    minimise(frogs, cost, Box(BOX.lower, BOX.upper), SearchBudget(6), seed=1)
    leaps = [k for k, point in enumerate(seen) if not any(np.array_equal(point, other) for other in drawn)]
    nearest = [np.linalg.norm((np.array(seen[:k]) - seen[k]) / BOX.width, axis=1).min() for k in leaps]
    assert len(leaps) > 30
    assert max(nearest) <= longest * (1 + 1e-9)


@every
def test_undefined_costs_are_survived_and_counted(optimiser: Optimiser) -> None:
    bad = 0

    def cost(points: FloatArray) -> FloatArray:
        nonlocal bad
        values = bowl(points)
        holes = (points[:, 0] > 1.0) | (points[:, 2] < 100.0)
        values[holes] = np.where(points[holes, 0] > 2.0, np.nan, -np.inf)
        bad += int(holes.sum())
        return values

    found = minimise(optimiser, cost, BOX, SearchBudget(80), seed=5)
    assert found.undefined == bad > 0
    assert np.all(np.abs(found.point - INSIDE) < 0.1 * BOX.width)


@every
def test_ctrl_c_gives_the_best_so_far(optimiser: Optimiser) -> None:
    seen: list[float] = []

    def cost(points: FloatArray) -> FloatArray:
        if len(seen) > 200:
            raise KeyboardInterrupt
        values = bowl(points)
        seen.extend(values)
        return values

    found = minimise(optimiser, cost, BOX, SearchBudget(1000), seed=6)
    assert found.ended == "interrupted"
    assert found.cost == min(seen)


@every
def test_the_time_limit_gives_the_best_so_far(optimiser: Optimiser, clock) -> None:
    def slow(points: FloatArray) -> FloatArray:
        clock.sleep(1.0)
        return bowl(points)

    found = minimise(optimiser, slow, BOX, SearchBudget(10**6, seconds=4.5), clock=clock)
    assert found.ended == "time"
    assert np.isfinite(found.cost)
    # One evaluation happens, however short the time is.
    assert np.isfinite(minimise(optimiser, slow, BOX, SearchBudget(9, seconds=1e-9), clock=clock).cost)


def test_ctrl_c_before_any_cost_is_passed_on() -> None:
    def cost(points: FloatArray) -> FloatArray:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimise(OPTIMISERS[0], cost, BOX, SearchBudget(3))


def test_costs_that_are_never_numbers_are_an_error() -> None:
    with pytest.raises(IdentificationError, match="none of 60 costs is a number"):
        minimise(OPTIMISERS[1], lambda points: np.full(len(points), np.nan), BOX, SearchBudget(1))


def test_given_points_belong_to_the_initial_population() -> None:
    found = minimise(OPTIMISERS[1], bowl, BOX, SearchBudget(1), first=INSIDE)
    assert found.cost == 0.0
    assert found.generations_to(0.0) == 0
    assert found.generations_to(-1.0) is None


@each(
    ("make", "message"),
    [
        (lambda: FrogLeaping(frogs=5, memeplexes=10), "10 memeplexes are more than 5 frogs"),
        (lambda: FrogLeaping(frogs=50, memeplexes=7), "do not divide"),
        (lambda: FrogLeaping(frogs=10, memeplexes=10), "leave one each"),
        (lambda: FrogLeaping(reach=float("nan")), "reach nan"),
        (lambda: ParticleSwarm(particles=1), "1 particles are too few for a swarm"),
        (lambda: ParticleSwarm(social=-1.0), "learning factors"),
        (lambda: ParticleSwarm(fastest=0.0), "velocity clamp 0"),
        (lambda: RandomWeight(0.9, 0.4), "no random weight"),
        (lambda: SearchBudget(0), "0 generations"),
        (lambda: SearchBudget(1, seconds=-1.0), "a search of"),
        (lambda: SearchBox(np.zeros(2), np.array([1.0, 0.0]), ("M1", "M2")), "search range of M2 is empty: 0 to 0"),
        (lambda: SearchBox(np.zeros(1), np.array([np.nan])), "variable 1 is empty"),
        (lambda: SearchBox.around(np.array([2.0, 0.0]), 0.1), "variable 2 is empty"),
    ],
)
def test_bad_settings_are_refused_in_one_line(make, message: str) -> None:
    with pytest.raises(UsageError, match=message) as refused:
        make()
    assert "\n" not in str(refused.value)
