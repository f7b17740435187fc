"""Joint temperatures of a recording, at the stamps of its joint stream."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Recording
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS

QUANTITY = "temperature"


def joint_temperature(recording: Recording, joint_names: tuple[str, ...]) -> FloatArray | None:
    """Temperatures (N, n) [K] of the joints, interpolated between readings; None where none was recorded.

    Thermometers have clocks of their own, so that streams are compared by the host's. Where several streams tell the
    temperature of a joint, the joint stream counts, then the first in the file. A joint without a reading is nan.
    """
    joints = recording.streams[JOINTS_STREAM]
    others = [stream for name, stream in recording.streams.items() if name != JOINTS_STREAM]
    values = np.full((len(joints.time), len(joint_names)), np.nan)
    for stream in (joints, *others):
        channel = stream.channels.get(QUANTITY)
        for column, name in enumerate(channel.columns if channel is not None else ()):
            if channel is None or name not in joint_names or not np.all(np.isnan(values[:, joint_names.index(name)])):
                continue
            read = np.isfinite(channel.values[:, column])
            if np.any(read):
                values[:, joint_names.index(name)] = np.interp(
                    joints.host_time, stream.host_time[read], channel.values[read, column]
                )
    return None if np.all(np.isnan(values)) else values + ZERO_CELSIUS
