"""Every driver of dynid keeps every point that a third party's has to keep."""

from __future__ import annotations

import itertools
import socket
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import motor_bench
import numpy as np
import pytest
import serial
import servo_bench
import yaml
from exact_plant import ExactPlant
from rtde_in_process import HOST, NOWHERE, SERVICES, Motions
from serial_lines import SerialLine
from simulated_serial import SerialPort, SimulatedLine

from daq.robot.loader import RobotFile, parse_robot
from daq.session.connections import driver_settings
from drivers.base import DriverSettings
from drivers.can_motors.driver import CanMotorDriver
from drivers.can_motors.settings import parse_settings as parse_motors
from drivers.core.arrays import FloatArray
from drivers.declaration import DRIVERS_GROUP, named
from drivers.gains import DriveGain
from drivers.rtde.driver import RtdeDriver
from drivers.serial_servos.driver import SerialServoDriver
from drivers.serial_servos.settings import parse_settings
from drivers.serial_thermometer.driver import SerialThermometerDriver
from dynid.testing import Bench, DriverConformance, SimulatedClock, declared_bench, simulated_time
from sim_drivers.can_motors.server import CanMotorServer
from sim_drivers.canopen import network
from sim_drivers.plant import servo
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer
from sim_drivers.serial_servos.server import SerialServoServer
from sim_drivers.served import SimOptions
from sim_drivers.thermometer.server import serve

CHANNELS = itertools.count()
JOINTS = ("shoulder", "elbow")
ARM = """
name: two
model:
  mdh:
    - {joint: shoulder, alpha: pi/2, d: 0, r: 0}
    - {joint: elbow, antecedent: shoulder, alpha: 0, d: 0.3, r: 0}
joints:
  - {name: shoulder, position: [-2, 2], velocity: 3, acceleration: 10, torque: 40}
  - {name: elbow, position: [-2, 2], velocity: 3, acceleration: 10, torque: 20}
drives:
  - {joint: shoulder, gain: 10, signal: current}
  - {joint: elbow, gain: -5, signal: current}
truth:
  links:
    shoulder: {mass: 2, com: [0.15, 0, 0], inertia: [0.001, 0, 0, 0.01, 0, 0.01]}
    elbow: {mass: 1, com: [0.1, 0, 0], inertia: [0.001, 0, 0, 0.005, 0, 0.005]}
  joints:
    shoulder: {motor_inertia: 0.3, coulomb: 0.5, viscous: 1}
    elbow: {motor_inertia: 0.2, coulomb: 0.3, viscous: 0.5}
"""
TURN = {"length": 24, "signed": True, "scale": 2.0**-20, "unit": "rev"}
SPEED = {"length": 16, "signed": True, "scale": 0.05, "unit": "deg/s"}
AMPERES = {"length": 16, "signed": True, "scale": 1, "unit": "mA"}
TABLE = {
    "rate": 100,
    "signals": [
        {"quantity": "counter", "id": 0x181, "start": 48, "length": 16},
        *({"quantity": "position", "joint": j, "id": 0x181, "start": 24 * n} | TURN for n, j in enumerate(JOINTS)),
        *({"quantity": "velocity", "joint": j, "id": 0x281, "start": 16 * n} | SPEED for n, j in enumerate(JOINTS)),
        *(
            {"quantity": "current", "joint": j, "id": 0x281, "start": 32 + 16 * n} | AMPERES
            for n, j in enumerate(JOINTS)
        ),
    ],
    "start": [{"id": 0x200, "data": "01 01"}],
    "stop": [{"id": 0x200, "data": "00 00"}],
    "command": {
        "quantity": "position",
        "signals": [{"joint": j, "id": 0x201, "start": 24 * n} | TURN for n, j in enumerate(JOINTS)],
    },
}
THERMOMETER = {"pattern": r"T(?P<channel>\d)=(?P<value>[-+.\d]+)", "channels": {1: "shoulder", 2: "elbow"}, "rate": 20}


@pytest.fixture(autouse=True)
def coarse_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated servos take the steps of their bench, drives on CANopen turn every 5 ms."""
    monkeypatch.setattr(servo, "STEP", motor_bench.STEP)
    monkeypatch.setattr(network, "LOOP_PERIOD", 5e-3)


def arm(driver: str, keys: Mapping[str, object]) -> RobotFile:
    """The arm with one connection."""
    text = ARM + yaml.safe_dump({"connections": {"bench": {"driver": driver, **keys}}})
    return parse_robot(text, where="two", folder=None)


def on_virtual_bus(driver: str, keys: Mapping[str, object], **more: Any) -> AbstractContextManager[Bench]:
    """A bench on a CAN bus of its own in this process."""
    bus = {"interface": "virtual", "channel": f"conformance-{next(CHANNELS)}"}
    return declared_bench(arm(driver, {**bus, **keys}), driver, **more)


class TestCanopen402(DriverConformance):
    def bench(self) -> AbstractContextManager[Bench]:
        nodes = {joint: {"id": number} for number, joint in enumerate(JOINTS, start=1)}
        return on_virtual_bus("canopen402", {"sync_rate": 100, "nodes": nodes}, idle=("position",))


class TestCanFrames(DriverConformance):
    def bench(self) -> AbstractContextManager[Bench]:
        return on_virtual_bus("can_frames", TABLE)


class Controller:
    """A simulated controller that comes and goes, reached by sockets within this process."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._server: RtdeServer | None = None
        self._far_ends: list[socket.socket] = []
        self.plant = ExactPlant()

    @contextmanager
    def device(self) -> Iterator[Controller]:
        with RtdeServer(self.plant, version="3.15", ports=NOWHERE, clock=self._clock) as self._server:
            yield self
        self._server = None

    def connect(self, host: str, port: int, timeout: float) -> socket.socket:
        if self._server is None:
            raise ConnectionRefusedError(111, "Connection refused")
        ours, theirs = socket.socketpair()
        self._far_ends.append(theirs.dup())
        self._server.serve(theirs, SERVICES[port])
        return ours

    def obey(self, line: str) -> None:
        if line == "garbage":
            self._far_ends[0].send(np.random.default_rng(0).bytes(64))
        else:
            assert self._server is not None
            self._server.obey(line)

    def truth(self) -> dict[str, FloatArray]:
        measured = self.plant.measure()
        return {"position": measured.position, "current": measured.current}


class TestRtde(DriverConformance):
    @contextmanager
    def bench(self) -> Iterator[Bench]:
        with simulated_time() as clock:
            controller = Controller(clock)
            motions = Motions(clock, controller.connect)
            joints = tuple(f"j{number}" for number in range(1, 7))
            keys: dict[str, object] = {"host": HOST, "timeout": 2.0}
            settings = DriverSettings(joints, keys, tuple(DriveGain(1.0) for _ in joints), clock=clock)

            def driver() -> RtdeDriver:
                return RtdeDriver(settings, controller.connect, motions.take_control)

            yield Bench(clock, driver, controller.device, controller.truth, babble="garbage")


class TestSerialThermometer(DriverConformance):
    @contextmanager
    def bench(self) -> Iterator[Bench]:
        with simulated_time() as clock:
            plants: list[Plant] = []
            robot_file = arm("serial_thermometer", {"url": "line://port", **THERMOMETER})
            keys = dict(robot_file.robot.connections["bench"].model_extra or {})
            settings = DriverSettings(JOINTS, keys, (DriveGain(1.0),) * 2, clock=clock)

            def device() -> AbstractContextManager:  # type: ignore[type-arg]
                plants.append(Plant(robot_file))
                return serve(robot_file, plants[-1], SimOptions(robot="two"), clock, SerialLine(clock))

            def truth() -> dict[str, FloatArray]:
                return {"temperature": plants[-1].thermal.housing}

            yield Bench(
                clock,
                lambda: SerialThermometerDriver(settings),
                device,
                truth,
                lose="silent 1",
                fall_silent="silent 60",
                babble="garbage 1",
            )


SAG = 0.01
"""How far [rad] a servo may yield to the weight of the arm while it is listened to."""


class SerialServos(DriverConformance):
    """Servos that come and go on a line which is opened by the same name each time."""

    wire: str

    @contextmanager
    def bench(self) -> Iterator[Bench]:
        with simulated_time() as clock, pytest.MonkeyPatch.context() as patch:
            arm_file, lines, servers = servo_bench.robot_file(), list[SimulatedLine](), list[SerialServoServer]()

            def open_port(url: str, *_: object, timeout: float, **__: object) -> SerialPort:
                if not lines:
                    raise serial.SerialException(f"could not open port {url}")
                return SerialPort(lines[-1], clock, timeout)

            patch.setattr(serial, "serial_for_url", open_port)
            keys = dict(arm_file.robot.connections[self.wire].model_extra or {})
            settings = replace(driver_settings(arm_file.robot, keys), clock=clock)

            @contextmanager
            def device() -> Iterator[SerialServoServer]:
                lines.append(SimulatedLine(clock))
                parsed = parse_settings(keys, arm_file.robot.joint_names, None, self.wire)
                servers.append(SerialServoServer(arm_file, parsed, servo_bench.START, line_end=lines[-1], clock=clock))
                with servers[-1]:
                    yield servers[-1]

            def truth() -> dict[str, FloatArray]:
                return {"position": servers[-1].plant.arm.position}

            yield Bench(clock, lambda: SerialServoDriver(settings, self.wire), device, truth, {"position": SAG})


class TestFeetech(SerialServos):
    wire = "feetech"


class TestDynamixel(SerialServos):
    wire = "dynamixel"


class CanMotors(DriverConformance):
    """Motors that come and go on a virtual bus."""

    wire: str

    @contextmanager
    def bench(self) -> Iterator[Bench]:
        with simulated_time() as clock:
            arm_file, keys, servers = motor_bench.robot_file(), motor_bench.keys_of(self.wire), list[CanMotorServer]()
            settings = replace(driver_settings(arm_file.robot, keys), clock=clock)
            parsed = parse_motors(keys, arm_file.robot.joint_names, self.wire)

            def device() -> CanMotorServer:
                servers.append(CanMotorServer(arm_file, parsed, motor_bench.START, clock))
                return servers[-1]

            def truth() -> dict[str, FloatArray]:
                arm = servers[-1].plant.arm
                states = [servers[-1].plant.measured(index) for index in range(2)]
                torque = [parsed.motors[index].to_joint("torque", states[index]["torque"]) for index in range(2)]
                return {"position": arm.position.copy(), "torque": np.array(torque)}

            yield Bench(
                clock,
                lambda: CanMotorDriver(settings, self.wire),
                device,
                truth,
                {"position": SAG, "torque": 0.5},
                ("position", "torque"),
            )


class TestDamiao(CanMotors):
    wire = "damiao"


class TestRobstride(CanMotors):
    wire = "robstride"


class TestCubemars(CanMotors):
    wire = "cubemars"


class TestMoteus(CanMotors):
    wire = "moteus"


class TestOdrive(CanMotors):
    wire = "odrive"


def test_every_driver_of_dynid_is_here() -> None:
    tried = {"canopen402", "can_frames", "rtde", "serial_thermometer", TestFeetech.wire, TestDynamixel.wire}
    tried |= set(motor_bench.WIRES)
    # From the source: an installation in place keeps the entry points of the day it was made.
    project = tomllib.loads((Path(__file__).resolve().parents[3] / "pyproject.toml").read_text("utf-8"))
    own = {
        name: EntryPoint(name, value, "") for name, value in project["project"]["entry-points"][DRIVERS_GROUP].items()
    }
    assert own.keys() == tried
    for entry in own.values():
        declaration = entry.load()
        assert callable(named(declaration.driver))
        for function in (declaration.budget, declaration.advice, declaration.connection_check):
            assert not function or callable(named(function))
