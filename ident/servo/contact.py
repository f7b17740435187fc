"""A surface that the arm's tool touches: found where roll-outs would go through it, and known to those that follow.

The surface is horizontal; the contact is a spring and damper that only push, at one point of the arm.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from daq.robot.loader import RobotFile
from drivers.core.arrays import BoolArray, FloatArray
from ident.model.kinematics.loops import main_chain
from ident.model.kinematics.urdf import urdf_model
from ident.servo.links import ServoLinks
from ident.servo.rollout.lanes import Lanes, at_samples, repeated
from ident.servo.rollout.rollout import roll_out
from ident.servo.search import EVERY_ERROR, lane_cost, loss, robust_scale
from ident.stored import Stored, Value

STIFFNESS = 2000.0
"""[N/m] Start: that of gripper, links and gears, which is less than a table's."""

BANDS = (0.0, 0.004, 0.008)
"""[m] Starts of the surface above the lowest point that was measured."""

NEAR = 0.02
"""[m] above the highest start: pieces that come nearer take part in the search."""

PIECES = 60
"""At most, in the search; every other one judges."""

SPREADS = np.array([0.01, 1.0])
"""σ of the weak prior about the start: height [m], logarithm of the stiffness. The point is not searched: it would go
where it makes up for what the joints' models lack."""

DIFFERENCES = np.array([1e-4, 0.02])
"""Steps of the differences that give derivatives, in the same coordinates."""

EVALUATIONS = 8

STILL = 1e-3
"""Relative fall of the cost at which the search ends."""

LEAST_GAIN = 0.02
"""Share of the cost of the held-out pieces near the surface that it must save."""

BETTER = 2.0
"""Cost that it saves on held-out pieces over what it costs on others."""

FARTHEST_LINKS = 2
"""Links at the end of the chain among which the tool point is sought."""

SHORTEST = 0.01
"""[m] from its joint, below which a frame of a URDF is no tool."""

BEFORE, AFTER = 0.1, 0.5
"""[s] about a contact in which samples say nothing about the joints."""

PRESSING = 0.05
"""[N] above which a contact counts."""


class ServoContact(Stored):
    """A horizontal surface that the arm touches, with one point."""

    link: str = Field(description="to which the point belongs")
    point: list[Value] = Field(description="in the frame of the link's joint [m]")
    height: Value = Field(description="of the surface, against gravity from the base frame's origin [m]")
    stiffness: Value = Field(description="[N/m]")

    def surface(self, pieces: int) -> FloatArray:
        """(5, pieces) as a roll-out takes it."""
        return np.tile(np.array([self.height, self.stiffness, *self.point])[:, None], (1, pieces))


def tool_point(robot_file: RobotFile, links: ServoLinks) -> tuple[str, FloatArray]:
    """The link and its point (3,) [m] that touch first: the file's tool point, else the URDF's farthest frame."""
    joints = links.model.joints
    chain = main_chain(joints, links.model.active)
    link, point = joints[chain[-1]].name, np.array(robot_file.robot.workspace.tool)
    if point.any() or not robot_file.urdf_text:
        return link, point
    read = urdf_model(robot_file.urdf_text, links.model.link_names, robot_file.robot.model.locked, robot_file.where)
    names = {read.getJointId(joints[index].name): joints[index].name for index in chain[-FARTHEST_LINKS:]}
    for frame in read.frames:
        placed = np.array(frame.placement.translation)
        if frame.parentJoint in names and np.linalg.norm(placed) > max(float(np.linalg.norm(point)), SHORTEST):
            link, point = names[frame.parentJoint], placed
    return link, point


def find_contact(
    lanes: Lanes, values: FloatArray, link: str, point: FloatArray, least: float, known: ServoContact | None = None
) -> ServoContact | None:
    """Return what the arm touches, where it lowers the error of pieces that it was not fitted to.

    Args:
        lanes: of all joints, with what they may touch.
        values: (n, terms) parameters.
        link: that touches.
        point: (3,) [m] of it, to begin with.
        least: smallest scale of errors [rad or m].
        known: a surface from a first fit, to begin with.
    """
    lowest = lowest_points(lanes, point)
    floor = float(lowest.min())
    top = floor + BANDS[-1] if known is None else known.height
    near = np.unique(lanes.piece)[lowest < top + NEAR]
    if len(near) < 2:
        return None
    if len(near) > PIECES:
        near = near[np.linspace(0, len(near) - 1, PIECES).astype(np.intp)]
    chosen, judged = lanes.of_pieces(near[::2]), lanes.of_pieces(near[1::2])
    starts = (
        [np.array([floor + band, np.log(STIFFNESS)]) for band in BANDS]
        if known is None
        else [np.array([known.height, np.log(known.stiffness)])]
    )
    fits = [_search(chosen, values, point, start, least) for start in starts]
    best = min(fits, key=lambda fit: fit[1])[0]
    if not _helps(judged, values, point, best, least):
        return None
    refined = _search(lanes.of_pieces(near), values, point, best, least)[0]
    height, stiffness = float(refined[0]), float(np.exp(refined[1]))
    return ServoContact(link=link, point=point.tolist(), height=height, stiffness=stiffness)


def away(lanes: Lanes, point: FloatArray) -> Lanes:
    """The pieces that do not come near the lowest point, if they are half of all: what nothing can have bent."""
    lowest = lowest_points(lanes, point)
    far = np.unique(lanes.piece)[lowest >= lowest.min() + BANDS[-1] + NEAR]
    return lanes.of_pieces(far) if 2 * len(far) >= len(lowest) else lanes


def in_contact(lanes: Lanes, values: FloatArray, contact: ServoContact) -> BoolArray:
    """(S, L) samples that a contact bends: from shortly before it until the joints have settled again."""
    pieces = len(np.unique(lanes.piece))
    force = roll_out(lanes, values[lanes.joint].T, surface=contact.surface(pieces))[2]
    before, after = (round(span / lanes.step) for span in (BEFORE, AFTER))
    pressed = np.cumsum(np.vstack([np.zeros((1, pieces)), force > PRESSING]), axis=0)
    rows = np.arange(len(force))
    about = pressed[np.minimum(rows + before, len(force))] - pressed[np.maximum(rows - after, 0)] > 0
    wide = np.repeat(about, len(lanes.joint) // pieces, axis=1)
    places = np.minimum(lanes.sample.astype(np.intp), len(force) - 1)
    found: BoolArray = wide[places, np.arange(wide.shape[1])]
    return found


def lowest_points(lanes: Lanes, point: FloatArray) -> FloatArray:
    """(P,) lowest heights of a point along the measured motions [m]."""
    assert lanes.touch is not None
    lowest: FloatArray = np.tensordot(np.array([1.0, *point]), lanes.touch.height, 1).min(axis=0)
    return lowest


def _residual(lanes: Lanes, values: FloatArray, point: FloatArray, surfaces: FloatArray) -> FloatArray:
    """(v, S, L) residuals with several surfaces (v, 2), all side by side."""
    count, joints = len(surfaces), len(values)
    wide = repeated(lanes, count, joints)
    each = np.column_stack([surfaces[:, 0], np.exp(surfaces[:, 1]), np.tile(point, (count, 1))])
    surface = np.repeat(each.T, len(np.unique(lanes.piece)), axis=1)
    path = roll_out(wide, values[wide.joint % joints].T, surface=surface)[0]
    return np.stack(np.split(at_samples(wide, path) - wide.measured, count, axis=1))


def _search(
    lanes: Lanes, values: FloatArray, point: FloatArray, start: FloatArray, least: float
) -> tuple[FloatArray, float]:
    """The surface (2,), height and logarithm of the stiffness, that minimises the robust cost, and the cost."""
    residual = _residual(lanes, values, point, _varied(start))
    scale = robust_scale(residual[0], lanes, len(values), least)[lanes.joint]
    found, damping = start.copy(), 1e-2
    cost = _cost(residual[0], scale, found, start)
    for _ in range(EVALUATIONS):
        counted = np.isfinite(residual[0])
        error = (residual[0] / scale)[counted]
        slopes = ((residual[1:] - residual[0]) / scale)[:, counted] / DIFFERENCES[:, None]
        weight = loss(error, EVERY_ERROR)[1]
        curvature = (slopes * weight) @ slopes.T + np.diag(SPREADS**-2)
        gradient = slopes @ (weight * error) + (found - start) / SPREADS**2
        move = -np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), gradient)
        trial = found + np.clip(move, -0.5 * SPREADS, 0.5 * SPREADS)
        new = _residual(lanes, values, point, _varied(trial))
        new_cost = _cost(new[0], scale, trial, start)
        if new_cost >= cost:
            damping *= 8.0
            continue
        fall, found, residual, cost, damping = cost - new_cost, trial, new, new_cost, damping / 4.0
        if fall < STILL * cost:
            break
    return found, cost


def _varied(surface: FloatArray) -> FloatArray:
    return np.vstack([surface, surface + np.diag(DIFFERENCES)])


def _cost(residual: FloatArray, scale: FloatArray, surface: FloatArray, start: FloatArray) -> float:
    robust = np.nansum(loss(residual / scale, EVERY_ERROR)[0])
    return float(robust + np.sum(((surface - start) / SPREADS) ** 2))


def _helps(lanes: Lanes, values: FloatArray, point: FloatArray, surface: FloatArray, least: float) -> bool:
    """Return whether a surface lowers the cost of pieces clearly."""
    away = np.array([surface[0] - 1e3, surface[1]])
    without, touched = _residual(lanes, values, point, np.stack([away, surface]))
    scale = robust_scale(without, lanes, len(values), least)
    before, after = (lane_cost(each, lanes, scale, EVERY_ERROR) for each in (without, touched))
    change = before - after
    saved, spent = float(change[change > 0].sum()), -float(change[change < 0].sum())
    return saved > BETTER * spent and saved - spent > LEAST_GAIN * float(before.sum())
