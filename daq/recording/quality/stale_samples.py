"""Samples that say nothing or something wrong: repeated rows, stuck encoders, jumps of positions, motors that are off.

A joint that moves by several steps of its encoder per sample cannot show the same position twice: such a row was
written again, or its positions were not read anew. An encoder that shows exactly the same position for a while has
stopped, not its joint, where the recorded velocity or the target goes on, or where the position jumps at the end by far
more than the joint moves from sample to sample. While a motor is off its brake holds the joint, and no torque shows it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from daq.recording.commanded_motion import TARGET, command_stream, held
from daq.recording.quality.outliers import PositionJump, beside_jumps, position_jumps
from daq.recording.quality.quantisation import resolution
from daq.recording.quality.signal_quality import white_noise
from daq.recording.recording import JOINTS_STREAM, MOTOR_SIGNALS, Recording, Stream
from drivers.core.arrays import BoolArray, FloatArray, true_runs
from drivers.streams import MOTOR_ON, motors_on

MEASURED = ("position", "velocity", "current", "voltage", "torque")
"""Quantities that all repeat where a whole row does."""

STEPS_PER_SAMPLE = 3.0
"""A joint that moves by so many encoder steps per sample, before and after, does not show a position twice."""

LONGEST_REPETITION = 10
"""Consecutive rows that repeat one; longer ones are a standstill, of the arm or of the recording."""

LEAST_SHARE = 0.002
"""Share of a recording's rows from which on repeated rows are left out: fewer change no estimate."""

LEAST_ROWS = 10

STANDSTILL = 0.1
"""Shortest standstill of an encoder [s] that is looked at."""

STANDSTILL_ROWS = 8

STANDSTILL_JUMP = 5.0
"""Change of position at the end of a standstill, in changes per sample before and after it."""

FAR_STEPS = 10.0
"""Encoder steps of a jump, or of the way that velocity or target goes meanwhile."""

VELOCITY_SHARE = 0.1
"""Root mean square of the velocity during a standstill over that of the recording; noise has less."""

NOISE = 5.0
"""The same over the velocity's white noise."""

TRACKING = 3.0
"""Way of the target during a standstill over the largest tracking error outside it."""

LEAST_WAY = 2e-3
"""[rad or m] A joint may rest by its friction or its backlash while its target moves by less."""

MOST_STUCK = 0.5
"""Share of a recording beyond which rows of stuck encoders stay: what is left would be another recording."""

_WINDOW = 3
_AROUND = 5

Evidence = Literal["velocity", "target", "jump"]


@dataclass(frozen=True)
class StuckEncoder:
    """A joint's position that stands still while the joint does not."""

    joint: str  # name
    # start, stop: stamps of its first and last sample [s]
    start: float
    stop: float
    # what shows that the joint moves: its velocity, its target, or the jump of the position at the end
    evidence: Evidence


@dataclass(frozen=True, eq=False)
class StaleSamples:
    """What of a stream of N samples was not measured anew."""

    repeated: BoolArray  # (N,) rows whose values all repeat those of the row before
    held: BoolArray  # (N,) rows whose positions repeat those of the row before, while other quantities do not
    stuck: BoolArray  # (N,) rows during which an encoder is stuck
    encoders: tuple[StuckEncoder, ...]  # these, in words
    beside: BoolArray  # (N,) rows about a jump of the positions
    jumps: tuple[PositionJump, ...] = ()  # these
    off: BoolArray | None = None  # (N,) rows during which a motor is off that is on in others; None where unknown

    @property
    def left_out(self) -> BoolArray:
        """(N,) rows that say nothing, or something wrong; those of stuck encoders only if most others stay.

        The first and the last row of motors that are off stay: times count from the first stamp.
        """
        few = np.count_nonzero(self.stuck) <= MOST_STUCK * len(self.stuck)
        stuck = self.stuck if few else np.zeros_like(self.stuck)
        stale = self.repeated | self.held | stuck | self.beside
        if self.off is not None:
            stale[1:-1] |= self.off[1:-1]
        return stale


def stale_samples(time: FloatArray, joints: tuple[str, ...], measured: Mapping[str, FloatArray]) -> StaleSamples:
    """Find the stale samples among those of N rising stamps [s].

    Measured are `position`, others of `MEASURED`, and `target_position`: (N, n) each, in the order of the joints.
    """
    position = measured["position"]
    none = np.zeros(len(time), dtype=np.bool_)
    if len(time) < 4 * _AROUND or not np.all(np.diff(time) >= 0) or not np.all(np.isfinite(position)):
        return StaleSamples(none, none, none, (), none)
    steps = np.array([resolution(column) for column in position.T])
    standstills = []
    for column in range(len(joints)):
        others_of = {name: measured[name][:, column] for name in ("velocity", "target_position") if name in measured}
        standstills += [
            (column, *standstill) for standstill in _standstills(time, position[:, column], steps[column], others_of)
        ]
    spans = Counter((start, stop) for _, start, stop, _ in standstills)
    rows = _repeated(position, steps)
    for (start, stop), several in spans.items():
        if several > 1:  # encoders do not stop and go on together: the rows were not read anew
            rows[start + 1 : stop] = True
    others = [measured[name] for name in MEASURED if name != "position" and name in measured]
    same = np.ones(len(time), dtype=np.bool_)
    for values in others:
        same[1:] &= np.all(values[1:] == values[:-1], axis=1)
    stale = []
    for kind in (rows & same, rows & ~same):
        counts = np.count_nonzero(kind)
        stale.append(kind if counts >= max(LEAST_ROWS, LEAST_SHARE * len(time)) else none)
    stuck, encoders = none.copy(), []
    for column, start, stop, evidence in standstills:
        if spans[start, stop] == 1:
            stuck[start + 1 : stop] = True
            encoders.append(StuckEncoder(joints[column], float(time[start]), float(time[stop - 1]), evidence))
    jumps = position_jumps(time, joints, position, rows | stuck)
    return StaleSamples(stale[0], stale[1], stuck, tuple(encoders), beside_jumps(time, jumps), jumps)


def stale_rows(recording: Recording) -> StaleSamples | None:
    """The stale samples of a recording's joint stream; None where it holds no positions."""
    stream = recording.streams.get(JOINTS_STREAM)
    if stream is None or "position" not in stream.channels or not len(stream.time):
        return None
    joints, measured = stream.channels["position"].columns, {}
    commanded = command_stream(recording)
    for name, source in (*((name, stream) for name in MEASURED), (TARGET, commanded)):
        channel = None if source is None else source.channels.get(name)
        if source is not None and channel is not None and all(joint in channel.columns for joint in joints):
            values = channel.values[:, [channel.columns.index(joint) for joint in joints]]
            measured[name] = values if source is stream else held(source.time, values, stream.time)
    return replace(
        stale_samples(stream.time, joints, measured), off=_motors_off(recording, stream, measured["position"])
    )


def _motors_off(recording: Recording, stream: Stream, position: FloatArray) -> BoolArray:
    """(N,) rows in which a motor is off that is on in others: by the drives' status, or all torques are 0 at rest."""
    time, on = stream.time, np.ones(position.shape, dtype=np.bool_)
    for source in recording.streams.values():
        for quantity in MOTOR_ON.keys() & source.channels.keys():
            if len(source.time):
                on &= motors_on(quantity, held(source.time, source.channels[quantity].values, time))
    signals = [stream.channels[name].values for name in MOTOR_SIGNALS if name in stream.channels]
    zero = np.all(np.concatenate(signals, axis=1) == 0.0, axis=1) if signals else np.zeros(len(time), dtype=np.bool_)
    for start, stop in true_runs(zero):
        still = float(np.ptp(position[start:stop], axis=0).max()) <= LEAST_WAY
        if still and stop - start >= STANDSTILL_ROWS and time[stop - 1] - time[start] >= STANDSTILL:
            on[start:stop] = False
    return np.asarray(np.any(~on & on.any(axis=0), axis=1))


def fresh_recording(recording: Recording) -> tuple[Recording, StaleSamples | None]:
    """The recording without the stale rows of its joint stream, and which they are; None where there are none."""
    stale = stale_rows(recording)
    if stale is None or not stale.left_out.any():
        return recording, None
    stream, rows = recording.streams[JOINTS_STREAM], ~stale.left_out
    channels = {name: replace(channel, values=channel.values[rows]) for name, channel in stream.channels.items()}
    fresh = replace(stream, time=stream.time[rows], host_time=stream.host_time[rows], channels=channels)
    return replace(recording, streams={**recording.streams, JOINTS_STREAM: fresh}), stale


def _repeated(position: FloatArray, steps: FloatArray) -> BoolArray:
    """(N,) rows whose positions all repeat those of the row before while a joint moves, before and after."""
    same = np.concatenate([[False], np.all(position[1:] == position[:-1], axis=1)])
    stale = np.zeros(len(same), dtype=np.bool_)
    for start, stop in true_runs(same):
        before, after = start - 1 - _WINDOW, stop - 1 + _WINDOW
        if stop - start > LONGEST_REPETITION or before < 0 or after >= len(position):
            continue
        slowest = np.minimum(
            np.abs(position[start - 1] - position[before]), np.abs(position[after] - position[stop - 1])
        )
        stale[start:stop] = np.any(slowest >= STEPS_PER_SAMPLE * _WINDOW * steps)
    return stale


def _standstills(
    time: FloatArray, position: FloatArray, step: float, others: Mapping[str, FloatArray]
) -> Iterator[tuple[int, int, Evidence]]:
    """First and last sample (exclusive) of each standstill of one encoder whose joint moves, and what shows it."""
    if not np.isfinite(step):
        return  # the joint never moves
    same = np.concatenate([[False], position[1:] == position[:-1]])
    changes = np.abs(np.diff(position))
    velocity, target = others.get("velocity"), others.get("target_position")
    floor = 0.0 if velocity is None else NOISE * white_noise(velocity)
    for first, stop in true_runs(same):
        start = first - 1
        if stop - start < STANDSTILL_ROWS or time[stop - 1] - time[start] < STANDSTILL:
            continue
        if velocity is not None and _moves(time[start:stop], velocity[start:stop], velocity, floor, step):
            yield start, stop, "velocity"
        elif target is not None and _leaves(position, target, start, stop, step):
            yield start, stop, "target"
        elif stop < len(position) and _jumps(changes, start, stop, step):
            yield start, stop, "jump"


def _moves(time: FloatArray, velocity: FloatArray, whole: FloatArray, floor: float, step: float) -> bool:
    """Return whether a velocity (M,) is that of a moving joint, by that of the whole recording (N,)."""
    if not np.all(np.isfinite(whole)):
        return False
    size = float(np.sqrt(np.mean(velocity**2)))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))])
    usual = float(np.sqrt(np.mean(whole**2)))
    return size > max(floor, VELOCITY_SHARE * usual) and float(np.ptp(way)) > max(FAR_STEPS * step, LEAST_WAY)


def _leaves(position: FloatArray, target: FloatArray, start: int, stop: int, step: float) -> bool:
    """Return whether a target (N,) moves on during a standstill of the position."""
    outside = np.ones(len(position), dtype=np.bool_)
    outside[start : min(len(position), stop + _AROUND)] = False
    error = np.abs(target - position)[outside]
    if not len(error) or not np.all(np.isfinite(target)):
        return False
    return float(np.ptp(target[start:stop])) > max(
        TRACKING * float(np.quantile(error, 0.999)), FAR_STEPS * step, LEAST_WAY
    )


def _jumps(changes: FloatArray, start: int, stop: int, step: float) -> bool:
    """Whether a moving joint seems to stop at once and to jump on later; `changes` (N − 1,) of the position per sample.

    From rest a servo may reach its speed within a sample, so that a jump alone says nothing.
    """
    before, after = changes[max(0, start - _AROUND) : start], changes[stop : stop + _AROUND]
    if len(before) < _AROUND or len(after) < _AROUND:
        return False
    stopped, speed = float(np.median(before[-_WINDOW:])), float(max(np.median(before), np.median(after)))
    jump = float(changes[stop - 1])
    return stopped >= STEPS_PER_SAMPLE * step and jump > max(STANDSTILL_JUMP * speed, FAR_STEPS * step)
