"""The simulated arm obeys its equations of motion, and its sensors say what they should."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm_kinds import ARM_KINDS
from each import each

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector
from sim_drivers.can_signals.arm import MEASURED
from sim_drivers.plant.plant import Plant, PlantSettings
from sim_drivers.synthetic.measurement import random_fourier_motion

SIMULATED = [name for name in ARM_KINDS if load_robot(name).robot.truth.links]
FREE = PlantSettings(controller="none")
START = np.array([0.4, -1.1, 0.9, -0.3, 0.7, 0.2])


@pytest.fixture(scope="module")
def ur5e():
    return load_robot("ur5e")


@pytest.fixture(scope="module")
def frictionless(ur5e, with_truth):
    joints = {
        name: joint.model_copy(update={"viscous": 0.0, "coulomb": 0.0, "offset": 0.0})
        for name, joint in ur5e.robot.truth.joints.items()
    }
    return with_truth(ur5e, joints=joints)


def reference_arm(robot_file):
    robot = robot_file.robot
    arm = pinocchio_model(build_model(robot_file), truth_vector(robot_file)[: 10 * robot.dof])
    arm.armature = np.array([robot.truth.joints[name].motor_inertia for name in robot.joint_names])
    return arm, arm.createData()


def energy(robot_file, plant):
    arm, data = reference_arm(robot_file)
    inertia = pin.crba(arm, data, plant.position)
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    return 0.5 * plant.velocity @ inertia @ plant.velocity, pin.computePotentialEnergy(arm, data, plant.position)


def follow(plant, motion, duration, each=lambda: None):
    """Follow a motion from its start, at speed from the first instant on."""
    time = np.arange(round(duration * 500)) / 500
    position, velocity, acceleration = (values.T for values in motion.evaluate(time))
    plant.velocity = velocity[0].copy()
    errors = []
    for sample in range(len(time)):
        errors.append(position[sample] - plant.position)
        plant.set_target(position[sample], velocity[sample], acceleration[sample])
        plant.advance(0.002)
        each()
    return np.array(errors)


def energy_drift(robot_file, step):
    plant = Plant(robot_file, PlantSettings(controller="none", step=step), position=START)
    total, moving = [sum(energy(robot_file, plant))], []
    for _ in range(100):
        plant.advance(0.03)
        kinetic, potential = energy(robot_file, plant)
        total.append(kinetic + potential)
        moving.append(kinetic)
    return np.max(np.abs(np.array(total) - total[0])) / max(moving)


def test_a_free_arm_keeps_its_energy_to_second_order(frictionless):
    coarse, fine = energy_drift(frictionless, 1e-3), energy_drift(frictionless, 5e-4)
    assert coarse < 1e-4
    assert fine < 0.35 * coarse


def test_a_free_fall_is_that_of_pinocchio(frictionless):
    plant = Plant(frictionless, FREE, position=START)
    arm, data = reference_arm(frictionless)
    for _ in range(50):
        assert plant.acceleration == pytest.approx(
            pin.aba(arm, data, plant.position, plant.velocity, np.zeros(6)), rel=1e-4, abs=1e-4
        )
        plant.advance(0.01)
    assert np.max(np.abs(plant.velocity)) > 0.3


@pytest.mark.parametrize("controller", ["pid", "computed-torque"])
def test_it_holds_against_gravity(ur5e, controller):
    plant = Plant(ur5e, PlantSettings(controller=controller), position=START)
    plant.advance(1.0)
    settled = plant.position
    velocities = []
    for _ in range(200):
        plant.advance(0.01)
        velocities.append(np.max(np.abs(plant.velocity)))
    assert np.max(np.abs(plant.position - START)) < 1e-4
    assert np.max(np.abs(plant.position - settled)) < 2e-5
    assert max(velocities) < 1e-3


@pytest.mark.parametrize(("controller", "allowed"), [("pid", 8e-3), ("computed-torque", 1e-3)])
@pytest.mark.parametrize("name", ["ur5e", "aubo_i5"])
def test_it_follows_a_motion_at_500_hz(name, controller, allowed):
    robot_file = load_robot(name)
    motion = random_fourier_motion(build_model(robot_file), 10.0, seed=1, candidates=2)
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    plant = Plant(robot_file, PlantSettings(controller=controller), position=start)
    errors = follow(plant, motion, 4.0)[500:]
    assert np.max(np.abs(errors)) < allowed
    assert np.max(np.std(errors, axis=0)) > 1e-6  # it does move


def test_a_wrong_nominal_model_follows_worse_but_follows(ur5e):
    motion = random_fourier_motion(build_model(ur5e), 10.0, seed=1, candidates=2)
    start = motion.evaluate(np.zeros(1))[0][:, 0]
    worst = [
        np.max(
            np.abs(
                follow(
                    Plant(ur5e, PlantSettings(controller="computed-torque", nominal_share=share), position=start),
                    motion,
                    2.0,
                )[250:]
            )
        )
        for share in (1.0, 0.8)
    ]
    assert 2.0 * worst[0] < worst[1] < 1e-2


@pytest.mark.parametrize("controller", ["pid", "computed-torque"])
def test_the_drive_torque_is_the_inverse_dynamics_of_the_motion(ur5e, controller):
    motion = random_fourier_motion(build_model(ur5e), 10.0, seed=1, candidates=2)
    plant = Plant(ur5e, PlantSettings(controller=controller), position=motion.evaluate(np.zeros(1))[0][:, 0])
    arm, data = reference_arm(ur5e)
    joints = [ur5e.robot.truth.joints[name] for name in ur5e.robot.joint_names]
    coulomb, viscous, offset = (np.array([getattr(j, key) for j in joints]) for key in ("coulomb", "viscous", "offset"))
    differences, sliding = [], []

    def compare():
        rigid = pin.rnea(arm, data, plant.position, plant.velocity, plant.acceleration)
        friction = viscous * plant.velocity + coulomb * np.sign(plant.velocity) + offset
        differences.append(plant.drive_torque - rigid - friction)
        sliding.append(np.abs(plant.velocity) > 0.1)

    follow(plant, motion, 3.0, compare)
    relative = np.abs(np.array(differences)[100:]) / np.array([j.torque for j in ur5e.robot.joints])
    chosen = np.array(sliding)[100:]
    assert np.mean(chosen) > 0.5
    assert np.max(relative[chosen]) < 1e-3


def test_a_seed_makes_it_repeatable(ur5e):
    def run(seed):
        plant = Plant(ur5e, seed=seed, position=START)
        plant.set_target(START + 0.05)
        samples = []
        for _ in range(20):
            plant.advance(0.002)
            samples.append(plant.measure())
        return {name: np.array([getattr(sample, name) for sample in samples]) for name in ("time", *MEASURED)}

    one, same, other = run(3), run(3), run(4)
    for quantity in one:
        assert np.array_equal(one[quantity], same[quantity]), quantity
    assert np.array_equal(one["position"], other["position"])
    assert not np.array_equal(one["current"], other["current"])


def test_time_adds_up_whatever_the_portions(pendulum):
    whole, portions = Plant(pendulum()), Plant(pendulum())
    whole.advance(1.0)
    for _ in range(3000):
        portions.advance(1.0 / 3000.0)
    assert whole.time == portions.time == pytest.approx(1.0)
    assert np.array_equal(whole.position, portions.position)


def test_positions_are_whole_encoder_steps(pendulum):
    plant = Plant(pendulum(noise="encoder_resolution: 1.0e-3"), FREE, position=np.array([0.1234567]))
    for _ in range(50):
        plant.advance(0.002)
        measured = plant.measure()
        steps = measured.position / 1e-3
        assert steps == pytest.approx(np.round(steps), abs=1e-9)
        assert np.abs(measured.position - plant.position) <= 0.5e-3 + 1e-12
    assert not np.allclose(plant.position / 1e-3, np.round(plant.position / 1e-3), atol=1e-3)


@pytest.mark.parametrize("gain", [10.0, -8.0])
def test_current_is_torque_over_gain_with_its_sign(pendulum, gain):
    plant = Plant(pendulum("coulomb: 1", gain=gain), position=np.zeros(1))
    plant.advance(1.0)
    measured = plant.measure()
    assert measured.torque == pytest.approx(2 * 0.25 * 9.81, abs=1.05)
    assert measured.current * gain == pytest.approx(measured.torque)
    assert np.sign(measured.current) == np.sign(gain)
    assert measured.target_torque == pytest.approx(2 * 0.25 * 9.81)


def test_without_a_gain_the_current_is_the_torque():
    measured = Plant(load_robot("up6")).measure()
    assert np.array_equal(measured.current, measured.torque)


def test_noise_and_ripple_have_their_size(pendulum):
    noisy = Plant(pendulum("coulomb: 9", noise="torque_std: {swing: 0.3}"), FREE)
    values = np.array([noisy.measure().torque[0] for _ in range(4000)])
    assert np.std(values) == pytest.approx(0.3, rel=0.05)
    assert np.mean(values) == pytest.approx(0.0, abs=0.03)
    noise = "ripple_amplitude: {swing: 0.5}, ripple_per_revolution: 7"
    rippled = Plant(pendulum(noise=noise), FREE, position=np.array([-1.5]))
    seen = []
    for _ in range(2000):
        rippled.advance(0.002)
        seen.append((rippled.position[0], rippled.measure().torque[0]))
    position, torque = np.array(seen).T
    columns = np.column_stack([np.sin(7 * position), np.cos(7 * position)])
    amplitudes, residual, _, _ = np.linalg.lstsq(columns, torque, rcond=None)
    assert np.hypot(*amplitudes) == pytest.approx(0.5)
    assert residual < 1e-12


def test_a_delayed_torque_is_the_same_torque_later(pendulum):
    prompt = Plant(pendulum("coulomb: 1"))
    late = Plant(pendulum("coulomb: 1", noise="torque_delay: 0.006"))
    torques = []
    for sample in range(100):
        for plant in (prompt, late):
            plant.set_target(np.array([0.2 * np.sin(0.1 * sample)]))
            plant.advance(0.002)
        torques.append((prompt.measure().torque[0], late.measure().torque[0]))
    first, second = np.array(torques).T
    assert np.array_equal(first[:-3], second[3:])
    assert np.ptp(first) > 1.0


def test_a_torque_meter_behind_the_motor_does_not_see_its_inertia(pendulum):
    robot_file = pendulum()
    behind = parse_robot(
        robot_file.text.replace("signal: current", "signal: current, inertia: false"), where="behind", folder=None
    )
    plant = Plant(behind, FREE, position=np.zeros(1))
    plant.advance(0.1)
    assert plant.measure().torque == pytest.approx(-0.3 * plant.acceleration)


@pytest.mark.parametrize("controller", ["pid", "computed-torque"])
@pytest.mark.parametrize("deceleration", [2.0, 8.0])
def test_halt_stops_within_its_limits(ur5e, controller, deceleration):
    motion = random_fourier_motion(build_model(ur5e), 6.0, seed=2, candidates=2)
    plant = Plant(ur5e, PlantSettings(controller=controller), position=motion.evaluate(np.zeros(1))[0][:, 0])
    follow(plant, motion, 2.0)
    start, speed = plant.position, plant.velocity
    assert np.max(np.abs(speed)) > 0.5
    plant.halt(deceleration)
    plant.advance(np.max(np.abs(speed)) / deceleration + 0.3)
    assert np.max(np.abs(plant.velocity)) < 0.01
    travel = plant.position - start
    assert np.all(np.abs(travel - np.sign(speed) * speed**2 / (2 * deceleration)) < 0.01)
    rest = plant.position
    plant.advance(1.0)
    # At rest the integral slowly unloads the friction, which moves the joints by steps of the encoder.
    assert np.max(np.abs(plant.position - rest)) < 5e-3
    assert np.max(np.abs(plant.velocity)) < 5e-3
    # A new target ends the stop.
    plant.set_target(rest + 0.02)
    plant.advance(1.0)
    assert plant.position == pytest.approx(rest + 0.02, abs=2e-3)


@pytest.mark.parametrize("controller", ["pid", "computed-torque"])
@pytest.mark.parametrize("name", SIMULATED)
def test_every_built_in_arm_runs(name, controller):
    plant = Plant(load_robot(name), PlantSettings(controller=controller))
    middle = plant.position
    for sample in range(100):
        plant.set_target(middle + 0.1 * np.sin(np.pi * sample / 50))
        plant.advance(0.02)
        measured = plant.measure()
        for quantity in MEASURED:
            assert np.all(np.isfinite(getattr(measured, quantity))), quantity
    assert measured.time == pytest.approx(2.0)
    assert np.max(np.abs(plant.position - middle)) < 0.3


def test_a_blocked_joint_stays_where_it_is_and_the_others_go_on(ur5e):
    plant = Plant(ur5e, seed=1)
    step = np.array([0.3, 0.2, 0.3, 0.2, 0.2, 0.2])
    target = plant.position + step
    plant.set_target(target)
    plant.advance(0.05)
    assert abs(plant.velocity[2]) > 0.1
    plant.block(2)
    jammed = plant.position[2]
    plant.advance(2.0)
    assert plant.position[2] == pytest.approx(jammed, abs=1e-4)
    others = np.arange(6) != 2
    np.testing.assert_allclose(plant.position[others], target[others], atol=0.02)
    assert np.all(np.isfinite(plant.measure().torque))
    with pytest.raises(ValueError, match="no joint 6"):
        plant.block(6)


def test_drives_do_not_exceed_their_limit(pendulum):
    plant = Plant(pendulum(), position=np.zeros(1))
    plant.set_target(np.array([3.0]))
    seen = []
    for _ in range(500):
        plant.advance(0.002)
        seen.append(plant.drive_torque[0])
    assert max(np.abs(seen)) == 60.0
    plant.advance(3.0)
    assert plant.position == pytest.approx(3.0, abs=1e-3)


@each("wrong", [np.zeros(2), np.array([np.nan]), np.zeros((1, 1))])
def test_vectors_must_fit(pendulum, wrong):
    with pytest.raises(ValueError, match="position"):
        Plant(pendulum(), position=wrong)
    with pytest.raises(ValueError, match="velocity"):
        Plant(pendulum()).set_target(np.zeros(1), wrong)


def test_impossible_settings_are_refused(pendulum):
    with pytest.raises(ValueError, match="step"):
        PlantSettings(step=0.0)
    with pytest.raises(ValueError, match="controller settings"):
        PlantSettings(bandwidth=-1.0)
    with pytest.raises(ValueError, match="deceleration"):
        Plant(pendulum()).halt(0.0)


def test_an_arm_without_a_truth_is_refused():
    text = (
        "name: real\nmodel: {mdh: [{joint: a, alpha: 0, d: 0, r: 0}]}\n"
        "joints: [{name: a, position: [-1, 1], velocity: 1}]\n"
    )
    with pytest.raises(RobotFileError, match="no true link"):
        Plant(parse_robot(text, where="real", folder=None))
    point = "truth: {links: {a: {mass: 1, com: [0, 0, 0.1], inertia: [0, 0, 0, 0, 0, 0]}}}\n"
    with pytest.raises(RobotFileError, match="moves no inertia"):
        Plant(parse_robot(text + point, where="point", folder=None))


@each("duration", [-0.1, float("nan"), float("inf")])
def test_time_does_not_run_backwards(pendulum, duration):
    with pytest.raises(ValueError, match="advance"):
        Plant(pendulum()).advance(duration)


def test_impossible_temperatures_and_joints_are_refused(pendulum):
    plant = Plant(pendulum())
    for celsius in (-300.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="works"):
            plant.heat(0, celsius)
    for joint in (1, -1):
        with pytest.raises(ValueError):
            plant.heat(joint, 1.0)
