"""Commanded and measured positions of a recording: the goals of a servo, and what its encoder showed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.text import counted
from drivers.streams import COMMANDS

TARGET = "target_position"


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """A recording's measured and commanded positions, in the robot's joint order; raw, each at its own stamps."""

    joint_names: tuple[str, ...]  # (n,)
    time: FloatArray  # (N,) stamps of the measured positions [s]
    position: FloatArray  # (N, n) measured [rad or m]
    command_time: FloatArray  # (M,) stamps of the commands [s], of the same clock
    # quantity of `drivers.streams.COMMANDS` → (M, n), in its unit; `target_position` is there
    commands: dict[str, FloatArray]

    def held(self, times: npt.ArrayLike, quantity: str = TARGET) -> FloatArray:
        """The command (K, n) in force at times (K,) [s]: the latest one sent; before the first, the first.

        Raises:
            KeyError: the quantity was not recorded.
        """
        return held(self.command_time, self.commands[quantity], np.asarray(times, dtype=np.float64))


def held(stamps: FloatArray, values: FloatArray, times: FloatArray) -> FloatArray:
    """Values (M, n), stamped (M,) [s], as they stand at times (K,): (K, n); before the first, the first."""
    latest = np.searchsorted(stamps, times, side="right") - 1
    standing: FloatArray = values[np.maximum(latest, 0)]
    return standing


def commanded_motion(recording: Recording, robot: Robot) -> CommandedMotion:
    """Measured and commanded positions of a recording.

    Raises:
        DataError: there are no measured or no commanded positions, a joint is missing, a value is not a number, or
            stamps do not rise; names the stream and the first such sample.
    """
    names = robot.joint_names
    joints = recording.streams.get(JOINTS_STREAM)
    if joints is None or "position" not in joints.channels:
        raise DataError("records no position", where=f"{recording.label}: {JOINTS_STREAM}")
    commanded = command_stream(recording)
    if commanded is None:
        quantities = ", ".join(sorted({name for stream in recording.streams.values() for name in stream.channels}))
        raise DataError(
            f"records no commanded position; it has {quantities}",
            where=recording.label,
            hint="import it with --column target_position=NAME, and target_time=NAME where its stamps differ",
        )
    commands = {
        name: _ordered(commanded, channel, names, recording.label)
        for name, channel in commanded.channels.items()
        if name in COMMANDS and (name == TARGET or set(names) <= set(channel.columns))
    }
    position = _ordered(joints, joints.channels["position"], names, recording.label)
    for stream in (joints, commanded):
        backward = np.flatnonzero(~(np.diff(stream.time) > 0))
        if len(backward):
            raise DataError(
                f"{len(backward)} stamps do not increase, first at sample {backward[0] + 1}",
                where=f"{recording.label}: {stream.name}",
                hint="import the source again with the repair sort or drop-duplicates (--repair, in Python repair=)",
            )
    time = joints.time
    if recording.trajectory and commanded.name == COMMANDS_STREAM and len(commanded.time):
        # Played and recorded by one program, by one clock: before its first command the arm was at rest.
        played = time >= commanded.time[0]
        time, position = time[played], position[played]
    return CommandedMotion(names, time, position, commanded.time, commands)


def command_stream(recording: Recording) -> Stream | None:
    """The stream that holds the commanded positions: that of the commands, else that of the joints; None without."""
    for name in (COMMANDS_STREAM, JOINTS_STREAM):
        stream = recording.streams.get(name)
        if stream is not None and TARGET in stream.channels and len(stream.time):  # none sent: a motion was refused
            return stream
    return None


def _ordered(stream: Stream, channel: Channel, names: tuple[str, ...], label: str) -> FloatArray:
    """(N, n) finite values in the order of the names."""
    where = f"{label}: {stream.name}/{channel.quantity}"
    missing = [name for name in names if name not in channel.columns]
    if missing:
        raise DataError(
            f"has no column for joint {' or '.join(missing)}; it has {', '.join(channel.columns)}",
            where=where,
            hint="is this the robot that was recorded? name another: --robot, in Python robot=",
        )
    values = channel.values[:, [channel.columns.index(name) for name in names]]
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise DataError(
            f"{counted(len(bad), 'value')} not a number, the first at sample {bad[0, 0]}, joint {names[bad[0, 1]]}",
            where=where,
            hint="import the source again with the repair drop-nan (--repair, in Python repair=)",
        )
    return values
