"""The command gate: the last check of every position, at the moment when it is sent to the drives.

The plan was checked before (`daq.motion.limits`); the gate checks what really goes out, and when. It trusts neither the
player's timing nor the plan, and nothing reaches a driver past it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from daq.motion.player import STALL_LIMIT, skip_limit
from daq.robot.schema import JointLimits
from daq.session.supervisor import CURES, TRACKING_ERROR, TRACKING_WINDOW
from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import SafetyStopError
from drivers.core.units import joint_unit

COMMAND_RATE = 100.0
"""A motion is not played with fewer commands, or fewer measured positions, per second than this."""
FRESH = 0.1
"""Greatest age [s] of the measured position. The supervisor stops an arm that is silent for 0.05 s; on top of it comes
a stall of this computer that the gate tolerates, after which the command may be sent before the samples are read."""
MARGIN = 0.01
"""Share by which a step or its change may pass its limit: rounding, and the differences of times near 2 ms."""
_CLOCK_CURE = "the motion jumps, or this computer's clock does: check the trajectory; is this a virtual machine?"
_ROUNDING = 1e-9
"""[rad or m]: of a position, and of the steps between positions."""


@dataclass(frozen=True)
class GateLimits:
    """What every command must keep; arrays (n,)."""

    joints: tuple[str, ...]  # names
    # lowest, highest: position [rad or m]
    lowest: FloatArray
    highest: FloatArray
    velocity: FloatArray  # [rad/s or m/s]
    acceleration: FloatArray  # [rad/s² or m/s²]
    # [rad or m], between a command and the measured position beyond what was commanded lately
    tracking_error: FloatArray
    sliding: tuple[bool, ...]  # whether a joint slides, for the units of messages

    @classmethod
    def of_joints(cls, joints: Sequence[JointLimits], tracking_error: float = TRACKING_ERROR) -> Self:
        """The limits of a robot file's joints."""
        return cls(
            tuple(joint.name for joint in joints),
            np.array([joint.position[0] for joint in joints]),
            np.array([joint.position[1] for joint in joints]),
            np.array([joint.velocity for joint in joints]),
            np.array([joint.acceleration for joint in joints]),
            np.full(len(joints), tracking_error),
            tuple(joint.sliding for joint in joints),
        )


class CommandGate:
    """Passes a command on to the driver, or refuses it; after a refusal nothing is passed any more.

    Each command has a due time: it is what the arm should do from then on. It is passed only if

    - it is not early, and the moving arm was not without a command for `STALL_LIMIT`;
    - it lies within the position limits;
    - the step since the last command, over the time between their due times, keeps the velocity limit, and the change
      of that mean velocity the acceleration limit. An arm that had to wait for longer than the player
      skips positions was held where it was, and must start from rest;
    - the measured position is fresh, and the command is not farther from it than the tracking limit allows.

    Args:
        send: takes a position (n,) and when it is due [s, host's clock].
        noted: called with the host's time [s] and each position before it is sent; the supervisor's `commanded`.
        limits: to keep.
        period: of the commands [s].
        clock: the host's.
    """

    def __init__(
        self,
        send: Callable[[FloatArray, float], None],
        noted: Callable[[float, FloatArray], None],
        limits: GateLimits,
        period: float,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        self._send = send
        self._noted = noted
        self._limits = limits
        self._period = period
        self._longest_step = (1 + skip_limit(period)) * period + 1e-6
        self._clock = clock
        self._measured: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None
        self._velocity = np.zeros(len(limits.joints))
        self._step_time = period
        self._recent = np.zeros((max(2, int(np.ceil(TRACKING_WINDOW / period))), len(limits.joints)))
        self._sent = 0
        self._closed: SafetyStopError | None = None

    def measured(self, now: float, position: FloatArray) -> None:
        """Take the newest measured position (n,) [rad or m], which arrived at `now` [s, host clock]."""
        self._measured = (now, position)  # one assignment: the player's thread reads it

    def command(self, position: FloatArray, due: float) -> None:
        """Send a position (n,) [rad or m] that is due at `due` [s, host clock].

        Raises:
            SafetyStopError: it does not pass; says which limit it breaks, and by how much.
            DynidError: the driver's own.
        """
        if self._closed is not None:
            raise SafetyStopError(self._closed.message, hint=self._closed.hint)
        now = self._clock.now()
        try:
            self._check(now, position, due)
        except SafetyStopError as error:
            self._closed = error
            raise
        self._noted(now, position)
        self._send(position, due)

    def _check(self, now: float, position: FloatArray, due: float) -> None:
        """Check a command, and remember it as the last one."""
        limits = self._limits
        if position.shape != limits.lowest.shape or not np.all(np.isfinite(position)):
            raise SafetyStopError(f"a command must be {len(limits.joints)} finite positions, not {position}")
        self._require("position", position, limits.highest + _ROUNDING, above=True)
        self._require("position", position, limits.lowest - _ROUNDING, above=False)
        if due > now + 1e-6:
            raise SafetyStopError(f"a command came {1e3 * (due - now):.3g} ms before it was due", hint=_CLOCK_CURE)
        measured = self._fresh_position(now)
        if self._last is None:
            # The arm is at rest where it was measured: this is where the path begins.
            self._require_step("first step", np.abs(position - measured), limits.velocity * self._period)
            self._recent[:] = position
        else:
            self._check_step(now, position, due, *self._last)
        self._recent[self._sent % len(self._recent)] = position
        self._sent += 1
        travelled = self._recent.max(axis=0) - self._recent.min(axis=0)
        self._require_step("tracking error", np.abs(position - measured), limits.tracking_error + travelled)
        self._last = (due, position)

    def _check_step(self, now: float, position: FloatArray, due: float, last_due: float, last: FloatArray) -> None:
        limits = self._limits
        step, dt = position - last, due - last_due
        if not np.any(step) and not np.any(self._velocity):
            self._step_time = self._period  # held: how long does not matter
            return
        if dt < 0.5 * self._period:
            raise SafetyStopError(
                f"two commands are {1e3 * dt:.3g} ms apart, where one is due every period", hint=_CLOCK_CURE
            )
        waited = max(dt, now - last_due)
        if waited > STALL_LIMIT + 2.0 * self._period:  # one that is due, and one of which part has passed
            raise SafetyStopError(
                f"the moving arm was without a command for {waited:.3f} s, more than {STALL_LIMIT:g} s",
                hint="this computer stalled: end other programs, or use --realtime",
            )
        if dt > self._longest_step:  # held meanwhile, so that it starts from rest
            self._velocity[:], self._step_time, dt = 0.0, self._period, self._period
        velocity = step / dt
        room = 2.0 * _ROUNDING / dt
        self._require_step("commanded velocity", np.abs(velocity), limits.velocity * (1.0 + MARGIN) + room, "rad/s")
        acceleration = np.abs(velocity - self._velocity) / (0.5 * (dt + self._step_time))
        room = 4.0 * _ROUNDING / min(dt, self._step_time) ** 2
        allowed = limits.acceleration * (1.0 + MARGIN) + room
        self._require_step("commanded acceleration", acceleration, allowed, "rad/s²")
        self._velocity, self._step_time = velocity, dt

    def _fresh_position(self, now: float) -> FloatArray:
        if self._measured is None:
            raise SafetyStopError("no position of the arm has been measured yet")
        arrived, position = self._measured
        if not np.all(np.isfinite(position)):
            raise SafetyStopError("the measured position is not a number", hint=CURES["stuck"])
        if now - arrived > FRESH:
            raise SafetyStopError(
                f"the measured position is {now - arrived:.3f} s old, more than {FRESH:g} s", hint=CURES["stale data"]
            )
        return position

    def _require(self, what: str, values: FloatArray, bound: FloatArray, above: bool) -> None:
        beyond = values > bound if above else values < bound
        if beyond.any():
            self._refuse(what, values, bound, int(np.argmax(beyond)), "rad")

    def _require_step(self, what: str, values: FloatArray, bound: FloatArray, unit: str = "rad") -> None:
        if not np.all(values <= bound):
            self._refuse(what, values, bound, int(np.argmax(values / bound)), unit)

    def _refuse(self, what: str, values: FloatArray, bound: FloatArray, joint: int, unit: str) -> None:
        cure = CURES.get(what, _CLOCK_CURE)
        name, unit = self._limits.joints[joint], joint_unit(unit, sliding=self._limits.sliding[joint])
        raise SafetyStopError(
            f"{what} of {name}: {values[joint]:.4g} {unit} passes {bound[joint]:.4g} {unit}; the command was not sent",
            hint=cure,
        )
