"""Swarms as methods of `identify`: they end at least squares or say how far from it."""

from __future__ import annotations

import numpy as np
import pytest
from each import each

from drivers.core.errors import UsageError
from ident.estimators.method_choice import chosen_method
from ident.estimators.search_estimator import centred_reduction
from ident.estimators.swarm.frog_leaping import FrogLeaping
from ident.estimators.swarm.particle_swarm import ParticleSwarm, RandomWeight
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.regression.least_squares import ordinary_least_squares, weighted_least_squares
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction", "mistakes_not_sought")


@pytest.fixture(scope="module")
def recording(three_joint):
    motion = random_fourier_motion(build_model(three_joint), 10.0, 1, candidates=3)
    return simulate_recording(three_joint, motion, 20.0, 1)


@pytest.fixture(scope="module")
def found(recording):
    known: dict[str, Identification] = {}

    def identified(method: str) -> Identification:
        if method not in known:
            known[method] = identify([recording], [], IdentifyChoices(method, search_delay=False))
        return known[method]

    return identified


@pytest.mark.parametrize(("method", "exact"), [("ls-pso", "ols"), ("wls-pso", "wls"), ("wls-rwpso", "wls")])
def test_a_long_search_in_a_small_box_is_least_squares(found, method: str, exact: str) -> None:
    swarm, wanted = found(f"{method}:generations=500:particles=30:box=0.01"), found(exact)
    assert np.all(np.abs(swarm.solution.parameters - wanted.solution.parameters) < 0.3 * wanted.std)
    assert swarm.solution.weights == pytest.approx(wanted.solution.weights, rel=0.01)
    assert swarm.std == pytest.approx(wanted.std, rel=0.05)
    assert swarm.fit.relative_error == pytest.approx(wanted.fit.relative_error, rel=0.02)
    assert "search-gap" not in [check.name for check in swarm.checks]


def test_what_the_search_found_is_in_the_result(found, recording) -> None:
    identification = found("wls-pso:generations=3")
    result = identification.result
    (step,) = [step for step in result.preprocessing if step.name == "search"]
    optimum = identification.estimation.optimum
    distance = np.abs(identification.solution.parameters - optimum.parameters) / optimum.std
    assert step.settings["largest_difference"] == pytest.approx(distance.max())
    assert step.settings["generations"] == 3
    assert step.settings["cost_above_optimum"] > 0.0
    assert "above the exact optimum, which is least squares" in step.text
    (loop,) = identification.estimation.loops
    assert len(loop.values) == 4
    (long,) = found("wls-pso:generations=500:particles=30:box=0.01").estimation.loops
    assert len(long.values) == 500
    assert long.name.endswith("500 of 501 generations")
    assert not loop.settled
    assert result.method_options["box"] == 0.1


def test_frogs_report_what_is_identifiable(found, recording) -> None:
    result = found("sfla:random=coordinate:generations=100").result
    assert result.fit.relative_error < 0.2
    (step,) = [step for step in result.preprocessing if step.name == "physical parameters"]
    # Link 1 turns about a vertical axis: its mass only adds to the inertia.
    assert step.settings["m1 determined"] < 0.99
    assert "m1 std" not in step.settings
    assert step.settings["Fv2 determined"] == 1.0
    assert step.settings["Fv2 std"] > 0.0


def test_penalised_frogs_end_at_links_that_can_exist(found, recording) -> None:
    least = {}
    for option in ("", ":feasible=true"):
        result = found(f"sfla:random=coordinate:generations=100{option}").result
        (step,) = [step for step in result.preprocessing if step.name == "physical parameters"]
        spreads = []
        for link in (2, 3):
            xx, xy, xz, yy, yz, zz = (step.settings[f"I{axes}{link}"] for axes in ("xx", "xy", "xz", "yy", "yz", "zz"))
            inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            spreads.append(np.linalg.eigvalsh(0.5 * np.trace(inertia) * np.eye(3) - inertia)[0])
        least[option] = min(spreads)
    assert least[":feasible=true"] > -1e-3
    assert least[""] < -1e-3


def test_a_centred_system_has_its_minimum_where_it_was_put(dense_reduction) -> None:
    generator = np.random.default_rng(4)
    plain = dense_reduction([(generator.standard_normal((50, 3)), generator.standard_normal(50)) for _ in range(2)])
    centre = np.array([1.0, -2.0, 0.5])
    centred = centred_reduction(plain, centre)
    for solve in (ordinary_least_squares, weighted_least_squares):
        solution = solve(centred, range(3))
        assert solution.parameters == pytest.approx(centre)
        assert centred.residual_sums(centre) == pytest.approx(plain.residual_sums(centre))


def test_settings_reach_the_optimiser() -> None:
    options = chosen_method("wls-rwpso:particles=9:c1=1:c2=2:least=0.1:most=0.2:spread=0.05").options
    assert options.swarm == ParticleSwarm(9, RandomWeight(0.1, 0.2, 0.05), 1.0, 2.0)
    assert chosen_method("wls-pso:weight=1.3").options.swarm.weight.value == 1.3
    assert chosen_method("wls-rwpso:seed=3") == chosen_method("pso:inertia=random:seed=3")
    assert chosen_method("ls-pso") == chosen_method("pso:about=ols")
    frogs = chosen_method("sfla:largest_leap=0.3").options
    assert isinstance(frogs, FrogLeaping)
    assert frogs.largest_leap == 0.3


@pytest.mark.parametrize(("box", "near"), [(0.01, True), (1.0, False)])
def test_frogs_keep_to_the_box_that_was_asked_for(found, box, near) -> None:
    """Ranges of masses go from 5 % of the prior's to three times the larger one of it and the mean, times `box`."""
    masses = []
    for seed in (0, 1):
        (step,) = [
            step
            for step in found(f"sfla:generations=3:box={box}:seed={seed}").estimation.steps
            if step.name == "physical parameters"
        ]
        masses.append(np.array([step.settings[f"m{link}"] for link in (1, 2, 3)]))
    limit = 3.0 * 0.01 * np.maximum(masses[0], masses[0].mean())
    assert bool(np.all(np.abs(masses[1] - masses[0]) <= 1.05 * limit)) == near


@each(
    "text",
    [
        "sfla:memeplexes=0",
        "sfla:frogs=5",
        "sfla:random=x",
        "wls-pso:particles=1",
        "wls-rwpso:least=2",
        "wls-rwpso:weight=1",
        "wls-pso:least=0.1",
        "ls-pso:about=wls",
        "ls-pso:box=0",
        "sfla:box=0",
        "sfla:largest_leap=0",
    ],
)
def test_bad_settings_are_refused_before_any_work(text: str) -> None:
    with pytest.raises(UsageError) as refused:
        IdentifyChoices(text)
    assert "\n" not in str(refused.value)
