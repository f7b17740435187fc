"""Simple shapes of the links, from joint to joint, so that an arm without meshes can be seen."""

from __future__ import annotations

import numpy as np

from daq.robot.loader import BASE
from drivers.core.arrays import FloatArray
from ident.export.arm import ExportedArm
from ident.model.kinematics.joints import BASE_INDEX

SHORTEST_LINK = 1e-3
"""[m] below which two joints count as lying on each other."""

Segment = tuple[FloatArray, FloatArray, float]
"""Start and end (3,) [m] in the link's frame, and radius [m]."""


def link_segments(arm: ExportedArm) -> dict[int, list[Segment]]:
    """Segments of every link by its number, the base's by `BASE_INDEX`; a sphere has one point twice.

    From the link's origin to those of the joints that hang on it, and of the last link to the tool.
    """
    model, workspace = arm.model, arm.robot_file.robot.workspace
    ends: dict[int, list[FloatArray]] = {index: [] for index in range(BASE_INDEX, len(model.joints))}
    for joint in model.joints:
        ends[joint.parent].append(joint.translation)
    ends[model.tool_link].append(np.array(workspace.tool, dtype=np.float64))
    origin, shapes = np.zeros(3), {}
    for link, points in ends.items():
        radius = workspace.radius_of(BASE if link == BASE_INDEX else model.link_names[link])
        long = [point for point in points if float(np.linalg.norm(point)) > SHORTEST_LINK]
        shapes[link] = [(origin, point, radius) for point in long] or [(origin, origin, radius)]
    return shapes
