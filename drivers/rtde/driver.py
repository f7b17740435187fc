"""The driver of Universal Robots arms: three streams from one RTDE connection, motion in a process of its own.

`joints` comes at the controller's rate; `thermal` and `status` are every n-th of the same packages.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivers.base import DeviceLimits, DriverSettings, Notice, require_state
from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT
from drivers.core.errors import ConnectionFailedError, DriverStateError, MotionRefusedError, UsageError
from drivers.first_step import check_first_step, finite_position
from drivers.gains import gives_torque, joint_torque, torque_channel
from drivers.life_cycle import LifeCycle
from drivers.rtde import protocol as wire
from drivers.rtde.configuration import Configuration, read_configuration
from drivers.rtde.modes import RUNTIME_STOPPED, describe_mode, serial_number, stop_program
from drivers.rtde.motion import JOINTS, MotionProcess, has_ur_rtde
from drivers.rtde.protocol import Connect, connect_tcp
from drivers.rtde.receiver import TIMESTAMP, TOGETHER, UNMOVED, RtdeReceiver, Samples
from drivers.rtde.settings import parse_settings
from drivers.streams import Batch, ChannelLayout, StreamLayout

THERMAL_RATE = 20.0
STATUS_RATE = 10.0
LIMITS_TIMEOUT = 1.0
"""How long [s] the controller may take to tell its joint limits."""
DASHBOARD_TIMEOUT = 1.0
"""How long [s] the dashboard may take to end a program."""


@dataclass(frozen=True)
class _Source:
    """Source of a quantity: the variable, its RTDE type and what it is."""

    quantity: str
    variable: str
    kind: str
    description: str
    unit: str = ""


_REQUIRED = (
    _Source("position", "actual_q", "VECTOR6D", "measured joint position"),
    _Source("velocity", "actual_qd", "VECTOR6D", "measured joint velocity, as the controller derives it"),
    _Source("current", "actual_current", "VECTOR6D", "measured motor current, raw"),
)
_TARGETS = (
    _Source("target_position", "target_q", "VECTOR6D", "target joint position of the controller"),
    _Source("target_velocity", "target_qd", "VECTOR6D", "target joint velocity of the controller"),
    _Source("target_acceleration", "target_qdd", "VECTOR6D", "target joint acceleration of the controller"),
    _Source("target_current", "target_current", "VECTOR6D", "motor current expected by the controller's model"),
    _Source("target_torque", "target_moment", "VECTOR6D", "joint torque expected by the controller's model"),
)
_THERMAL = (_Source("temperature", "joint_temperatures", "VECTOR6D", "motor temperature"),)
_MODES = (
    _Source("robot_mode", "robot_mode", "INT32", "-1 no controller … 7 running", "1"),
    _Source("safety_mode", "safety_mode", "INT32", "1 normal, 2 reduced, 3 protective stop …", "1"),
    _Source("runtime_state", "runtime_state", "UINT32", "of the program: 1 stopped, 2 playing, 4 paused …", "1"),
)
_JOINT_MODE = (_Source("joint_mode", "joint_mode", "VECTOR6INT32", "253 running, 255 idle, 252 fault …", "1"),)
_STATUS = _MODES + _JOINT_MODE
_STREAMS: Mapping[str, tuple[_Source, ...]] = {"joints": _REQUIRED + _TARGETS, "thermal": _THERMAL, "status": _STATUS}


@dataclass(frozen=True)
class ControllerIdentity:
    """Who answers."""

    controller: str  # address and port
    software: str  # version of the controller's software
    rate: float  # of the samples [Hz]
    variables: int  # that the controller delivers
    serial: str = ""  # number, as its dashboard tells it; empty where it does not


class ArmControl(Protocol):
    """Control of one arm, as `drivers.rtde.motion.MotionProcess` has it."""

    def command(self, position: FloatArray, due: float) -> None:
        """Send a joint position (6,) [rad] that was due at a time [s, host's clock]."""

    def stop(self) -> bool:
        """Halt the arm and give it back; whether the controller confirmed it."""


OWN_PROGRAM = (
    "dynid's own program moves the arm, as ur-rtde is not installed: it was tried on simulated controllers only"
)


class RtdeDriver(LifeCycle):
    """A Universal Robots arm of six joints on RTDE; implements `drivers.base.Driver`.

    The connection's keys are those of `drivers.rtde.settings.RtdeSettings`. `take_control` gets the host, the rate of
    the commands [Hz] and a time limit [s].

    Raises:
        UsageError: the connection's keys are wrong, or the arm does not have six joints.
    """

    def __init__(
        self,
        settings: DriverSettings,
        connect: Connect = connect_tcp,
        take_control: Callable[[str, float, float], ArmControl] = MotionProcess,
    ) -> None:
        if len(settings.joints) != JOINTS:
            raise UsageError(
                f"an RTDE controller moves {JOINTS} joints, but the robot file names {len(settings.joints)}: "
                f"{', '.join(settings.joints)}",
                hint="choose a Universal Robots arm, or another connection",
            )
        super().__init__(settings)
        self._gains, self._coupling = settings.gains, settings.coupling
        self._knows_torque = gives_torque(settings.gains, settings.joints)
        self._settings = parse_settings(settings.connection)
        self._receiver = RtdeReceiver(
            self._settings.host,
            self._settings.port,
            {source.variable: source.kind for source in _REQUIRED},
            {source.variable: source.kind for source in _TARGETS + _THERMAL + _STATUS},
            self._settings.rate,
            self._settings.timeout,
            connect,
            self._clock,
        )
        self._reach = connect
        self._take_control = take_control
        self._motion: ArmControl | None = None
        self._moved = False
        self._motion_lock = self._clock.lock()  # held while control is being taken
        self._cautions: tuple[str, ...] = ()
        self._last_group: dict[str, int] = {}
        self._last_mode: dict[str, int] = {}
        self._latest_position: FloatArray | None = None

    def _connect(self) -> None:
        self._receiver.connect()
        if (expected := self._settings.serial) is not None and (own := self.serial_number()) != expected:
            raise ConnectionFailedError(
                f"the controller {f'has serial number {own}' if own else 'reports no serial number'}, but the robot "
                f"file expects {expected}",
                where=self._settings.host,
                hint="is this the right arm? The key 'serial' is the connection's; port 29999 gives the number",
            )

    def _disconnect(self) -> None:
        self._receiver.close()

    def serial_number(self) -> str:
        """The controller's serial number, asked now at its dashboard; empty where it tells none."""
        return serial_number(self._settings.host, LIMITS_TIMEOUT, self._reach, self._clock)

    def identify(self) -> tuple[ControllerIdentity, ...]:
        """The controller."""
        self._require_open("identify the controller")
        receiver = self._receiver
        return (
            ControllerIdentity(
                receiver.where,
                str(receiver.version),
                receiver.rate,
                len(receiver.recipe.variables),
                self.serial_number(),
            ),
        )

    def device_limits(self) -> DeviceLimits:
        """The joint limits that the controller's secondary interface tells, asked now; nan where it tells none."""
        self._require_open("ask for the controller's limits")
        limits, self._cautions = np.full((4, JOINTS), np.nan), ()
        try:
            limits = self._configuration().limits
        except ConnectionFailedError as error:
            self._cautions = (f"the controller's own joint limits are not known ({error})",)
        sources = dict.fromkeys(("position", "velocity", "acceleration"), "its secondary interface")
        return DeviceLimits(limits[0], limits[1], limits[2], np.full(JOINTS, np.nan), sources, acceleration=limits[3])

    def arm_lengths(self) -> FloatArray | None:
        """Upper arm, forearm, shoulder offset and wrist offset (4,) [m], asked now; None where it tells none."""
        self._require_open("ask for the arm's lengths")
        with contextlib.suppress(ConnectionFailedError):
            return self._configuration().lengths
        return None

    def cautions(self) -> tuple[str, ...]:
        """Return why `device_limits` has none, or empty; whether our own program moves the arm."""
        own = self._take_control is MotionProcess and not has_ur_rtde()
        return (*self._cautions, OWN_PROGRAM) if own else self._cautions

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the full rate, `thermal` at about 20 Hz and `status` at about 10 Hz, as far as delivered."""
        self._require_open("list its streams")
        layouts = []
        for name in _STREAMS:
            channels = [
                ChannelLayout(
                    source.quantity,
                    self._joints if source.kind.startswith("VECTOR6") else (source.quantity,),
                    source.unit,
                    f"{source.description} (RTDE {source.variable})",
                )
                for source in self._delivered(name)
            ]
            if name == "joints" and self._knows_torque:
                channels.append(torque_channel(self._joints, self._coupling))
            if channels:
                layouts.append(StreamLayout(name, tuple(channels), self._receiver.rate / self._every(name)))
        return tuple(layouts)

    def unreported(self) -> Sequence[str]:
        """Return which of safety mode, robot mode and runtime state the controller refuses to deliver."""
        self._require_open("list what is not reported")
        delivered = self._receiver.recipe.variables
        return [source.variable for source in _MODES if source.variable not in delivered]

    def start(self) -> None:
        """Make samples flow; a connection that was lost while open is made again."""
        require_state(self._state, "open", "start")
        self._last_group, self._last_mode, self._latest_position = {}, {}, None
        if self._receiver.connected:
            self._receiver.start()
        else:
            self._receiver.reconnect()
        self._halted = False
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Blocks that have arrived, waiting at most `timeout` [s] for the first; empty where none came."""
        require_state(self._state, "running", "read")
        samples = self._receiver.take(timeout, UNMOVED if self._motion is None else TOGETHER)
        if samples is None:
            return ()
        self._latest_position = samples.rows["actual_q"][-1].astype(np.float64)
        self._watch_modes(samples.rows)
        blocks = [self._joints_block(samples)]
        for name in ("thermal", "status"):
            if (sources := self._delivered(name)) and (block := self._thinned_block(name, sources, samples)):
                blocks.append(block)
        return blocks

    def notices(self) -> Sequence[Notice]:
        """What the controller reported since the last call: modes, messages, refused variables, reconnections."""
        return [*self._receiver.notices(), *super().notices()]

    def command_rate(self) -> float:
        """The controller's own rate, whatever that of the samples; 0 where it is closed."""
        return 0.0 if self._state == "closed" else self._receiver.version.maximum_rate

    def holds(self) -> bool:
        """No: a motion goes on through a stall that is bridged, and ends by a longer one."""
        return False

    def buffered(self) -> float:
        """Return how late [s] a position may be sent: the arm follows it later."""
        return STALL_LIMIT

    def take_control(self) -> None:
        """Take control of the arm, which lasts seconds; no program may play on the controller.

        Raises:
            DriverStateError: it is not running, or the port is not the one that ur_rtde insists on.
            MotionRefusedError: a program plays on the controller, which ur_rtde would end.
            ConnectionFailedError: no control of the arm within the connection's `timeout`.
        """
        with self._motion_lock:
            self._require_running()
            self._check_port()
            self._controlled()

    def command(self, position: FloatArray, due: float | None = None) -> None:
        """Send a joint position (6,) [rad]; takes control first if need be.

        The arm reaches it `DELAY`, and servoj's lookahead, after it was `due` [s, host's clock], now where None.
        """
        position = finite_position(position, self._joints)
        with self._motion_lock:
            self._require_running()
            if not self._moved:
                self._check_port()
                check_first_step(position, self._latest_position, self._joints)
            self._controlled().command(position, self._clock.now() if due is None else due)
            self._moved = True

    def stop(self) -> None:
        """Halt the arm where this driver moves it, then the samples; safe in every state, never raises.

        Another thread may go on reading until the arm has come to rest, but no longer command it.
        """
        self._halted = True
        with self._motion_lock:
            motion, self._motion, self._moved = self._motion, None, False
        if motion is not None and not motion.stop():
            # Out of reach, or killed; ur_rtde may have started a fresh program meanwhile, which would stay.
            if stop_program(self._settings.host, DASHBOARD_TIMEOUT, self._reach, self._clock):
                said = "the arm did not confirm that it stopped; the controller's program was ended by its dashboard"
            else:
                said = "the arm did not confirm that it stopped, and the controller's program may still run"
            self._tell("error", said)
        if self._state == "running":
            self._receiver.pause()
            self._state = "open"

    def _configuration(self) -> Configuration:
        return read_configuration(self._settings.host, LIMITS_TIMEOUT, self._reach, self._clock)

    def _delivered(self, stream: str) -> tuple[_Source, ...]:
        variables = self._receiver.recipe.variables
        return tuple(source for source in _STREAMS[stream] if source.variable in variables)

    def _every(self, stream: str) -> int:
        wanted = {"thermal": THERMAL_RATE, "status": STATUS_RATE}.get(stream, self._receiver.rate)
        return max(1, round(self._receiver.rate / wanted))

    def _joints_block(self, samples: Samples) -> Batch:
        values = {source.quantity: _values(samples.rows, source) for source in self._delivered("joints")}
        if self._knows_torque:
            values["torque"] = joint_torque(values["current"], self._gains, self._coupling)
        return Batch("joints", _clock(samples.rows), samples.host_time, values, samples.lost)

    def _thinned_block(self, stream: str, sources: Sequence[_Source], samples: Samples) -> Batch | None:
        """The first package of every so many ticks of the controller's clock, so that a gap shifts nothing."""
        clock = _clock(samples.rows)
        rate, every = self._receiver.rate, self._every(stream)
        newest = round(float(clock[-1]) * rate) // every
        if newest == self._last_group.get(stream):
            return None
        group = np.floor(np.rint(clock * rate) / every).astype(np.int64)
        before = self._last_group.get(stream, int(group[0]) - 1)
        self._last_group[stream] = newest
        steps = np.diff(group, prepend=before)
        first = steps != 0
        values = {source.quantity: _values(samples.rows[first], source) for source in sources}
        lost = int(np.maximum(steps - 1, 0).sum())
        return Batch(stream, clock[first], samples.host_time[first], values, lost)

    def _watch_modes(self, rows: npt.NDArray[np.void]) -> None:
        clock = _clock(rows)
        for source in _MODES:
            if source.variable not in self._receiver.recipe.variables:
                continue
            before = self._last_mode.get(source.variable)
            if before is not None and (rows[source.variable] == before).all():
                continue
            column = rows[source.variable].astype(np.int64)
            changed = np.flatnonzero(np.diff(column, prepend=column[0] - 1 if before is None else before))
            for index in changed:
                level, text, hint = describe_mode(source.variable, int(column[index]))
                self._tell(level, text, hint, float(clock[index]))
            self._last_mode[source.variable] = int(column[-1])

    def _controlled(self) -> ArmControl:
        if self._motion is None:
            self._require_no_program()
            self._motion = self._take_control(self._settings.host, self.command_rate(), self._settings.timeout)
        return self._motion

    def _require_no_program(self) -> None:
        state = self._last_mode.get("runtime_state")
        if state not in (None, RUNTIME_STOPPED):
            raise MotionRefusedError(
                f"a program is active on the controller ({describe_mode('runtime_state', state)[1]})",
                where=self._settings.host,
                hint="stop it on the pendant first: taking control would end it wherever the arm is",
            )

    def _check_port(self) -> None:
        if self._settings.port != wire.PORT:
            raise DriverStateError(
                f"motion needs RTDE on port {wire.PORT}, but the connection's is {self._settings.port}",
                where=self._settings.host,
                hint="ur_rtde knows no other port; recording alone works on any",
            )


def _clock(rows: npt.NDArray[np.void]) -> FloatArray:
    return np.asarray(rows[TIMESTAMP], dtype=np.float64)


def _values(rows: npt.NDArray[np.void], source: _Source) -> FloatArray:
    values = np.asarray(rows[source.variable], dtype=np.float64)
    return values if values.ndim == 2 else values[:, np.newaxis]
