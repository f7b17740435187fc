"""What a history keeps of a result: which arm, when, how warm, and its parameters with σ."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from daq.output_files import content_hash
from drivers.core.errors import ResultFileError
from ident.friction.table import TEMPERATURE_KINDS, TERMS
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.graded import UsedRecording
from ident.result.gravity import GRAVITY_SCHEMA, GravityResult
from ident.result.result_file import GRAVITY, SERVO, checked
from ident.result.schema import RESULT_SCHEMA, Result
from ident.servo.result import SERVO_SCHEMA, ServoResult

EARLIEST = datetime(2000, 1, 1, tzinfo=UTC)
"""A clock that shows an earlier time was not set."""

CLOCKS_APART = timedelta(hours=1)
"""By which the clock of a recording may be ahead of this computer's."""

_STATE_TIME = "state its time: dynid history add RESULT --history FILE --time 2026-05-01T12:00, in Python time="


@dataclass(frozen=True)
class KeptValue:
    """A parameter of a result."""

    name: str  # of the parameter
    joint: str  # that it belongs to
    kind: str  # in words, as "Coulomb friction"
    unit: str  # of value and σ
    # what else the value depends on: other friction terms, drive gains, grouped parameters. Values of different bases
    # are not compared.
    basis: str
    value: float  # of the parameter
    std: float  # its σ, > 0
    temperature: float | None  # of the joint [°C]; None where it is not known, or the model has its own terms for it


@dataclass(frozen=True)
class HistoryEntry:
    """What is kept of one result."""

    digest: str  # SHA-256 of its content; one result, one digest
    data: str  # SHA-256 of its kind and of the recordings that it was identified from
    # robot, serial: which arm; the serial number is empty where the recordings do not say it
    robot: str
    serial: str
    kind: str  # result, gravity or servo
    time: float  # mean start of the recordings [s since 1970, UTC]
    created: str  # when it was identified, ISO 8601
    source: str  # its file, as it was given
    values: tuple[KeptValue, ...]  # its parameters that have a σ

    @property
    def arm(self) -> str:
        """Name of the arm in a history."""
        return f"{self.robot} {self.serial}" if self.serial else self.robot


def read_entry(content: Mapping[str, Any], path: Path, recorded: datetime | None = None) -> HistoryEntry:
    """What to keep of the object of a result.json, whose path is for messages; recorded when it says, or as given.

    Raises:
        ResultFileError: no result, one without times or with impossible ones, one of several arms, or without values.
    """
    kind = content.get("kind")
    result: Result | GravityResult | ServoResult
    if kind == SERVO:
        result = checked(ServoResult, content, path, SERVO, "dynid identify", SERVO_SCHEMA)
    elif kind == GRAVITY:
        result = checked(GravityResult, content, path, GRAVITY, "dynid identify", GRAVITY_SCHEMA)
    else:
        result = checked(Result, content, path, "result", "dynid identify", RESULT_SCHEMA)
    used = [recording for recording in result.recordings if recording.role == "identification"]
    serials = {recording.serial for recording in used if recording.serial}
    if len(serials) > 1:
        raise ResultFileError(
            f"was identified from recordings of several arms: serial numbers {', '.join(sorted(serials))}",
            where=str(path),
            hint="identify each arm by itself",
        )
    warm = _temperatures(used, result.joints)
    values = tuple(value for value in _values(result, warm) if _usable(value))
    if not values:
        raise ResultFileError("has no parameter with a standard deviation", where=str(path))
    digest = content_hash(content)
    # Without recordings nothing shows two results to be of the same data: each counts as its own.
    recordings = sorted(recording.sha256 for recording in used)
    return HistoryEntry(
        digest=digest,
        data=hashlib.sha256("\n".join([result.kind, *(recordings or [digest])]).encode()).hexdigest(),
        robot=result.robot,
        serial=next(iter(serials), ""),
        kind=result.kind,
        time=_time(used, path) if recorded is None else _plausible(recorded, path),
        created=result.created,
        source=str(path),
        values=values,
    )


def _usable(value: KeptValue) -> bool:
    numbers = (value.value, value.std, value.temperature or 0.0)
    return all(map(math.isfinite, numbers)) and value.std > 0.0


def parse_time(text: str) -> datetime:
    """An ISO 8601 time; one without a zone is UTC.

    Raises:
        ValueError: it is none.
    """
    time = datetime.fromisoformat(text)
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def _time(used: Sequence[UsedRecording], path: Path) -> float:
    """Mean start of the recordings [s]."""
    starts = []
    for recording in used:
        try:
            starts.append(_plausible(parse_time(recording.started), path))
        except (ValueError, OverflowError):
            said = f"does not state when '{recording.file}' was recorded: {recording.started or 'nothing'}"
            hint = f"identify again with this version of dynid, or {_STATE_TIME}"
            raise ResultFileError(said, where=str(path), hint=hint) from None
    if not starts:
        raise ResultFileError("names no recording, so its time is not known", where=str(path), hint=_STATE_TIME)
    return sum(starts) / len(starts)


def _plausible(time: datetime, path: Path) -> float:
    if not EARLIEST <= time <= datetime.now(UTC) + CLOCKS_APART:
        shown = time.isoformat(timespec="minutes")
        said = "was recorded in the future" if time > EARLIEST else "was recorded with a clock that was not set"
        raise ResultFileError(f"{said}: {shown}", where=str(path), hint=_STATE_TIME)
    return time.timestamp()


def _temperatures(used: Sequence[UsedRecording], joints: list[str]) -> dict[str, float]:
    """Joint → mean temperature over the recordings [°C]; joints without one in each recording are left out."""
    means: dict[str, float] = {}
    for place, joint in enumerate(joints):
        read = [recording.temperature[place] for recording in used if place < len(recording.temperature)]
        finite = [value for value in read if value is not None]
        if finite and len(finite) == len(used):
            means[joint] = sum(finite) / len(finite)
    return means


def _values(result: Result | GravityResult | ServoResult, warm: Mapping[str, float]) -> Iterator[KeptValue]:
    if isinstance(result, ServoResult):
        return _servo_values(result, warm)
    return _gravity_values(result, warm) if isinstance(result, GravityResult) else _model_values(result, warm)


def _model_values(result: Result, warm: Mapping[str, float]) -> Iterator[KeptValue]:
    gains = {gain.joint: f"gain {gain.gain:.6g}" for gain in result.drive_gains if gain.gain is not None}
    kinds: dict[str, list[str]] = {}
    for entry in result.base_parameters:
        if entry.kind not in _BODY_KINDS:
            kinds.setdefault(entry.joint, []).append(entry.kind)
    for entry in result.base_parameters:
        if entry.value is None or entry.std is None:
            continue
        if entry.kind in _BODY_KINDS:
            basis = ", ".join([entry.expression, *gains.values()])
        else:
            basis = ", ".join([*kinds[entry.joint], *([gains[entry.joint]] if entry.joint in gains else [])])
        own = entry.kind not in _BODY_KINDS and any(kind in TEMPERATURE_KINDS for kind in kinds[entry.joint])
        temperature = None if own else warm.get(entry.joint)
        words = _KIND_WORDS.get(entry.kind, entry.kind.replace("_", " "))
        yield KeptValue(entry.name, entry.joint, words, entry.unit, basis, entry.value, entry.std, temperature)


_BODY_KINDS = frozenset({"inertial", "motor_inertia"})
"""Kinds of parameters that are estimated from all joints' torques."""

_KIND_WORDS = {
    "inertial": "inertial parameter",
    "motor_inertia": "motor inertia",
    "coupling": "friction of coupled joints",
    **{term.kind: term.words for term in TERMS},
    "offset": "torque offset",
}


def _gravity_values(result: GravityResult, warm: Mapping[str, float]) -> Iterator[KeptValue]:
    for entry in result.gravity_parameters:
        if entry.value is not None and entry.std is not None:
            words = "gravity parameter" if entry.kind == "inertial" else "torque offset"
            yield KeptValue(
                entry.name, entry.joint, words, entry.unit, entry.expression, entry.value, entry.std,
                warm.get(entry.joint),
            )  # fmt: skip
    for joint in result.of_joints:
        if joint.friction is not None and joint.friction_interval is not None:
            std = joint.friction_interval / WITHIN_95_PERCENT
            yield KeptValue(
                f"friction {joint.joint}", joint.joint, "friction at low speed", joint.unit, "", joint.friction, std,
                warm.get(joint.joint),
            )  # fmt: skip


def _servo_values(result: ServoResult, warm: Mapping[str, float]) -> Iterator[KeptValue]:
    for joint in result.servo:
        terms = ", ".join(joint.parameters)
        for name, entry in joint.parameters.items():
            if entry.interval is None or entry.unidentifiable or entry.origin != "data":
                continue
            std = (entry.interval[1] - entry.interval[0]) / (2.0 * WITHIN_95_PERCENT)
            words = name.replace("_", " ")
            yield KeptValue(
                f"{words} {joint.joint}", joint.joint, words, entry.unit, terms, entry.value, std,
                warm.get(joint.joint),
            )  # fmt: skip
