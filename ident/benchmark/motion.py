"""States of a recording as the judge and the plain methods see them: zero-phase filters and central differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, filtfilt

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.model.dynamic_model import build_model
from ident.signals.joint_signals import read_joint_signals

ORDER = 4
"""Order of the Butterworth filter, which runs forward and backward."""

EDGE = 2.0
"""Periods of the lower cut-off at each end that do not count: the filters see no samples beyond."""

LARGEST_GAP = 0.1
"""[s] Between two stamps: a longer one ends a motion."""


@dataclass(frozen=True, eq=False)
class BenchmarkMotion:
    """A gap-free motion on a uniform grid."""

    rate: float  # [Hz]
    band: float  # cut-off of the torques that are compared [Hz]
    # q, dq, ddq: (N, n) positions, low-passed, and their derivatives [rad, rad/s, rad/s²; m for sliding joints]
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    torque: FloatArray  # (N, n) of the joints, as recorded, interpolated linearly [N·m or N]

    @property
    def inner(self) -> slice:
        """Samples that count."""
        edge = int(np.ceil(EDGE * self.rate / self.band))
        return slice(edge, len(self.q) - edge)

    def in_band(self, values: FloatArray) -> FloatArray:
        """A signal (N, …) of this motion low-passed at `band`."""
        return low_pass(values, self.band, self.rate)


def low_pass(values: FloatArray, cutoff: float, rate: float) -> FloatArray:
    """A signal (N, …) through a Butterworth filter, forward and backward; as it is where the cut-off is beyond it."""
    if cutoff >= 0.45 * rate:
        return values
    b, a = butter(ORDER, cutoff, fs=rate)
    return np.asarray(filtfilt(b, a, values, axis=0), dtype=np.float64)


def motions(recording: Recording, robot: RobotFile, rate: float, states: float, band: float) -> list[BenchmarkMotion]:
    """The gap-free motions of a recording, each long enough for the filters.

    Args:
        recording: with positions and torques, or currents of known gains.
        robot: of the arm.
        rate: largest rate of the grid [Hz].
        states: cut-off of the positions [Hz].
        band: of the torques that are compared [Hz].

    Raises:
        DataError: there is none, or the recording lacks positions or torques.
    """
    signals = read_joint_signals(recording, robot.robot)
    time, of_joints = signals.time, signals.torque @ build_model(robot).transmission.coupling
    ends = np.flatnonzero(np.diff(time) > LARGEST_GAP) + 1
    read = []
    for rows in np.split(np.arange(len(time)), ends):
        if len(rows) < 3:
            continue
        native = 1.0 / float(np.median(np.diff(time[rows])))
        used = native / max(1, round(native / rate))
        grid = np.arange(time[rows[0]], time[rows[-1]], 1.0 / native)
        if len(grid) / native < 3.0 * EDGE / band:
            continue
        position = low_pass(values_at(grid, time[rows], signals.position[rows]), states, native)
        velocity = np.gradient(position, 1.0 / native, axis=0)
        acceleration = np.gradient(velocity, 1.0 / native, axis=0)
        every = slice(None, None, round(native / used))
        torque = values_at(grid, time[rows], of_joints[rows])
        read.append(BenchmarkMotion(used, band, position[every], velocity[every], acceleration[every], torque[every]))
    if not read:
        raise DataError(f"no gap-free motion lasts {3.0 * EDGE / band:.2g} s", where=recording.label)
    return read


def values_at(grid: FloatArray, time: FloatArray, values: FloatArray) -> FloatArray:
    """Values (N, n) at times (N,), interpolated at those of a grid."""
    return np.stack([np.interp(grid, time, column) for column in values.T], axis=1)
