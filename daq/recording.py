"""The recording: HDF5 schema version 1 (DESIGN.md "The recording").

    /            attrs: dynid_schema, robot, urdf, created, versions, trajectory, host, comment, complete
    /streams/<name>/time, host_time      (N,) float64 [s]
    /streams/<name>/<quantity>           (N, n), attrs unit, description, joints
    /events      compound (N,): time, level, source, message

Everything is created before the first append and nothing is resized but along N, as HDF5's single-writer
multiple-reader mode demands; a writer only appends and flips `complete` at the end.
"""

from daq.recording_reader import read_recording
from daq.recording_writer import RecordingWriter, write_recording
from daq.streams import (
    JOINTS_STREAM,
    SCHEMA_VERSION,
    Channel,
    Event,
    Level,
    Recording,
    Stream,
    software_versions,
)

__all__ = [
    "JOINTS_STREAM",
    "SCHEMA_VERSION",
    "Channel",
    "Event",
    "Level",
    "Recording",
    "RecordingWriter",
    "Stream",
    "read_recording",
    "software_versions",
    "write_recording",
]
