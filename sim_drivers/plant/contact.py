"""Contact of a simulated arm with its surroundings: pushes on links, a wall, a body that it picks up.

Typed while it runs, or given at its start, whatever its bus:

    push LINK FX FY FZ [at X Y Z] for SECONDS    force [N], base frame, on a point [m] of the link's frame (its far end)
    wall X Y Z NX NY NZ [STIFFNESS [DAMPING]]    of a plane that the tool point cannot pass [m; N/m, N·s/m]
    pick MASS [at X Y Z]                         [kg] on the tool, its centre of mass [m] from the tool point
    release                                      of what was picked up

each followed by `after SECONDS`, where it is not to begin at once.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.ranges import Range
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.link_jacobian import LinkJacobians, link_end, link_index

USAGE = (
    "push LINK FX FY FZ [at X Y Z] for SECONDS | wall X Y Z NX NY NZ [STIFFNESS [DAMPING]] | pick MASS [at X Y Z] | "
    "release, each with [after SECONDS]"
)
CONTACT_WORDS = ("push", "wall", "pick", "release")
STIFFNESS, DAMPING = 2e4, 200.0
"""Stiffness and damping of a wall that names neither [N/m, N·s/m]."""
NUMBERS = {
    "force": Range(-1e4, 1e4, "N"),
    "place": Range(-100.0, 100.0, "m"),
    "seconds": Range(0.0, 1e6, "s"),
    "mass": Range(1e-3, 1e3, "kg"),
    "stiffness": Range(1.0, 1e5, "N/m"),
    "damping": Range(0.0, 2e3, "N·s/m"),
}
"""What the numbers can be; a stiffer wall is none for steps of 1 ms."""


@dataclass(frozen=True)
class Push:
    """A constant force [N] in the base frame on a point [m] of a link, between two times [s]."""

    link: int
    force: FloatArray
    point: FloatArray
    start: float
    end: float


@dataclass(frozen=True)
class Wall:
    """A plane through a point [m] with a unit normal towards the free side, that pushes the tool point back."""

    point: FloatArray
    normal: FloatArray
    stiffness: float
    damping: float
    start: float


@dataclass(frozen=True)
class Grasp:
    """A point mass [kg] on the tool from a time [s] on, its centre [m] from the tool point; none where it is 0."""

    mass: float
    centre: tuple[float, float, float]
    start: float


Event = Push | Wall | Grasp


class Contacts:
    """What touches an arm; requests may come from any thread."""

    def __init__(self, robot_file: RobotFile, model: DynamicModel) -> None:
        self._model, self._tool = model, np.array(robot_file.robot.workspace.tool)
        self._places: LinkJacobians | None = None
        self._requested: deque[str] = deque()
        self._touching: list[Push | Wall] = []
        self._grasps: list[Grasp] = []

    def request(self, line: str) -> None:
        """Let a typed contact begin with the next step.

        Raises:
            UsageError: it is none.
        """
        parse_contact(line, self._model, self._tool, 0.0)
        self._requested.append(line)

    def due(self, time: float) -> Grasp | None:
        """Take over what was requested; the grasp that begins by a time [s], if one does."""
        while self._requested:
            event = parse_contact(self._requested.popleft(), self._model, self._tool, time)
            if isinstance(event, Grasp):
                self._grasps.append(event)
            else:
                self._touching.append(event)
        begun = [grasp for grasp in self._grasps if grasp.start <= time]
        if not begun:
            return None
        self._grasps = [grasp for grasp in self._grasps if grasp.start > time]
        return begun[-1]

    @property
    def present(self) -> bool:
        """Return whether something touches the arm, or will."""
        return bool(self._touching)

    def torque(self, position: FloatArray, velocity: FloatArray, time: float) -> FloatArray:
        """External torque (n,) [N·m or N] at the joints with a motor, for their position and velocity (n,)."""
        total, pressed = self.acting(position, time)
        for wall, lever, depth in pressed:
            leaving = float(lever @ velocity)
            total += lever * max(0.0, wall.stiffness * depth - wall.damping * leaving)  # a wall does not pull
        return total

    def acting(self, position: FloatArray, time: float) -> tuple[FloatArray, list[tuple[Wall, FloatArray, float]]]:
        """Torque (n,) of pushes [N·m or N], and the walls that the tool point (joints at `position`, (n,)) is in.

        Beside each wall: the lever (n,) of its force on the joints [m or 1], and how deep the tool point is in it [m].
        """
        self._touching = [surface for surface in self._touching if isinstance(surface, Wall) or surface.end > time]
        total, pressed = np.zeros(len(position)), list[tuple[Wall, FloatArray, float]]()
        acting = [surface for surface in self._touching if surface.start <= time]
        if not acting:
            return total, pressed
        if self._places is None:
            self._places = LinkJacobians(self._model)
        self._places.move(position)
        for surface in acting:
            if isinstance(surface, Push):
                total += self._places.jacobian(surface.link, surface.point)[:3].T @ surface.force
                continue
            jacobian = self._places.jacobian(self._model.tool_link, self._tool)[:3]
            depth = float(surface.normal @ (surface.point - self._places.point(self._model.tool_link, self._tool)))
            if depth > 0.0:
                pressed.append((surface, jacobian.T @ surface.normal, depth))
        return total, pressed


def parse_contact(line: str, model: DynamicModel, tool: FloatArray, now: float) -> Event:
    """Read a typed contact, as the module describes.

    The tool point (3,) is that in the last joint's frame [m]; `after` counts from `now` [s].

    Raises:
        UsageError: not of that form, no such link, or a number out of its range.
    """
    words = line.split()
    start = now
    if len(words) > 2 and words[-2] == "after":
        start, words = now + _numbers(words[-1:], "seconds", line)[0], words[:-2]
    match words:
        case ["push", link, fx, fy, fz, "for", seconds]:
            place = None
        case ["push", link, fx, fy, fz, "at", x, y, z, "for", seconds]:
            place = _numbers((x, y, z), "place", line)
        case ["wall", x, y, z, nx, ny, nz, *rest] if len(rest) <= 2:
            normal = _numbers((nx, ny, nz), "place", line)
            if not normal.any():
                raise UsageError(f"'{line.strip()}': the wall's normal is 0", hint=USAGE)
            stiffness = float(_numbers(rest[:1], "stiffness", line)[0]) if rest else STIFFNESS
            damping = float(_numbers(rest[1:], "damping", line)[0]) if rest[1:] else DAMPING
            point = _numbers((x, y, z), "place", line)
            return Wall(point, normal / np.linalg.norm(normal), stiffness, damping, start)
        case ["pick", mass, *rest] if not rest or (len(rest) == 4 and rest[0] == "at"):
            cx, cy, cz = _numbers(rest[1:], "place", line).tolist() if rest else (0.0, 0.0, 0.0)
            return Grasp(float(_numbers([mass], "mass", line)[0]), (cx, cy, cz), start)
        case ["release"]:
            return Grasp(0.0, (0.0, 0.0, 0.0), start)
        case _:
            raise UsageError(f"'{line.strip()}' is not a contact", hint=USAGE)
    index = link_index(model, link)
    point = link_end(model, index, tool) if place is None else place
    force = _numbers((fx, fy, fz), "force", line)
    return Push(index, force, point, start, start + float(_numbers([seconds], "seconds", line)[0]))


def _numbers(texts: Sequence[str], what: str, line: str) -> FloatArray:
    try:
        values = [float(text) for text in texts]
    except ValueError:
        raise UsageError(f"'{line.strip()}' is not a contact", hint=USAGE) from None
    for value in values:
        if not NUMBERS[what].holds(value):
            raise UsageError(f"'{line.strip()}': {value:g} is not within {NUMBERS[what]}", hint=USAGE)
    return np.array(values)
