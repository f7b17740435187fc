"""`dynid sim`: builds the plant and serves it on a bus until it is interrupted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.errors import UsageError
from sim_drivers.rtde.server import RtdeServer
from sim_drivers.serving.served import BusOptions, Served, serve_until_interrupted

if TYPE_CHECKING:
    from daq.robot.loader import RobotFile

WIRES = ("rtde", "canopen", "slcan", "can", "thermometer")


AS_THE_ROBOT_FILE_SAYS = BusOptions()


def simulate(
    robot: str,
    wire: str,
    host: str,
    version: str,
    seed: int,
    *,
    live: bool,
    bus: BusOptions = AS_THE_ROBOT_FILE_SAYS,
    payload: str | None = None,
) -> None:
    """Serve a simulated arm until Ctrl-C or SIGTERM.

    Args:
        robot: built-in robot or robot file.
        wire: its bus, one of `WIRES`.
        host: address to listen on.
        version: of a UR controller.
        seed: of the noise.
        live: whether a line on standard error shows its state.
        bus: how its bus differs from its robot file's.
        payload: see `sim_drivers.plant.altered_arm.with_payload`; None for none.

    Raises:
        UsageError: a bus, a version, a payload or an arm that cannot be simulated, or wrong keys of a connection.
        RobotFileError: the robot file cannot be read, or has no truth.
        ConnectionFailedError: an address cannot be listened on, or a bus not opened.
    """
    from daq.robot.loader import load_robot

    if wire not in WIRES:
        raise UsageError(f"'{wire}' cannot be simulated", hint=f"--wire {', '.join(WIRES)}")
    robot_file = load_robot(robot)
    if payload is not None:
        from sim_drivers.plant.altered_arm import with_payload

        robot_file = with_payload(robot_file, payload)
    served = _served(robot_file, wire, host, version, seed, bus)
    serve_until_interrupted(served, robot_file.robot.name, live=live)


def _served(robot_file: RobotFile, wire: str, host: str, version: str, seed: int, bus: BusOptions) -> Served:
    from sim_drivers.plant.plant import Plant

    if wire == "thermometer":
        from sim_drivers.serving.thermometer import thermometer_alone

        return thermometer_alone(robot_file, seed)
    plant = Plant(robot_file, seed=seed)
    served: Served
    if wire == "rtde":
        served = RtdeServer(plant, host=host, version=version, joints=robot_file.robot.joints)
    else:
        from sim_drivers.serving import can as can_wires

        prepare = {"canopen": can_wires.canopen, "slcan": can_wires.slcan, "can": can_wires.proprietary}[wire]
        served = prepare(robot_file, plant, bus)
    if bus.thermometer:
        from sim_drivers.serving.thermometer import BesideThermometer, thermometer_keys
        from sim_drivers.thermometer.server import serve_thermometer

        served = BesideThermometer(served, serve_thermometer(plant, thermometer_keys(robot_file.robot), seed))
    return served
