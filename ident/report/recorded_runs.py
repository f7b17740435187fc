"""What the report shows of the recordings beside torques: the motion and the temperatures."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.core.arrays import FloatArray
from drivers.streams import UNITS
from ident.identify.identification import Identification


@dataclass(frozen=True)
class MotionSegment:
    """Filtered motion of one gap-free segment."""

    time: FloatArray  # (M,) [s]
    position: FloatArray  # (n, M) [rad or m]
    velocity: FloatArray  # (n, M) [rad/s or m/s]
    held_out: bool  # whether it belongs to the validation data


@dataclass(frozen=True)
class TemperatureSeries:
    """One recorded channel of temperatures."""

    name: str  # stream and quantity
    columns: tuple[str, ...]  # (k,) joints or sensors
    time: FloatArray  # (N,) [s]
    values: FloatArray  # (N, k) [°C]


@dataclass(frozen=True)
class RecordedRuns:
    """Motion and temperatures of all recordings used; both empty where a result was read from a file."""

    motion: tuple[MotionSegment, ...] = ()
    temperatures: tuple[TemperatureSeries, ...] = ()


def recorded_runs(identification: Identification) -> RecordedRuns:
    """Motion and temperatures of an identification."""
    motion = [
        MotionSegment(segment.time, segment.position, segment.velocity, held_out)
        for runs, held_out in ((identification.runs, False), (identification.validation_runs, True))
        for run in runs
        for segment in run.prepared.segments
    ]
    temperatures = [
        TemperatureSeries(f"{stream.name}/{quantity}", channel.columns, stream.time, channel.values)
        for recording in (*identification.recordings, *identification.held_out_recordings)
        for stream in recording.streams.values()
        for quantity, channel in stream.channels.items()
        if channel.unit == UNITS["temperature"]
    ]
    return RecordedRuns(tuple(motion), tuple(temperatures))
