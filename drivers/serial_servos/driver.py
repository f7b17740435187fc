"""The driver of an arm of serial bus servos: Feetech SCS and STS, Dynamixel protocol 2.0."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import DeviceLimits, DriverSettings, Notice, State, drained, require_state
from drivers.core.arrays import FloatArray
from drivers.core.errors import (
    ConnectionFailedError,
    ConnectionLostError,
    DriverStateError,
    UsageError,
)
from drivers.first_step import check_first_step, finite_position
from drivers.serial_servos.bus import ServoBus, called
from drivers.serial_servos.control import ServoControl
from drivers.serial_servos.cycle import ServoCycle, feedback_channels
from drivers.serial_servos.line import LEAST_PATIENCE
from drivers.serial_servos.settings import parse_settings
from drivers.serial_servos.setup import ServoIdentity, configure, identity, reading_time, slow_reading
from drivers.streams import Batch, ChannelLayout, StreamLayout

SILENCE_LIMIT = 0.5
"""Without a row for so long [s], or for `SILENT_PERIODS`, the connection counts as lost."""
SILENT_PERIODS = 20
LONGEST_PATIENCE = 0.05
"""[s] that answers are waited for at most."""


class SerialServoDriver:
    """Serial bus servos on one line; implements `drivers.base.Driver`.

    Args:
        settings: joints and the connection's keys (see `drivers.serial_servos.settings.ServoKeys`).
        protocol: "feetech" or "dynamixel".

    Raises:
        UsageError: the connection's keys are wrong, or its calibration cannot be used.
    """

    def __init__(self, settings: DriverSettings, protocol: str) -> None:
        self._joints, self._sliding, self._clock = settings.joints, settings.sliding, settings.clock
        self._settings = parse_settings(settings.connection, settings.joints, settings.folder, protocol)
        self._state: State = "closed"
        self._bus = ServoBus(self._settings, self._clock)
        self._control = ServoControl(self._bus, self._settings, self._clock)
        self._cycle: ServoCycle | None = None
        self._command_lock = self._clock.lock()
        self._commanded = self._halted = False
        self._identities: tuple[ServoIdentity, ...] = ()
        self._notices: deque[Notice] = deque()

    def open(self) -> None:
        """Open the port and ask every servo for its model and settings; nothing is written but with `--configure`.

        Raises:
            ConnectionFailedError: no such port, or a servo that does not answer or is another model.
            UsageError: the port does not have this baud rate, or the calibration is another arm's.
            DriverStateError: it is open already.
        """
        require_state(self._state, "closed", "open")
        try:
            self._bus.open()
            if self._settings.keys.configure:
                self._tell("info", *configure(self._bus, self._settings))
            self._identities = tuple(identity(self._bus, motor) for motor in self._settings.motors)
            self._require_own_calibration()
            lasted = reading_time(self._bus, self._clock)
            self._bus.line.patience = min(max(LEAST_PATIENCE, 2.0 * lasted), LONGEST_PATIENCE)
            if said := slow_reading(self._bus, self._settings, lasted):
                self._tell("warning", *said)
        except ConnectionLostError as error:
            self._bus.close()
            raise ConnectionFailedError(error.message, where=error.where, hint=error.hint) from error
        except BaseException:
            self._bus.close()
            raise
        self._state = "open"

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the connection's rate, and `commands`: what was sent, when it was sent.

        Raises:
            DriverStateError: it is closed.
        """
        if self._state == "closed":
            require_state(self._state, "open", "list its streams")
        joints = StreamLayout("joints", feedback_channels(self._settings), self._settings.keys.rate)
        if self._settings.keys.read_only:
            return (joints,)
        goal = ChannelLayout("target_position", self._joints, "", "goals that were sent, by this computer's clock")
        return joints, StreamLayout("commands", (goal,), 0.0, essential=False)

    def start(self) -> None:
        """Make samples flow.

        Raises:
            DriverStateError: it is not open.
        """
        require_state(self._state, "open", "start")
        self._halted = False
        self._control.sent.clear()
        self._cycle = ServoCycle(self._bus, self._control, self._settings, self._clock)
        self._cycle.start()
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Rows that have arrived, waiting at most `timeout` [s] for the first; empty where none came.

        Raises:
            DriverStateError: it is not running.
            ConnectionLostError: the port is gone, or no complete row came for half a second.
        """
        require_state(self._state, "running", "read")
        cycle = self._running_cycle()
        batches = cycle.take(timeout)
        limit = max(SILENCE_LIMIT, SILENT_PERIODS / self._settings.keys.rate)
        if not batches and self._clock.now() - cycle.last_row > limit:
            why = self.silence("joints", limit)
            raise ConnectionLostError(
                f"no complete row of the servos for {limit:g} s{f': {why}' if why else ''}",
                where=self._settings.url,
                hint="power, cables, and ids: two servos with one id garble each other's answers",
            )
        return batches

    def notices(self) -> Sequence[Notice]:
        """Notices since the last call: faults of servos, missing answers, a slow adapter."""
        return drained(self._notices) + (drained(self._cycle.notices) if self._cycle is not None else [])

    def command_rate(self) -> float:
        """Rate of the commands [Hz]: that of the readings; 0 where the connection only reads."""
        return 0.0 if self._settings.keys.read_only else self._settings.keys.rate

    def holds(self) -> bool:
        """Yes: a servo keeps its last goal."""
        return True

    def take_control(self) -> None:
        """Set limits and profiles in the servos, read them back, and let the arm hold where it is.

        Raises:
            DriverStateError: it is not running, or a servo is in fault or in another mode.
            ConnectionFailedError: a servo does not answer, or does not keep what is written.
            ConnectionLostError: the port is gone.
        """
        with self._command_lock:
            self._require_movable()
            self._control.take()

    def command(self, position: FloatArray) -> None:
        """Send a joint position (n,) [rad] to be reached within one period; takes control where nobody has.

        Raises:
            DriverStateError: it is not running, a position does not fit, or a first one is too far from the arm.
            ConnectionLostError: the port is gone.
            ValueError: not n finite numbers.
        """
        target = finite_position(position, self._joints)
        with self._command_lock:
            self._require_movable()
            if not self._control.active:
                self._control.take()
            if not self._commanded:
                check_first_step(target, self._running_cycle().latest, self._joints, self._sliding)
            self._control.command(target)
            self._commanded = True

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

    def close(self) -> None:
        """Let go of the port; safe in every state."""
        self.stop()
        self._bus.close()
        self._state = "closed"

    def silence(self, stream: str, limit: float) -> str:
        """Which servos do not answer, in words; empty of another stream than `joints` (see `drivers.base`)."""
        if stream != "joints" or self._cycle is None:
            return ""
        newest = max(self._cycle.answered.values(), default=-math.inf)
        if self._clock.now() - newest > limit:
            return "no servo answers: look at the power and the cable, or this computer was late"
        heard = self._cycle.answered
        silent = [
            called(motor) for motor in self._settings.motors if newest - heard.get(motor.id, -math.inf) > limit / 2
        ]
        return f"no answer of {', '.join(silent)}" if silent else ""

    def losses(self, stream: str) -> str:
        """Why rows of `joints` were lost, in words (see `drivers.base`)."""
        return self._cycle.losses() if stream == "joints" and self._cycle is not None else ""

    def identify(self) -> Sequence[ServoIdentity]:
        """What every servo says of itself.

        Raises:
            DriverStateError: it is closed.
        """
        if self._state == "closed":
            require_state(self._state, "open", "identify")
        return self._identities

    def device_limits(self) -> DeviceLimits:
        """The position limits that the servos keep.

        Raises:
            DriverStateError: it is closed.
        """
        bounds = [
            sorted((motor.scale.position(told.min_position), motor.scale.position(told.max_position)))
            if told.min_position < told.max_position
            else [math.nan, math.nan]
            for motor, told in zip(self._settings.motors, self.identify(), strict=True)
        ]
        nothing = np.full(len(bounds), np.nan)
        lowest, highest = np.array(bounds).T
        return DeviceLimits(lowest, highest, nothing, nothing, {"position": "the servos' position limits"})

    def cautions(self) -> Sequence[str]:
        """What the arm does before, at a stop and where this computer dies."""
        keys, motors = self._settings.keys, self._settings.motors
        said = [f"first the servos' torque is switched on: the arm stiffens where it is; then, {self._stop_words()}"]
        if motors[0].table.protocol == "feetech":
            said.append(
                "Feetech servos have no watchdog: where this computer dies or the cable is cut in a motion, the arm "
                "holds its last goal with torque on until it is switched off"
            )
        else:
            said.append(
                f"the servos' bus watchdog is armed: {keys.watchdog:g} s after the last request they stop by themselves"
            )
        if assumed := [motor for motor in motors if motor.assumed_zero]:
            said.append(
                f"no calibration: {assumed[0].table.steps // 2} steps are taken for the zero of "
                f"{', '.join(motor.joint for motor in assumed)} (keys `calibration`, or `zero` of a motor)"
            )
        return said

    def _stop_words(self) -> str:
        if self._settings.keys.on_stop == "limp":
            return "when the motion ends or is stopped, the torque is switched off: THE ARM FALLS (on_stop: limp)"
        return (
            "when the motion ends or is stopped, the arm holds, torque on, even after dynid has ended (on_stop: hold)"
        )

    def _stopped_words(self) -> str:
        limp = self._settings.keys.on_stop == "limp"
        return "the torque is off, the arm is limp" if limp else "the arm holds, its torque stays on"

    def _require_own_calibration(self) -> None:
        for motor, told in zip(self._settings.motors, self._identities, strict=True):
            expected = motor.calibration
            if expected is not None and told.homing_offset != expected.homing_offset:
                raise UsageError(
                    f"{called(motor)} has homing offset {told.homing_offset}, and {expected.homing_offset} in "
                    f"{self._settings.keys.calibration}: its positions would be wrong",
                    where=self._settings.url,
                    hint="take the calibration of this arm, or write it: dynid check --connect --configure",
                )

    def _require_movable(self) -> None:
        require_state(self._state, "running", "move")
        if self._halted:
            raise DriverStateError("the arm is being stopped", hint="start again before the next motion")
        if self._settings.keys.read_only:
            raise DriverStateError("this connection is read only")

    def _running_cycle(self) -> ServoCycle:
        if self._cycle is None:
            raise DriverStateError("no samples flow", hint="start the driver first")
        return self._cycle

    def _tell(self, level: str, *messages: str) -> None:
        self._notices.extend(Notice(math.nan, level, message) for message in messages)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Protocol:
    """Makes the driver of a protocol, as the entry points of `dynid.drivers` need it."""

    name: str

    def __call__(self, settings: DriverSettings) -> SerialServoDriver:
        return SerialServoDriver(settings, self.name)


feetech = _Protocol("feetech")
dynamixel = _Protocol("dynamixel")
