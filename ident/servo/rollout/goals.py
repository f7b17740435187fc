"""Goals of the servos' profiles: what a drive follows after a command, with delay and a limit of acceleration."""

from __future__ import annotations

from collections.abc import Collection
from ctypes import c_double, c_long
from typing import NamedTuple

import numpy as np

from drivers.core.arrays import FloatArray
from ident.compiled.library import Call, kernels
from ident.servo.rollout.lanes import Lanes

STEEPNESS_SPAN = 0.03
"""Half of the difference that gives derivatives by the logarithm of an acceleration limit."""

UNLIMITED = 1e6
"""[rad/s²] From this acceleration on, a profile is its target."""


class Goals(NamedTuple):
    """Goals (K + 1, L) of profiles, and their derivatives by a limit; None where not asked for.

    During a step, its own row is the goal for the `late` (L,) share, and the next row for the rest.
    """

    path: FloatArray
    late: FloatArray
    by_limit: FloatArray | None

    def errors(self, steps: int | slice, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position errors (…, L) before and after the goal changes in some steps, from positions (…, L) before them."""
        older, newer = (self.path[:-1], self.path[1:])
        return older[steps] - position, newer[steps] - position


def goals_of(lanes: Lanes, delay: FloatArray, steepest: FloatArray, names: Collection[str]) -> Goals:
    """Goals of the servos' profiles, and their derivatives by the limit where `names` holds it.

    A profile starts at once, however small a part of a command has come: goals are delayed, not commands. Goals are
    means over the step, as commands are. A profile that switches between its limits has no smooth derivative by them:
    differences over a finite span stand for it.
    """
    limited = "acceleration_limit" in names
    if (library := kernels().long) is not None:
        call, shape = Call(), lanes.load.shape
        path, late = np.empty((shape[0] + 1, shape[1])), np.empty(shape[1])
        by_limit = np.empty_like(path) if limited else None
        sizes = (c_long(lanes.history), c_long(shape[0]), c_long(shape[1]), c_double(lanes.step))
        given = map(call.given, (lanes.command, delay, steepest, path, late, by_limit))
        library.servo_goals(*sizes, c_double(STEEPNESS_SPAN), c_double(UNLIMITED), *given)
        return Goals(path, late, by_limit)
    factor = np.exp(STEEPNESS_SPAN)
    limits = [steepest, *([steepest * factor, steepest / factor] if limited else [])]
    wide, steep = np.tile(lanes.command, (1, len(limits))), np.concatenate(limits)
    ends = profile_goals(wide, lanes.step, steep)
    wide[1:] = np.where(steep < UNLIMITED, 0.5 * (ends[1:] + ends[:-1]), wide[1:])
    lateness = delay / lanes.step
    whole = np.floor(lateness)
    newer = lanes.history - whole.astype(np.intp)
    places = np.clip(newer + np.arange(len(lanes.load) + 1)[:, None], 0, len(lanes.command) - 1)
    lane = np.arange(len(delay))
    reached = [own[places, lane] for own in np.split(wide, len(limits), axis=1)]
    by_limit = (reached[1] - reached[2]) / (2 * STEEPNESS_SPAN) if limited else None
    return Goals(reached[0], lateness - whole, by_limit)


def profile_goals(command: FloatArray, step: float, steepest: FloatArray) -> FloatArray:
    """Goals (K, L) of the servos' profiles at each time of commands (K, L): as fast there as accelerations (L,) allow.

    They brake so as to stop at the command, and are at rest at the first.
    """
    if np.all(steepest >= UNLIMITED):
        return command
    goals = np.empty(command.shape)
    if (library := kernels().long) is not None:
        sizes, call = (c_long(len(command)), c_long(command.shape[1]), c_double(step)), Call()
        library.servo_profile(*sizes, *map(call.given, (command, steepest, goals)))
        return goals
    half, most = 0.5 * step * steepest, step * steepest
    goals[0] = goal = command[0]
    pace = np.zeros_like(goal)
    twice, square = 2.0 * steepest, half * half
    for index in range(1, len(command)):
        ahead = command[index] - goal
        distance = np.abs(ahead)
        # never past the target in one step
        braking = np.minimum(np.sqrt(twice * distance + square) - half, distance / step)
        pace = np.minimum(np.maximum(np.copysign(braking, ahead), pace - most), pace + most)
        goal = goal + step * pace
        goals[index] = goal - 0.5 * step * pace  # a sum of velocities after their steps is half a step ahead
    return goals
