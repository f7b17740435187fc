"""Locked joints and chosen torques: found from positions, and what the arm can then show follows from the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each

from daq.robot.loader import load_robot
from drivers.core.errors import DataError, UsageError
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import build_model
from ident.model.regressor import regressor
from ident.regression.observability import (
    RIGHT_ANGLE,
    Experiment,
    describe,
    experiment_base,
    find_experiment,
    moving_motors,
    predictable_torques,
    whole_arm,
)
from ident.regression.options import REST_TOLERANCE, ExperimentChoices


@pytest.fixture(scope="module")
def ur(ur_like):
    return build_model(ur_like)


@pytest.fixture(scope="module")
def sr400():
    return build_model(load_robot("sr400"))


def positions(model, locked, pose, samples=2000, noise=0.0, seed=0):
    """Positions (N, n) of a motion with some joints at a pose."""
    generator = np.random.default_rng(seed)
    time = np.arange(samples)[:, None] / 200.0
    moving = np.sin(generator.uniform(1, 3, model.dof) * time + generator.uniform(0, 6, model.dof))
    moving[:, list(locked)] = pose
    return moving + noise * generator.standard_normal(moving.shape)


@each("noise", [0.0, 1e-5, 1e-3, 1e-2])
def test_what_stands_still_is_found_whatever_the_encoders_noise(ur, noise):
    found = find_experiment(ur, [("run", positions(ur, (3, 5), (0.3, -1.2), noise=noise))], ExperimentChoices())
    assert found.locked == (3, 5)
    assert found.torques == (0, 1, 2, 4)
    assert found.poses[0] == pytest.approx((0.3, -1.2), abs=5e-3)


@each("samples", [0, 1, 3])
def test_a_recording_without_motion_locks_nothing(ur, samples):
    """Whoever prepares it says so."""
    assert find_experiment(ur, [("run", np.zeros((samples, 6)))], ExperimentChoices()) == whole_arm(ur)


def test_a_creeping_joint_is_not_locked(ur):
    run = positions(ur, (3,), (0.3,))
    run[:, 3] += np.linspace(0.0, 2 * REST_TOLERANCE, len(run))
    assert find_experiment(ur, [("run", run)], ExperimentChoices()) == whole_arm(ur)


def test_a_joint_locked_in_one_recording_only_is_not_locked(ur):
    runs = [("a", positions(ur, (3,), (0.3,))), ("b", positions(ur, (), ()))]
    assert find_experiment(ur, runs, ExperimentChoices()).locked == ()


def test_poses_are_kept_apart_and_not_repeated(ur):
    runs = [(str(i), positions(ur, (3,), (angle,), seed=i)) for i, angle in enumerate((0.3, 0.3001, 0.8))]
    found = find_experiment(ur, runs, ExperimentChoices())
    assert len(found.poses) == 2
    # Two positions tell more than one.
    alone = replace(found, poses=found.poses[:1])
    assert experiment_base(ur, [found]).count > experiment_base(ur, [alone]).count


@each(("angle", "taken"), [(1e-3, 0.0), (np.pi / 2 - 1e-3, np.pi / 2), (0.01, 0.01)])
def test_nearly_a_right_angle_is_one(ur, angle, taken):
    assert RIGHT_ANGLE > 1e-3
    found = find_experiment(ur, [("run", positions(ur, (3,), (angle,)))], ExperimentChoices())
    assert found.poses == ((pytest.approx(taken, abs=1e-12),),)


def test_a_locked_joint_that_moves_is_refused_with_how_far(ur):
    with pytest.raises(DataError, match=r"joint j2 is declared locked but moves over 2 rad") as caught:
        find_experiment(ur, [("run.h5", positions(ur, (3,), (0.3,)))], ExperimentChoices(locked=("j4", "j2")))
    assert caught.value.where == "run.h5"
    assert "--start" in (caught.value.hint or "")


@pytest.mark.parametrize("choices", [ExperimentChoices(locked=("j9",)), ExperimentChoices(torques_of=("j1", ""))])
def test_names_that_no_joint_has_are_refused(ur, choices):
    with pytest.raises(UsageError, match="is called") as caught:
        find_experiment(ur, [("run", positions(ur, (), ()))], choices)
    assert "j1, j2" in (caught.value.hint or "")


def test_a_coupled_motor_turns_with_either_joint(sr400):
    names = sr400.joint_names
    assert [names[motor] for motor in moving_motors(sr400, [names.index("j6")])] == list(names)
    still = moving_motors(sr400, [names.index("j5"), names.index("j6")])
    assert [names[motor] for motor in still] == ["j1", "j2", "j4", "j7"]
    assert names.index("j6") in moving_motors(sr400, [names.index("j5")])
    assert names.index("j5") not in moving_motors(sr400, [names.index("j5")])


EXPERIMENTS = [
    Experiment((3, 4), ((0.0, 0.0),), (0, 1, 2, 5)),
    Experiment((3, 4), ((0.4, -1.1),), (0, 1, 2, 5)),
    Experiment((0, 5), ((0.2, 1.0), (1.2, -0.3)), (1, 2, 3, 4)),
    Experiment((), ((),), (3, 4)),
    Experiment((1,), ((-1.5,),), (2,)),
]


@pytest.mark.parametrize("robot", ["ur5e", "sr400"])
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_the_base_parameters_give_the_chosen_torques_and_no_fewer_do(robot, experiment):
    """Along random states with the joints locked: W_base·(P·π) = W·π, and the rank is their number."""
    model = build_model(load_robot(robot))
    base = experiment_base(model, [experiment])
    generator = np.random.default_rng(7)
    position, velocity, acceleration = random_states(model, 300, seed=8)
    locked = list(experiment.locked)
    pose = np.array(experiment.poses)[generator.integers(len(experiment.poses), size=300)].T
    position[locked], velocity[locked], acceleration[locked] = pose, 0.0, 0.0
    rows = regressor(model, position, velocity, acceleration)[list(experiment.torques)]
    system = rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])
    parameters = generator.standard_normal(rows.shape[1])
    expected = system @ parameters
    found = system[:, list(base.columns)] @ (base.projection @ parameters)
    assert np.max(np.abs(found - expected)) < 1e-8 * np.max(np.abs(expected))
    lengths = np.linalg.norm(system, axis=0)
    acting = lengths > 1e-9 * np.max(lengths)
    assert np.linalg.matrix_rank(system[:, acting] / lengths[acting], tol=1e-6) == base.count
    assert base.margin > 1e3


@each("robot", ["ur5e", "sr400"])
@each("experiment", EXPERIMENTS)
def test_they_are_combinations_of_the_whole_arm_s(robot, experiment):
    model = build_model(load_robot(robot))
    whole, base = base_parameters(model), experiment_base(model, [experiment])
    shares = base.projection[:, list(whole.columns)]
    assert np.allclose(shares @ whole.projection, base.projection, atol=1e-7 * np.max(np.abs(base.projection)))


@pytest.mark.parametrize(("wrist", "counts"), [(("j4", "j5", "j6"), (24, 32)), (("j5", "j6"), (34, 22))])
def test_the_paper_s_two_experiments_show_the_whole_sr400(sr400, wrist, counts):
    """SR400 .4.3 point 7: the wrist's own equations in free motion, then the wrist locked; they share nothing."""
    joints = tuple(sr400.joint_names.index(name) for name in wrist)
    arm = Experiment(joints, ((0.0,) * len(joints),), moving_motors(sr400, joints))
    free = Experiment((), ((),), joints)
    assert tuple(experiment_base(sr400, [one]).count for one in (arm, free)) == counts
    together = experiment_base(sr400, [arm, free])
    assert together.names == base_parameters(sr400).names
    assert together.expressions == base_parameters(sr400).expressions


def test_links_that_stand_still_are_regrouped_on_those_that_move(ur):
    base = experiment_base(ur, [Experiment((3, 4, 5), ((0.1, -1.2, 0.4),), (0, 1, 2))])
    assert {name[-1] for name in base.names} == {"1", "2", "3"}


def test_the_whole_arm_is_the_whole_arm(ur):
    assert experiment_base(ur, [whole_arm(ur)]) is base_parameters(ur)
    partial = Experiment((), ((),), (0,))
    assert experiment_base(ur, [partial, whole_arm(ur)]) is base_parameters(ur)


def test_what_a_model_predicts(ur):
    locked = Experiment((3,), ((0.3,),), (0, 1, 2, 4, 5))
    same, elsewhere = positions(ur, (3,), (0.3,)), positions(ur, (3,), (0.7,))
    free = positions(ur, (), ())
    assert predictable_torques(ur, [whole_arm(ur)], "run", free) == (0, 1, 2, 3, 4, 5)
    assert predictable_torques(ur, [locked], "run", same) == (0, 1, 2, 4, 5)
    assert predictable_torques(ur, [locked, Experiment((), ((),), (3,))], "run", same) == (0, 1, 2, 3, 4, 5)
    assert predictable_torques(ur, [Experiment((), ((),), (3,))], "run", same) == (3,)
    with pytest.raises(DataError, match=r"j4 is at 0\.7 rad"):
        predictable_torques(ur, [locked], "run", elsewhere)
    with pytest.raises(DataError, match=r"moves j4 over .* rad, and j4 was locked"):
        predictable_torques(ur, [locked], "run", free)


def test_words(ur):
    assert describe(ur, whole_arm(ur)) == "torques of all motors"
    assert (
        describe(ur, Experiment((3, 4), ((0.0, 0.5), (1.0, 0.5)), (0, 1)))
        == "locked: j4 at 0 rad, j5 at 0.5 rad; or j4 at 1 rad, j5 at 0.5 rad; torques of j1, j2"
    )
