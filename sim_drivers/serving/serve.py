"""`dynid sim`: builds the plant and serves it on a bus until it is interrupted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daq.robot.arm_lengths import arm_lengths
from drivers.core.errors import UsageError
from sim_drivers.rtde.server import RtdeServer
from sim_drivers.rtde.variables import JOINTS
from sim_drivers.serving.served import BusOptions, Served, serve_until_interrupted

if TYPE_CHECKING:
    from daq.robot.loader import RobotFile
    from drivers.core.arrays import FloatArray

START = "start"
"""Name of the pose in which a simulated arm stands at first."""

WIRES = ("rtde", "canopen", "slcan", "can", "thermometer")
_WIRE_OF_DRIVER = {"rtde": "rtde", "canopen402": "canopen", "can_frames": "can"}

AS_THE_ROBOT_FILE_SAYS = BusOptions()


def simulate(
    robot: str,
    wire: str | None,
    host: str,
    version: str,
    seed: int,
    *,
    live: bool,
    bus: BusOptions = AS_THE_ROBOT_FILE_SAYS,
    payload: str | None = None,
    position: str | None = None,
) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM.

    Args:
        robot: built-in robot or robot file.
        wire: its bus, one of `WIRES`; see `wire_of` where None.
        host: address to listen on.
        version: of a UR controller.
        seed: of the noise.
        live: whether a status line is shown on standard error.
        bus: how its bus differs from its robot file's.
        payload: see `sim_drivers.plant.altered_arm.with_payload`; None for none.
        position: see `start_position`; the file's pose `start`, else the middle of the joints' ranges, where None.

    Raises:
        UsageError: a bus, a version, a payload, a position or an arm that cannot be simulated, or wrong keys of a
            connection.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on, or a bus not opened.
    """
    import numpy as np

    from daq.robot.loader import load_robot

    if wire is not None and wire not in WIRES:
        raise UsageError(f"'{wire}' cannot be simulated", hint=f"--wire {', '.join(WIRES)}")
    robot_file = load_robot(robot)
    wire = wire or wire_of(robot_file)
    if payload is not None:
        from sim_drivers.plant.altered_arm import with_payload

        robot_file = with_payload(robot_file, payload)
    if position is not None:
        start: FloatArray | None = start_position(robot_file, position)
    else:
        start = np.array(pose) if (pose := robot_file.robot.poses.get(START)) is not None else None
    served = _served(robot_file, wire, host, version, seed, bus, start)
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


def _served(
    robot_file: RobotFile,
    wire: str,
    host: str,
    version: str,
    seed: int,
    bus: BusOptions,
    position: FloatArray | None,
) -> Served:
    from sim_drivers.plant.plant import Plant

    if wire == "thermometer":
        from sim_drivers.serving.thermometer import thermometer_alone

        return thermometer_alone(robot_file, seed)
    plant = Plant(robot_file, seed=seed, position=position)
    served: Served
    if wire == "rtde":
        served = RtdeServer(plant, host=host, version=version, joints=robot_file.robot.joints)
        if (lengths := arm_lengths(robot_file)) is not None:
            served.controller.lengths = lengths.tolist()
    else:
        from sim_drivers.serving import can as can_wires

        prepare = {"canopen": can_wires.canopen, "slcan": can_wires.slcan, "can": can_wires.proprietary}[wire]
        served = prepare(robot_file, plant, bus)
    if bus.thermometer:
        from sim_drivers.serving.thermometer import BesideThermometer, thermometer_keys
        from sim_drivers.thermometer.server import serve_thermometer

        served = BesideThermometer(served, serve_thermometer(plant, thermometer_keys(robot_file.robot), seed))
    return served
