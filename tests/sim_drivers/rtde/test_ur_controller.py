"""The simulated controller without sockets: references of its motions, the control script, safety, typed faults."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from each import each
from exact_plant import ExactPlant
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.rtde import protocol
from sim_drivers.plant.control import Reference
from sim_drivers.rtde.control_script import ControlScript, ScriptSession
from sim_drivers.rtde.controller import DRIFT_ACCELERATION, NORMAL, PROTECTIVE_STOP, Controller
from sim_drivers.rtde.joint_motion import JointMotion, MoveJ, ServoJ, VelocityRamp
from sim_drivers.rtde.session import RtdeSession
from sim_drivers.rtde.variables import PackageRecipe, parse_version

PERIOD = 0.002
LIMIT = np.full(6, math.pi)
JOINTS = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)


def run(motion: JointMotion, periods: int = 20_000) -> list[Reference]:
    references = []
    for _ in range(periods):
        references.append(motion.step(PERIOD))
        if motion.finished:
            return references
    raise AssertionError("the motion does not end")


def controller(version: str = "5.22") -> Controller:
    made = Controller(ExactPlant(), parse_version(version), PERIOD)
    made.start_program(ControlScript(0))
    return made


def command(controller: Controller, number: int, *vector: float, integer: int = 0) -> None:
    registers = {f"input_double_register_{index}": value for index, value in enumerate(vector)}
    controller.write_inputs({"input_int_register_0": number, "input_int_register_1": integer, **registers})
    controller.step()


@settings(max_examples=20)
@given(JOINTS, JOINTS, JOINTS, st.floats(1.0, 5.0), st.floats(5.0, 40.0))
def test_movej_arrives_smoothly_within_its_limits(
    start: np.ndarray, velocity: np.ndarray, target: np.ndarray, speed: float, acceleration: float
) -> None:
    begin = Reference(start, velocity, np.zeros(6))
    references = run(MoveJ(begin, target, speed, acceleration, LIMIT))
    position = np.array([begin.position, *(reference.position for reference in references)])
    velocities = np.array([begin.velocity, *(reference.velocity for reference in references)])
    np.testing.assert_array_equal(position[-1], target)
    np.testing.assert_array_equal(velocities[-1], 0.0)
    assert np.all(np.abs(velocities) <= LIMIT * (1 + 1e-9))
    assert np.max(np.abs(np.diff(velocities, axis=0))) <= 1.001 * acceleration * PERIOD
    # Position is the integral of velocity, to within what one period of acceleration can do.
    step = np.diff(position, axis=0) - 0.5 * PERIOD * (velocities[1:] + velocities[:-1])
    assert np.max(np.abs(step)) <= acceleration * PERIOD**2


@settings(max_examples=40)
@given(JOINTS, st.floats(0.5, 40.0))
def test_stopping_takes_the_time_that_the_deceleration_says(velocity: np.ndarray, deceleration: float) -> None:
    references = run(VelocityRamp(Reference(np.zeros(6), velocity, np.zeros(6)), np.zeros(6), deceleration))
    expected = np.max(np.abs(velocity)) / deceleration
    assert len(references) * PERIOD == pytest.approx(expected, abs=2 * PERIOD)
    np.testing.assert_allclose(references[-1].position, velocity * expected / 2, atol=0.02)


@pytest.mark.parametrize("lookahead", [0.03, 0.1, 0.2])
def test_servoj_follows_a_steady_motion_one_lookahead_late(lookahead: float) -> None:
    motion = ServoJ(Reference.at_rest(np.zeros(6)))
    for step in range(1, 1001):
        motion.retarget(np.full(6, 0.5 * step * PERIOD), lookahead)
        reference = motion.step(PERIOD)
    np.testing.assert_allclose(reference.velocity, 0.5, rtol=5e-3)
    np.testing.assert_allclose(0.5 * 1000 * PERIOD - reference.position, 0.5 * lookahead, rtol=0.05)


def test_a_blocking_command_is_done_once_and_ready_after_command_0() -> None:
    arm = controller()
    command(arm, 0)
    assert arm.values["output_int_register_0"] == 1
    goal = np.full(6, 0.2)
    command(arm, 1, *goal, 3.0, 40.0)
    steps = 0
    while arm.values["output_int_register_0"] != 2:
        arm.step()
        steps += 1
        assert steps < 1000
    np.testing.assert_array_equal(arm.reference.position, goal)
    command(arm, 1, *np.zeros(6), 3.0, 40.0)  # not obeyed before command 0
    np.testing.assert_array_equal(arm.reference.position, goal)
    command(arm, 0)
    assert arm.values["output_int_register_0"] == 1


@each("number", [1, 11])
@each("value", [7.0, -7.0, math.nan, math.inf])
def test_targets_outside_the_limits_stop_protectively(number: int, value: float) -> None:
    arm = controller()
    command(arm, number, value, 0, 0, 0, 0, 0, 1.0, 1.0, 0.002, 0.1, 300)
    assert arm.safety_mode == PROTECTIVE_STOP
    assert arm.script is None
    assert isinstance(arm.arm, ExactPlant)
    assert arm.arm.halted
    arm.start_program(ControlScript(0))
    assert arm.script is None


def test_a_servoj_jump_faster_than_the_joint_can_turn_stops_protectively() -> None:
    arm = controller()
    command(arm, 11, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 0, 0, 0.002, 0.03, 300)
    for _ in range(50):
        arm.step()
    assert arm.safety_mode == PROTECTIVE_STOP


def test_speedj_into_a_limit_stops_protectively_at_the_limit() -> None:
    arm = controller()
    command(arm, 9, 3.0, 0, 0, 0, 0, 0, 10.0, 0.0)
    for _ in range(2000):
        arm.step()
    assert arm.safety_mode == PROTECTIVE_STOP
    assert arm.reference.position[0] == pytest.approx(2 * math.pi, abs=0.01)


def test_a_protective_stop_can_be_unlocked_after_five_seconds() -> None:
    arm = controller()
    arm.protective_stop("test")
    arm.step()
    assert not arm.unlock_protective_stop()
    for _ in range(2501):
        arm.step()
    assert arm.unlock_protective_stop()
    assert arm.safety_mode == NORMAL
    arm.start_program(ControlScript(0))
    arm.step()
    assert arm.values["runtime_state"] == 2


def test_the_watchdog_ends_the_program_when_commands_stay_away() -> None:
    arm = controller()
    command(arm, 35, 9.9)
    command(arm, 0)
    for _ in range(100):
        command(arm, 9, 0.1, 0, 0, 0, 0, 0, 1.0, 0.0)
    last = arm.arm.time - PERIOD  # of the last command
    while arm.script is not None:
        arm.step()
    assert arm.arm.time - PERIOD - last == pytest.approx(0.102)  # the first period that begins after 1/9.9 s
    for _ in range(100):
        arm.step()
    np.testing.assert_array_equal(arm.reference.velocity, 0.0)


def test_a_drift_carries_a_joint_away_until_the_program_ends() -> None:
    arm = controller()
    start = arm.arm.measure().position.copy()
    command(arm, 11, *start, *[0.0] * 3, 0.1, 300.0)
    arm.drift(0, 0.5)
    for _ in range(500):
        command(arm, 11, *start, *[0.0] * 3, 0.1, 300.0)
    ramp = 0.5 / DRIFT_ACCELERATION
    moved = arm.arm.measure().position - start
    assert moved[0] == pytest.approx(0.5 * (500 * PERIOD - 0.5 * ramp), abs=0.01)
    np.testing.assert_array_equal(moved[1:], 0.0)
    arm.stop_program()
    np.testing.assert_allclose(arm.reference.position, arm.arm.measure().position)  # no step back
    for _ in range(300):
        arm.step()
    np.testing.assert_array_equal(arm.arm.measure().velocity, 0.0)
    arm.drift(0, 0.5)  # no program runs: nothing happens
    held = arm.arm.measure().position.copy()
    for _ in range(100):
        arm.step()
    np.testing.assert_array_equal(arm.arm.measure().position, held)


def test_a_drift_beyond_the_limits_is_a_protective_stop() -> None:
    arm = controller()
    start = arm.arm.measure().position.copy()
    command(arm, 11, *start, *[0.0] * 3, 0.1, 300.0)
    arm.drift(0, 10.0)
    for _ in range(1000):
        command(arm, 11, *start, *[0.0] * 3, 0.1, 300.0)
    assert arm.safety_mode == PROTECTIVE_STOP


def test_stop_script_brakes_a_moving_arm() -> None:
    arm = controller()
    for _ in range(200):
        command(arm, 9, 0.5, 0, 0, 0, 0, 0, 10.0, 0.0)
    assert arm.reference.velocity[0] == pytest.approx(0.5)
    command(arm, 255)
    assert arm.values["runtime_state"] == 1
    for _ in range(100):
        arm.step()
    np.testing.assert_array_equal(arm.reference.velocity, 0.0)
    assert arm.safety_mode == NORMAL


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.integers(-5, 300), st.lists(st.floats(), min_size=24, max_size=24)), max_size=8),
    st.integers(-3, 3),
)
def test_no_command_breaks_the_controller(commands: list[tuple[int, list[float]]], integer: int) -> None:
    arm = controller()
    for number, vector in commands:
        command(arm, number, *vector, integer=integer)
        command(arm, 0)
    assert np.all(np.isfinite(arm.reference.position))
    assert np.all(np.abs(arm.reference.position) <= 2 * math.pi + 1e-6)


def test_scripts_start_only_where_they_are_the_control_script() -> None:
    arm = Controller(ExactPlant(), parse_version("5.22"), PERIOD)
    session = ScriptSession(arm)
    session.receive(b"def other():\n  movej([0,0,0,0,0,0])\nend\n")
    assert arm.script is None
    text = b"def rtde_control():\n    global reg_offset_int = # int register offset\n24    def a():\n    end\nend\n"
    for byte in text:
        assert arm.script is None
        session.receive(bytes([byte]))
    assert arm.script is not None
    assert arm.values["output_int_register_24"] == 1


def listed(text: str) -> list[str]:
    return text.split()


RECORD_CONFIGURATION = listed(
    "timestamp target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
    "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
    "actual_digital_input_bits joint_temperatures actual_execution_time robot_mode joint_mode safety_mode "
    "actual_tool_accelerometer speed_scaling target_speed_fraction actual_momentum actual_main_voltage "
    "actual_robot_voltage actual_robot_current actual_joint_voltage actual_digital_output_bits runtime_state "
    "payload payload_cog script_control_line output_bit_registers0_to_31 output_bit_registers32_to_63 "
) + [f"output_{kind}_register_{number}" for kind in ("int", "double") for number in range(24)]
"""Fields of the example of Universal Robots' RTDE client in Python, with those in a comment there."""
GUIDE = listed(
    "actual_current_window tcp_offset actual_TCP_acceleration target_TCP_acceleration safety_status "
    "actual_configurable_digital_input_bits actual_configurable_digital_output_bits target_execution_time "
    "elbow_position elbow_velocity robot_status_bits safety_status_bits analog_io_types standard_analog_input0 "
    "standard_analog_input1 standard_analog_output0 standard_analog_output1 io_current "
    "actual_robot_energy_consumed actual_robot_braking_energy_dissipated encoder0_raw encoder1_raw "
    "euromap67_input_bits euromap67_output_bits euromap67_24V_voltage euromap67_24V_current tool_mode "
    "tool_analog_input_types tool_analog_input0 tool_analog_input1 tool_output_voltage tool_output_current "
    "tool_temperature tool_output_mode tool_digital_output0_mode tool_digital_output1_mode tcp_force_scalar "
    "joint_position_deviation_ratio collision_detection_ratio ft_raw_wrench wrench_calc_from_currents "
    "payload_inertia time_scale_source target_gravity target_base_acceleration control_step target_base_wrench "
)
"""What the RTDE guide lists beside these."""


@pytest.mark.parametrize("version", ["5.22", "10.10"])
def test_a_client_may_ask_for_all_that_the_guide_lists(version: str) -> None:
    made = controller(version)
    session = RtdeSession(made, {})
    assert session.receive(protocol.encode_package(protocol.REQUEST_PROTOCOL_VERSION, b"\x00\x02"))[-1] == 1
    for names in (RECORD_CONFIGURATION, RECORD_CONFIGURATION + GUIDE):
        question = struct.pack(">d", 500.0) + ",".join(names).encode()
        answer = session.receive(protocol.encode_package(protocol.SETUP_OUTPUTS, question))
        assert answer[3] == 1  # the recipe's number; 0 refuses it
        types = answer[4:].decode().split(",")
        assert len(types) == len(names)
        assert "NOT_FOUND" not in types
        assert session.receive(protocol.encode_package(protocol.START, b""))[-1] == 1
        recipe = PackageRecipe(1, list(zip(names, types, strict=True)))
        made.step()
        values = recipe.decode(session.data_package()[3:])
        assert values is not None
        assert set(values) == set(names)


def test_energy_and_steps_are_counted() -> None:
    made = controller()
    current = float(made.values["actual_robot_current"])  # type: ignore[arg-type]
    for _ in range(100):
        made.step()
    assert made.values["control_step"] == 100
    assert made.values["actual_robot_energy_consumed"] == pytest.approx(48.0 * current * 100 * PERIOD)
