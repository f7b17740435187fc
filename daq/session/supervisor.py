"""The safety supervisor: checks every batch, and names the first limit that was passed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from daq.robot.loops import coupling_matrix
from daq.robot.schema import Robot
from daq.session.stuck_channels import LOOK_EVERY, MOST_TOGETHER, WATCHED, JointSpeed, StuckChannel
from drivers.core.arrays import FloatArray, IndexArray
from drivers.core.units import joint_unit
from drivers.gains import torque_at_joints
from drivers.streams import UNITS, Batch, StreamLayout

TRACKING_ERROR = 0.2
"""Default limit of the tracking error [rad or m]."""
TRACKING_WINDOW = 0.25
"""Greatest age [s] of a command that a measured position may still follow."""
VELOCITY_MARGIN = 1.1
"""A motion may use the whole velocity limit; this leaves room for its noise and overshoot."""
STALE_PERIODS = 5
STALE_FLOOR = 0.05
"""A PC stalls for tens of milliseconds itself: below this [s] that is indistinguishable from a silent source."""
VALUE_AGES = {"position": (0.0, 1.0), "velocity": (0.0, 1.0), "torque": (0.0, 1.0), "temperature": (5.0, 60.0)}
"""Quantity with a limit: how old [s] its newest value may be at least, and where its rate is unknown."""


OTHER_VELOCITY = "velocity channel"
CURES = {
    "position": "keep the motion away from the joint's limits, or correct them or the joint's zero in the robot file",
    "velocity": "lower --speed-scale, or correct the limit in the robot file",
    "torque": "lower --speed-scale; look for a contact, a load or friction that was not planned for",
    "temperature": "let it cool down, and pause between motions",
    "tracking error": "check for a blocked joint or a closed brake, or lower --speed-scale",
    "stale data": "check cables and power; if this computer stalled, end other programs or use --realtime",
    "stuck": "check the sensor, its cable and its drive",
    OTHER_VELOCITY: "correct the unit, scale or sign of the velocity: in the drive, or in the connection's signals",
}
"""What passed a limit, or was stuck → what to do about it."""


@dataclass(frozen=True)
class Breach:
    """A limit that was passed."""

    what: str  # position, velocity, torque, temperature, tracking error, stale data, what is stuck, or `OTHER_VELOCITY`
    joint: str  # name of the joint, or of the stream for stale data
    # value, limit: in `unit`
    value: float
    limit: float
    time: float  # of the source's clock [s]; nan where there is none
    unit: str  # of both
    cause: str = ""  # why, in words; empty where unknown
    supervised: bool = True  # whether a motion must not go on

    @property
    def cure(self) -> str:
        """Return what to do about it."""
        return CURES["stuck" if self.what.startswith("stuck") or np.isnan(self.value) else self.what]

    def __str__(self) -> str:
        if self.what == OTHER_VELOCITY:
            return f"{self.what} of {self.joint}: it says {self.value:.3g} {self.unit}, but {self.cause}"
        if np.isnan(self.value):
            return f"{self.what} of {self.joint} is not a number"
        said = f"{self.what} of {self.joint}: {self.value:.4g} {self.unit} passes {self.limit:.4g} {self.unit}"
        return f"{said} ({self.cause})" if self.cause else said


@dataclass(frozen=True)
class Limits:
    """Limits of an arm in motion; arrays (n,), infinite where a limit is unknown."""

    joints: tuple[str, ...]  # names
    # lowest, highest: position [rad or m]
    lowest: FloatArray
    highest: FloatArray
    velocity: FloatArray  # [rad/s or m/s], with its margin
    torque: FloatArray  # [N·m or N]
    temperature: FloatArray  # [°C]
    tracking_error: FloatArray  # [rad or m]
    torque_per_current: FloatArray  # of the motors [N·m/A], nan where unknown; used where a source has no torque
    coupling: FloatArray  # (n, n) R of q_motor = R·q_joint
    sliding: tuple[bool, ...]  # whether a joint slides, for the units of messages

    @classmethod
    def of_robot(cls, robot: Robot, tracking_error: float = TRACKING_ERROR) -> Self:
        """The limits of a robot file."""
        drives = [robot.drive(name) for name in robot.joint_names]
        return cls(
            robot.joint_names,
            np.array([joint.position[0] for joint in robot.joints]),
            np.array([joint.position[1] for joint in robot.joints]),
            VELOCITY_MARGIN * np.array([joint.velocity for joint in robot.joints]),
            np.array([np.inf if joint.torque is None else joint.torque for joint in robot.joints]),
            np.array([np.inf if joint.temperature is None else joint.temperature for joint in robot.joints]),
            np.full(robot.dof, tracking_error),
            np.array([d.gain if d.gain is not None and d.signal == "current" else np.nan for d in drives]),
            coupling_matrix(robot.model.coupling, robot.joint_names),
            robot.sliding,
        )

    def torque_of_current(self, current: FloatArray, motors: IndexArray) -> tuple[FloatArray, IndexArray]:
        """Joint torque (N, k) [N·m] of the currents (N, m) [A] of some motors (m,), and of which joints (k,).

        A joint is left out where one of the motors that move it is not among them, or has an unknown gain.
        """
        gain = np.full(len(self.joints), np.nan)
        gain[motors] = self.torque_per_current[motors]
        joints = np.flatnonzero(~np.any((self.coupling != 0.0) & np.isnan(gain)[:, np.newaxis], axis=0))
        torque = np.zeros((len(current), len(self.joints)))
        torque[:, motors] = current * gain[motors]
        return torque_at_joints(torque, self.coupling)[:, joints], joints


def stale_after(rate: float) -> float:
    """Age [s] from which a stream of this rate [Hz] is stale: five periods, at least 50 ms; never where it is 0."""
    return max(STALE_PERIODS / rate, STALE_FLOOR) if rate > 0 else np.inf


def value_stale_after(quantity: str, rate: float) -> float:
    """Age [s] from which a value with a limit is stale, in a stream of this rate [Hz], 0 where it is unknown."""
    floor, unknown = VALUE_AGES[quantity]
    return max(floor, stale_after(rate)) if rate > 0 else unknown


_Part = tuple[FloatArray, IndexArray]
"""Values (N, m) of m joints, and which joints (m,) they are."""


class Supervisor:
    """Checks blocks, commands and ages against limits.

    A column with a joint's name has that joint's limit, also in a stream that has only some of the joints
    or has them in another order; where no column does, as many columns as joints count as the joints. Only streams with
    all joints are compared with commands and targets.
    """

    def __init__(self, limits: Limits, layouts: Sequence[StreamLayout]) -> None:
        self._limits = limits
        self._stale_after = {layout.name: stale_after(layout.rate) for layout in layouts if layout.essential}
        self._parts = _partial_channels(limits.joints, layouts)
        self._all = np.arange(len(limits.joints))
        self._last_arrival: dict[str, float] = {}
        bounds = {
            "position": np.minimum(limits.highest, -limits.lowest),
            "velocity": limits.velocity,
            "torque": limits.torque,
            "temperature": limits.temperature,
        }
        # When each joint's newest value came [s, host clock]; NaN before the first, and where there is no limit.
        self._newest = np.full((len(bounds), len(limits.joints)), np.nan)
        self._last_value = dict(zip(bounds, self._newest, strict=True))
        self._limited = {quantity: np.isfinite(bound) for quantity, bound in bounds.items()}
        self._value_stale_after = np.array([[_oldest(quantity, layouts)] for quantity in bounds])
        self._commands: deque[tuple[float, FloatArray, float]] = deque()  # sent, position, due
        self._rates = {layout.name: layout.rate for layout in layouts}
        self._unseen: dict[str, tuple[float, list[Batch]]] = {}
        self._stuck: dict[tuple[str, str], StuckChannel] = {}
        self._speed = JointSpeed(len(limits.joints))
        self._velocity_units: dict[str, VelocityUnit] = {}

    def commanded(self, host_time: float, position: FloatArray, lag: float = 0.0) -> None:
        """Note a commanded position (n,), when it was sent [s, host clock], and how much later the arm is there [s]."""
        self._commands.append((host_time, position, host_time + lag))

    def check(self, batch: Batch, now: float) -> Breach | None:
        """The first limit that a batch passes, in time; None where it passes none. `now` [s] is the host's clock."""
        self._last_arrival[batch.stream] = now
        # A temperature that is not a number is a sensor without a reading; elsewhere it is a breach.
        breaches: list[tuple[int, Breach]] = []
        limits = self._limits
        if (measured := self._part(batch, "position")) is not None:
            position, at = measured
            self._note_values("position", measured, now)
            self._add(breaches, batch, "position", "rad", measured, position >= limits.lowest[at], limits.lowest)
            self._add(breaches, batch, "position", "rad", measured, position <= limits.highest[at], limits.highest)
            if len(at) == len(limits.joints):
                bound, target = limits.tracking_error, self._part(batch, "target_position")
                if target is not None and len(target[1]) == len(at):
                    error = np.abs(target[0] - position)
                    self._add(breaches, batch, "tracking error", "rad", (error, at), error <= bound, bound)
                error = self._distance_to_commands(batch.host_time, position, bound)
                self._add(breaches, batch, "tracking error", "rad", (error, at), error <= bound, bound)
        if (measured := self._part(batch, "velocity")) is not None:
            speed, at = np.abs(measured[0]), measured[1]
            self._note_values("velocity", measured, now)
            self._add(breaches, batch, "velocity", "rad/s", (speed, at), speed <= limits.velocity[at], limits.velocity)
        if (measured := self._torque(batch)) is not None:
            torque, at = measured
            self._note_values("torque", measured, now)
            self._add(breaches, batch, "torque", "N·m", measured, torque <= limits.torque[at], limits.torque)
        if (measured := self._part(batch, "temperature")) is not None:
            heat, at = measured
            self._note_values("temperature", measured, now)
            within = (heat <= limits.temperature[at]) | np.isnan(heat)
            self._add(breaches, batch, "temperature", "°C", measured, within, limits.temperature)
        return min(breaches, key=lambda entry: entry[0])[1] if breaches else None

    def stuck(self, batch: Batch, together: float = LOOK_EVERY) -> list[Breach]:
        """The channels of a stream that repeat bit for bit and should not, or are not what they are called.

        To be called for every batch, in order. It is looked at every `together` [s], which costs less than looking at
        every sample.
        """
        seen, batches = self._unseen.setdefault(batch.stream, (-np.inf, []))
        batches.append(batch)
        if len(batches) < MOST_TOGETHER and batch.time[-1] - seen < together:
            return []
        self._unseen[batch.stream] = float(batch.time[-1]), []
        breaches = []
        for quantity in WATCHED:
            parts = [part for batch in batches if (part := self._part(batch, quantity)) is not None]
            if not parts:
                continue
            values, joints = np.concatenate([rows for rows, _ in parts]), parts[0][1]
            time, whole = float(batch.time[-1]), len(joints) == len(self._limits.joints)
            if quantity == "position" and whole:
                self._speed.add(time, values[-1])
            if quantity == "velocity" and whole:
                breaches += self._other_velocities(batch, values)
            way, cause = self._speed.position, "while the joint moves"
            if quantity == "temperature":
                way, cause = np.full(len(self._limits.joints), time), "although it changed continuously before"
            elif quantity == "position":
                way, cause = self._aimed_at(batch), "while it is commanded on: its sensor hangs, or it is jammed"
            key = batch.stream, quantity
            if key not in self._stuck:
                rate = self._rates.get(batch.stream, 0.0)
                patience = stale_after(rate) if rate > 0.0 else VALUE_AGES[_supervised_as(quantity)][1]
                self._stuck[key] = StuckChannel(quantity, len(joints), patience)
            channel = self._stuck[key]
            for column in channel.add(time, values, way[joints], self._speed.speed[joints]).tolist():
                name, joint = self._limits.joints[joints[column]], int(joints[column])
                shown, unit = (
                    joint_unit(unit, sliding=self._limits.sliding[joint])
                    for unit in (UNITS[quantity].replace("degC", "°C"), "s" if quantity == "temperature" else "rad")
                )
                said = f"{values[-1, column]:.6g} {shown} repeats bit for bit {cause}"
                supervised = self._depends_on(batch, quantity, joint)
                breaches.append(Breach(f"stuck {quantity}", name, *channel.stood(column), time, unit, said, supervised))
        return breaches

    def _other_velocities(self, batch: Batch, values: FloatArray) -> list[Breach]:
        """The joints whose velocity contradicts their positions."""
        unit = self._velocity_units.setdefault(batch.stream, VelocityUnit(len(self._limits.joints)))
        breaches = []
        for joint in unit.add(values, self._speed.speed).tolist():
            named = joint_unit("rad/s", sliding=self._limits.sliding[joint])
            name, said, moved = self._limits.joints[joint], unit.mean[joint], unit.speed[joint]
            cause = f"its position moves by {moved:.3g} {named}: another unit, scale or sign"
            breaches.append(Breach(OTHER_VELOCITY, name, said, moved, float(batch.time[-1]), named, cause))
        return breaches

    def _aimed_at(self, batch: Batch) -> FloatArray:
        """(n,) the commanded position that is due, else the controller's target; NaN where there is neither."""
        if commands := list(self._commands):
            now = float(batch.host_time[-1])
            return next((target for _, target, due in reversed(commands) if due <= now), commands[0][1])
        target = self._part(batch, "target_position")
        aim = np.full(len(self._limits.joints), np.nan)
        if target is not None:
            aim[target[1]] = target[0][-1]
        return aim

    def _depends_on(self, batch: Batch, quantity: str, joint: int) -> bool:
        if quantity == "current" and ("torque" in batch.values or np.isnan(self._limits.torque_per_current[joint])):
            return False
        return quantity == "position" or bool(self._limited[_supervised_as(quantity)][joint])

    def check_ages(self, now: float, explain: Callable[[str, float], str] | None = None) -> Breach | None:
        """What has been silent for too long, once it has begun: a stream, or a quantity of joints that has a limit.

        `now` is the host's clock [s]; `explain` gives the cause of a stream's silence longer than a limit [s]; empty if
        unknown.
        """
        for stream, arrival in self._last_arrival.items():
            allowed = self._stale_after.get(stream, np.inf)
            if now - arrival > allowed:
                cause = "" if explain is None else explain(stream, allowed)
                return Breach("stale data", f"stream {stream}", now - arrival, allowed, float("nan"), "s", cause)
        stale = now - self._newest > self._value_stale_after
        if not stale.any():
            return None
        row = int(stale.any(axis=1).argmax())
        quantity, allowed = list(self._last_value)[row], float(self._value_stale_after[row, 0])
        who = f"{quantity} of {', '.join(self._limits.joints[joint] for joint in np.flatnonzero(stale[row]))}"
        age = float(now - self._newest[row, stale[row]].min())
        return Breach("stale data", who, age, allowed, float("nan"), "s")

    def restart_ages(self, now: float) -> None:
        """Restart the ages at `now` [s, host clock], after a time in which this process could not check."""
        self._last_arrival = dict.fromkeys(self._last_arrival, now)
        self._newest[~np.isnan(self._newest)] = now

    def _note_values(self, quantity: str, part: _Part, now: float) -> None:
        values, joints = part
        came = joints[np.isfinite(values).any(axis=0)]
        self._last_value[quantity][came[self._limited[quantity][came]]] = now

    def _part(self, batch: Batch, quantity: str) -> _Part | None:
        """A batch's values of a quantity, and their joints; None where it has none."""
        values = batch.values.get(quantity)
        if values is None:
            return None
        if (partial := self._parts.get((batch.stream, quantity))) is not None:
            columns, joints = partial
            return (values[:, columns], joints) if len(joints) else None
        return (values, self._all) if values.ndim == 2 and values.shape[1] == len(self._all) else None

    def _torque(self, batch: Batch) -> _Part | None:
        if (measured := self._part(batch, "torque")) is not None:
            return np.abs(measured[0]), measured[1]
        if (measured := self._part(batch, "current")) is None:
            return None
        torque, joints = self._limits.torque_of_current(*measured)
        return np.abs(torque), joints

    def _distance_to_commands(self, host_time: FloatArray, position: FloatArray, bound: FloatArray) -> FloatArray:
        """How far (N, n) positions lie from everything commanded shortly before, or more where that is within bounds.

        0 without a command.
        """
        while len(self._commands) > 1 and self._commands[1][0] < host_time[0] - TRACKING_WINDOW:
            self._commands.popleft()
        commands = list(self._commands)
        if not commands:
            return np.zeros_like(position)
        times = np.array([sent for sent, _, _ in commands])
        targets = np.array([target for _, target, _ in commands])
        first = np.maximum(np.searchsorted(times, host_time - TRACKING_WINDOW) - 1, 0)
        last = np.searchsorted(times, host_time, side="right")
        # Most often all positions are near what was commanded before each of them.
        if (common := targets[first.max() : last.min()]).size:
            distance: FloatArray = np.maximum(common.min(0) - position, position - common.max(0))
            if (distance <= bound).all():
                return distance
        distance = np.zeros_like(position)
        for row, (begin, end) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
            if end > begin:
                window = targets[begin:end]
                distance[row] = np.maximum(window.min(0) - position[row], position[row] - window.max(0))
        return np.maximum(distance, 0.0) + np.where(np.isnan(position), np.nan, 0.0)

    def _add(
        self,
        breaches: list[tuple[int, Breach]],
        batch: Batch,
        what: str,
        unit: str,
        measured: _Part,
        within: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
        limit: FloatArray,
    ) -> None:
        if within.all():
            return
        values, joints = measured
        row, column = (int(index) for index in np.argwhere(~within)[0])
        joint = int(joints[column])
        breach = Breach(
            what,
            self._limits.joints[joint],
            float(values[row, column]),
            float(limit[joint]),
            float(batch.time[row]),
            joint_unit(unit, sliding=self._limits.sliding[joint]),
        )
        breaches.append((row, breach))


def _supervised_as(quantity: str) -> str:
    return "torque" if quantity == "current" else quantity


def _oldest(quantity: str, layouts: Sequence[StreamLayout]) -> float:
    """Age [s] from which the values of a quantity are stale; that of the slowest stream that has them."""
    names = {quantity, "current"} if quantity == "torque" else {quantity}
    rates = [layout.rate for layout in layouts for channel in layout.channels if channel.quantity in names]
    return max((value_stale_after(quantity, rate) for rate in rates), default=np.inf)


def _partial_channels(
    joints: Sequence[str], layouts: Sequence[StreamLayout]
) -> Mapping[tuple[str, str], tuple[IndexArray, IndexArray]]:
    """(stream, quantity) → its columns with joints' names, and those joints, in their order.

    Channels with a column for each joint, in their order or under other names, are left out.
    """
    partial: dict[tuple[str, str], tuple[IndexArray, IndexArray]] = {}
    for layout in layouts:
        for channel in layout.channels:
            named = [joint_index for joint_index, joint in enumerate(joints) if joint in channel.columns]
            if channel.columns == tuple(joints) or (not named and len(channel.columns) == len(joints)):
                continue
            columns = [channel.columns.index(joints[joint_index]) for joint_index in named]
            partial[layout.name, channel.quantity] = (np.array(columns, np.intp), np.array(named, np.intp))
    return partial


SLOWEST = 0.1
"""[rad/s or m/s]: slower joints are not judged."""
LEAST, MOST = 0.5, 2.0
"""The velocity over the change of position, from which or up to which it is the same quantity, but for its filter."""
WINDOWS = 6
"""So many segments in a row must show it, all on the same side; a velocity that repeats in all of them is stale."""


class VelocityUnit:
    """Compares the velocities of one stream with the speeds of its positions."""

    def __init__(self, joints: int) -> None:
        self._sum, self._count = np.zeros(joints), 0
        self._below, self._above = np.zeros((2, joints), dtype=int)
        self._last, self._varied = np.full(joints, np.nan), np.zeros(joints, dtype=bool)
        self.mean, self.speed = np.zeros(joints), np.zeros(joints)
        """`mean` and `speed` are those of the segment that was compared last [rad/s or m/s]."""

    def add(self, velocity: FloatArray, speed: FloatArray) -> IndexArray:
        """Take samples; returns the joints whose velocity is another quantity.

        Args:
            velocity: (N, n) [rad/s or m/s].
            speed: (n,) of the positions since the last one that was no NaN [rad/s or m/s]; else NaN.
        """
        self._sum += velocity.sum(axis=0)
        self._count += len(velocity)
        self._varied |= (velocity != self._last).any(axis=0)
        self._last = velocity[-1].copy()
        if np.isnan(speed).all():
            return np.array([], dtype=np.intp)
        self.mean, self.speed = self._sum / self._count, speed
        self._sum, self._count = np.zeros(len(speed)), 0
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio, fast = self.mean / speed, np.abs(speed) >= SLOWEST
        self._below = np.where(fast, np.where(ratio < LEAST, self._below + 1, 0), self._below)
        self._above = np.where(fast, np.where(ratio > MOST, self._above + 1, 0), self._above)
        lasting = np.maximum(self._below, self._above)
        self._varied &= lasting > 0
        return np.flatnonzero((lasting >= WINDOWS) & self._varied)
