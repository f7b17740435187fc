"""`dynid sim`: builds the plant and serves it on a bus until it is interrupted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daq.robot.arm_lengths import arm_lengths
from drivers.core.errors import UsageError
from sim_drivers.options import SimOptions
from sim_drivers.rtde.server import RtdeServer
from sim_drivers.rtde.variables import JOINTS
from sim_drivers.serving.served import Served, serve_until_interrupted

if TYPE_CHECKING:
    from daq.robot.loader import RobotFile
    from drivers.core.arrays import FloatArray

START = "start"
"""Name of the pose in which a simulated arm stands at first."""

WIRES = ("rtde", "canopen", "slcan", "can", "thermometer")
_WIRE_OF_DRIVER = {"rtde": "rtde", "canopen402": "canopen", "can_frames": "can"}


def simulate(options: SimOptions, *, live: bool) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM, with a status line on standard error where `live`.

    Its bus is `wire_of` its file where none is named, and it stands in the file's pose `start`, or in the middle of the
    joints' ranges, where no position is.

    Raises:
        UsageError: a bus, a version, a payload, a position or an arm that cannot be simulated, or wrong keys of a
            connection.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on, or a bus not opened.
    """
    import numpy as np

    from daq.robot.loader import load_robot

    if options.wire is not None and options.wire not in WIRES:
        raise UsageError(f"'{options.wire}' cannot be simulated", hint=f"--wire {', '.join(WIRES)}")
    robot_file = load_robot(options.robot)
    if options.payload is not None:
        from sim_drivers.plant.altered_arm import with_payload

        robot_file = with_payload(robot_file, options.payload)
    if options.position is not None:
        start: FloatArray | None = start_position(robot_file, options.position)
    else:
        start = np.array(pose) if (pose := robot_file.robot.poses.get(START)) is not None else None
    served = _served(robot_file, options, start)
    serve_until_interrupted(served, robot_file.robot.name, live=live)


def wire_of(robot_file: RobotFile) -> str:
    """The bus of an arm: that of its first connection which can be simulated, else RTDE for six turning joints."""
    robot = robot_file.robot
    for connection in robot.connections.values():
        if connection.driver in _WIRE_OF_DRIVER:
            return _WIRE_OF_DRIVER[connection.driver]
    return "rtde" if robot.dof == JOINTS and not any(robot.sliding) else "canopen"


def start_position(robot_file: RobotFile, text: str) -> FloatArray:
    """Where an arm stands at first: `A,B,…`, a number for each joint [rad or m].

    Raises:
        UsageError: not of that form, another number of joints, or beyond a joint's range.
    """
    import numpy as np

    joints = robot_file.robot.joints
    hint = f"--position {','.join('0' for _ in joints)}, rad or m, for {', '.join(robot_file.robot.joint_names)}"
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        raise UsageError(f"'{text}' is not a position", hint=hint) from None
    if len(numbers) != len(joints):
        raise UsageError(f"'{text}' has {len(numbers)} numbers for {len(joints)} joints", hint=hint)
    for number, joint in zip(numbers, joints, strict=True):
        least, most = joint.position
        if not least <= number <= most:
            raise UsageError(f"--position: {number:g} of {joint.name} is not within {least:g} to {most:g}", hint=hint)
    return np.array(numbers)


def _served(robot_file: RobotFile, options: SimOptions, position: FloatArray | None) -> Served:
    from sim_drivers.plant.plant import Plant

    wire, seed = options.wire or wire_of(robot_file), options.seed
    if wire == "thermometer":
        from sim_drivers.serving.thermometer import thermometer_alone

        return thermometer_alone(robot_file, seed)
    plant = Plant(robot_file, seed=seed, position=position)
    served: Served
    if wire == "rtde":
        served = RtdeServer(plant, host=options.host, version=options.version, joints=robot_file.robot.joints)
        if (lengths := arm_lengths(robot_file)) is not None:
            served.controller.lengths = lengths.tolist()
    else:
        from sim_drivers.serving import can as can_wires

        prepare = {"canopen": can_wires.canopen, "slcan": can_wires.slcan, "can": can_wires.proprietary}[wire]
        served = prepare(robot_file, plant, options)
    if options.thermometer:
        from sim_drivers.serving.thermometer import BesideThermometer, thermometer_keys
        from sim_drivers.thermometer.server import serve_thermometer

        served = BesideThermometer(served, serve_thermometer(plant, thermometer_keys(robot_file.robot), seed))
    return served
