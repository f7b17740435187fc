"""Target positions of a recording: the references that the arm's controller followed."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import Stream
from drivers.ranges import RECORDED_POSITION
from drivers.streams import FloatArray

QUANTITY = "target_position"


def joint_target(joints: Stream, joint_names: tuple[str, ...]) -> FloatArray | None:
    """Target positions (N, n) [rad or m] of the joints; None where none was recorded, or not of every joint.

    Nothing but instrumental variables and DIDIM needs them: a value that no target can have is nan, and no error.
    """
    channel = joints.channels.get(QUANTITY)
    if channel is None or any(name not in channel.columns for name in joint_names):
        return None
    values = channel.values[:, [channel.columns.index(name) for name in joint_names]]
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) <= RECORDED_POSITION.most, values, np.nan)
