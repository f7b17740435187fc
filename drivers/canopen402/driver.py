"""The driver of arms whose joints have CiA 402 drives on one CANopen bus.

`joints` has a row a SYNC; `thermal` comes by SDO, a few times a second, where the robot file says where drives keep it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import replace

import can
import numpy as np

from drivers.base import SILENCE_LIMIT, DeviceLimits, DriverSettings, Notice, require_state
from drivers.can.bus import Sender, close_bus, keep_quiet, open_bus, returns_own_frames, sends_in_kernel
from drivers.can.receiver import Receiver
from drivers.canopen402.monitor.drives import DriveWatch
from drivers.canopen402.monitor.life_signs import HeartbeatClocks, LifeSigns, Silence, guard_requests, heartbeat
from drivers.canopen402.monitor.presence import Heartbeats, NodeGuarding, Presence
from drivers.canopen402.motion.drive_motion import DriveMotion
from drivers.canopen402.motion.target_path import SdoStop
from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.sdo import CanopenNetwork, RemoteDrive
from drivers.canopen402.samples.alignment import REST_LATENESS, Aligned, Aligner, stream_layouts
from drivers.canopen402.samples.sync import BEHIND, KernelSync, SyncProducer
from drivers.canopen402.samples.temperature import TemperaturePoll, read_temperature
from drivers.canopen402.settings import MODES, parse_settings
from drivers.canopen402.setup.configuration import Configured, Identity, configure, map_torque
from drivers.canopen402.setup.drive_limits import at_joints
from drivers.canopen402.setup.error_control import check_own_id, release
from drivers.canopen402.setup.readiness import masters_heartbeats, require_alone
from drivers.core.arrays import FloatArray
from drivers.core.clock import STALL_LIMIT
from drivers.core.errors import ConnectionLostError, DriverStateError, MotionRefusedError
from drivers.first_step import check_first_step, finite_position
from drivers.life_cycle import LifeCycle
from drivers.standstill import StandstillWatch
from drivers.streams import Batch, StreamLayout

SILENCE_PERIODS = 10
"""Without a complete row for so many periods, at least `SILENCE_LIMIT`, the connection counts as lost."""
FIRST_ROW_LIMIT = 1.0
"""How long [s] the first complete row may take."""
STANDSTILL = 0.01
"""Speed [rad/s] below which a stopped joint is at rest."""


class Canopen402Driver(LifeCycle):
    """An arm of CiA 402 drives; implements `drivers.base.Driver`.

    The connection's keys are those of `drivers.canopen402.settings.CanopenSettings`.

    Raises:
        UsageError: the connection's keys are wrong.
    """

    def __init__(self, settings: DriverSettings) -> None:
        super().__init__(settings)
        self._coupling = settings.coupling
        self._settings = parse_settings(settings.connection, settings.joints)
        self._ids = tuple(node.id for node in self._settings.nodes)
        self._mode = MODES[self._settings.mode]
        self._motion_lock = self._clock.lock()
        self._motion: DriveMotion | None = None
        self._end_told = False
        self._bus: can.BusABC | None = None
        self._poll: TemperaturePoll | None = None
        self._life: LifeSigns | None = None
        self._clocks: HeartbeatClocks | None = None
        self._last_row = 0.0
        self._last_slot: int | None = None
        self._latest_position: FloatArray | None = None
        self._standstill = StandstillWatch(BEHIND + REST_LATENESS)
        self._skipped = self._asked = 0

    def _connect(self) -> None:
        """Open the bus, listen for other masters, then check the drives and configure them within `timeout`.

        Raises:
            MotionRefusedError: another master is on the bus, or a drive is powered; nothing was changed. Or a drive is
                in fault, where the arm is to be moved.
        """
        settings = self._settings
        keep_quiet("canopen")  # the library
        self._bus = open_bus(settings.interface, settings.channel, settings.bitrate, settings.options)
        self._sender = Sender(self._bus, self._clock)
        network = CanopenNetwork(self._sender)
        stored = frozenset(base + node for base in objects.TPDO_BASES for node in self._ids)
        self._receiver = Receiver(self._bus, stored, network.take, self._clock)
        self._receiver.start()
        require_alone(network, self._ids, settings.own_id, settings.heartbeat, self._clock)
        deadline = self._clock.now() + settings.timeout
        pairs = zip(self._joints, self._ids, strict=True)
        self._drives = [RemoteDrive(network, joint, node, settings.sdo_timeout, self._clock) for joint, node in pairs]
        self._configured = self._configure(deadline, network)
        self._scaling = replace(self._configured.scaling, coupling=self._coupling)
        self._sync = self._make_sync(network)
        self._watch = self._make_watch()
        self._sdo_stop = SdoStop(self._sender, self._ids, self._clock)
        self._silence = Silence(self._joints, self._ids, self._receiver.latest)
        for node in self._ids:
            network.subscribe(objects.EMCY + node, self._watch.on_emergency)
            network.subscribe(objects.HEARTBEAT + node, self._watch.on_error_control)
            network.subscribe(objects.SDO_ANSWER + node, self._sdo_stop.on_answer)
        for identifier, node in masters_heartbeats(self._ids, settings.own_id).items():
            if node != settings.own_id or not returns_own_frames(self._bus):
                network.subscribe(identifier, self._watch.on_other_master)
        self._poll = self._make_poll()
        if self._life is not None:
            self._life.start()

    def identify(self) -> tuple[Identity, ...]:
        """Who the drives are, one a joint."""
        self._require_open("identify the drives")
        return self._configured.identities

    def holds(self) -> bool:
        """Return whether drives come to rest by themselves, as in mode "profile", or go on towards the next target."""
        return self._settings.mode == "profile"

    def buffered(self) -> float:
        """Return how late [s] a position may be sent: targets follow them so much later, but in mode "profile"."""
        return 0.0 if self.holds() else STALL_LIMIT

    def device_limits(self) -> DeviceLimits:
        """The drives' own limits: 0x607D, 0x607F, 0x6072, 0x6065 and the ramp of their quick stop."""
        self._require_open("tell the drives' limits")
        return at_joints(self._configured.limits, self._scaling)

    def cautions(self) -> tuple[str, ...]:
        """What to mind of the drives' quick stop (0x605A), of their supervision, and of how they notice dynid's end."""
        self._require_open("tell what to mind")
        return self._configured.cautions

    def streams(self) -> tuple[StreamLayout, ...]:
        """`joints` at the rate of SYNC; `thermal` with a column for every joint whose drive tells a temperature."""
        self._require_open("list its streams")
        return stream_layouts(self._joints, self._joints_with_temperature(), self._settings.sync_rate)

    def start(self) -> None:
        """Set the drives operational and send SYNC: samples flow. Nothing is enabled."""
        require_state(self._state, "open", "start")
        self._receiver.take()  # from before
        self._aligner = Aligner(self._ids, self._settings.sync_rate)
        self._latest_position, self._last_slot = None, None
        self._standstill = StandstillWatch(BEHIND + REST_LATENESS)
        self._skipped = self._sync.skipped
        self._motion = None if self._mode is None else self._make_motion(self._mode)
        self._halted = self._end_told = False
        for node in self._ids:
            self._sender.send(objects.NMT, bytes([objects.NMT_START, node]))
        self._last_row, self._asked = self._clock.now(), self._sync.count
        self._sync.start()
        self._watch.start(self._last_row)
        if self._poll is not None:
            self._poll.start()
        self._state = "running"

    def read(self, timeout: float) -> Sequence[Batch]:
        """Blocks that have arrived, waiting at most `timeout` [s] for the first; empty where none came.

        A row is handed out when the next SYNC has gone out: only then it is sure that nothing more belongs to it.
        """
        require_state(self._state, "running", "read")
        deadline = self._clock.now() + timeout
        blocks: list[Batch] = []
        while not blocks:
            left = max(0.0, deadline - self._clock.now())
            frames = self._receiver.take(left, self._aligner.wanted)
            aligned = self._aligner.feed(frames, self._sync.take(), self._receiver.drained, at_rest=self._at_rest())
            blocks = [*self._joints_block(aligned), *self._thermal_blocks()]
            if self._clock.now() >= deadline:
                break
        self._watch.check_presence(self._receiver.drained)
        self._check_silence()
        return blocks

    def notices(self) -> Sequence[Notice]:
        """Return what drives and adapter reported since the last call."""
        notices = [*super().notices()]
        if self._bus is not None:
            notices += self._receiver.notices()
            if self._state != "closed":
                notices += self._watch.notices()
                if self._poll is not None:
                    notices += self._poll.notices()
        return notices

    def command_rate(self) -> float:
        """The rate of SYNC; 0 where the connection's mode is "none"."""
        return 0.0 if self._mode is None else self._settings.sync_rate

    def take_control(self) -> None:
        """Enable the drives, each holding its position; that lasts a few tenths of a second and more."""
        with self._motion_lock:
            motion = self._require_movable()
            if self._latest_position is None:
                raise DriverStateError("no position of the arm is known yet", hint="read samples before")
            if self._clocks is not None and (wrong := self._clocks.wait(self._clock)):
                raise MotionRefusedError(wrong)
            if not motion.moving and motion.ended_by is None:
                motion.enable(self._settings.timeout)

    def command(self, position: FloatArray, due: float | None = None) -> None:
        """Send a joint position (n,) [rad] to be reached within a few periods (see `TargetPath`).

        The first one enables the drives where `take_control` did not. `due` [s, host's clock] is when it should have
        been sent; now where None.
        """
        position = finite_position(position, self._joints)
        with self._motion_lock:
            motion = self._require_movable()
            if not motion.moving and motion.ended_by is None:
                check_first_step(position, self._latest_position, self._joints, self._sliding)
                motion.enable(self._settings.timeout)
            try:
                motion.command(self._scaling.counts(position), due)
            except DriverStateError as error:
                cause = "" if motion.dropped_out is None else self._watch.cause(motion.dropped_out)
                if not cause:
                    raise
                raise DriverStateError(f"{error.message}: {cause}", hint=error.hint) from error

    def guiding_refusal(self, *, pushed: bool) -> str:
        """Why the arm cannot be led by hand: limp, or where drives would not notice that this computer is gone."""
        if not pushed:
            return "drives without power are held by their brakes: their arm is led with --model only"
        if self._mode is None:
            return "this connection only records (mode: none)"
        pairs = () if self._state == "closed" else zip(self._joints, self._configured.controls, strict=True)
        stops = tuple(objects.AbortOption)[1:]
        blind = [joint for joint, own in pairs if own.watching is None or own.abort_option not in stops]
        return f"the last torque would stay where this computer is gone: {', '.join(blind)}" if blind else ""

    def guiding_cautions(self, *, pushed: bool) -> Sequence[str]:
        """Return what to mind before the arm is led by hand, and of the drives' own stops."""
        self._require_open("tell cautions")
        carried = "while you hold the key, the drives carry the arm's weight as the model has it: it drifts, and falls"
        return [f"{carried} where the model is wrong", *self._configured.cautions]

    def release(self, torque: FloatArray | None) -> None:
        """Go over to cyclic torques (n,) [N·m], which drives take by a second RPDO (see `drivers.base.Guidable`)."""
        if torque is None:
            raise DriverStateError(self.guiding_refusal(pushed=False))
        with self._motion_lock:
            motion = self._require_movable()
            if self._poll is not None:  # it asks the same drives
                self._poll.stop()
            try:
                for drive in self._drives:
                    map_torque(drive)
            finally:
                if self._poll is not None:
                    self._poll.start()
            motion.release(self._scaling.per_mille(torque))

    def push(self, torque: FloatArray) -> None:
        """Command joint torques (n,) [N·m] of an arm that is let go (see `drivers.base.Guidable`)."""
        with self._motion_lock:
            self._require_movable().push(self._scaling.per_mille(finite_position(torque, self._joints)))

    def stop(self) -> None:
        """Quick-stop the drives that this driver moves, then end the samples; safe in every state, never raises.

        Another thread may go on reading until the arm has come to rest, but no longer command it.
        """
        self._halted = True
        motion = self._motion
        if motion is not None:
            motion.halt()
        if self._poll is not None:
            self._poll.finish()  # drives may have to be stopped by SDO
        with self._motion_lock:
            moved = motion is not None and not motion.idle
            if motion is not None and self._state == "running":
                for trouble in motion.stop(lambda: self._sync.running):
                    self._tell("error", trouble)
            self._motion = None
            if self._state == "running":
                self._receiver.report_rest()
                self._watch.report_alignment(self._receiver.drained)
                self._watch.stop()
                if self._poll is not None:
                    self._poll.stop()
                self._sync.stop()
                for index, node in enumerate(self._ids):
                    if not moved and self._watch.powered(index):
                        continue  # somebody else runs it: leaving operational would stop it
                    with contextlib.suppress(ConnectionLostError):
                        self._sender.send(objects.NMT, bytes([objects.NMT_PRE_OPERATIONAL, node]))
                self._state = "open"

    def silence(self, stream: str, limit: float) -> str:
        """Name the drives that do not answer SYNC; empty where all do, or of another stream (see `drivers.base`)."""
        if stream != "joints" or self._state != "running":
            return ""
        return self._silence.explain(self._clock.now(), self._receiver.drained, self._sync.latest, limit)

    def losses(self, stream: str) -> str:
        """Return why rows of `joints` were lost, in words; empty of another stream (see `drivers.base`)."""
        return self._watch.losses() if stream == "joints" and self._state != "closed" else ""

    def _take_leave(self) -> None:
        if self._life is not None:
            release(self._drives, self._configured.controls, self._clock)  # while they still hear from us

    def _require_movable(self) -> DriveMotion:
        self._require_running()
        if self._motion is None:
            raise DriverStateError(
                "this connection only records (mode: none)", hint="set its 'mode' to position or profile"
            )
        for failure in (self._sync.failure, self._receiver.failure):
            if failure is not None:
                raise failure
        return self._motion

    def _configure(self, deadline: float, network: CanopenNetwork) -> Configured:
        settings = self._settings
        if settings.mode != "none" and settings.guarding is None:
            own = RemoteDrive(network, "dynid", settings.own_id, settings.sdo_timeout, self._clock)
            check_own_id(own, self._clock)
        configured = configure(self._drives, self._settings, self._sender, deadline, self._clock)
        for drive, node in zip(self._drives, self._settings.nodes, strict=True):
            if node.temperature is not None:
                read_temperature(drive, node.temperature)  # a wrong index shows here, not in the recording
        for drive in self._drives:
            drive.deadline = math.inf
        self._notices.extend(configured.notices)
        return configured

    def _make_motion(self, mode: int) -> DriveMotion:
        standstill = STANDSTILL / np.abs(self._scaling.radians_per_count)
        period = 1.0 / self._settings.sync_rate
        latest, sender, beside = self._receiver.latest, self._sender, self._sdo_stop
        return DriveMotion(self._joints, self._ids, mode, period, list(standstill), latest, sender, beside, self._clock)

    def _make_sync(self, network: CanopenNetwork) -> SyncProducer:
        sender, rate, clock = self._sender, self._settings.sync_rate, self._clock
        if self._bus is None or not sends_in_kernel(self._bus):
            return SyncProducer(sender, rate, self._outputs, clock, self._at_rest)
        sync = KernelSync(sender, rate, self._outputs, lambda: self._receiver.drained, clock, self._at_rest)
        network.subscribe(objects.SYNC, sync.on_sync)
        return sync

    def _make_watch(self) -> DriveWatch:
        settings, ids, count = self._settings, self._ids, len(self._ids)
        presence: Presence
        if (guarding := settings.guarding) is not None:
            presence = NodeGuarding(count, guarding.period, guarding.factor)
            self._life = guard_requests(self._sender, ids, guarding.period, presence.ask, self._clock)
        else:
            presence = Heartbeats(count, settings.heartbeat)
            if any(control.present for control in self._configured.controls):
                self._clocks = HeartbeatClocks(count, settings.heartbeat)
            if settings.mode != "none":
                self._life = heartbeat(self._sender, settings.own_id, settings.heartbeat, self._clock)
        controls = self._configured.controls
        expected, watching = (
            [control.present for control in controls],
            [control.watching is not None for control in controls],
        )
        return DriveWatch(
            self._joints, ids, expected, presence, watching, self._sync.clock, self._moved_in, self._clocks
        )

    def _make_poll(self) -> TemperaturePoll | None:
        sources = [node.temperature for node in self._settings.nodes]
        drives = [drive for drive, source in zip(self._drives, sources, strict=True) if source is not None]
        stated = [source for source in sources if source is not None]
        return TemperaturePoll(drives, stated, self._clock) if drives else None

    def _joints_with_temperature(self) -> tuple[str, ...]:
        pairs = zip(self._joints, self._settings.nodes, strict=True)
        return tuple(joint for joint, node in pairs if node.temperature is not None)

    def _outputs(self, moment: float, left_out: int) -> Sequence[tuple[int, bytes]]:
        motion = self._motion
        return () if motion is None else motion.outputs(moment, left_out)

    def _moved_in(self) -> int | None:
        """The mode of operation in which the drives are being moved; None where they are not."""
        motion = self._motion
        return motion.mode if motion is not None and motion.active else None

    def _at_rest(self) -> bool:
        """Return whether the arm stands still, and nothing here moves it."""
        motion = self._motion
        return (motion is None or motion.idle) and self._standstill.at_rest

    def _joints_block(self, aligned: Aligned) -> list[Batch]:
        rows = aligned.rows
        if self._last_slot is not None:  # before the first row the drives are still starting
            skipped = self._sync.skipped
            self._watch.check_alignment(aligned, skipped - self._skipped, self._receiver.drained)
            self._skipped = skipped
        if not len(rows.slot):
            return []
        before = int(rows.slot[0]) - 1 if self._last_slot is None else self._last_slot
        self._last_slot = int(rows.slot[-1])
        lost = self._last_slot - before - len(rows.slot)
        time_ = self._sync.clock(rows.sent)
        values = self._scaling.values(rows)
        values["sync_lateness"] = (time_ - rows.slot / self._settings.sync_rate)[:, np.newaxis]
        self._latest_position = values["position"][-1].copy()
        self._standstill.add(float(rows.host_time[-1]), self._latest_position)
        self._last_row, self._asked = float(rows.host_time[-1]), self._sync.count
        motion = self._motion
        if motion is not None and motion.ended_by is not None and motion.dropped_out is None and not self._end_told:
            self._end_told = True
            self._tell("error", motion.ended_by, "end other programs, or use --realtime", float(time_[0]))
        self._watch.check_status(time_, rows.statusword, rows.mode)
        return [Batch("joints", time_, rows.host_time, values, lost)]

    def _thermal_blocks(self) -> list[Batch]:
        readings = [] if self._poll is None else self._poll.take()
        if not readings:
            return []
        host_time = np.array([reading.host_time for reading in readings])
        time_ = np.array([self._sync.clock(moment) for moment in host_time])
        return [Batch("thermal", time_, host_time, {"temperature": np.stack([reading.values for reading in readings])})]

    def _check_silence(self) -> None:
        if self._sync.failure is not None:
            raise self._sync.failure
        period = 1.0 / self._settings.sync_rate
        limit = max(SILENCE_LIMIT, SILENCE_PERIODS * period)
        if self._last_slot is None:
            limit = max(FIRST_ROW_LIMIT, limit)
        silent_for = self._receiver.drained - self._last_row
        asked_for = (self._sync.count - self._asked) * period  # a computer that was late itself has not asked
        if silent_for <= limit or asked_for <= 0.5 * limit:
            return
        self._watch.report_alignment(self._receiver.drained)
        who = self._silence.who(self._receiver.drained - limit)[0] or "some drive to every SYNC"
        raise ConnectionLostError(
            f"no complete sample for {silent_for:.1f} s: no answer of {who}",
            where=f"{self._settings.interface} {self._settings.channel}",
            hint="is the power on, and can the bus carry this sync_rate? (dynid check)",
        )

    def _disconnect(self) -> None:
        life, self._life = self._life, None
        if life is not None:
            life.stop()
        bus, self._bus = self._bus, None
        if bus is not None:
            receiver = getattr(self, "_receiver", None)
            if receiver is not None:
                receiver.stop()
            close_bus(bus)
