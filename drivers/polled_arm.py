"""The driver of an arm whose motors are asked again and again: what serial servos and CAN motors have in common."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from drivers.base import SILENCE_LIMIT, DriverSettings, Notice, drained, require_state
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionLostError, DriverStateError
from drivers.first_step import check_first_step, finite_position
from drivers.life_cycle import LifeCycle
from drivers.polled_rows import PolledRows
from drivers.streams import Batch, ChannelLayout, StreamLayout

ASKING_PERIODS = 4
"""From one reading to the next, answers that are missing waited for, no more periods pass on a computer in time."""
SILENT_PERIODS = 20
"""Without a row for so many periods, at least `SILENCE_LIMIT`, the connection counts as lost."""


HOLD_LEAD = 0.05
"""[rad] that a goal may be ahead of a joint which is held: more would press on what blocks it."""
STOP_LIMIT = 2.0
"""How long [s] an arm may take to come to rest."""
STOP_SENDINGS = 3
"""So often a stop is sent: it is not confirmed."""


def not_at_rest(silent: Sequence[str], *, limp: bool) -> str:
    """What is wrong with a stop after which an arm did not show that it is at rest, or motors were silent, in words."""
    state = "limp" if limp else "held"
    if silent:
        return f"{', '.join(silent)} did not answer when the arm was {state}: its position is unknown"
    return f"the arm did not show within {STOP_LIMIT:g} s that it is at rest, {state}"


class MotorsControl(Protocol):
    """Commands of an arm's motors."""

    active: bool  # whether the motors were made to obey, and not yet stopped
    # commands since they were taken: (when [s, host's monotonic clock], (n,) [rad])
    sent: deque[tuple[float, FloatArray]]

    def take(self) -> None:
        """Prepare the motors, and let them hold where they are."""

    def command(self, target: FloatArray) -> None:
        """Send a position (n,) [rad]."""

    def release(self, torque: FloatArray | None) -> None:
        """Let the arm go, so that it is led by hand, with first torques (n,) [N·m] or limp."""

    def push(self, torque: FloatArray) -> None:
        """Command joint torques (n,) [N·m] of a released arm."""

    def stop(self) -> str:
        """Let the arm hold or go limp; what is wrong, in words, or nothing."""


class PolledArm(LifeCycle):
    """Implements `drivers.base.Driver` and `Guidable` on `_connect`, `_disconnect`, `_new_cycle` and `_channels`.

    Rows and commands come at a rate [Hz]. Messages call the motors by `names`, id → name, any of them a `device`, and
    the connection `where`.
    """

    def __init__(
        self,
        settings: DriverSettings,
        where: str,
        rate: float,
        names: Mapping[int, str],
        device: str,
        *,
        read_only: bool,
    ) -> None:
        super().__init__(settings)
        self._where, self._rate, self._names, self._device = where, rate, names, device
        self._read_only = read_only
        self._cycle: PolledRows | None = None
        self._command_lock = self._clock.lock()
        self._commanded = False
        self._identities: tuple[object, ...] = ()
        self._control: MotorsControl

    @abstractmethod
    def _new_cycle(self) -> PolledRows:
        """Return what reads the motors from now on, not started."""

    @abstractmethod
    def _channels(self) -> tuple[ChannelLayout, ...]:
        """The channels of the stream `joints`."""

    def _gains(self) -> Mapping[str, FloatArray]:
        """Quantity → (n,) of the loop that follows the commands, where the connection sets it."""
        return {}

    @abstractmethod
    def guiding_refusal(self, *, pushed: bool) -> str:
        """Return why the arm cannot be led by hand (see `drivers.base.Guidable`)."""

    @abstractmethod
    def _stop_words(self) -> str:
        """Return what the arm does when a motion ends or is stopped."""

    @abstractmethod
    def _stopped_words(self) -> str:
        """Return how a stop has left the arm."""

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the connection's rate, and `commands`: what was sent, when it was sent."""
        self._require_open("list its streams")
        joints = StreamLayout("joints", self._channels(), self._rate)
        if self._read_only:
            return (joints,)
        goal = ChannelLayout("target_position", self._joints, "", "goals that were sent, by this computer's clock")
        gains = (ChannelLayout(name, self._joints, "", "as set in the motors") for name in self._gains())
        return joints, StreamLayout("commands", (goal, *gains), 0.0, essential=False)

    def start(self) -> None:
        """Make samples flow."""
        require_state(self._state, "open", "start")
        self._halted = False
        self._control.sent.clear()
        self._cycle = self._new_cycle()
        self._cycle.start()
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Rows that have arrived, waiting at most `timeout` [s] for the first; empty where none came."""
        require_state(self._state, "running", "read")
        cycle = self._running_cycle()
        batches = cycle.take(timeout)
        limit = max(SILENCE_LIMIT, SILENT_PERIODS / self._rate)
        if not batches and self._clock.now() - cycle.last_row - self._clock.stalled(cycle.last_row) > limit:
            why = self.silence("joints", limit)
            raise ConnectionLostError(
                f"no complete row of the {self._device}s for {limit:g} s{f': {why}' if why else ''}",
                where=self._where,
                hint=f"check power, cables and ids: two {self._device}s with one id garble each other's answers",
            )
        return batches

    def notices(self) -> Sequence[Notice]:
        """Faults of motors, missing answers, a slow or faulty bus, since the last call."""
        return drained(self._notices) + (drained(self._cycle.notices) if self._cycle is not None else [])

    def command_rate(self) -> float:
        """Rate of the commands [Hz]: that of the readings; 0 where the connection only reads."""
        return 0.0 if self._read_only else self._rate

    def identify(self) -> Sequence[object]:
        """Return what every motor said of itself when the connection was opened."""
        self._require_open("identify")
        return self._identities

    def holds(self) -> bool:
        """Yes: a motor keeps its last goal."""
        return True

    def take_control(self) -> None:
        """Set limits in the motors, read them back, and let the arm hold where it is."""
        with self._command_lock:
            self._require_movable()
            self._control.take()

    def command(self, position: FloatArray) -> None:
        """Send a joint position (n,) [rad] to be reached within one period; takes control first if need be."""
        target = finite_position(position, self._joints)
        with self._command_lock:
            self._require_movable()
            if not self._control.active:
                self._control.take()
            if not self._commanded:
                check_first_step(target, self._running_cycle().latest, self._joints, self._sliding)
            self._control.command(target)
            self._commanded = True

    def guiding_cautions(self, *, pushed: bool) -> Sequence[str]:
        """Return what to mind before the arm is led by hand."""
        self._require_open("tell cautions")
        carried = (
            f"while you hold the key, the {self._device}s carry the arm's weight as the model has it: it drifts, and "
            "falls where the model is wrong"
            if pushed
            else f"while you hold the key, the {self._device}s carry nothing: THE ARM FALLS unless you carry it"
        )
        return [carried, self._stop_words()]

    def release(self, torque: FloatArray | None) -> None:
        """Let the arm go, so that it is led by hand, with first torques (n,) [N·m], or limp."""
        with self._command_lock:
            self._require_movable()
            self._control.release(torque)

    def push(self, torque: FloatArray) -> None:
        """Command joint torques (n,) [N·m] of a released arm."""
        if torque.shape != (len(self._joints),) or not np.all(np.isfinite(torque)):
            raise ValueError(f"{len(self._joints)} finite torques are needed, not {torque}")
        with self._command_lock:
            self._require_movable()
            self._control.push(torque)

    def stop(self) -> None:
        """Let the arm hold or go limp where this driver moves it, then end the samples; never raises."""
        self._halted = True
        with self._command_lock:
            active, self._commanded = self._control.active, False
            if self._cycle is not None:
                self._cycle.stop()
                self._notices.extend(drained(self._cycle.notices))
            if active and (trouble := self._control.stop()):
                self._tell("error", trouble)
            elif active:
                self._tell("info", self._stopped_words())
        if self._state == "running":
            self._state = "open"

    def silence(self, stream: str, limit: float) -> str:
        """Return which motors do not answer, in words; empty of another stream than `joints` (see `drivers.base`)."""
        if stream != "joints" or self._cycle is None:
            return ""
        heard = self._cycle.answered
        newest = max(heard.values(), default=-math.inf)
        if (idle := self._clock.now() - self._cycle.asked) > max(0.5 * limit, ASKING_PERIODS / self._rate):
            return f"no {self._device} was asked for {idle:.2f} s"
        besides = self._cycle.besides and f", but {self._cycle.besides}"
        if self._clock.now() - newest > limit:
            return f"no {self._device} answers{besides or ': check the power and the cable'}"
        silent = [name for motor, name in self._names.items() if newest - heard.get(motor, -math.inf) > limit / 2]
        return f"no answer of {', '.join(silent)}{besides}" if silent else ""

    def losses(self, stream: str) -> str:
        """Return why rows of `joints` were lost, in words (see `drivers.base`)."""
        return self._cycle.losses() if stream == "joints" and self._cycle is not None else ""

    def _require_movable(self) -> None:
        self._require_running()
        if self._read_only:
            raise DriverStateError("this connection is read only")

    def _running_cycle(self) -> PolledRows:
        if self._cycle is None:
            raise DriverStateError("no samples arrive", hint="start the driver first")
        return self._cycle
