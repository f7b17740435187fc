"""Forward simulation: energy, agreement with an ordinary integrator, rest, stops, closed loops, coupled motors."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from each import each
from loop_arms import FOUR_BAR, four_bar_arm
from true_results import true_result

import dynid
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.model.dynamics.energy import EnergyKernel
from ident.result.result_file import stored_model

SLIDE = """\
name: slide
model:
  mdh:
    - {joint: slide, type: prismatic, alpha: pi/2, d: 0, r: 0}
joints: [{name: slide, position: [-9, 9], velocity: 9, acceleration: 9, torque: 99}]
drives: [{joint: slide, gain: 1, signal: torque, inertia: false}]
truth:
  links: {slide: {mass: 2.0, com: [0, 0, 0], inertia: [0.01, 0, 0, 0.01, 0, 0.01]}}
  joints: {slide: {coulomb: 3.0}}
"""
"""A block of 2 kg on a level slide, 3 N of dry friction."""


@functools.cache
def arm(name: str) -> RobotFile:
    if name == "four_bar":
        return four_bar_arm()
    if name == "coupled_four_bar":
        coupled = FOUR_BAR.replace("joints:\n", "  coupling: {wrist: {wrist: 1, crank: 0.5}}\njoints:\n", 1)
        return parse_robot(coupled, where="arm.yaml", folder=None)
    return parse_robot(SLIDE, where="slide.yaml", folder=None) if name == "slide" else load_robot(name)


@functools.cache
def model(name: str, *, friction: bool = True) -> dynid.Model:
    """The true model of an arm."""
    result = true_result(arm(name))
    if friction:
        return dynid.Model(result, "full")
    kept = ("inertial", "motor_inertia")
    without = {p.name: 0.0 for p in result.base_parameters if p.kind not in kept and not p.name.startswith("Iac")}
    return dynid.Model(true_result(arm(name), without), "full")


def start(name: str) -> np.ndarray:
    """A posture that gravity moves."""
    middle = np.array([0.5 * sum(joint.position) for joint in arm(name).robot.joints])
    return middle + (0.1 if "four_bar" in name else 0.3)


def energy(of: dynid.Model, motion: dynid.SimulatedMotion) -> np.ndarray:
    stored = stored_model(of.result)
    kernel = EnergyKernel(stored.model, stored.base.columns)
    states = [np.ascontiguousarray(part.T) for part in (motion.position, motion.velocity)]
    return of.parameters["value"] @ kernel.energy(*states)


@pytest.mark.parametrize(
    ("name", "duration", "step"),
    [
        ("ur5e", 1.0, 2e-3),
        ("panda", 0.3, 1e-3),
        ("sr400", 0.6, 2e-3),
        ("four_bar", 0.3, 2e-3),
        ("coupled_four_bar", 0.3, 2e-3),
    ],
)
def test_energy_is_conserved_without_friction_to_second_order_in_the_step(name, duration, step):
    free = model(name, friction=False)
    errors = []
    for length in (step, step / 2):
        motion = free.simulate(start(name), np.zeros(free.dof), None, duration, step=length)
        kinetic = 0.5 * np.einsum("Ni,Nij,Nj->N", motion.velocity, free.mass_matrix(motion.position), motion.velocity)
        errors.append(np.ptp(energy(free, motion)) / kinetic.max())
        assert kinetic.max() > 0.01
    assert errors[0] < 2e-3
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.parametrize("name", ["ur5e", "sr400", "coupled_four_bar"])
def test_sliding_joints_move_as_an_ordinary_integrator_of_the_forward_dynamics_says(name):
    from scipy.integrate import solve_ivp

    full = model(name)
    n = full.dof
    q0, dq0 = start(name), np.full(n, 0.4)
    q0 = q0 - 0.05
    holding = full.gravity(q0) + full.friction(dq0)
    duration = 0.1

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        return np.concatenate([state[n:], full.forward_dynamics(state[:n], state[n:], holding)])

    expected = solve_ivp(rate, (0.0, duration), np.concatenate([q0, dq0]), rtol=1e-9, atol=1e-10).y[:, -1]
    motion = full.simulate(q0, dq0, holding, duration)
    assert np.all(motion.velocity * dq0 > 0)  # nothing reversed
    np.testing.assert_allclose(motion.position[-1], expected[:n], rtol=0, atol=1e-5)
    np.testing.assert_allclose(motion.velocity[-1], expected[n:], rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", ["ur5e", "sr400", "four_bar", "coupled_four_bar"])
def test_an_arm_that_friction_holds_stays_where_it_is(name):
    full = model(name)
    q0 = start(name)
    motion = full.simulate(q0, np.zeros(full.dof), full.gravity(q0) + full.friction(np.zeros(full.dof)), 0.05)
    np.testing.assert_allclose(motion.position, np.broadcast_to(q0, motion.position.shape), rtol=0, atol=1e-12)


def test_a_block_stops_when_and_where_friction_says_and_breaks_away_above_its_limit():
    slide = model("slide")
    motion = slide.simulate([0.0], [1.5], None, 1.5)  # decelerates at 1.5 m/s²: stops at 1 s after 0.75 m
    after = motion.time > 1.0 + 2e-3
    np.testing.assert_allclose(motion.velocity[after], 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.position[after], 0.75, rtol=0, atol=2e-3)
    held = slide.simulate([0.0], [0.0], [2.99], 0.5)
    np.testing.assert_allclose(held.position, 0.0, rtol=0, atol=1e-15)
    moved = slide.simulate([0.0], [0.0], [5.0], 1.0)  # 1 m/s² beyond friction
    np.testing.assert_allclose(moved.position[-1], 0.5, rtol=0, atol=1e-9)


def test_torque_samples_are_interpolated_and_a_controller_is_asked_once_a_step():
    slide = model("slide")
    ramp = np.linspace(3.0, 7.0, 11)[:, None]  # acceleration from 0 to 2 m/s² in 2 s: v = 2 m/s
    motion = slide.simulate([0.0], [1e-6], ramp, 2.0)
    np.testing.assert_allclose(motion.velocity[-1], 2.0, atol=1e-4)
    times = []

    def controller(time, position, velocity):
        times.append(time)
        return -200.0 * position - 40.0 * velocity

    controlled = slide.simulate([0.1], [0.0], controller, 1.0)
    np.testing.assert_array_equal(times, controlled.time[:-1])
    assert abs(controlled.position[-1, 0]) < 0.1
    np.testing.assert_array_equal(controlled.torque[-1], controlled.torque[-2])


def test_the_torque_of_a_simulated_motion_is_that_of_the_inverse_dynamics():
    full = model("ur5e")
    motion = full.simulate(start("ur5e"), np.full(6, 0.5), lambda t, q, dq: full.gravity(q) + 3.0 - dq, 0.4)
    middle = slice(50, -50)
    change = (motion.velocity[2:] - motion.velocity[:-2]) / (motion.time[2] - motion.time[0])
    ran = np.all(np.abs(motion.velocity) > 0.05, axis=1)[1:-1][middle]
    predicted = full.torque(motion.position[1:-1], motion.velocity[1:-1], change)[middle]
    applied = 0.5 * (motion.torque[:-2] + motion.torque[1:-1])[middle]  # that of the steps before and after
    assert ran.sum() > 100
    np.testing.assert_allclose(predicted[ran], applied[ran], rtol=0, atol=1e-2)


def test_what_cannot_be_simulated_is_refused_in_words():
    full = model("ur5e")
    still = np.zeros(6)
    name = next(p.name for p in full.result.base_parameters if p.kind == "coulomb")
    negative = dynid.Model(true_result(arm("ur5e"), {name: -1.0}), "full")
    with pytest.raises(dynid.ModelError, match=r"negative Coulomb friction .*shoulder_pan.* \(-1 N·m\)"):
        negative.simulate(still, still, None, 1.0)
    unknown = dynid.Model(true_result(arm("ur5e"), {name: None}), "full")
    with pytest.raises(dynid.ModelError, match=f"{name} has no value"):
        unknown.simulate(still, still, None, 1.0)
    with pytest.raises(dynid.ModelError, match=r"diverges at 0\.00\d s: \w+ passes 10000 rad/s.*kg·m².*1e\+09 N·m"):
        full.simulate(still, still, np.full(6, 1e9), 1.0)
    light = {p.name: -5.0 for p in full.result.base_parameters if p.name.startswith("ZZ")}
    with pytest.raises(dynid.ModelError, match="not positive definite at 0 s"):
        dynid.Model(true_result(arm("ur5e"), light), "full").simulate(still, still, None, 1.0)


def test_a_divergence_names_its_cause():
    slide = model("slide")
    with pytest.raises(dynid.ModelError, match=r"slide passes 10000 m/s, its inertia 2 kg there.* N .*sign at every"):
        slide.simulate([0.1], [0.0], lambda t, q, dq: -1e4 * q - 1e4 * dq, 1.0)
    full = model("ur5e")
    name = next(p.name for p in full.result.base_parameters if p.kind == "viscous" and p.joint == "wrist_3_joint")
    driven = dynid.Model(true_result(arm("ur5e"), {name: -300.0}), "full")
    with pytest.raises(dynid.ModelError, match=r"wrist_3_joint passes.*viscous friction is negative"):
        driven.simulate(np.zeros(6), np.full(6, 0.5), None, 1.0)


def test_an_arm_that_leaves_its_loop_is_refused_with_the_time():
    rocker = four_bar_arm(**{"d: 0.25, r: 0}": "d: 0.45, r: 0}", "[-2.4, -0.4]": "[-1.6, -0.8]"})
    with pytest.raises(dynid.ModelError, match=r"at 0\.\d+ s the loop of coupler, rocker does not close"):
        dynid.Model(true_result(rocker), "full").simulate([0.0, -1.2, 0.0], [0.0, 40.0, 0.0], None, 0.5)


@each(
    ("changes", "message"),
    [
        ({"q0": np.zeros((3, 6))}, "3 rows|shape"),
        ({"q0": np.zeros(5)}, "q0: has shape"),
        ({"dq0": np.full(6, np.nan)}, "dq0: is not finite"),
        ({"torque": np.zeros(5)}, "torque: has shape"),
        ({"torque": np.zeros((1, 6))}, "torque: has 1 row"),
        ({"torque": lambda t, q, dq: [0.0]}, "controller returned shape"),
        ({"torque": lambda t, q, dq: ["a"] * 6}, "controller returned no numbers"),
        ({"torque": lambda t, q, dq: np.full(6, np.inf)}, "controller's torque of .* is not finite at 0 s"),
        ({"duration": -1.0}, "duration: -1 is not a positive"),
        ({"duration": np.inf}, "duration: inf is not a positive"),
        ({"step": 0.0}, "step: 0 is not a positive"),
        ({"step": 1e-9}, "step: .*longer steps"),
    ],
)
def test_bad_input_is_refused(changes, message):
    given = {"q0": np.zeros(6), "dq0": np.zeros(6), "torque": None, "duration": 0.01, **changes}
    with pytest.raises(dynid.DynidError, match=message):
        model("ur5e").simulate(**given)
