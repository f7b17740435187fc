"""A simulated arm that differs from its robot file: a load on its tool.

Only `RobotFile.robot`, from which recordings are computed, is changed. The text, which recordings carry, stays as it
was: an identification sees the arm that the user believes to have.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.errors import RobotFileError, UsageError
from drivers.core.ranges import LENGTH, PAYLOAD
from ident.checks.urdf_guess import truth_link
from ident.model.dynamic_model import build_model
from ident.model.parameters import link_parameters


def with_load(robot_file: RobotFile, mass: float, com: Sequence[float], inertia: Sequence[float]) -> RobotFile:
    """The arm with a rigid load fixed to the link that carries its tool.

    Args:
        robot_file: of a simulated arm.
        mass: [kg].
        com: (3,) centre of mass [m] from the tool point (`workspace.tool`), axes of the last joint's frame.
        inertia: (6,) xx, xy, xz, yy, yz, zz about the load's centre of mass, same axes [kg·m²].

    Raises:
        RobotFileError: the file has no true link there, or the load has no mass.
    """
    robot = robot_file.robot
    model = build_model(robot_file)
    last = model.link_names[model.tool_link]
    link = robot.truth.links.get(last)
    if link is None:
        raise RobotFileError(f"no true link for joint {last}", where=f"{robot.name}: truth.links")
    if not mass > 0:
        raise RobotFileError(f"a load of {mass:g} kg is not possible", where=robot.name)
    load = link_parameters(mass, (np.array(com) + robot.workspace.tool).tolist(), inertia)
    loaded = truth_link(link_parameters(link.mass, link.com, link.inertia) + load)
    truth = robot.truth.model_copy(update={"links": {**robot.truth.links, last: loaded}})
    return robot_file.model_copy(update={"robot": robot.model_copy(update={"truth": truth})})


def with_payload(robot_file: RobotFile, text: str) -> RobotFile:
    """The arm with a point mass `MASS@X,Y,Z` [kg, m], such as 2.0@0,0,0.05, in the flange frame (the last joint's).

    Raises:
        UsageError: not of that form, or not a positive finite mass.
        RobotFileError: the file has no true link there.
    """
    mass, _, place = text.partition("@")
    try:
        values = [float(value) for value in (mass, *place.split(","))]
    except ValueError:
        values = []
    if len(values) != 4 or not np.all(np.isfinite(values)) or values[0] <= 0.0:
        raise UsageError(f"'{text}' is not a payload", hint="--payload MASS@X,Y,Z in kg and m, such as 2.0@0,0,0.05")
    for value, allowed in zip(values, (PAYLOAD, LENGTH, LENGTH, LENGTH), strict=True):
        if not allowed.holds(value):
            raise UsageError(f"{value:g} is not within {allowed}", where="--payload")
    com = np.array(values[1:]) - np.array(robot_file.robot.workspace.tool)
    return with_load(robot_file, values[0], com.tolist(), [0.0] * 6)
