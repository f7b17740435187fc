"""Mistakes of sign, column and gravity: what every arm satisfies, and which hypothesis wins."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from each import each
from random_arms import random_arm

from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import FloatArray
from ident.assessment.file_errors.model_errors import simplest_first
from ident.assessment.file_errors.refit import Refit
from ident.assessment.file_errors.unknowns import Unknown, tangents
from ident.assessment.instants import BLOCKS, Columns, Instants, instants
from ident.assessment.mistakes.checks import _check, mistake_checks
from ident.assessment.mistakes.competition import Competition, explanations
from ident.assessment.mistakes.conditions import friction_conditions, inertia_conditions, on_active
from ident.assessment.mistakes.hypotheses import as_recorded, mistakes
from ident.assessment.mistakes.ripple import less_ripples, ripple_checks
from ident.assessment.mistakes.shifts import shift_check
from ident.assessment.mistakes.unsigned import unsigned_torques
from ident.assessment.torque_level import _small_beside, torque_level_checks, weight_checks
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import BaseParameters, base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import weights_in_offsets
from ident.model.regressor import RegressorKernel
from ident.model.true_parameters import truth_vector
from ident.regression.observability import whole_arm
from ident.signals.prepared import Segment
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")

BOTH = Columns((0, 1, 2), (1.0, 1.0, 1.0))


@cache
def found_of(robot_file_text: str) -> Identification:
    robot_file = parse_robot(robot_file_text, where="mistakes", folder=None)
    motion = random_fourier_motion(build_model(robot_file), 10.0, 1, candidates=3)
    return identify([simulate_recording(robot_file, motion, 20.0, 1)], [], IdentifyChoices(search_delay=False))


@pytest.fixture(scope="module")
def found(three_joint: RobotFile) -> Identification:
    """A sound recording of the three-joint arm."""
    return found_of(three_joint.text)


def light(found: Identification) -> Instants:
    kernel = RegressorKernel(found.model, found.base.columns)
    return instants(kernel, [run.prepared for run in found.runs])


def competition(found: Identification, spoilt: Instants) -> Competition:
    return Competition(found.model, found.experiment, found.base, found.solution.active, spoilt)


@pytest.mark.parametrize("seed", range(0, 12, 2))
def test_true_parameters_meet_the_conditions(seed):
    """Whatever the arm: sliding joints, branches, no motor inertia, no friction."""
    robot_file = random_arm(seed)
    model = build_model(robot_file)
    base = base_parameters(model)
    truth = base.projection @ truth_vector(robot_file)
    position, velocity, acceleration = random_states(model, 200)
    counted = np.ones(position.shape, dtype=np.bool_)
    states = Instants(position, velocity, acceleration, position, counted, np.zeros(200, dtype=np.int64), np.zeros(200))
    kernel = RegressorKernel(model, base.columns)
    energies = energies_of(model, base) @ truth
    powers = friction_conditions(model, base, states, states.regressor(kernel)) @ truth
    assert len(energies)
    assert np.min(energies) > -1e-9 * np.max(np.abs(energies))
    assert np.min(powers, initial=0.0) > -1e-9 * np.max(np.abs(powers), initial=1.0)
    seen = np.flatnonzero(np.arange(base.count) != base.count - 1)
    assert np.min(on_active(energies_of(model, base), seen) @ truth[seen], initial=0.0) > -1e-9 * np.max(energies)


def energies_of(model: DynamicModel, base: BaseParameters) -> FloatArray:
    return inertia_conditions(model, whole_arm(model), base)


def test_every_hypothesis_is_undone_by_one_of_its_name():
    tried, values = mistakes(4, range(4)), np.arange(8.0).reshape(4, 2)
    for one in tried:
        alike = [other for other in tried if (other.name, other.joints) == (one.name, one.joints)]
        for columns in ("torques", "positions"):
            moved = getattr(one, columns).of(values)
            assert any(np.array_equal(getattr(other, columns).of(moved), values) for other in alike)


@pytest.mark.parametrize("number", range(len(mistakes(3, range(3)))))
def test_each_mistake_is_what_explains_the_data_or_stays_among_those_that_do(found, number):
    """What was done to the recording is undone by the same columns."""
    mistake = mistakes(3, range(3))[number]
    few = light(found)
    spoilt = replace(few.with_positions(mistake.positions), torque=mistake.torques.of(few.torque))
    said = explanations(competition(found, spoilt), [])
    if mistake.name == "joint-sign" and mistake.joints == (0,):  # a mirrored arm, the first axis being vertical
        assert not said
        return
    alike = {(one.name, one.joints) for one in said}
    assert said
    # Signs of a torque and of a position differ by the sign of both, which the first joint does not show.
    joints = {joint for one in said for joint in one.joints}
    assert (mistake.name, mistake.joints) in alike or joints <= {*mistake.joints, 0}


@pytest.mark.parametrize("signal", ["torques", "positions"])
def test_of_coupled_motors_the_remedy_is_that_of_what_was_recorded(found, signal):
    """`model.coupling` converts torques only."""
    few = light(found)
    torque = few.torque - np.array([[0.0], [0.0], [1.0]]) * few.torque[1]
    spoilt = few.less(1, 2, -1.0) if signal == "positions" else replace(few, torque=torque)
    check = _check(found.model, explanations(competition(found, spoilt), []), ())
    assert check.name == "motors-coupled"
    assert f"the {signal} of {' and '.join(found.model.joint_names[1:])} seem to be those of coupled" in check.text
    assert ("model.coupling" in check.text) == (signal == "torques") != ("convert the positions" in check.text)


def test_a_sound_recording_is_explained_as_it_is(found):
    sound = competition(found, light(found))
    assert sound.well_explained
    assert explanations(sound, []) == []
    runs = [run.prepared for run in found.runs]
    independent = found.corrected.effective_rows
    assert mistake_checks(found.model, found.experiment, found.base, runs, found.solution, independent) == []


def test_a_joint_without_equations_hides_no_torque(found):
    """A torque that nothing explains would not count in its place, and an offset explains a lift at rest."""
    few = light(found)
    counted, torque = few.counted.copy(), few.torque.copy()
    counted[2], torque[2] = False, 5.0
    torque[1] = np.random.default_rng(0).standard_normal(torque.shape[1])
    assert explanations(competition(found, replace(few, counted=counted, torque=torque)), []) == []


def turned_over(found: Identification) -> DynamicModel:
    """The arm as believed by someone who hung it from the ceiling."""
    return replace(found.model, gravity=-found.model.gravity)


def test_gravity_s_sign_competes_with_the_other_signs_however_few_samples_are_independent(found):
    believed = turned_over(found)
    runs = [run.prepared for run in found.runs]
    (check,) = mistake_checks(believed, found.experiment, found.base, runs, found.solution, 3.0)
    assert check.name == "gravity-opposite"


def test_of_directions_that_explain_alike_a_sign_is_named_and_else_the_smaller_turn(found):
    refit = Refit(turned_over(found), found.experiment, found.base.columns, light(found), found.solution)
    exact = refit.opposite_gravity()
    near, mirrored = (replace(exact, value=angle, std=0.01) for angle in (0.3, np.pi - 0.3))
    assert simplest_first([replace(mirrored, likelihood=exact.likelihood + 5.0), exact])[0] is exact
    assert simplest_first([replace(mirrored, likelihood=near.likelihood + 5.0), near])[0] is near
    far_better = replace(mirrored, likelihood=near.likelihood + 50.0)
    assert simplest_first([far_better, near, exact])[0] is far_better


def test_noise_alone_is_explained_by_nothing(found):
    """Torques that no arm made: no sign and no column explains them."""
    few = light(found)
    noise = np.random.default_rng(1).normal(size=few.torque.shape)
    assert explanations(competition(found, replace(few, torque=noise)), []) == []


@pytest.mark.parametrize("degrees", [4.0, 15.0, 80.0, 180.0])
@pytest.mark.parametrize("around", [0.0, 2.0])
def test_gravity_s_direction_is_found_within_its_interval(found, degrees, around):
    few = light(found)
    across = np.array([np.cos(around), np.sin(around)]) @ tangents(found.model.gravity)
    angle = np.deg2rad(degrees)
    believed = np.cos(angle) * found.model.gravity + 9.81 * np.sin(angle) * across
    refit = Refit(replace(found.model, gravity=believed), found.experiment, found.base.columns, few, found.solution)
    start = None if degrees < 90.0 else found.model.gravity + 1.0
    estimate = refit.deviation(Unknown("gravity"), start=start)
    assert estimate is not None
    error = np.arccos(np.clip(estimate.model.gravity @ found.model.gravity / 9.81**2, -1.0, 1.0))
    independent = refit.rows.sum() / found.corrected.effective_rows
    assert error < 4.0 * estimate.std * np.sqrt(independent)
    assert estimate.value == pytest.approx(angle, abs=np.deg2rad(1.5))
    assert estimate.std * np.sqrt(independent) < np.deg2rad(1.5)


@each("factor", [0.02, 0.1, 30.0])
def test_a_gain_that_was_left_at_1_is_found_from_afar(found, factor):
    few = light(found)
    spoilt = replace(few, torque=few.torque * np.array([1.0, 1.0, factor])[:, None])
    refit = Refit(found.model, found.experiment, found.base.columns, spoilt, found.solution)
    starts = (0.01, 0.1, 10.0, 100.0)
    estimates = [one for start in starts if (one := refit.deviation(Unknown("gain", 2), start=start)) is not None]
    best = max(estimates, key=lambda one: one.likelihood)
    assert 1.0 + best.value == pytest.approx(1.0 / (1.0 / factor), rel=0.1)


def test_an_arm_whose_torques_are_never_negative_was_recorded_without_signs_even_if_nothing_explains_them(found):
    generator = np.random.default_rng(2)

    def folded(negative: int | None) -> list[int]:
        def spoilt(segment: Segment) -> Segment:
            torque = np.abs(segment.torque * generator.uniform(0.5, 1.5, segment.torque.shape))
            if negative is not None:
                torque[negative] = segment.torque[negative]
            return replace(segment, torque=torque)

        runs = [
            replace(run.prepared, segments=tuple(spoilt(segment) for segment in run.prepared.segments))
            for run in found.runs
        ]
        kernel = RegressorKernel(found.model, found.base.columns)
        return unsigned_torques(competition(found, instants(kernel, runs)), runs)

    assert folded(None) == [0, 1, 2]
    assert 1 not in folded(1)


def test_a_torque_that_is_explained_as_it_is_has_its_sign_however_noisy_another_one_is(found):
    generator = np.random.default_rng(2)
    least = min(float(np.min(one.torque[1, one.used])) for run in found.runs for one in run.prepared.segments)

    def spoilt(segment: Segment) -> Segment:
        torque = segment.torque.copy()
        torque[0] = np.std(torque[0]) * generator.standard_normal(torque.shape[1])
        torque[1] -= least
        return replace(segment, torque=torque)

    runs = [
        replace(run.prepared, segments=tuple(spoilt(segment) for segment in run.prepared.segments))
        for run in found.runs
    ]
    kernel = RegressorKernel(found.model, found.base.columns)
    assert unsigned_torques(competition(found, instants(kernel, runs)), runs) == []


@pytest.mark.parametrize(("joint", "order", "degrees"), [(1, 8, 0.5), (2, 30, 0.08)])
def test_a_ripple_of_a_position_is_named_with_its_size_and_one_of_the_torque_is_not(found, joint, order, degrees):
    sound = light(found)
    spoilt = less_ripples(sound, {joint: order}, -np.deg2rad([[degrees, 0.0]]))
    (check,) = ripple_checks(competition(found, spoilt))
    assert (check.name, check.joints) == ("position-ripple", (found.model.joint_names[joint],))
    size, times = re.search(r"by ([\d.]+)° (\d+) times per turn", check.text).groups()
    assert (float(size), int(times)) == (pytest.approx(degrees, rel=0.15), order)
    wave = np.std(sound.torque[joint]) * np.sin(order * sound.position[joint])
    for size in (0.0, 0.1, 1.0):
        torque = sound.torque + size * wave * (np.arange(3) == joint)[:, None]
        assert ripple_checks(competition(found, replace(sound, torque=torque))) == []


@pytest.mark.parametrize("joints", [(1,), (0, 1, 2)])
@pytest.mark.parametrize("recordings", [1, 2])
def test_torques_of_another_time_are_named_however_many_recordings_there_are(found, recordings, joints):
    kernel = RegressorKernel(found.model, found.base.columns)
    few = instants(kernel, [run.prepared for run in found.runs] * recordings)
    few = replace(few, time=few.time + 1.3 * few.track)
    assert not shift_check(competition(found, few))
    torque = few.torque.copy()
    for joint, track in product(joints, range(recordings)):
        here = few.track == track
        torque[joint, here] = np.interp(few.time[here] - 0.5, few.time[here], few.torque[joint, here])
    (check,) = shift_check(competition(found, replace(few, torque=torque)))
    assert f"0.50 s before {'its' if joints == (1,) else 'their'} stamps" in check.text
    assert check.joints == (() if joints[1:] else (found.model.joint_names[1],))


def test_blocks_cover_the_recording(found):
    few = light(found)
    assert set(few.block) == set(range(BLOCKS))
    assert as_recorded(3).torques == BOTH


def test_currents_in_milliampere_show_in_gravity(found):
    positions = np.concatenate(
        [one.position[:, one.used] for run in found.runs for one in run.prepared.segments], axis=1
    )
    parameters, robot = found.solution.parameters, found.robot_file.robot
    assert weight_checks(robot, found.model, found.base, parameters, positions) == []
    (check,) = weight_checks(robot, found.model, found.base, 1e3 * parameters, positions)
    assert check.name == "implausible-load"


def test_gravity_is_compared_with_the_torque_limits(found):
    """Limits that gravity alone exceeds, and such as it hardly uses, of an arm that seems light, too."""
    positions = np.concatenate(
        [one.position[:, one.used] for run in found.runs for one in run.prepared.segments], axis=1
    )
    parameters, robot = found.solution.parameters, found.robot_file.robot

    def said(factor: float, apparent: float | None) -> list[str]:
        limits = [one.model_copy(update={"torque": factor * (3 - n)}) for n, one in enumerate(robot.joints)]
        rated = robot.model_copy(update={"joints": tuple(limits)})
        return [one.name for one in weight_checks(rated, found.model, found.base, parameters, positions, apparent)]

    assert said(30.0, 1.0) == []
    assert said(0.1, 10.0) == ["implausible-load"]
    assert said(1e4, 1e-3) == ["torque-far-below-limits"]
    assert said(1e4, 1e3) == []


@pytest.mark.parametrize("seed", [16, 18, 26])
def test_a_lift_carries_its_weight_though_it_shows_in_the_offset_alone(seed):
    lifting = random_arm(seed, sliding=0.4, trees=False)
    model, robot = build_model(lifting), lifting.robot
    base = base_parameters(model)
    parameters = base.projection @ truth_vector(lifting)
    ((lift, column),) = weights_in_offsets(model, base).items()
    positions = np.random.default_rng(seed).uniform(-1.0, 1.0, (model.dof, 50))

    def said(share: float) -> list[str]:
        torque = {one.name: 1e5 + n for n, one in enumerate(robot.joints)} | {lift: abs(parameters[column]) / share}
        limits = tuple(one.model_copy(update={"torque": torque[one.name]}) for one in robot.joints)
        rated = robot.model_copy(update={"joints": limits})
        return [one.name for one in weight_checks(rated, model, base, parameters, positions, 1e-3)]

    assert said(0.5) == []
    assert said(1e-4) == ["torque-far-below-limits"]


@pytest.mark.parametrize(("held", "names"), [(1.0, []), (0.02, ["torque-far-below-limits"])])
def test_torque_limits_that_are_placeholders_do_not_make_a_light_arm_wrong(held, names):
    """A URDF's effort of 1000 N·m; a gear ratio of 50 left out is found nevertheless."""
    urdf = """<robot name="finger"><link name="base"/><link name="rod"><inertial>
      <origin xyz="0 0 0.1"/><mass value="0.2"/>
      <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
      <limit lower="-3" upper="3" velocity="5" effort="1000"/></joint></robot>"""
    hinge = "{name: hinge, position: [-3, 3], velocity: 5, torque: 1000}"
    text = f"name: finger\nmodel: {{urdf: finger.urdf}}\njoints: [{hinge}]"
    robot_file = parse_robot(text, where="finger", folder=Path("."), urdf_text=urdf)
    torque = held * 0.2 * 9.81 * 0.1 * np.sin(np.linspace(-3.0, 3.0, 500))[:, None]
    assert [check.name for check in torque_level_checks(robot_file, build_model(robot_file), torque)] == names


def test_the_lighter_an_arm_seems_the_more_of_the_limits_gravity_may_take():
    """Where torques show no mass, friction that gears do not have says the same; arms that carry nothing do not."""
    assert _small_beside(0.09, 30.0, 3.0, None)
    assert not _small_beside(0.09, 30.0, 9.0, None)
    assert _small_beside(0.05, 30.0, 9.0, None)
    assert not _small_beside(0.2, 30.0, 1.0, 1e-3)
    assert _small_beside(0.05, 30.0, None, 5e-3)
    assert not _small_beside(0.05, 30.0, None, 0.05)
    assert not _small_beside(0.0, 30.0, None, 5e-3)
