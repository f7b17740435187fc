"""What an arm must keep clear of: its mounting surface and the obstacles of its workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass

from daq.robot.schema import Robot
from daq.robot.workspace import Box, HalfSpace

_SAME_SIDE = math.cos(math.radians(45.0))
"""A half-space of the workspace that faces like the mounting surface, within 45°, replaces it."""


@dataclass(frozen=True)
class Obstacle:
    """Something that no moving link comes near."""

    name: str  # for messages and figures
    shape: HalfSpace | Box  # half-space or box in the base frame [m]
    clearance: float  # distance that is kept [m]
    mounting: bool  # whether it is the mounting surface
    where: str  # key of the robot file


def obstacles_of(robot: Robot) -> tuple[Obstacle, ...]:
    """The mounting surface, unless the workspace has another or none is known, then the workspace's obstacles."""
    workspace = robot.workspace
    surface = _mounting_surface(robot)
    obstacles = [] if surface is None else [surface]
    for index, keep_out in enumerate(workspace.keep_out):
        obstacles.append(
            Obstacle(
                keep_out.name or f"{'box' if keep_out.box is not None else 'half-space'} keep_out[{index}]",
                keep_out.shape,
                workspace.clearance if keep_out.clearance is None else keep_out.clearance,
                mounting=False,
                where=f"workspace.keep_out[{index}]",
            )
        )
    return tuple(obstacles)


def _mounting_surface(robot: Robot) -> Obstacle | None:
    workspace, mounted = robot.workspace, robot.model.mounted
    if workspace.floor is None:
        replaced = workspace.height is not None or any(
            keep_out.half_space is not None and _faces_as_the_surface(keep_out.half_space)
            for keep_out in workspace.keep_out
        )
        if mounted == "free" or replaced:
            return None
    plane = HalfSpace(normal=(0.0, 0.0, 1.0), offset=workspace.floor or 0.0)
    name = "the floor" if mounted == "free" else f"the {mounted}"
    return Obstacle(name, plane, workspace.clearance, mounting=True, where="model.mounting")


def _faces_as_the_surface(half_space: HalfSpace) -> bool:
    return half_space.normal[2] / math.hypot(*half_space.normal) >= _SAME_SIDE
