"""The load from a free and a loaded run of a simulated arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loaded_arm import LOAD, RATE, runs

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import DataError, UsageError
from ident.experiments.load.payload import identify_payload
from ident.experiments.run_pair import prepare_pair
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad
from ident.model.parameters import INERTIAL
from ident.regression.hypothesis_tests import chi_square_test
from ident.signals.joint_signals import read_joint_signals
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.payload.payload import unconstrained_load

SEEDS = range(4)


@pytest.fixture(scope="module")
def found():
    return [identify_payload(*runs(seed), LOAD) for seed in SEEDS]


def column(rows, field: str) -> np.ndarray:
    return np.array([getattr(row, field) for row in rows])


def test_the_load_lies_within_its_error_bars(found):
    errors = np.array([(column(each.load, "value") - LOAD.values) / column(each.load, "noise_std") for each in found])
    assert np.mean(np.abs(errors) < 2) > 0.85
    assert np.max(np.abs(errors)) < 4.5
    assert np.sqrt(np.mean(errors**2)) > 0.5  # the error bars are not much too long either


def test_mass_and_centre_are_close(found):
    for each in found:
        assert each.mass.value == pytest.approx(LOAD.mass, abs=0.05)
        moments = column(each.load, "value")[6:9]
        assert moments / each.mass.value == pytest.approx(LOAD.com, abs=0.005)


def test_the_right_load_is_accepted(found):
    for each in found:
        assert each.tests.mass.passed
        assert each.tests.values.passed
        assert each.tests.load.passed
        assert each.tests.known_load.passed
        assert each.tests.unchanged.p_value > 1e-3
        assert "agrees with the known 2.8 kg" in each.sentences[0]


@pytest.mark.parametrize(
    "wrong",
    [
        KnownLoad(2.9, LOAD.com, LOAD.inertia),
        KnownLoad(2.8, (0.03, -0.02, 0.10), LOAD.inertia),
        KnownLoad(2.8, (0.03, 0.02, 0.08), LOAD.inertia),
    ],
)
def test_a_wrong_load_is_rejected(wrong):
    each = identify_payload(*runs(0), wrong)
    assert not each.tests.known_load.passed
    assert not each.tests.values.passed
    assert each.tests.load.passed  # some load it is
    assert any("do not agree" in sentence for sentence in each.sentences)


def test_the_table_predicts_the_loaded_parameters(found):
    """Free plus load equals identified loaded, the comparison of SR400 Table 4."""
    changes = found[0].base_parameters
    spread = np.array([np.hypot(row.free_std, row.loaded_std) for row in changes])
    assert np.max(np.abs([row.predicted - row.loaded for row in changes]) / spread) < 4.5
    assert np.max(np.abs([row.free - row.loaded for row in changes]) / spread) > 20


def test_a_known_mass_is_held(found):
    only_mass = identify_payload(*runs(0), KnownLoad(2.8))
    rows, centre = only_mass.load_with_known, only_mass.centre_of_mass
    assert centre.value == pytest.approx(LOAD.com, abs=0.005)
    assert min(centre.std) > 0
    assert found[0].load_with_known == []
    assert "M_L" not in [row.name for row in rows]
    assert only_mass.consistent_load.mass == pytest.approx(2.8, rel=1e-12)
    assert column(rows, "value") == pytest.approx(LOAD.values[:9], abs=5 * column(rows, "std").max())


def test_gains_ten_percent_wrong_show_in_the_mass():
    each = identify_payload(*runs(1, everywhere=1 / 1.1), KnownLoad(2.8))
    assert each.mass.value == pytest.approx(1.1 * 2.8, rel=0.01)
    assert not each.tests.mass.passed
    assert any("drive gains are off by about as much" in warning for warning in each.warnings)
    # The robot file says 10 % of each gain's standard deviation itself: the sentence does not blame the scales.
    assert "covers the difference" in each.sentences[0]


def test_gains_wrong_unevenly_are_no_load():
    each = identify_payload(*runs(1, hidden=True), LOAD)
    assert not each.tests.known_load.passed


def test_the_gains_part_of_the_error_bars_is_what_wrong_gains_do():
    """A gain off by ε moves the load by ε times that joint's contribution: checked against files with such gains."""
    free, loaded = runs(2)
    robot_file = load_robot("ur10e")
    reference = identify_payload(free, loaded)
    moved = np.zeros((6, 10))
    for joint, drive in enumerate(robot_file.robot.drives):
        step = 1e-3
        drives = tuple(
            each.model_copy(update={"gain": each.gain * (1 + step)}) if each is drive else each
            for each in robot_file.robot.drives
        )
        other = robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"drives": drives})})
        changed = identify_payload(free, loaded, None, other, reference.delay.used)
        moved[joint] = (column(changed.load, "value") - column(reference.load, "value")) / step
    relative = np.array([drive.gain_std / drive.gain for drive in robot_file.robot.drives])
    independent = np.sqrt(np.sum((moved * relative[:, None]) ** 2, axis=0))
    common = np.abs(np.sum(moved * relative[:, None], axis=0))
    of_gains, size = column(reference.load, "gain_std"), np.abs(column(reference.load, "value"))
    assert of_gains == pytest.approx(np.maximum(independent, common), rel=0.1)
    # All gains too high by a share make everything heavier by that share.
    assert common == pytest.approx(relative.mean() * size, rel=0.05, abs=0.02 * of_gains.max())


def test_a_recorded_torque_has_no_error_of_a_gain():
    """Neither run's torque is a gain's, then the free run's alone."""
    pair = prepare_pair(*runs(0), read_joint_signals)
    moves = []
    for used in ((), ()), (pair.runs[0].gains_used, ()), (pair.runs[0].gains_used,) * 2:
        runs_of = tuple(replace(run, gains_used=gains) for run, gains in zip(pair.runs, used, strict=True))
        moves.append(unconstrained_load(replace(pair, runs=runs_of)).gain_moves)
    assert not moves[0].any()
    assert moves[2] == pytest.approx(unconstrained_load(pair).gain_moves)
    assert np.abs(moves[1]).max() > np.abs(moves[2]).max()  # a gain that is wrong in one run only looks like a load


@pytest.mark.parametrize("common", [False, True])
def test_intervals_of_the_mass_hold_the_truth_whatever_the_gains(common):
    """Gains of the robot file drawn about the true ones by its gain_std: each by itself, or all by the same share."""
    free, loaded = runs(3)
    file = load_robot("ur10e")
    relative = np.array([drive.gain_std / abs(drive.gain) for drive in file.robot.drives])
    # The estimate is linear in the gains: one identification says what every draw of them gives.
    pair = prepare_pair(free, loaded, read_joint_signals)
    reference = unconstrained_load(pair)
    place = reference.columns.names.index("M_L")
    moves, mass = reference.gain_moves[:, place], reference.parameters[place]
    generator = np.random.default_rng(0)
    draws = generator.standard_normal((4000, 1 if common else 6)) * np.ones(6)
    masses = mass.value + draws @ moves
    held = np.abs(masses - 2.8) <= 1.96 * mass.std
    assert np.mean(held) > 0.93
    for draw in draws[:2]:
        drives = tuple(
            drive.model_copy(update={"gain": drive.gain * (1 + share)})
            for drive, share in zip(file.robot.drives, relative * draw, strict=True)
        )
        other = file.model_copy(update={"robot": file.robot.model_copy(update={"drives": drives})})
        changed = identify_payload(free, loaded, None, other, pair.delay.used)
        assert changed.load[place].value == pytest.approx(mass.value + draw @ moves, abs=0.05)


def test_no_load_is_said():
    free, _ = runs(0)
    again = simulate_recording(
        load_robot("ur10e"),
        random_fourier_motion(build_model(load_robot("ur10e")), 20.0, seed=0, candidates=3),
        20.0,
        seed=99,
        rate=RATE,
    )
    each = identify_payload(free, again)
    assert any("no load detected" in warning for warning in each.warnings)


def test_friction_that_changed_is_said():
    text = load_robot("ur10e").text.replace("coulomb: 14.2", "coulomb: 16.2")
    warmer = parse_robot(text, where="warmer", folder=None)
    motion = random_fourier_motion(build_model(warmer), 20.0, seed=0, candidates=3)
    free, _ = runs(0)
    each = identify_payload(free, replace(simulate_recording(warmer, motion, 20.0, seed=5, rate=RATE)))
    assert each.tests.unchanged.worst == "Fs2"
    assert not each.tests.unchanged.passed
    assert any("friction or motor inertia changed" in warning for warning in each.warnings)


def test_joints_at_rest_are_said():
    robot_file = load_robot("ur10e")
    motion = random_fourier_motion(build_model(robot_file), 20.0, seed=1, candidates=2)
    moving = np.array([[0.0], [1.0], [1.0], [1.0], [1.0], [1.0]])
    still = replace(motion, sine=motion.sine * moving, cosine=motion.cosine * moving)
    free = simulate_recording(robot_file, still, 20.0, seed=0, rate=RATE)
    each = identify_payload(free, runs(1)[1])
    assert any(warning.startswith("shoulder_pan_joint rests throughout") for warning in each.warnings)
    assert "rests throughout" not in " ".join(identify_payload(*runs(1)).warnings)


def test_different_arms_are_refused(three_joint):
    free, loaded = runs(0)
    other = simulate_recording(
        three_joint, random_fourier_motion(build_model(three_joint), 10.0, seed=0, candidates=2), 5.0, seed=0
    )
    with pytest.raises(DataError, match=r"is of three_joint with joints .* not of ur10e"):
        identify_payload(free, other)
    moved = loaded.robot_text.replace("r: 0.11655", "r: 0.1")
    with pytest.raises(DataError, match="is placed differently"):
        identify_payload(free, replace(loaded, robot_text=moved))


def test_the_same_file_twice_is_refused(tmp_path):
    free, _ = runs(0)
    once = replace(free, path=tmp_path / "run.h5")
    with pytest.raises(UsageError, match="same file"):
        identify_payload(once, once)


def test_the_object_is_complete(found):
    content = found[0].model_dump()
    assert [row["name"] for row in content["load"]] == [f"{symbol}_L" for symbol in INERTIAL]
    assert content["tests"]["mass"]["passed"] is True
    assert content["not_identifiable"] == []
    assert {row["name"] for row in content["base_parameters"]} >= {"ZZR1", "MXR2", "MX6"}


def test_chi_square_of_chance_and_of_more():
    generator = np.random.default_rng(0)
    draws = generator.standard_normal((40, 5))
    covariance = draws.T @ draws / 40
    root = np.linalg.cholesky(covariance)
    chance = [chi_square_test(root @ generator.standard_normal(5), covariance, 10_000).p_value for _ in range(400)]
    assert np.mean(np.array(chance) < 0.05) == pytest.approx(0.05, abs=0.035)
    assert not chi_square_test(10 * root[:, 0], covariance, 100).passed
    along = chi_square_test(10 * root[:, 0], covariance, 100, root[:, :1])
    assert along.freedom == 4
    assert along.statistic == pytest.approx(0.0, abs=1e-9)
    assert chi_square_test(root[:, 0], covariance, 8) is None
