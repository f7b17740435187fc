"""Torques of motors that take each goal in a step, as if the goal moved on evenly.

A spring kp to a goal that stands for a period T falls by kp·q̇·T while the joint goes on. Where in the period a motor
is read makes a difference of up to kp·q̇·T/2, viscous friction to an identification: a late reading is a bias. What
drives the arm over several periods is the spring to a goal that moves evenly, and is at each goal in the middle of its
period: kp times the distance between the two is added to the torque that was read.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daq.recording.commanded_motion import TARGET
from daq.recording.recording import Stream
from drivers.core.arrays import FloatArray
from drivers.streams import GOAL_AGE

LONGEST_PERIOD = 0.1
"""[s] between two goals from which on the arm rested, or was held."""


def with_even_goals(joints: Stream, commands: Stream | None) -> Stream:
    """The joints' stream, with torques as if goals moved evenly where it says when they were obeyed."""
    ages, torque = joints.channels.get(GOAL_AGE), joints.channels.get("torque")
    if commands is None or ages is None or torque is None or len(commands.time) < 2:
        return joints
    names = [name for name in torque.columns if name in ages.columns]
    goals, gain = (commands.channels.get(quantity) for quantity in (TARGET, "gain_p"))
    if goals is None or gain is None or not {*names} <= {*goals.columns} & {*gain.columns}:
        return joints
    values = torque.values.copy()
    for name in names:
        at = {channel.quantity: channel.columns.index(name) for channel in (ages, torque, goals, gain)}
        ahead = _ahead(commands.time, goals.values[:, at[TARGET]], joints.time, ages.values[:, at[GOAL_AGE]])
        values[:, at["torque"]] += gain.values[0, at["gain_p"]] * ahead
    return replace(joints, channels={**joints.channels, "torque": replace(torque, values=values)})


def _ahead(stamps: FloatArray, goals: FloatArray, times: FloatArray, ages: FloatArray) -> FloatArray:
    """Return how far the evenly moving goal is ahead of the one in force (N,) [rad].

    Args:
        stamps: (M,) of the goals [s].
        goals: (M,) [rad].
        times: (N,) of the readings [s].
        ages: (N,) of the goals in force [s]; nan where there was none.
    """
    order = np.searchsorted(stamps, times, side="left") - 1  # a goal with a reading's stamp was obeyed after it
    valid = (order >= 0) & np.isfinite(ages)
    order = np.maximum(order, 0)
    periods = np.diff(stamps)
    periods = np.append(periods, periods[-1])  # live, the newest goal is in force as long as those before
    valid &= periods[order] < LONGEST_PERIOD
    middles = stamps + 0.5 * np.minimum(periods, LONGEST_PERIOD)
    even = np.interp(stamps[order] + ages, middles, goals)
    return np.where(valid, even - goals[order], 0.0)
