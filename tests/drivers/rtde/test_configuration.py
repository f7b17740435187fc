"""The controller's own joint limits: found among whatever else its secondary interface sends, or said not to be."""

from __future__ import annotations

import socket
import struct

import numpy as np
import pytest
from exact_plant import ExactPlant
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rtde_in_process import HOST, NOWHERE, serving
from simulated_clock import SimulatedClock, simulated_time

from daq.robot.loader import load_robot
from daq.session.device_limits import before_a_motion, require_same_arm
from drivers.base import DriverSettings
from drivers.core.errors import ConnectionFailedError, UsageError
from drivers.rtde.configuration import PORT, read_configuration
from drivers.rtde.driver import RtdeDriver
from sim_drivers.rtde.dashboard import SecondarySession
from sim_drivers.rtde.server import RtdeServer

ROBOT = load_robot("ur5e").robot
VERSION = struct.pack(">iB", 13, 20) + b"URControl"[:8]
"""A message that is no state."""
MODE = struct.pack(">iB", 14, 0) + bytes(9)
"""A part of the state that is not the configuration."""


def state() -> bytes:
    return SecondarySession(RtdeServer(ExactPlant(), joints=ROBOT.joints, ports=NOWHERE).controller).greeting()


def told(content: list[bytes]) -> np.ndarray:
    """What is read of a controller that says so and then nothing more."""
    ours, theirs = socket.socketpair()
    with simulated_time() as clock, theirs:
        theirs.sendall(b"".join(content))
        begun = clock.now()
        try:
            return read_configuration(HOST, 0.5, lambda host, port, timeout: ours, clock).limits
        finally:
            assert clock.now() - begun <= 0.5 + 1e-6
            assert ours.fileno() == -1


def test_limits_are_found_among_other_messages_and_parts() -> None:
    whole = state()
    longer = struct.pack(">iB", len(whole) + len(MODE), 16) + MODE + whole[5:]
    for content in ([whole], [VERSION, whole], [VERSION, longer]):
        limits = told(content)
        lowest, highest = np.array([joint.position for joint in ROBOT.joints]).T
        np.testing.assert_array_equal(limits[:2], [lowest, highest])
        np.testing.assert_array_equal(limits[2], [joint.velocity for joint in ROBOT.joints])
        np.testing.assert_array_equal(limits[3], [joint.acceleration for joint in ROBOT.joints])
    assert len(whole) == 5 + 445  # as Universal Robots documents the part


@settings(max_examples=30)
@given(st.binary(max_size=40), st.integers(0, 460), st.integers(0, 255))
@example(b"", 460, 0)
@example(struct.pack(">iB", -5, 16), 0, 0)
@example(struct.pack(">iB", 2**31 - 1, 16), 0, 0)
def test_hostile_bytes_are_told_in_one_line(before: bytes, kept: int, changed: int) -> None:
    content = bytearray(before + state()[:kept])
    if content:
        content[kept % len(content)] ^= changed
    refused = ConnectionFailedError("", where=f"{HOST}:{PORT}")
    try:
        assert np.isfinite(told([bytes(content)])).all()
    except ConnectionFailedError as error:
        refused = error
    assert refused.where == f"{HOST}:{PORT}"
    assert "\n" not in str(refused)


def test_the_robot_file_is_compared_with_what_the_controller_tells(clock: SimulatedClock) -> None:
    server = RtdeServer(ExactPlant(), joints=ROBOT.joints, ports=NOWHERE, clock=clock)
    with serving(server) as network:
        driver = RtdeDriver(DriverSettings(ROBOT.joint_names, {"host": HOST}, (), clock=clock), network.connect)
        driver.open()
        assert before_a_motion(ROBOT, driver) == []
        server.controller.speed_limit[2] = 1.0  # a reduced speed in its safety configuration
        server.controller.upper[4] = 2.0
        position, velocity = before_a_motion(ROBOT, driver)
        assert "wider than the controller's own (its secondary interface): wrist_2_joint " in position
        assert "above the controller's own (its secondary interface): elbow_joint " in velocity
        require_same_arm(load_robot("ur10e"), driver)  # it does not say what it moves
        server.controller.lengths = [0.426, 0.392, 0.134, 0.099]  # calibrated
        require_same_arm(load_robot("ur5e"), driver)
        for other, words in (("ur10e", "upper arm 0.426 m, and not 0.6127 m; "), ("aubo_i5", "upper arm 0.426 m")):
            with pytest.raises(UsageError, match=f"controller's arm is not {other}: {words}"):
                require_same_arm(load_robot(other), driver)
        server.controller.lengths = [0.425, 0.39225, 0.10915, 0.09465]
        with pytest.raises(UsageError, match=r"is not ur5e: shoulder offset 0.1091 m, and not 0.1333 m "):
            require_same_arm(load_robot("ur5e"), driver)  # a UR5
        network.dead = True
        require_same_arm(load_robot("ur10e"), driver)
        (unknown,) = before_a_motion(ROBOT, driver)
        assert unknown.startswith("the controller's own joint limits are not known (arm:30002: no joint limits from")
        driver.close()


def test_a_controller_that_closes_the_port_is_told() -> None:
    ours, theirs = socket.socketpair()
    theirs.close()
    with simulated_time() as clock, pytest.raises(ConnectionFailedError, match="it closed the connection"):
        read_configuration(HOST, 0.5, lambda host, port, timeout: ours, clock)
