"""Signals of an identification: a recording's joint positions and joint torques, in the robot's joint order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daq.recording.commanded_motion import TARGET, command_stream
from daq.recording.quality.outliers import without_outliers
from daq.recording.quality.quantisation import encoder_step
from daq.recording.quality.stale_samples import StaleSamples, fresh_recording
from daq.recording.recording import COMMANDS_STREAM, JOINTS_STREAM, MOTOR_SIGNALS, Channel, Recording, Stream
from daq.robot.loops import coupling_matrix
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from drivers.core.text import counted
from drivers.core.units import ZERO_CELSIUS
from drivers.gains import DriveGain, joint_torque
from drivers.streams import GOAL_AGE
from ident.ranges import RECORDED_POSITION, RECORDED_TORQUE, RECORDED_VELOCITY

SERVO_HINT = "identify a servo model from commands and encoder: --method servo"

JOINT_QUANTITIES = ("position", "velocity", "current", "voltage", "torque")

LONGEST_PERIOD = 0.1
"""[s] between two goals from which on the arm rested, or was held."""


@dataclass(frozen=True)
class ReplacedSamples:
    """Samples of a recorded quantity that were outliers (`daq.recording.quality.outliers`)."""

    quantity: str  # as recorded: position, current, …
    joint: str  # name
    count: int  # of samples


@dataclass(frozen=True, eq=False)
class JointPositions:
    """One recording's joint positions, stale rows left out, outliers replaced; N samples, n joints in robot order.

    Raises:
        DataError: a position is not finite.
    """

    label: str  # name of the recording in messages; may be empty
    joint_names: tuple[str, ...]  # (n,)
    time: FloatArray  # (N,) the source's clock [s]
    position: FloatArray  # (N, n) [rad or m]

    def __post_init__(self) -> None:
        _check(self.label, self.joint_names, self.time, {"position": self.position})


@dataclass(frozen=True, eq=False)
class JointSignals:
    """One recording's joint signals, stale rows left out, outliers replaced; N samples, n joints in robot order.

    Raises:
        DataError: a value is not finite; names the first such sample and its joint.
    """

    label: str  # name of the recording in messages; may be empty
    joint_names: tuple[str, ...]  # (n,)
    time: FloatArray  # (N,) the source's clock [s]
    position: FloatArray  # (N, n) [rad or m]
    torque: FloatArray  # (N, n) of the motors, referred to the joint side [N·m or N]
    torque_origin: str  # origin of the torque, in words
    velocity: FloatArray | None = None  # (N, n) [rad/s or m/s]; None where it was not recorded
    gains_used: tuple[str, ...] = ()  # names of the joints whose drive gain made the torque out of what was recorded
    replaced: tuple[ReplacedSamples, ...] = ()  # outliers in place of which stands what their neighbours say
    # (N, n) of the joints [K], nan for joints without a sensor; None where none was recorded
    temperature: FloatArray | None = None
    # (N, n) positions that the controller aimed at [rad or m], nan where no number; None where not recorded
    target: FloatArray | None = None
    # rows that were left out because they were not measured anew; None where there were none
    stale: StaleSamples | None = None
    sliding: tuple[bool, ...] = ()  # whether each joint slides, for the units of messages; empty where all turn

    def __post_init__(self) -> None:
        optional = {} if self.velocity is None else {"velocity": self.velocity}
        quantities = {"position": self.position, "torque": self.torque, **optional}
        _check(self.label, self.joint_names, self.time, quantities)

    @cached_property
    def encoder_steps(self) -> FloatArray:
        """Steps (n,) of the joints' encoders [rad or m]; nan where the positions lie on no grid."""
        return np.array([encoder_step(column) for column in self.position.T])


_RANGES = {"position": RECORDED_POSITION, "velocity": RECORDED_VELOCITY, "torque": RECORDED_TORQUE}


def _check(label: str, joint_names: Sequence[str], time: FloatArray, quantities: Mapping[str, FloatArray]) -> None:
    for name, values in quantities.items():
        if values.shape != (len(time), len(joint_names)):
            raise ValueError(f"{name} of shape {values.shape}, {len(time)} stamps, {len(joint_names)} joints")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            sample, joint = bad[0]
            values_of_joint = counted(int(np.count_nonzero(bad[:, 1] == joint)), "value")
            raise DataError(
                f"{values_of_joint} not a number, the first at sample {sample}",
                where=f"{label}: {name} of {joint_names[joint]}".removeprefix(": "),
                hint="import the source again with the repair drop-nan (--repair, in Python repair=)",
            )
        allowed = _RANGES[name]
        bad = np.argwhere(np.abs(values) > allowed.most)
        if len(bad):
            sample, joint = bad[0]
            raise DataError(
                f"{values[sample, joint]:g} at sample {sample} is not within {allowed}",
                where=f"{label}: {name} of {joint_names[joint]}".removeprefix(": "),
            )


def read_joint_signals(recording: Recording, robot: Robot) -> JointSignals:
    """Positions and torques of a recording; a motor signal is turned into torque by the robot file's gains.

    Γ = gain · signal (SR400 .4.3 point 1; AUBO eq. 2). Where both exist, a signal with a known gain is preferred to a
    recorded torque: the gain may have been corrected since. A signal is its motor's; a recorded torque is the joint's,
    and is referred to the motors by R⁻ᵀ where the robot file couples them.

    Raises:
        DataError: a stream, quantity, joint or gain is missing, or values are not finite.
    """
    recording, stale = fresh_recording(recording)
    joints = with_even_goals(_joints_stream(recording), recording.streams.get(COMMANDS_STREAM))
    stream, replaced = _without_outliers(joints)
    position = _positions(stream, robot, recording.label)
    hint = "" if command_stream(recording) is None else SERVO_HINT
    torque, origin, gains_used = _joint_torque(stream, robot, recording.label, hint)
    velocity = _joint_values(stream, "velocity", robot, recording.label)
    return JointSignals(
        recording.label,
        tuple(robot.joint_names),
        stream.time,
        position,
        torque,
        origin,
        velocity,
        gains_used,
        replaced,
        joint_temperature(recording, tuple(robot.joint_names)),
        joint_target(stream, tuple(robot.joint_names), position),
        stale,
        robot.sliding,
    )


def joint_positions(recording: Recording, robot: Robot) -> JointPositions:
    """Positions of a recording.

    Raises:
        DataError: the stream, the quantity or a joint is missing, or values are not finite.
    """
    recording, _ = fresh_recording(recording)
    stream, _ = _without_outliers(_joints_stream(recording), ("position",))
    position = _positions(stream, robot, recording.label)
    return JointPositions(recording.label, tuple(robot.joint_names), stream.time, position)


def live_signals(stream: Stream, robot: Robot, label: str) -> tuple[FloatArray, FloatArray]:
    """Positions (N, n) [rad or m] and motor torques (N, n) [N·m or N] of samples as they come, not cleaned.

    Raises:
        DataError: a quantity, joint or gain is missing.
    """
    return _positions(stream, robot, label), _joint_torque(stream, robot, label, "")[0]


def _joints_stream(recording: Recording) -> Stream:
    stream = recording.streams.get(JOINTS_STREAM)
    if stream is None:
        streams = ", ".join(recording.streams) or "none"
        raise DataError(f"has no stream '{JOINTS_STREAM}'; streams: {streams}", where=recording.label)
    if len(stream.time) < 2 or np.ptp(stream.time) == 0.0:
        problem = f"its {len(stream.time)} samples last 0 s" if len(stream.time) else "the recording holds no samples"
        raise DataError(problem, where=recording.label)
    return stream


def _without_outliers(
    stream: Stream, quantities: Sequence[str] = JOINT_QUANTITIES
) -> tuple[Stream, tuple[ReplacedSamples, ...]]:
    """The stream with outliers of some quantities replaced, and how many of them there were."""
    channels, replaced = dict(stream.channels), []
    for quantity in quantities:
        if quantity not in channels:
            continue
        channel = channels[quantity]
        clean = without_outliers(stream.time, channel.values)
        channels[quantity] = replace(channel, values=clean.values)
        replaced += [
            ReplacedSamples(quantity, joint, int(count))
            for joint, count in zip(channel.columns, clean.replaced, strict=True)
            if count
        ]
    return replace(stream, channels=channels), tuple(replaced)


def _positions(stream: Stream, robot: Robot, label: str) -> FloatArray:
    position = _joint_values(stream, "position", robot, label)
    if position is None:
        raise DataError("records no position", where=f"{label}: {JOINTS_STREAM}")
    return position


def _joint_torque(stream: Stream, robot: Robot, label: str, hint: str) -> tuple[FloatArray, str, tuple[str, ...]]:
    """Torque, where it comes from, joints whose gain made it."""
    drives = [robot.drive(name) for name in robot.joint_names]
    signals = {drive.signal for drive in drives}
    signal = signals.pop() if len(signals) == 1 else "current"
    unsigned = {name for name in MOTOR_SIGNALS if name in stream.channels and stream.channels[name].magnitude}
    recorded = None if "torque" in unsigned else _joint_values(stream, "torque", robot, label)
    if signal != "torque" and len(signals) == 0:
        raw = None if signal in unsigned else _joint_values(stream, signal, robot, label)
        unknown = [drive.joint for drive in drives if drive.gain is None]
        if raw is not None and not unknown:
            drive_gains = [DriveGain(drive.gain, drive.gain_std, drive.signal) for drive in drives]
            origin = f"{signal} times the robot file's gains"
            return joint_torque(raw, drive_gains), origin, tuple(robot.joint_names)  # the motors' where coupled
        if recorded is None and raw is not None:
            raise DataError(
                f"records {signal}, but the gain of {', '.join(unknown)} is unknown",
                where=label,
                hint=f"give it in a robot file (drives: - {{joint: {unknown[0]}, gain: …}}), name that: --robot, in "
                "Python robot=",
            )
    if recorded is None and (unsigned or any(drive.signal == "magnitude" for drive in drives)):
        raise DataError(
            f"its {' and '.join(sorted(unsigned)) or 'current'} is a magnitude: without its sign it is not a torque",
            where=label,
            hint=SERVO_HINT,
        )
    if recorded is None:
        other, quantities = signal if signal != "torque" else "current", ", ".join(sorted(stream.channels)) or "nothing"
        said = f"records neither torque nor {other}; it has {quantities}"
        if other in stream.channels:
            declared = " and ".join(sorted({drive.signal for drive in drives}))
            said = f"records {other} alone, but the signal of the robot file's drives is {declared}"
        raise DataError(said, where=label, hint=hint)
    used = tuple(drive.joint for drive in drives if drive.signal == "torque" and drive.gain)
    gains = np.array([drive.gain if drive.joint in used else 1.0 for drive in drives], dtype=np.float64)
    if robot.model.coupling:
        coupling = coupling_matrix(robot.model.coupling, robot.joint_names)
        return (
            np.linalg.solve(coupling.T, (recorded * gains).T).T,
            "torque as recorded, referred to the coupled motors",
            used,
        )
    return recorded * gains, "torque as recorded", used


def _joint_values(stream: Stream, quantity: str, robot: Robot, label: str) -> FloatArray | None:
    """(N, n) in the robot's joint order; None where the quantity was not recorded."""
    channel: Channel | None = stream.channels.get(quantity)
    if channel is None:
        return None
    missing = [name for name in robot.joint_names if name not in channel.columns]
    if missing:
        raise DataError(
            f"'{quantity}' has no column for joint {' or '.join(missing)}; it has {', '.join(channel.columns)}",
            where=f"{label}: {stream.name}",
            hint="is this the robot that was recorded? name another: --robot, in Python robot=",
        )
    order = [channel.columns.index(name) for name in robot.joint_names]
    return channel.values[:, order]


def joint_target(joints: Stream, joint_names: tuple[str, ...], position: FloatArray) -> FloatArray | None:
    """Target positions (N, n) [rad or m] of the joints, nan where a value cannot be one.

    None where none was recorded or not of every joint, and where those of a moving joint are its very positions: a
    controller that copies them has no reference of its own. No error, for few methods need targets.
    """
    channel = joints.channels.get(TARGET)
    if channel is None or any(name not in channel.columns for name in joint_names):
        return None
    values = channel.values[:, [channel.columns.index(name) for name in joint_names]]
    if np.any(np.all(values == position, axis=0) & (np.ptp(position, axis=0) > 0.0)):
        return None
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) <= RECORDED_POSITION.most, values, np.nan)


TEMPERATURE = "temperature"


def joint_temperature(recording: Recording, joint_names: tuple[str, ...]) -> FloatArray | None:
    """Temperatures (N, n) [K] of the joints, interpolated between readings; None where none was recorded.

    Thermometers have clocks of their own, so that streams are compared by the host's. Where several streams tell the
    temperature of a joint, the joint stream counts, then the first in the file. A joint without a reading is nan.
    """
    joints = recording.streams[JOINTS_STREAM]
    others = [stream for name, stream in recording.streams.items() if name != JOINTS_STREAM]
    values = np.full((len(joints.time), len(joint_names)), np.nan)
    for stream in (joints, *others):
        channel = stream.channels.get(TEMPERATURE)
        for column, name in enumerate(channel.columns if channel is not None else ()):
            if channel is None or name not in joint_names or not np.all(np.isnan(values[:, joint_names.index(name)])):
                continue
            read = np.isfinite(channel.values[:, column])
            if np.any(read):
                values[:, joint_names.index(name)] = np.interp(
                    joints.host_time, stream.host_time[read], channel.values[read, column]
                )
    return None if np.all(np.isnan(values)) else values + ZERO_CELSIUS


def with_even_goals(joints: Stream, commands: Stream | None) -> Stream:
    """The joints' stream, with torques as if goals moved evenly where it says when they were obeyed.

    A spring kp to a goal that stands for a period T falls by kp·q̇·T while the joint goes on. Where in the period a
    motor is read makes a difference of up to kp·q̇·T/2, viscous friction to an identification: a late reading is a bias.
    What drives the arm over several periods is the spring to a goal that moves evenly, and is at each goal in the
    middle of its period: kp times the distance between the two is added to the torque that was read.
    """
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
