"""The connection that a simulated CAN device answers on: the robot file's, with the options in its place."""

from __future__ import annotations

from daq.robot.schema import Robot
from daq.session.connections import keys_of_driver
from sim_drivers.served import SimOptions


def connection_keys(robot: Robot, driver: str, options: SimOptions) -> dict[str, object] | None:
    """The keys of the first connection with a driver, with the options in their place; None where there is none."""
    keys = keys_of_driver(robot, driver)
    return None if keys is None else with_options(keys, options)


def with_options(keys: dict[str, object], options: SimOptions) -> dict[str, object]:
    """The keys with the interface and the channel that were asked for."""
    if options.interface is not None and options.interface != keys.get("interface"):
        keys |= {"interface": options.interface, "options": {}}
    if options.channel is not None:
        keys["channel"] = options.channel
    return keys
