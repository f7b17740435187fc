"""The load as a body that can exist: what is known is held, the truth comes back, error bars hold it."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from loaded_arm import LOAD, arm_runs, runs

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.estimators.feasible.pseudo_inertia import body_of, pseudo_inertia
from ident.experiments.load.consistent_load import consistent_load
from ident.experiments.load.payload import identify_payload
from ident.experiments.payload_summary import payload_result
from ident.model.load import KnownLoad, moved_origin
from ident.model.parameters import link_parameters

ROUNDED = KnownLoad(LOAD.mass, LOAD.com, (0.01, 0.0, 0.0, 0.012, 0.0, 0.0225))
KNOWN = {"nothing": None, "mass": KnownLoad(2.8), "centre": KnownLoad(2.8, LOAD.com), "all": LOAD, "rounded": ROUNDED}


@pytest.fixture(scope="module")
def payload():
    return identify_payload(*runs(0))


@pytest.fixture(scope="module", params=KNOWN)
def loads(request, payload):
    known = KNOWN[request.param]
    return known, consistent_load(payload.pair, payload.load, known)


def standard(load) -> np.ndarray:
    return link_parameters(load.body.mass, load.body.com, load.body.inertia[np.triu_indices(3)])


def test_load_and_loaded_links_can_exist(loads, payload):
    _, load = loads
    own = standard(load)
    links = load.loaded_arm.reshape(-1, 10)
    assert np.linalg.eigvalsh(pseudo_inertia(own))[0] > 0
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(links))[:, 0] > 0)
    without = load.arm[: links.size].reshape(-1, 10)
    tool = moved_origin(np.array(payload.pair.robot_file.robot.workspace.tool))
    assert links[-1] - without[-1] == pytest.approx(tool @ own)
    assert np.array_equal(links[:-1], without[:-1])


def test_what_is_known_is_held(loads):
    known, load = loads
    if known is None:
        assert not load.known.any()
        return
    assert load.body.mass == pytest.approx(known.mass, rel=1e-12)
    assert load.mass_std == 0.0
    if known.com is not None:
        assert load.body.com == pytest.approx(np.array(known.com), abs=1e-12)
        assert np.all(load.com_std == 0.0)
    assert load.rounded is (known is ROUNDED)
    if known is LOAD:
        assert load.body.inertia[np.triu_indices(3)] == pytest.approx(np.array(LOAD.inertia), abs=1e-12)
        assert np.all(load.inertia_std == 0.0)
    else:
        assert np.all(load.inertia_std > 0.0)


def test_consistency_costs_what_the_sum_of_squares_says(loads):
    _, load = loads
    assert np.sum(load.consistent_errors) > np.sum(load.errors)
    assert load.consistent_errors == pytest.approx(load.errors, rel=0.01)
    assert load.test.passed


def test_the_truth_lies_within_the_error_bars():
    """Inertias too: bodies at the boundary are the harder case, and the load of seed 0 lies there."""
    file = load_robot("ur10e")
    drives = tuple(drive.model_copy(update={"gain_std": None}) for drive in file.robot.drives)
    certain = file.model_copy(update={"robot": file.robot.model_copy(update={"drives": drives})})
    errors = []
    for seed in range(4):
        load = identify_payload(*runs(seed), KnownLoad(2.8), certain).consistent
        errors += [*(load.body.com - LOAD.com) / load.com_std]
        errors += [*(load.body.inertia[np.triu_indices(3)] - LOAD.inertia) / load.inertia_std]
    assert np.mean(np.abs(errors) < 2) > 0.85
    assert np.max(np.abs(errors)) < 4


def test_a_load_that_cannot_exist_is_found_to_cost(payload):
    """A weighed mass of twice the load leaves errors that no noise explains."""
    wrong = identify_payload(*runs(0), KnownLoad(5.6)).consistent
    assert not wrong.test.passed
    assert wrong.consistent_errors[1] > 1.5 * wrong.errors[1]


def test_without_noise_the_truth_comes_back():
    content = yaml.safe_load(load_robot("ur10e").text)
    content["truth"]["noise"] = {}
    for joint in content["truth"]["joints"].values():
        joint.pop("ripple", None)
    exact = parse_robot(yaml.safe_dump(content), where="exact", folder=None)
    load = identify_payload(*arm_runs(exact, {}, LOAD, seed=1)).consistent
    assert load.body.mass == pytest.approx(LOAD.mass, rel=1e-3)
    assert load.body.com == pytest.approx(np.array(LOAD.com), abs=1e-3)
    assert load.body.inertia[np.triu_indices(3)] == pytest.approx(np.array(LOAD.inertia), abs=1e-3)


def test_what_the_prior_decides_has_no_error_bar(three_joint):
    """Three parallel axes do not show ten parameters of a load."""
    planar = parse_robot(three_joint.text.replace("alpha: pi/2", "alpha: 0"), where="planar", folder=None)
    known = KnownLoad(1.0, (0.1, 0.0, 0.0), (0.01, 0, 0, 0.01, 0, 0.01))
    body = identify_payload(*arm_runs(planar, {}, known, 0)).consistent
    shares = body.determined
    assert np.any(shares < 0.5)
    assert np.any(np.isnan(body.inertia_std))
    assert np.linalg.eigvalsh(pseudo_inertia(standard(body)))[0] > 0


def test_a_load_keeps_the_prior_of_the_file(payload):
    """The Euclidean distance gives a load that can exist, too, and the same where data decide."""
    file = payload.pair.robot_file
    prior = file.robot.prior.model_copy(update={"distance": "euclidean"})
    euclidean = file.model_copy(update={"robot": file.robot.model_copy(update={"prior": prior})})
    load = identify_payload(*runs(0), None, euclidean).consistent
    assert load.body.mass == pytest.approx(payload.consistent.body.mass, abs=0.01)
    assert np.linalg.eigvalsh(pseudo_inertia(standard(load)))[0] > 0


def test_impossible_knowledge_is_refused():
    file = load_robot("ur10e")
    text = file.text + "known: {M6: {min: 50}, total_mass: {max: 10}}\n"
    with pytest.raises(RobotFileError, match="no body satisfies all of"):
        identify_payload(*runs(0), None, parse_robot(text, where="wrong", folder=None))


def test_the_result_holds_the_load_and_the_arm_with_it(payload):
    content = payload_result(payload).consistent_load
    assert content.mass == payload.consistent.body.mass
    assert content.links[-1].link == payload.pair.model.link_names[-1]
    carried = body_of(payload.consistent.loaded_arm[-10:])
    assert content.links[-1].mass == pytest.approx(carried.mass)
    assert [error.unconstrained for error in content.errors] == pytest.approx(payload.consistent.errors)
