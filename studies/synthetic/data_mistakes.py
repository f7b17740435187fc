"""What goes wrong with the data of a sound recording: stuck encoders, repeated rows, jitter, contacts, drop-outs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from daq.recording.recording import JOINTS_STREAM, MOTOR_SIGNALS, Channel, Recording, Stream
from drivers.core.arrays import BoolArray, FloatArray, IntArray
from drivers.streams import UNITS


def with_velocity(recording: Recording) -> Recording:
    """The recording with the velocity that its positions have, where none was recorded [rad/s or m/s]."""
    stream = recording.streams[JOINTS_STREAM]
    if "velocity" in stream.channels:
        return recording
    position = stream.channels["position"]
    velocity = np.gradient(position.values, stream.time, axis=0)
    return _changed(
        recording, channels={"velocity": Channel("velocity", velocity, UNITS["velocity"], position.columns)}
    )


def stuck_encoder(recording: Recording, joint: int, start: float, seconds: float) -> Recording:
    """The position of one joint stands still for `seconds` from `start` [s after the first stamp]."""
    stream = recording.streams[JOINTS_STREAM]
    position = stream.channels["position"].values.copy()
    first, stop = np.searchsorted(stream.time - stream.time[0], [start, start + seconds])
    position[first:stop, joint] = position[first, joint]
    return with_values(recording, position=position)


def repeated_rows(recording: Recording, share: float, seed: int, quantities: Sequence[str] | None = None) -> Recording:
    """A random share of the rows repeats the one before, stamps apart; of some quantities only where they are named."""
    stream = recording.streams[JOINTS_STREAM]
    repeated = np.random.default_rng(seed).random(len(stream.time)) < share
    repeated[0] = False
    source = np.maximum.accumulate(np.where(repeated, 0, np.arange(len(repeated))))
    names = stream.channels if quantities is None else quantities
    return with_values(recording, **{name: stream.channels[name].values[source] for name in names})


def jittering_position(recording: Recording, seconds: float, seed: int) -> Recording:
    """Each position is that of another moment, normally distributed with so many seconds about its stamp."""
    stream = recording.streams[JOINTS_STREAM]
    read = stream.time + seconds * np.random.default_rng(seed).standard_normal(len(stream.time))
    values = stream.channels["position"].values
    moved = np.stack([np.interp(read, stream.time, column) for column in values.T], axis=1)
    return with_values(recording, position=moved)


def contact(recording: Recording, share: float, size: float, seed: int) -> Recording:
    """Something touches the arm for a share of the time, half a second at a time.

    Each contact adds a half sine to the motor signals of all joints, with `size` times their root mean square at most.
    """
    stream = recording.streams[JOINTS_STREAM]
    generator = np.random.default_rng(seed)
    duration = float(stream.time[-1] - stream.time[0])
    count = max(1, round(share * duration / 0.5))
    starts = stream.time[0] + (np.arange(count) + generator.uniform(0.2, 0.8, count)) * duration / count
    changed: dict[str, FloatArray] = {}
    for name in MOTOR_SIGNALS:
        if name in stream.channels:
            values = stream.channels[name].values.copy()
            force = size * np.sqrt(np.mean(values**2, axis=0)) * generator.uniform(-1.0, 1.0, (count, values.shape[1]))
            for start, amplitude in zip(starts, force, strict=True):
                phase = np.clip((stream.time - start) / 0.5, 0.0, 1.0)
                values += np.sin(np.pi * phase)[:, None] * amplitude
            changed[name] = values
    return with_values(recording, **changed)


def filled_with_zeros(recording: Recording, share: float, seed: int) -> Recording:
    """The motor signals are missing in a share of the samples, which were filled with zeros."""
    stream = recording.streams[JOINTS_STREAM]
    missing = np.random.default_rng(seed).random(len(stream.time)) < share
    signals = {name: stream.channels[name].values for name in MOTOR_SIGNALS if name in stream.channels}
    return with_values(recording, **{name: np.where(missing[:, None], 0.0, values) for name, values in signals.items()})


def sampled(recording: Recording, every: int) -> Recording:
    """Every so-many-th row."""
    return with_rows(recording, slice(None, None, every))


def with_rows(recording: Recording, kept: slice | IntArray | BoolArray) -> Recording:
    """The recording with some rows of its joints alone."""
    stream = recording.streams[JOINTS_STREAM]
    channels = {name: replace(channel, values=channel.values[kept]) for name, channel in stream.channels.items()}
    fewer = replace(stream, time=stream.time[kept], host_time=stream.host_time[kept], channels=channels)
    return replace(recording, streams={**recording.streams, JOINTS_STREAM: fewer})


def quantised(recording: Recording, position: float) -> Recording:
    """Positions of an encoder with this step [rad or m]."""
    values = recording.streams[JOINTS_STREAM].channels["position"].values
    return with_values(recording, position=np.round(values / position) * position)


def with_values(recording: Recording, **values: FloatArray) -> Recording:
    """The recording with other values (N, n) of some quantities of its joints."""
    channels = recording.streams[JOINTS_STREAM].channels
    return _changed(recording, {name: replace(channels[name], values=value) for name, value in values.items()})


def _changed(recording: Recording, channels: dict[str, Channel]) -> Recording:
    stream = recording.streams[JOINTS_STREAM]
    changed: Stream = replace(stream, channels={**stream.channels, **channels})
    return replace(recording, streams={**recording.streams, JOINTS_STREAM: changed})
