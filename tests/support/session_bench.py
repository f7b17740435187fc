"""Sessions of an arm that is not there, and what their files must hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from kinematic_arm import FIRST_STAMP, QUANTITIES, RATE, ROBOT_FILE, KinematicArm
from recorded_session import record_session
from unchecked import unchecked_play

from daq.motion.player import DRY_RUN
from daq.motion.trajectories import PointToPoint
from daq.recording.reader import read_recording
from daq.recording.recording import Event, Recording
from daq.session.course import REST_TIME
from daq.session.play import Play
from daq.session.session import SessionReport
from daq.session.watch import Watch

MOTION = PointToPoint(np.array([[0.1, -0.1], [0.5, 0.3], [0.0, 0.0]]), np.array([1.2, 1.2]))
PLAY = unchecked_play(MOTION, ROBOT_FILE.robot)
PERIOD = 1.0 / RATE
AFTER = 0.802
"""When faults begin [s]: in the motion, and between two samples."""
SEEN = 161 * PERIOD
"""When the first sample after that is read."""
STALE = 0.05
TRACKING_ERROR = 0.05
WAITED = DRY_RUN - PERIOD
"""When the first samples are looked at: after the dry run, and those of that time are there at once."""
PLAYED = REST_TIME + 3.0 * PERIOD
"""When the player begins: the first sample comes after a period, and another one after control was taken."""


def run(
    path: Path, arm: KinematicArm, play: Play | None = None, duration: float | None = None, watch: Watch | None = None
) -> SessionReport:
    arm.open()
    limit = TRACKING_ERROR
    return record_session(path, ROBOT_FILE, arm, play, duration, tracking_error=limit, clock=arm.clock, watch=watch)


def stopped(arm: KinematicArm) -> float:
    """When the arm was stopped, after its start [s]."""
    assert arm.stopped_at is not None
    return arm.stopped_at - arm.begun


def recorded(path: Path, arm: KinematicArm) -> Recording:
    """The recording; it holds what the arm handed out, all of it and nothing else."""
    recording = read_recording(path)
    joints = recording.streams["joints"]
    np.testing.assert_array_equal(joints.time, np.concatenate([block.time for block in arm.samples]))
    np.testing.assert_array_equal(joints.host_time, np.concatenate([block.host_time for block in arm.samples]))
    for name in QUANTITIES:
        np.testing.assert_array_equal(
            joints.channels[name].values, np.concatenate([block.values[name] for block in arm.samples])
        )
    np.testing.assert_allclose(joints.time, FIRST_STAMP + np.arange(arm.count) * PERIOD, atol=1e-9)
    return recording


def session_event(recording: Recording) -> Event:
    (event,) = (event for event in recording.events if event.source == "session")
    return event


def assert_closed(path: Path, arm: KinematicArm, report: SessionReport) -> Recording:
    """The arm stands, and the file says why."""
    assert arm.stopped_at is not None
    assert arm.commands_after_stop == 0
    recording = recorded(path, arm)
    assert not recording.complete
    assert session_event(recording).message == f"stopped: {report.stopped_by}"
    return recording
