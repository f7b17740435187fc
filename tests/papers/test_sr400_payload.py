"""SR400 .4.4: the load of Table 3 on the simulated arm, the base parameters it changes, and the drive chains' gains."""

from __future__ import annotations

import numpy as np
import pytest

from daq.robot.loader import load_robot
from ident.experiments.gains.drive_gains import identify_gains
from ident.experiments.load.payload import identify_payload
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad, load_columns, load_effect
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.synthetic.altered_arms import with_gains

TABLE_3 = np.array([0.454, -0.02, -0.09, 0.445, -0.115, 0.065, 0.48, 0.6, 2.0, 10.9])
PRINTED = [
    "ZZR1",
    "XXR2",
    "ZZR2",
    "MXR2",
    "XXR3",
    "XYR3",
    "ZZR3",
    "MXR3",
    "MYR3",
    "XXR5",
    "ZZR5",
    "MYR5",
    "XXR6",
    "XY6",
    "XZ6",
    "YZ6",
    "ZZ6",
    "MX6",
    "MY6",
]
DURATION, RATE = 20.0, 200.0


@pytest.fixture(scope="module")
def load() -> KnownLoad:
    """Table 3 as mass, centre of mass and the inertia about it."""
    mass = TABLE_3[9]
    centre = TABLE_3[6:9] / mass
    xx, xy, xz, yy, yz, zz = TABLE_3[:6]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - mass * (
        centre @ centre * np.eye(3) - np.outer(centre, centre)
    )
    six = about[np.triu_indices(3)]
    return KnownLoad(float(mass), tuple(centre.tolist()), tuple(six.tolist()))


@pytest.fixture(scope="module")
def recordings(load):
    """Factors on the gains of Table 2 that nobody knows, and the runs."""
    robot_file = load_robot("sr400")
    factors = dict(zip(robot_file.robot.joint_names, (1.05, 0.95, 1.08, 0.92, 1.04, 0.97), strict=True))
    motion = random_fourier_motion(build_model(robot_file), DURATION, seed=0, candidates=3)
    runs = {}
    for name, arm in (("file", robot_file), ("hidden", with_gains(robot_file, factors))):
        loaded = with_load(arm, load.mass, load.com, load.inertia)
        runs[name] = (
            simulate_recording(arm, motion, DURATION, seed=1, rate=RATE),
            simulate_recording(loaded, motion, DURATION, seed=2, rate=RATE),
        )
    return factors, runs


def test_table_3_as_a_body(load):
    assert load.values == pytest.approx(TABLE_3, abs=1e-12)


def test_the_19_printed_parameters_change():
    robot_file = load_robot("sr400")
    model = build_model(robot_file)
    base = base_parameters(model)
    effect = load_effect(model, base, robot_file.robot)
    changed = [base.names[i] for i in range(base.count) if np.any(np.abs(effect[i]) > 1e-9)]
    assert sorted(changed) == sorted(PRINTED)
    assert len(load_columns(effect).names) == 10
    change = dict(zip(base.names, effect @ TABLE_3, strict=True))
    d4, d3 = change["MXR3"] / 10.9, change["MXR2"] / 10.9
    rl4 = change["MYR3"] / 10.9
    assert change["XXR3"] == pytest.approx((rl4**2 - d4**2) * 10.9)
    assert change["XYR3"] == pytest.approx(-d4 * rl4 * 10.9)
    assert change["XXR2"] == pytest.approx(-(d3**2) * 10.9)
    assert change["XXR6"] == pytest.approx(0.454 - 0.445)
    assert change["MYR5"] == pytest.approx(2.0)


def test_the_load_is_found(recordings, load):
    found = identify_payload(*recordings[1]["file"], load)
    values, std = (np.array([getattr(row, name) for row in found.load]) for name in ("value", "noise_std"))
    errors = (values - TABLE_3) / std
    assert np.max(np.abs(errors)) < 4
    assert found.tests.known_load is not None
    assert found.tests.known_load.passed
    assert found.tests.mass is not None
    assert found.tests.mass.passed


def test_gains_of_coupled_motors_and_a_closed_loop(recordings, load):
    factors, runs = recordings
    robot = load_robot("sr400").robot
    true = np.array([robot.drive(name).gain * factor for name, factor in factors.items()])
    found = identify_gains(*runs["hidden"], KnownLoad(load.mass))
    assert found.signal == "voltage"
    assert found.values == pytest.approx(true, rel=0.06)
    assert np.max(np.abs(found.values - true) / found.std) < 4
