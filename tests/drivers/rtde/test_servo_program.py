"""dynid's own program for UR arms: the text that is uploaded runs on a simulated controller, in simulated time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from rtde_in_process import HOST, NOWHERE, Network, serving
from simulated_clock import SimulatedClock

from daq.robot.loader import load_robot
from drivers.core.errors import ConnectionFailedError
from drivers.rtde.delayed_path import DELAY, DelayedPath
from drivers.rtde.servo_program import ANSWER_LIMIT, LOOKAHEAD, PROGRAM, ServoProgram
from sim_drivers.plant.plant import Plant
from sim_drivers.rtde.server import RtdeServer

RATE = 500.0
STILL = 2e-3


@pytest.fixture
def server(clock: SimulatedClock) -> RtdeServer:
    robot = load_robot("ur5e")
    return RtdeServer(Plant(robot, seed=1), ports=NOWHERE, joints=robot.robot.joints, clock=clock)


@pytest.fixture
def network(server: RtdeServer) -> Iterator[Network]:
    with serving(server) as network:
        yield network


def take(network: Network, clock: SimulatedClock) -> ServoProgram:
    return ServoProgram(HOST, RATE, network.connect, clock)


def move(control: ServoProgram, server: RtdeServer, clock: SimulatedClock, speed: float, seconds: float) -> bool:
    """Send positions that move every joint at a speed [rad/s]; whether all were taken."""
    start = np.array(server.controller.values["actual_q"])
    path = DelayedPath(RATE)
    for step in range(round(seconds * RATE)):
        path.put(clock.now(), start + speed * step / RATE)
        if not control.follow(path):
            return False
        clock.sleep(1.0 / RATE)
    return True


def at(position: np.ndarray) -> DelayedPath:
    """A path of one position."""
    path = DelayedPath(RATE)
    path.put(0.0, position)
    return path


def fastest(server: RtdeServer) -> float:
    return float(np.abs(server.controller.values["actual_qd"]).max())


def test_the_arm_follows_and_stops_and_the_program_ends(
    server: RtdeServer, network: Network, clock: SimulatedClock
) -> None:
    control = take(network, clock)
    assert control.setWatchdog(1.0)
    start = np.array(server.controller.values["actual_q"])
    assert move(control, server, clock, 0.3, 1.0)
    np.testing.assert_allclose(
        np.array(server.controller.values["actual_q"]) - start, 0.3 * (1.0 - DELAY - LOOKAHEAD), atol=0.01
    )
    assert fastest(server) > 0.25
    assert control.servoStop(10.0)
    assert not control.isProgramRunning()
    assert server.controller.script is None
    clock.sleep(0.5)
    assert fastest(server) < STILL


@pytest.mark.parametrize("moving", [False, True])
def test_without_commands_the_controller_stops_the_arm_by_itself(
    server: RtdeServer, network: Network, clock: SimulatedClock, moving: bool
) -> None:
    control = take(network, clock)
    control.setWatchdog(5.0)
    if moving:
        move(control, server, clock, 0.3, 0.5)
    else:
        control.kickWatchdog()
    clock.sleep(0.18)
    assert control.isProgramRunning()
    clock.sleep(0.8)
    assert not control.isProgramRunning()
    assert any("no command" in message for message in server.messages)
    assert fastest(server) < STILL
    assert not control.follow(at(np.zeros(6)))


def test_a_position_outside_the_limits_ends_it(server: RtdeServer, network: Network, clock: SimulatedClock) -> None:
    control = take(network, clock)
    control.follow(at(np.full(6, 7.0)))
    clock.sleep(0.1)
    assert not control.isProgramRunning()
    assert not control.servoStop(10.0)  # the program did not confirm a stop


def test_who_is_refused_learns_why(server: RtdeServer, network: Network, clock: SimulatedClock) -> None:
    first = take(network, clock)
    with pytest.raises(ConnectionFailedError, match="another client has the RTDE input registers"):
        take(network, clock)
    first.servoStop(10.0)
    first.disconnect()
    clock.sleep(0.1)
    server.controller.remote_control = False
    before = clock.now()
    with pytest.raises(ConnectionFailedError, match=r"its program did not start.*remote control"):
        take(network, clock)
    assert clock.now() - before == pytest.approx(ANSWER_LIMIT, abs=0.1)
    server.controller.remote_control = True
    second = take(network, clock)  # what an earlier run left in the register is no answer
    assert second.isProgramRunning()


def test_a_cut_connection_is_noticed_and_the_arm_stops(
    server: RtdeServer, network: Network, clock: SimulatedClock
) -> None:
    control = take(network, clock)
    control.setWatchdog(1.0)
    move(control, server, clock, 0.3, 0.5)
    control.disconnect()
    assert not control.isConnected()
    assert not control.follow(at(np.zeros(6)))
    clock.sleep(2.0)
    assert server.controller.script is None
    assert fastest(server) < STILL


def test_blocks_of_the_program_are_closed() -> None:
    """URScript closes every def, if and while by an `end`; `elif` and `else` open nothing."""
    lines = [line.strip() for line in PROGRAM.splitlines()]
    opened = sum(line.startswith(("def ", "if ", "while ")) for line in lines)
    assert lines.count("end") == opened
