"""Packages of others read and command the simulated motors: damiao_motor, robstride, moteus, ODrive's DBC."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import can
import numpy as np
import pytest
from motor_bench import START, MotorBench, motors
from simulated_clock import SimulatedClock

OTHERS = "a package that speaks to such motors is not installed: pip install -e '.[dev]'"


@contextmanager
def bus_of(bench: MotorBench) -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=bench.keys["channel"]) as bus:
        yield bus


def answers(bench: MotorBench, bus: can.BusABC, wait: float = 0.005) -> list[can.Message]:
    bench.clock.sleep(wait)
    said = []
    while (message := bus.recv(0.0)) is not None:
        said.append(message)
    return said


def test_damiao_motor(clock: SimulatedClock):
    package = pytest.importorskip("damiao_motor", reason=OTHERS)
    with motors(clock) as bench, bus_of(bench) as bus:
        client = package.DaMiaoMotor(1, 0x11, bus, motor_type="4310")

        def told() -> dict[str, object]:
            for message in answers(bench, bus):
                assert message.arbitration_id == 0x11
                client.process_feedback_frame(bytes(message.data), message.arbitration_id)
            return client.get_states()

        client.enable()
        state = told()
        assert state["status"] == "ENABLED"
        assert state["pos"] == pytest.approx(START[0], abs=1e-3)
        client.send_cmd_mit(START[0] + 0.2, 0.0, 60.0, 2.0, 0.0)
        told()
        clock.sleep(0.6)
        client.send_cmd_mit(START[0] + 0.2, 0.0, 60.0, 2.0, 0.0)
        state = told()
        assert state["pos"] == pytest.approx(START[0] + 0.2, abs=0.05)
        assert state["torq"] == pytest.approx(60.0 * (START[0] + 0.2 - state["pos"]), abs=0.05)
        assert (state["t_mos"], state["t_rotor"]) == (23.0, 23.0)
        client.set_can_timeout(50)
        client.request_register_reading(9)
        client.request_register_reading(21)
        told()
        assert client.registers == {9: 1000, 21: 12.5}
        clock.sleep(0.1)
        client.send_raw(client.encode_cmd_msg(0.0, 0.0, 0.0, 0.0, 0.0))
        assert told()["status"] == "LOST_COMM"
        client.clear_error()
        assert told()["status"] == "DISABLED"


def test_robstride(clock: SimulatedClock):
    package = pytest.importorskip("robstride.client", reason=OTHERS)
    with motors(clock, "robstride") as bench, bus_of(bench) as bus:
        client = package.Client(bus, host_can_id=0xFD)
        assert client.read_param(1, "mechpos") == pytest.approx(START[0], abs=1e-6)
        client.write_param(1, "limit_torque", 3.0)
        assert client.read_param(1, "limit_torque") == 3.0
        state = client.enable(1)
        assert (state.errors, state.angle, state.temp) == ([], pytest.approx(START[0], abs=1e-3), 23.0)
        assert bench.server.motors[0].enabled
        bench.server.motors[0].protect(bench.server.motors[0].over_temperature)
        assert client.disable(1).errors == [package.MotorError.Overtemp]


def test_moteus(clock: SimulatedClock):
    package = pytest.importorskip("moteus", reason=OTHERS)
    with motors(clock, "moteus") as bench, bus_of(bench) as bus:
        client = package.Controller(id=1, transport=object())

        def told(command: object) -> dict[int, float]:
            source = 0x8000 if command.reply_required else 0
            bus.send(can.Message(arbitration_id=source | 1, is_extended_id=True, is_fd=True, data=command.data))
            (message,) = answers(bench, bus)
            return (
                package.parse_reply(message.data) if hasattr(package, "parse_reply") else command.parse(message).values
            )

        register = package.Register
        state = told(client.make_query())
        assert state[register.MODE] == package.Mode.STOPPED
        assert state[register.POSITION] == pytest.approx(START[0] / math.tau, abs=1e-6)
        assert (state[register.FAULT], state[register.TEMPERATURE], state[register.VOLTAGE]) == (0, 23, 24.0)
        goal = (START[0] + 0.2) / math.tau
        command = {"position": goal, "velocity": 0.0, "maximum_torque": 5.0, "watchdog_timeout": 0.05, "query": True}
        for _ in range(40):
            state = told(client.make_position(**command))
            clock.sleep(0.02)
        assert state[register.MODE] == package.Mode.POSITION
        assert state[register.POSITION] == pytest.approx(goal, abs=0.01)
        moving = {"position": goal, "velocity": 0.1, "stop_position": goal + 0.04, "watchdog_timeout": math.nan}
        told(client.make_position(**moving, query=True))
        clock.sleep(0.3)
        assert told(client.make_query())[register.VELOCITY] == pytest.approx(0.1, abs=0.05)
        clock.sleep(0.5)
        assert told(client.make_query())[register.POSITION] == pytest.approx(goal + 0.04, abs=0.01)
        told(client.make_position(**command))
        clock.sleep(0.1)
        assert told(client.make_query())[register.MODE] == package.Mode.TIMEOUT
        assert told(client.make_stop(query=True))[register.MODE] == package.Mode.STOPPED


DBC = """VERSION ""
BS_:
BU_: axis
BO_ 1 Heartbeat: 8 axis
 SG_ Axis_State : 32|8@1+ (1,0) [0|0] "" axis
 SG_ Axis_Error : 0|32@1+ (1,0) [0|0] "" axis
BO_ 9 Get_Encoder_Estimates: 8 axis
 SG_ Vel_Estimate : 32|32@1- (1,0) [0|0] "" axis
 SG_ Pos_Estimate : 0|32@1- (1,0) [0|0] "" axis
BO_ 7 Set_Axis_State: 8 axis
 SG_ Axis_Requested_State : 0|32@1+ (1,0) [0|0] "" axis
BO_ 12 Set_Input_Pos: 8 axis
 SG_ Torque_FF : 48|16@1- (0.001,0) [0|0] "" axis
 SG_ Vel_FF : 32|16@1- (0.001,0) [0|0] "" axis
 SG_ Input_Pos : 0|32@1- (1,0) [0|0] "" axis
SIG_VALTYPE_ 9 Pos_Estimate : 1;
SIG_VALTYPE_ 9 Vel_Estimate : 1;
SIG_VALTYPE_ 12 Input_Pos : 1;
"""
"""Messages as ODrive's own file has them (odriverobotics/ODrive, tools/odrive-cansimple.dbc)."""


def test_odrive_by_its_dbc(clock: SimulatedClock):
    cantools = pytest.importorskip("cantools", reason=OTHERS)
    table = cantools.database.load_string(DBC, "dbc")
    with motors(clock, "odrive") as bench, bus_of(bench) as bus:

        def send(name: str, **values: float) -> None:
            message = table.get_message_by_name(name)
            number = 1 << 5 | message.frame_id
            bus.send(can.Message(arbitration_id=number, data=message.encode(values), is_extended_id=False))

        def told(name: str) -> dict[str, float]:
            number = 1 << 5 | table.get_message_by_name(name).frame_id
            bus.send(can.Message(arbitration_id=number, is_remote_frame=True, dlc=8, is_extended_id=False))
            (message,) = [one for one in answers(bench, bus) if one.arbitration_id == number]
            return table.decode_message(number & 0x1F, message.data)

        turns = told("Get_Encoder_Estimates")["Pos_Estimate"]
        assert turns == pytest.approx(8 * START[0] / math.tau, abs=1e-5)
        send("Set_Axis_State", Axis_Requested_State=8)
        assert told("Heartbeat") == {"Axis_State": 8, "Axis_Error": 0}
        send("Set_Input_Pos", Input_Pos=turns + 0.2, Vel_FF=0.0, Torque_FF=0.0)
        clock.sleep(1.5)
        moved = np.array([told("Get_Encoder_Estimates")["Pos_Estimate"] - turns])
        assert moved == pytest.approx([0.2], abs=0.15)
        assert moved > 0.05
