"""Configuration of the drives by SDO: who they are, whether they are the right ones, and what their PDOs carry."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.base import Level, Notice
from drivers.can.bus import Sender
from drivers.canopen402.protocol import objects
from drivers.canopen402.protocol.emcy import HOW_TO_RESET
from drivers.canopen402.protocol.objects import DriveObject
from drivers.canopen402.protocol.sdo import RemoteDrive
from drivers.canopen402.protocol.state_machine import supports_mode
from drivers.canopen402.samples.alignment import Scaling
from drivers.canopen402.settings import MODES, CanopenSettings, NodeSettings
from drivers.canopen402.setup.drive_limits import DriveLimits, cautions_of, read_drive_limits
from drivers.canopen402.setup.error_control import ErrorControl, configure_error_control, warnings_of
from drivers.canopen402.setup.readiness import faults, require_unpowered, reset_faults
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, MotionRefusedError

_INVALID = 1 << 31
_OLD_ID = (1 << 30) - 1
_SYNCHRONOUS = 1
_UNUSED_TPDOS = (0x1802, 0x1803)

PROBE_LIMIT = 1.0
"""How long [s] all drives together may take to answer the first one."""
SECOND_ANSWER = 0.02
"""How long [s] a second device with the same node id may take to answer as well."""
PERIOD_AGREEMENT = 1e-3
"""Relative difference from which the interpolation period of a drive is not that of SYNC."""
AGREEMENT = 0.01
"""Relative difference from which a rated value in the robot file and in the drive contradict each other."""


def configure_pdos(drive: RemoteDrive, *, commanded: bool) -> None:
    """Two TPDOs answered to every SYNC, and one RPDO applied at SYNC where the drive is to be moved.

    Args:
        drive: in pre-operational.
        commanded: whether the RPDO is used; else it is disabled, so that nothing can move the drive through it.

    Raises:
        ConnectionFailedError: no answer, refused, or not kept.
    """
    tpdos = zip(objects.TPDO_BASES, objects.TPDO_OBJECTS, strict=True)
    for number, (base, carried) in enumerate(tpdos):
        _map_pdo(drive, 0x1800 + number, 0x1A00 + number, base + drive.node, carried)
    for index in _UNUSED_TPDOS:  # they would take room on the bus
        identifier = drive.read_optional(_communication(index, 1, 4))
        if identifier is not None and not identifier & _INVALID:
            drive.write_optional(_communication(index, 1, 4), identifier | _INVALID)
    if not commanded:
        identifier = drive.read(_communication(0x1400, 1, 4))
        drive.write(_communication(0x1400, 1, 4), identifier | _INVALID)
    else:
        _map_pdo(drive, 0x1400, 0x1600, objects.RPDO1 + drive.node, objects.RPDO_OBJECTS)


def map_torque(drive: RemoteDrive) -> None:
    """A second RPDO with the target torque, applied at SYNC; for a drive that may be enabled.

    Raises:
        ConnectionFailedError: it has no cyclic torque, does not answer, or does not keep what is written.
    """
    supported = drive.read_optional(objects.SUPPORTED_MODES)
    if supported is not None and not supports_mode(supported, objects.MODE_CYCLIC_TORQUE):
        words = objects.mode_words(objects.MODE_CYCLIC_TORQUE)
        raise ConnectionFailedError(f"the drive does not support mode {words}", where=drive.where)
    _map_pdo(drive, 0x1401, 0x1601, objects.RPDO2 + drive.node, (objects.TARGET_TORQUE,))


def _map_pdo(
    drive: RemoteDrive, communication: int, mapping: int, identifier: int, carried: Sequence[DriveObject]
) -> None:
    """Disable, map, enable (CiA 301, 7.5.2.36): a mapping can be changed only while its PDO is disabled."""
    entry = _communication(communication, 1, 4)
    flags = drive.read(entry) & ~(_INVALID | _OLD_ID)  # bit 30 (no remote frames) is the drive's own
    drive.write(entry, flags | _INVALID | identifier)
    drive.write(_communication(communication, 2, 1), _SYNCHRONOUS)
    count = DriveObject(mapping, 0, 1, False, "PDO mapping")
    drive.write(count, 0)
    for position, mapped in enumerate(carried, start=1):
        drive.write(DriveObject(mapping, position, 4, False, f"PDO mapping, {mapped.name}"), mapped.mapping)
    drive.write(count, len(carried))
    drive.write(entry, flags | identifier)
    written = drive.read(entry), drive.read(_communication(communication, 2, 1)), drive.read(count)
    if written[0] & (_INVALID | _OLD_ID) != identifier or written[1:] != (_SYNCHRONOUS, len(carried)):
        raise ConnectionFailedError(
            f"the drive did not keep its PDO settings (0x{communication:04X}, 0x{mapping:04X})",
            where=drive.where,
            hint="does the drive's manufacturer fix its PDOs?",
        )


def _communication(index: int, subindex: int, size: int) -> DriveObject:
    return DriveObject(index, subindex, size, False, "PDO communication")


@dataclass(frozen=True)
class Identity:
    """Who a drive is and what it is rated for."""

    joint: str  # that it moves
    node: int  # its id
    # vendor, product, revision, serial: of object 0x1018; None where it does not say
    vendor: int | None
    product: int | None
    revision: int | None
    serial: int | None
    name: str  # device name; empty where it does not say
    firmware: str  # software version; empty where it does not say
    counts_per_turn: float  # position counts a joint revolution, as used
    rated_current: float  # [A], as used
    rated_torque: float  # [N·m], as used


@dataclass(frozen=True)
class Configured:
    """What the configuration found."""

    identities: tuple[Identity, ...]  # one a joint
    scaling: Scaling  # of their numbers
    controls: tuple[ErrorControl, ...]  # how each drive is watched, and watches
    limits: tuple[DriveLimits, ...]  # that each drive keeps itself
    cautions: tuple[str, ...]  # what to mind before the drives move an arm
    notices: tuple[Notice, ...]  # warnings


def configure(  # noqa: C901 — the steps, in their order
    drives: Sequence[RemoteDrive],
    settings: CanopenSettings,
    sender: Sender,
    deadline: float,
    clock: Clock = SYSTEM_CLOCK,
) -> Configured:
    """Check drives, put them into pre-operational, and configure their error control and their PDOs.

    A drive that somebody else has powered is left as it is, and so are all others then.

    Args:
        drives: one a joint.
        settings: of the connection.
        sender: of the bus.
        deadline: [s, host's monotonic clock].
        clock: the host's.

    Raises:
        ConnectionFailedError: a drive does not answer, is not the right one, or refuses something.
        MotionRefusedError: a drive is powered already; or is in fault, where the arm is to be moved.
    """
    notices: list[Notice] = []

    def report(level: Level, message: str) -> None:
        notices.append(Notice(math.nan, level, message))

    for drive in drives:
        drive.deadline = deadline
    _probe(drives, sender, deadline, clock)
    require_unpowered(drives)
    for drive in drives:
        sender.send(objects.NMT, bytes([objects.NMT_PRE_OPERATIONAL, drive.node]))
    mode = MODES[settings.mode]
    serials = {drive.joint: drive.read_optional(objects.SERIAL) for drive in drives}
    for drive, node in zip(drives, settings.nodes, strict=True):
        _check_profile(drive, mode)
        _check_serial(drive, node, serials, drives)
    if settings.reset_faults:
        for message in reset_faults(drives, clock):
            report("warning", message)
    if (in_fault := faults(drives)) and mode is not None:
        raise MotionRefusedError("; ".join(in_fault), hint=HOW_TO_RESET)
    for message in in_fault:
        report("warning", message)
    identities, controls = [], []
    for drive, node in zip(drives, settings.nodes, strict=True):
        identity, contradictions = _identify(drive, node, serials[drive.joint])
        for message in contradictions:
            report("warning", message)
        identities.append(identity)
        controls.append(configure_error_control(drive, settings))
        configure_pdos(drive, commanded=mode is not None)
        if mode is not None:
            drive.write(objects.MODE, mode)
            _configure_mode(drive, node, identity, settings)
    limits = tuple(read_drive_limits(drive) for drive in drives)
    blind = warnings_of([(drive.where, control) for drive, control in zip(drives, controls, strict=True)], settings)
    for message in blind:
        report("warning", message)
    scaling = Scaling(
        counts_per_turn=np.array([drive.counts_per_turn for drive in identities]),
        direction=np.array([float(node.direction) for node in settings.nodes]),
        zero=np.array([node.zero for node in settings.nodes]),
        rated_current=np.array([drive.rated_current for drive in identities]),
        rated_torque=np.array([drive.rated_torque for drive in identities]),
    )
    cautions = (*blind, *cautions_of([drive.joint for drive in drives], limits))
    return Configured(tuple(identities), scaling, tuple(controls), limits, cautions, tuple(notices))


def _probe(drives: Sequence[RemoteDrive], sender: Sender, deadline: float, clock: Clock) -> None:
    end = min(deadline, clock.now() + max(PROBE_LIMIT, 2.0 * drives[0].timeout))
    silent = list(drives)
    while silent:
        for drive in silent:
            drive.ask_for(objects.DEVICE_TYPE)
        again = min(end, clock.now() + drives[0].timeout)
        while any(not drive.answers for drive in silent) and clock.now() < again:
            clock.sleep(1e-3)
        silent = [drive for drive in silent if not drive.answers]
        if silent and clock.now() >= end:
            who = ", ".join(drive.where for drive in silent)
            if len(silent) == len(drives):
                hint = "is the power on, the bus terminated, and the bit rate the drives' own?"
            else:
                hint = "is this drive on the bus, and does it have this node id?"
            raise ConnectionFailedError(f"no answer from {who}", hint=hint)
        for drive in silent:  # a node that is "stopped" answers no SDO; one without a master may be woken
            sender.send(objects.NMT, bytes([objects.NMT_PRE_OPERATIONAL, drive.node]))
    clock.sleep(SECOND_ANSWER)
    for drive in drives:
        if drive.answers > 1 and (count := _answers_to_one_question(drive, clock)) > 1:
            raise ConnectionFailedError(
                f"{count} devices answer to one node id", where=drive.where, hint="give each its own node id"
            )


def _answers_to_one_question(drive: RemoteDrive, clock: Clock) -> int:
    """Return how many devices have this node id; a drive that was asked again may have answered late, and so twice."""
    drive.ask_for(objects.DEVICE_TYPE)
    end = clock.now() + drive.timeout
    while not drive.answers and clock.now() < end:
        clock.sleep(1e-3)
    clock.sleep(SECOND_ANSWER)
    return drive.answers


def _check_profile(drive: RemoteDrive, mode: int | None) -> None:
    profile = drive.read(objects.DEVICE_TYPE) & 0xFFFF
    if profile != objects.PROFILE_402:
        raise ConnectionFailedError(
            f"this device has profile {profile}, not that of a drive ({objects.PROFILE_402})",
            where=drive.where,
            hint="does the joint have another node id?",
        )
    supported = None if mode is None else drive.read_optional(objects.SUPPORTED_MODES)
    if mode is not None and supported is not None and not supports_mode(supported, mode):
        others = [key for key, code in MODES.items() if code is not None and supports_mode(supported, code)]
        raise ConnectionFailedError(
            f"the drive does not support mode {mode} ({objects.MODE_NAMES[mode]})",
            where=drive.where,
            hint=f"set the connection's 'mode' to {' or '.join([*others, 'none'])}",
        )


def _check_serial(
    drive: RemoteDrive, node: NodeSettings, serials: Mapping[str, int | None], drives: Sequence[RemoteDrive]
) -> None:
    serial = serials[drive.joint]
    if node.serial is None or serial == node.serial:
        return
    elsewhere = next((other for other in drives if serials[other.joint] == node.serial), None)
    has = "reports no serial number" if serial is None else f"has serial number {serial}"
    hint = "compare node ids and serial numbers with the robot file"
    if elsewhere is not None:
        hint = f"drive {node.serial} answers as {elsewhere.where}: node ids are swapped, on the drives or in the file"
    raise ConnectionFailedError(
        f"the drive {has}, but the robot file expects {node.serial}", where=drive.where, hint=hint
    )


def _identify(drive: RemoteDrive, node: NodeSettings, serial: int | None) -> tuple[Identity, list[str]]:
    contradictions: list[str] = []

    def choose(name: str, unit: str, own: float | None, said: float | None, source: str) -> float:
        if own is None and not said:
            raise ConnectionFailedError(
                f"the drive does not report its {name} ({source})",
                where=drive.where,
                hint=f"give {name}: … [{unit}] in the robot file",
            )
        if own is not None and said and abs(own / said - 1.0) > AGREEMENT:
            contradictions.append(
                f"{drive.where}: {name} is {own:g} {unit} in the robot file, but {said:g} {unit} in the drive "
                f"({source}); the file's counts"
            )
        return own if own is not None else float(said or 0.0)

    current = drive.read_optional(objects.RATED_CURRENT)
    torque = drive.read_optional(objects.RATED_TORQUE)
    identity = Identity(
        joint=drive.joint,
        node=drive.node,
        vendor=drive.read_optional(objects.VENDOR),
        product=drive.read_optional(objects.PRODUCT),
        revision=drive.read_optional(objects.REVISION),
        serial=serial,
        name=drive.read_text(objects.DEVICE_NAME),
        firmware=drive.read_text(objects.FIRMWARE),
        counts_per_turn=choose("counts_per_turn", "counts", node.counts_per_turn, _counts(drive), "0x608F, 0x6091"),
        rated_current=choose("rated_current", "A", node.rated_current, _milli(current), str(objects.RATED_CURRENT)),
        rated_torque=choose("rated_torque", "N·m", node.rated_torque, _milli(torque), str(objects.RATED_TORQUE)),
    )
    return identity, contradictions


def _milli(value: int | None) -> float | None:
    return None if value is None else 1e-3 * value


def _counts(drive: RemoteDrive) -> float | None:
    """Position counts a joint revolution, from the encoder's resolution and the gear's ratio; None where unknown."""
    increments = drive.read_optional(objects.ENCODER_INCREMENTS)
    turns = drive.read_optional(objects.ENCODER_TURNS)
    motor = drive.read_optional(objects.GEAR_MOTOR_TURNS)
    shaft = drive.read_optional(objects.GEAR_SHAFT_TURNS)
    if not increments or not turns or not motor or not shaft:
        return None
    return increments / turns * (motor / shaft)


def _configure_mode(drive: RemoteDrive, node: NodeSettings, identity: Identity, settings: CanopenSettings) -> None:
    drive.write_optional(objects.CYCLE_PERIOD, round(1e6 / settings.sync_rate))
    if settings.mode == "position":
        value, exponent = _as_power(1.0 / settings.sync_rate)
        if drive.write_optional(objects.INTERPOLATION_INDEX, exponent):
            _require_exact_period(drive, value * 10.0**exponent, settings.sync_rate)
            drive.write_optional(objects.INTERPOLATION_PERIOD, value)
        return
    counts = identity.counts_per_turn / (2.0 * math.pi)
    if node.velocity is not None:
        drive.write(objects.PROFILE_VELOCITY, round(node.velocity * counts))
    if node.acceleration is not None:
        drive.write(objects.PROFILE_ACCELERATION, round(node.acceleration * counts))
        drive.write(objects.PROFILE_DECELERATION, round(node.acceleration * counts))


def _require_exact_period(drive: RemoteDrive, written: float, rate: float) -> None:
    """Refuse a rate whose period the drive's one byte would round: it would interpolate at another rate."""
    if abs(written * rate - 1.0) < PERIOD_AGREEMENT:
        return
    step = 10.0 ** math.ceil(math.log10(1.0 / rate / 255.0))
    periods = (step * round_(1.0 / rate / step) for round_ in (math.ceil, math.floor))
    raise ConnectionFailedError(
        f"the period of sync_rate {rate:g} Hz, {1e3 / rate:.6g} ms, does not fit into {objects.INTERPOLATION_PERIOD}, "
        f"which would hold {1e3 * written:g} ms",
        where=drive.where,
        hint=f"set sync_rate to {' or '.join(f'{1.0 / period:.6g}' for period in periods)} Hz",
    )


def _as_power(period: float) -> tuple[int, int]:
    """A period [s] as value · 10^exponent, the value within one byte (object 0x60C2)."""
    exponent = math.ceil(math.log10(period / 255.0))
    value = round(period / 10.0**exponent)
    while value % 10 == 0 and value:
        value, exponent = value // 10, exponent + 1
    return value, exponent
