from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from ident.estimators.swarm.minimisation import SearchBox
from ident.estimators.swarm.physical import (
    FeasibilityPenalty,
    PhysicalCost,
    PhysicalParameters,
    QuadraticCost,
    identifiability,
    physical_names,
    physical_values,
)
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, model_torque, motion_factor
from ident.model.true_parameters import truth_vector

GENERATOR = np.random.default_rng(5)
UP6 = load_robot("up6")
MODEL = build_model(UP6)
BASE = base_parameters(MODEL)
TRUTH = truth_vector(UP6)
TABLE_3 = ("m1", "m2", "m3", "Izz1", "Izz2", "Izz3", "Fs1", "Fs2", "Fs3", "Fv1", "Fv2", "Fv3")


@pytest.fixture(scope="module")
def quadratic(smooth_segment) -> QuadraticCost:
    segment = smooth_segment(MODEL, 400)
    root = motion_factor(RegressorKernel(MODEL, BASE.columns), segment.position, segment.velocity, segment.acceleration)
    return QuadraticCost(root, root @ (BASE.projection @ TRUTH))


def test_physical_and_standard_parameters_are_the_same_bodies() -> None:
    values = physical_values(MODEL, TRUTH)
    named = dict(zip(physical_names(MODEL), values, strict=True))
    assert (named["m1"], named["cz1"], named["Izz2"], named["Fs3"]) == pytest.approx((60, -0.1, 0.7, 12))
    whole = PhysicalParameters.of(MODEL, np.zeros_like(values), physical_names(MODEL))
    assert whole.standard(values[None])[0] == pytest.approx(TRUTH)


def test_the_derivative_is_that_of_the_map() -> None:
    parameters = PhysicalParameters.of(MODEL, physical_values(MODEL, TRUTH), ["m2", "cx2", "cy3", "Ixy3", "Fv1"])
    point = GENERATOR.standard_normal(5)
    steps = 1e-6 * np.eye(5)
    numeric = (parameters.standard(point + steps) - parameters.standard(point - steps)) / 2e-6
    assert parameters.derivative(point) == pytest.approx(numeric.T, abs=1e-7)


def test_the_cost_is_the_torques(smooth_segment, quadratic) -> None:
    segment = smooth_segment(MODEL, 400)
    parameters = PhysicalParameters.of(MODEL, physical_values(MODEL, TRUTH), TABLE_3)
    points = np.array([physical_values(MODEL, TRUTH)[list(parameters.chosen)]] * 3) * [[1.0], [1.1], [0.5]]
    motion = segment.position, segment.velocity, segment.acceleration
    wanted = [
        np.linalg.norm(model_torque(MODEL, None, standard - TRUTH, *motion)) for standard in parameters.standard(points)
    ]
    assert PhysicalCost(parameters, quadratic, BASE.projection)(points) == pytest.approx(wanted, rel=1e-9, abs=1e-6)


def test_the_mass_of_link_1_is_only_visible_with_its_inertia(quadratic) -> None:
    parameters = PhysicalParameters.of(MODEL, physical_values(MODEL, TRUTH), TABLE_3)
    cost = PhysicalCost(parameters, quadratic, BASE.projection)
    point = parameters.reference[list(parameters.chosen)]
    found = {p.name: p for p in identifiability(cost.derivative(point), 1.0, TABLE_3)}
    assert [name for name, p in found.items() if not p.identifiable] == ["m1", "Izz1"]
    assert found["m1"].confounded_with == ("Izz1",)
    assert np.isinf(found["m1"].std)
    without = [name for name in TABLE_3 if name != "m1"]
    chosen = PhysicalParameters.of(MODEL, parameters.reference, without)
    derivative = PhysicalCost(chosen, quadratic, BASE.projection).derivative(point[1:])
    deviations = np.sqrt(np.diag(np.linalg.inv(derivative.T @ derivative)))
    result = identifiability(derivative, 0.3, without)
    assert [p.std for p in result] == pytest.approx(0.3 * deviations)
    units = np.logspace(-4, 4, 12)
    in_units = identifiability(cost.derivative(point) * units, 1.0, TABLE_3)
    assert [p.identifiable for p in in_units] == [p.identifiable for p in found.values()]
    assert [p.determined for p in in_units] == pytest.approx([p.determined for p in found.values()])
    assert [p.std for p in in_units] == pytest.approx([p.std for p in found.values()] / units)


def test_gauss_newton_steps_find_the_truth_with_centres_of_mass_among_the_parameters(quadratic) -> None:
    names = ("m3", "cx3", "cy3", "Izz3", "Fs2", "Fv3")
    parameters = PhysicalParameters.of(MODEL, physical_values(MODEL, TRUTH), names)
    truth = parameters.reference[list(parameters.chosen)]
    cost = PhysicalCost(parameters, quadratic, BASE.projection)
    box = SearchBox.around(truth, 0.9, names)

    def residual(scaled: np.ndarray) -> np.ndarray:
        return quadratic.root @ cost.base((box.lower + box.width * scaled)[None, :])[0] - quadratic.target

    begin = np.clip((box.draw(GENERATOR, 1)[0] - box.lower) / box.width, 1e-6, 1.0 - 1e-6)
    reached = least_squares(
        residual,
        begin,
        lambda scaled: cost.derivative(box.lower + box.width * scaled) * box.width,
        bounds=(0.0, 1.0),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    point = box.clip(box.lower + box.width * reached.x)
    assert cost.base(point[None])[0] == pytest.approx(BASE.projection @ TRUTH, rel=1e-6, abs=1e-6)


def test_parameters_that_do_not_exist_are_refused() -> None:
    for names, message in ((["m9"], "'m9' is not a physical parameter of up6"), (["m1", "m1"], "named twice")):
        with pytest.raises(UsageError, match=message):
            PhysicalParameters.of(MODEL, TRUTH, names)


def test_only_impossible_bodies_are_penalised() -> None:
    links = truth_vector(load_robot("up6"))[:30].reshape(3, 10)
    penalty = FeasibilityPenalty.of(links)
    impossible = links.copy()
    impossible[1, 9] = -1.0
    worse = links.copy()
    worse[1, 9] = -35.0
    costs = penalty(np.array([links, 0.1 * links, impossible, worse]))
    assert costs[:2] == pytest.approx(0.0)
    assert 0.0 < costs[2] < costs[3]
