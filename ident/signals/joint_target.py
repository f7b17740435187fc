"""Target positions of a recording: the references that the arm's controller followed."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import Stream
from drivers.core.arrays import FloatArray
from ident.ranges import RECORDED_POSITION

QUANTITY = "target_position"


def joint_target(joints: Stream, joint_names: tuple[str, ...], position: FloatArray) -> FloatArray | None:
    """Target positions (N, n) [rad or m] of the joints, nan where a value cannot be one.

    None where none was recorded or not of every joint, and where those of a moving joint are its very positions: a
    controller that copies them has no reference of its own. No error, for few methods need targets.

    Args:
        joints: the joint stream.
        joint_names: (n,).
        position: (N, n) recorded [rad or m].
    """
    channel = joints.channels.get(QUANTITY)
    if channel is None or any(name not in channel.columns for name in joint_names):
        return None
    values = channel.values[:, [channel.columns.index(name) for name in joint_names]]
    if np.any(np.all(values == position, axis=0) & (np.ptp(position, axis=0) > 0.0)):
        return None
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) <= RECORDED_POSITION.most, values, np.nan)
