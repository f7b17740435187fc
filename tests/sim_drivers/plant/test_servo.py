"""Simulated servos: each imperfection does what its truth says, and nothing where it is not asked for."""

from __future__ import annotations

import numpy as np
import pytest

from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import TruthSupply
from drivers.core.errors import RobotFileError
from sim_drivers.plant.servo import ServoArm
from sim_drivers.synthetic.servo import record_servo
from studies.synthetic.altered_arms import another_unit, true_values, with_servos

PAN, LIFT = 0, 1


@pytest.fixture(scope="module")
def file() -> RobotFile:
    return with_servos(load_robot("so101"), bias=0.0)


def held(arm: ServoArm, goal: np.ndarray, seconds: float) -> np.ndarray:
    """Joint positions (K, n) while a goal is held."""
    rows = []
    for _ in range(round(seconds / arm.step)):
        arm.advance(goal)
        rows.append(arm.position.copy())
    return np.array(rows)


def test_a_saturated_servo_turns_no_faster_than_its_no_load_speed_at_its_supply(file):
    ideal = {"viscous": 0.0, "coulomb": 0.0}
    for share in (1.0, 0.7):
        supply = TruthSupply(nominal=12.0, voltage=12.0 * share)
        fast = with_servos(file, supply, ideal, no_load_speed=3.0, load_friction=0.0)
        arm = ServoArm(fast, np.zeros(6))
        goal = np.zeros(6)
        goal[PAN] = 1.9
        path = held(arm, goal, 0.3)[:, PAN]
        assert np.diff(path).max() / arm.step == pytest.approx(3.0 * share, rel=0.02)


def test_a_supply_sags_by_the_current_that_is_drawn(file):
    supply = TruthSupply(nominal=12.0, voltage=12.0, resistance=0.5)
    arm = ServoArm(with_servos(file, supply, no_load_speed=5.0, stall_current=2.7), np.zeros(6))
    goal = np.zeros(6)
    goal[PAN] = 1.9
    held(arm, goal, 4 * arm.step)
    drawn = float(np.abs(arm.current).sum())
    assert arm.current[PAN] > 2.0
    assert arm.supply == pytest.approx(1.0 - 0.5 * drawn / 12.0, abs=0.02)


def test_play_is_crossed_and_kept(file):
    play, gear = 0.02, 5000.0
    arm = ServoArm(with_servos(file, backlash=play, gear_stiffness=gear), np.zeros(6))
    gaps = []
    for target in (0.2, -0.2):
        goal = np.full(6, target)
        for _ in range(250):
            arm.advance(goal)
            gaps.append((arm.motor - arm.position)[PAN])
    truth = file.robot.truth.joints[file.robot.joint_names[PAN]]
    closing = np.abs(np.diff(gaps)).max() / arm.step
    yielding = truth.servo.torque_limit / gear + closing * np.sqrt(truth.motor_inertia / gear)
    for gap in (max(gaps), -min(gaps)):
        assert play / 2 <= gap <= play / 2 + yielding  # what the gear yields: to the torque, and to the impact


def test_a_warm_winding_weakens_a_servo_by_its_resistance(file):
    ideal = {"coulomb": 0.0, "viscous": 0.5}
    warm = with_servos(file, None, ideal, load_friction=0.0, no_load_speed=5.0, resistance_slope=0.004)
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
    sags = []
    for celsius in (23.0, 73.0):
        arm = ServoArm(warm, pose, celsius)
        sags.append((pose - held(arm, pose, 1.0)[-1])[LIFT])
    assert abs(sags[0]) > 0.01
    assert sags[1] / sags[0] == pytest.approx(1.0 + 50 * 0.004, rel=0.03)


def test_a_servo_that_works_warms_and_says_so(file):
    hot = with_servos(file, None, stall_current=2.7, resistance_slope=0.004)
    arm = ServoArm(hot, np.zeros(6))
    goal = np.zeros(6)
    goal[LIFT] = 1.0
    held(arm, goal, 1.0)
    assert arm.heat.winding[LIFT] > arm.heat.ambient
    time = np.arange(10) / 50
    run = record_servo(hot, time, np.zeros((10, 6)), 0)
    assert run.streams["joints"].channels["temperature"].values.shape == (10, 6)


def test_a_loop_that_sees_steps_rests_within_them(file):
    step = 0.01
    arm = ServoArm(with_servos(file, encoder_step=step), np.zeros(6))
    goal = np.full(6, 0.2)
    path = held(arm, goal, 1.2)
    assert np.ptp(path[-50:, PAN]) < 1e-9
    free = ServoArm(with_servos(file), np.zeros(6))
    assert not np.allclose(held(free, goal, 1.2)[-1], path[-1], atol=1e-5)


def test_commands_come_late_by_their_delay_and_jitter(file):
    ideal = {"coulomb": 0.0}
    time = np.arange(20) / 50
    command = np.zeros((20, 6))
    command[5:, PAN] = 0.3
    begins = {}
    for delay, jitter in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1)):
        late = with_servos(file, None, ideal, delay=delay, jitter=jitter)
        path = record_servo(late, time, command, 3).streams["joints"].channels["position"].values[:, PAN]
        begins[delay, jitter] = time[np.argmax(path > 0.01)]
    assert begins[0.1, 0.0] - begins[0.0, 0.0] == pytest.approx(0.1, abs=0.021)
    assert 0.0 <= begins[0.0, 0.1] - begins[0.0, 0.0] <= 0.121


def test_a_joint_without_a_servo_is_named(file):
    joints = {**file.robot.truth.joints}
    joints["elbow_flex"] = joints["elbow_flex"].model_copy(update={"servo": None})
    truth = file.robot.truth.model_copy(update={"joints": joints})
    without = file.model_copy(update={"robot": file.robot.model_copy(update={"truth": truth})})
    with pytest.raises(RobotFileError, match="elbow_flex"):
        ServoArm(without, np.zeros(6))


def test_another_unit_differs_by_its_spread_and_only_in_servos(file):
    other, same = another_unit(file, 0.1, 1), another_unit(file, 0.0, 1)
    assert same.robot.truth == file.robot.truth
    factors = [
        getattr(other.robot.truth.joints[name], field) / getattr(joint, field)
        for name, joint in file.robot.truth.joints.items()
        for field in ("motor_inertia", "viscous", "coulomb")
    ]
    assert 0.05 < np.std(np.log(factors)) < 0.2
    assert other.robot.truth.links == file.robot.truth.links
    assert other.text == file.text


def test_true_values_are_those_of_the_supply_and_count_back_emf_as_damping(file):
    low = with_servos(file, TruthSupply(nominal=12.0, voltage=9.0), no_load_speed=4.0, jitter=0.01, gain_d=0.3)
    values, joint = true_values(low)["elbow_flex"], low.robot.truth.joints["elbow_flex"]
    assert joint.servo is not None
    assert values["stiffness"] == pytest.approx(0.75 * joint.servo.stiffness)
    assert values["torque_limit"] == pytest.approx(0.75 * joint.servo.torque_limit)
    assert values["damping"] == pytest.approx(joint.viscous + 0.3 + joint.servo.torque_limit / 4.0)
    assert values["delay"] == pytest.approx(joint.servo.delay + 0.005)
