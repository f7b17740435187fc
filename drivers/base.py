"""The contract between a driver and what uses it.

    closed ──open()──▶ open ──start()──▶ running ──stop()──▶ open ──close()──▶ closed

`open` connects and checks the other side; `start` makes samples flow; `read` hands out what has arrived;
`take_control` makes the arm obey, holding its position, and `command` sends a joint position (only drivers that move
an arm); `stop` halts the arm, whatever the state, and is safe to
call twice; `close` lets go of the connection. A method called in a state that does not allow it raises
DriverStateError. A connection that breaks raises ConnectionLostError from `read` or `command`; after that only `stop`
and `close` make sense. A driver never hands out a value twice or one that it has not just received.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, TypeVar, runtime_checkable

from drivers.core.arrays import FloatArray
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import DriverStateError
from drivers.gains import DriveGain
from drivers.streams import Batch, StreamLayout

SILENCE_LIMIT = 0.5
"""A connection counts as lost after this long [s] without a sample, whatever its bus; a slow one after some periods."""

_Item = TypeVar("_Item")
State = Literal["closed", "open", "running"]
Level = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class DriverSettings:
    """What a driver knows of its arm."""

    joints: tuple[str, ...]  # joint names in the order of every array
    connection: Mapping[str, object]  # the robot file's keys for this connection, without `driver`
    gains: tuple[DriveGain, ...]  # one a joint
    # R (n, n) of q_motor = R·q_joint; None where each motor moves its own joint alone
    coupling: FloatArray | None = None
    folder: Path | None = None  # what relative paths among the keys start at; None for the current folder
    clock: Clock = SYSTEM_CLOCK  # the host's, whose monotonic time stamps what arrives
    sliding: tuple[bool, ...] = ()  # (n,) whether each joint slides, its positions being in m; all turn where empty


@dataclass(frozen=True)
class Notice:
    """Something that the source reported: a protective stop, a mode change, a reconnection."""

    time: float  # of the source's clock [s]; nan where it has none
    level: Level  # an `error` makes the session stop the arm
    message: str  # in words
    hint: str = ""  # what to do about an error; empty where there is nothing to say


@dataclass(frozen=True)
class DeviceLimits:
    """Limits that a controller or its drives keep themselves; arrays (n,), nan where they tell none."""

    # lowest, highest: position [rad]
    lowest: FloatArray
    highest: FloatArray
    velocity: FloatArray  # [rad/s]
    torque: FloatArray  # [N·m]
    sources: Mapping[str, str]  # position, velocity, torque, … → where it is read, such as an object's index
    following_error: FloatArray | None = None  # between the target and the measured position [rad]
    stopping: FloatArray | None = None  # deceleration of their own stop [rad/s²]
    acceleration: FloatArray | None = None  # [rad/s²]


class Driver(Protocol):
    """One arm on one connection."""

    def open(self) -> None:
        """Connect, within a time limit.

        Raises:
            ConnectionFailedError: no answer, or not from the expected device.
            MotionRefusedError: another master is on the bus, or something moves the arm.
            UsageError: the connection's keys are wrong, or do not fit this bus or these devices.
        """

    def streams(self) -> tuple[StreamLayout, ...]:
        """Return what will be delivered; known once open."""

    def start(self) -> None:
        """Make samples flow.

        Raises:
            ConnectionLostError, ConnectionFailedError: the connection broke meanwhile.
        """

    def read(self, timeout: float) -> Sequence[Batch]:
        """Blocks that have arrived, waiting at most `timeout` [s] for the first; empty where none came.

        Raises:
            ConnectionLostError: the connection broke, or went silent for longer than the driver allows.
        """

    def notices(self) -> Sequence[Notice]:
        """Return what the source reported since the last call."""

    def command_rate(self) -> float:
        """The rate [Hz] at which it takes positions; 0 where it cannot move the arm; known once open."""

    def take_control(self) -> None:
        """Make the arm ready to obey commands; it holds its position until the first. May last seconds.

        Raises:
            DriverStateError: this driver or this connection cannot move the arm, or the arm is not ready (no position
                known yet, a motor in fault or in another mode).
            MotionRefusedError: something else moves the arm, or a clock is wrong.
            ConnectionFailedError: no control of the arm within a time limit.
            ConnectionLostError: the connection broke.
        """

    def command(self, position: FloatArray) -> None:
        """Send a joint position (n,) [rad or m] to be reached within one period; takes control first if need be.

        Raises:
            DriverStateError: this driver or this connection cannot move the arm, a position is beyond what can be
                commanded, or a first one is too far from where the arm is.
            ConnectionLostError: the connection broke.
            ValueError: not n finite numbers.
        """

    def stop(self) -> None:
        """Halt the arm; never raises for an arm that cannot be reached."""

    def close(self) -> None:
        """Let go of the connection; safe in every state."""


@runtime_checkable
class Identifying(Protocol):
    """A driver that can also identify the devices at the other end; `dynid check --connect` shows them."""

    def identify(self) -> Sequence[object]:
        """The devices that answer: a dataclass per device; known once open.

        Raises:
            DriverStateError: it is closed.
        """


@runtime_checkable
class Attributing(Protocol):
    """A driver that can name the cause of missing samples: this computer, or a device that does not answer."""

    def silence(self, stream: str, limit: float) -> str:
        """Return which devices are silent, and for how long, in words; empty where none is, or the cause is unknown.

        Args:
            stream: name of the stream.
            limit: how long it has been silent for, at least [s].
        """

    def losses(self, stream: str) -> str:
        """Why samples of a stream were lost since the last `start`, in words; empty where the cause is unknown."""


@runtime_checkable
class Measured(Protocol):
    """A driver whose controller knows how long its arm's links are."""

    def arm_lengths(self) -> FloatArray | None:
        """Upper arm, forearm, shoulder offset and wrist offset (4,) [m]; None where it tells none."""


@runtime_checkable
class Numbered(Protocol):
    """A driver whose controller has a serial number of its own."""

    def serial_number(self) -> str:
        """The number; empty where it tells none."""


@runtime_checkable
class Limiting(Protocol):
    """A driver whose controller tells limits of its own; they are compared with the robot file's."""

    def device_limits(self) -> DeviceLimits:
        """The limits; may ask the controller for them.

        Raises:
            DriverStateError: it is closed.
        """


@runtime_checkable
class Holding(Protocol):
    """A driver that knows what its arm does where commands pause for longer than a few periods."""

    def holds(self) -> bool:
        """Return whether it comes to rest in order and is held, so that a motion may go on from there."""


@runtime_checkable
class Buffering(Protocol):
    """A driver whose arm follows each position a fixed time after it was due: one that is sent late changes nothing."""

    def buffered(self) -> float:
        """Return how late [s] one may be sent; 0 where lateness is felt."""

    def command(self, position: FloatArray, due: float | None = None) -> None:
        """Do the same as `Driver.command`; `due` [s, host's clock] is when it should have been sent, now where None."""


@runtime_checkable
class Guidable(Protocol):
    """A driver whose arm can be led by hand: limp, or with torques that are commanded; `stop` ends it."""

    def guiding_refusal(self, *, pushed: bool) -> str:
        """Return why it cannot, in words, `pushed` by torques; empty where it can."""

    def guiding_cautions(self, *, pushed: bool) -> Sequence[str]:
        """Return what to mind before it is, one line each; known once open.

        Raises:
            DriverStateError: it is closed.
        """

    def release(self, torque: FloatArray | None) -> None:
        """Let the arm go, with limits and time-outs as before a motion: with first torques (n,), or limp where None.

        Raises:
            DriverStateError: it is not running, or the arm is not ready.
            ConnectionFailedError, ConnectionLostError: as `Driver.take_control`.
        """

    def push(self, torque: FloatArray) -> None:
        """Command joint torques (n,) [N·m or N] of a released arm; they end by themselves where no new ones come.

        Raises:
            DriverStateError: it is not released.
            ConnectionLostError: the connection broke.
            ValueError: not n finite numbers.
        """


@runtime_checkable
class Cautioning(Protocol):
    """A driver that knows what a person should mind before its arm is moved."""

    def cautions(self) -> Sequence[str]:
        """Return what to mind, one line each; known once open.

        Raises:
            DriverStateError: it is closed.
        """


@runtime_checkable
class ReportingSafety(Protocol):
    """A driver whose device reports its safety status, unless it is too old or refuses."""

    def unreported(self) -> Sequence[str]:
        """Return what of it does not come: the device's own names; known once open."""


def drained(queue: deque[_Item]) -> list[_Item]:
    """All items of a queue that another thread may append to, oldest first; the queue is left without them."""
    return [queue.popleft() for _ in range(len(queue))]


def require_state(actual: State, allowed: State, action: str) -> None:
    """Raise DriverStateError unless the driver is in the state that an action needs."""
    if actual != allowed:
        raise DriverStateError(f"cannot {action} while {actual}", hint=f"the driver must be {allowed}")
