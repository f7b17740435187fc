"""The load as a body that can exist: what is known is held, the truth comes back, error bars hold it."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from loaded_arm import LOAD, arm_runs, runs

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.estimators.feasible.pseudo_inertia import pseudo_inertia
from ident.experiments.load.consistent_load import consistent_load
from ident.experiments.load.payload import identify_payload
from ident.experiments.run_pair import prepare_pair
from ident.model.load import KnownLoad, moved_origin
from ident.model.parameters import link_parameters
from ident.signals.joint_signals import read_joint_signals
from studies.payload.payload import unconstrained_load

ROUNDED = KnownLoad(LOAD.mass, LOAD.com, (0.01, 0.0, 0.0, 0.012, 0.0, 0.0225))
KNOWN = {"nothing": None, "mass": KnownLoad(2.8), "centre": KnownLoad(2.8, LOAD.com), "all": LOAD, "rounded": ROUNDED}


@pytest.fixture(scope="module")
def pair():
    return prepare_pair(*runs(0), read_joint_signals)


@pytest.fixture(scope="module")
def estimate(pair):
    return unconstrained_load(pair)


@pytest.fixture(scope="module", params=KNOWN)
def loads(request, pair, estimate):
    known = KNOWN[request.param]
    return known, consistent_load(pair, estimate, known)


def standard(body) -> np.ndarray:
    return link_parameters(body.mass, body.com, [*body.inertia.values()])


def errors_of(load, kind: str) -> list[float]:
    return [getattr(error, kind) for error in load.errors]


def test_load_and_links_can_exist_with_the_load_and_without_it(loads, pair):
    _, load = loads
    own, links = standard(load), np.array([standard(link) for link in load.links])
    assert [link.link for link in load.links] == list(pair.model.link_names)
    assert np.linalg.eigvalsh(pseudo_inertia(own))[0] > 0
    assert np.all(np.linalg.eigvalsh(pseudo_inertia(links))[:, 0] > 0)
    links[-1] -= moved_origin(np.array(pair.robot_file.robot.workspace.tool)) @ own
    assert np.linalg.eigvalsh(pseudo_inertia(links[-1]))[0] > 0


def test_what_is_known_is_held(loads):
    known, load = loads
    if known is None:
        assert not load.held
        return
    assert load.mass == pytest.approx(known.mass, rel=1e-12)
    assert load.mass_std == 0.0
    if known.com is not None:
        assert load.com == pytest.approx(known.com, abs=1e-12)
        assert load.com_std == [0.0] * 3
    assert load.rounded is (known is ROUNDED)
    if known is LOAD:
        assert [*load.inertia.values()] == pytest.approx(LOAD.inertia, abs=1e-12)
        assert [*load.inertia_std.values()] == [0.0] * 6
    else:
        assert all(std > 0.0 for std in load.inertia_std.values())


def test_consistency_costs_what_the_sum_of_squares_says(loads):
    _, load = loads
    assert sum(errors_of(load, "consistent")) > sum(errors_of(load, "unconstrained"))
    assert errors_of(load, "consistent") == pytest.approx(errors_of(load, "unconstrained"), rel=0.01)
    assert load.cost.passed


def test_the_truth_lies_within_the_error_bars():
    """Inertias too: bodies at the boundary are the harder case, and the load of seed 0 lies there."""
    file = load_robot("ur10e")
    drives = tuple(drive.model_copy(update={"gain_std": None}) for drive in file.robot.drives)
    certain = file.model_copy(update={"robot": file.robot.model_copy(update={"drives": drives})})
    errors = []
    for seed in range(4):
        load = identify_payload(*runs(seed), KnownLoad(2.8), certain).consistent_load
        errors += [*(np.array(load.com) - LOAD.com) / load.com_std]
        errors += [*(np.array([*load.inertia.values()]) - LOAD.inertia) / [*load.inertia_std.values()]]
    assert np.mean(np.abs(errors) < 2) > 0.85
    assert np.max(np.abs(errors)) < 4


def test_a_load_that_cannot_exist_is_found_to_cost():
    """A weighed mass of twice the load leaves errors that no noise explains."""
    wrong = identify_payload(*runs(0), KnownLoad(5.6)).consistent_load
    assert not wrong.cost.passed
    assert wrong.errors[1].consistent > 1.5 * wrong.errors[1].unconstrained


def test_without_noise_the_truth_comes_back():
    content = yaml.safe_load(load_robot("ur10e").text)
    content["truth"]["noise"] = {}
    for joint in content["truth"]["joints"].values():
        joint.pop("ripple", None)
    exact = parse_robot(yaml.safe_dump(content), where="exact", folder=None)
    load = identify_payload(*arm_runs(exact, {}, LOAD, seed=1)).consistent_load
    assert load.mass == pytest.approx(LOAD.mass, rel=1e-3)
    assert load.com == pytest.approx(LOAD.com, abs=1e-3)
    assert [*load.inertia.values()] == pytest.approx(LOAD.inertia, abs=1e-3)


def test_what_the_prior_decides_has_no_error_bar(three_joint):
    """Three parallel axes do not show ten parameters of a load."""
    planar = parse_robot(three_joint.text.replace("alpha: pi/2", "alpha: 0"), where="planar", folder=None)
    known = KnownLoad(1.0, (0.1, 0.0, 0.0), (0.01, 0, 0, 0.01, 0, 0.01))
    body = identify_payload(*arm_runs(planar, {}, known, 0)).consistent_load
    assert min(body.determined.values()) < 0.5
    assert np.any(np.isnan([*body.inertia_std.values()]))
    assert np.linalg.eigvalsh(pseudo_inertia(standard(body)))[0] > 0


def test_a_load_keeps_the_prior_of_the_file(pair, estimate):
    """The Euclidean distance gives a load that can exist, too, and the same where data decide."""
    file = pair.robot_file
    prior = file.robot.prior.model_copy(update={"distance": "euclidean"})
    euclidean = file.model_copy(update={"robot": file.robot.model_copy(update={"prior": prior})})
    load = identify_payload(*runs(0), None, euclidean).consistent_load
    assert load.mass == pytest.approx(consistent_load(pair, estimate, None).mass, abs=0.01)
    assert np.linalg.eigvalsh(pseudo_inertia(standard(load)))[0] > 0


def test_impossible_knowledge_is_refused():
    file = load_robot("ur10e")
    text = file.text + "known: {M6: {min: 50}, total_mass: {max: 10}}\n"
    with pytest.raises(RobotFileError, match="no body satisfies all of"):
        identify_payload(*runs(0), None, parse_robot(text, where="wrong", folder=None))
