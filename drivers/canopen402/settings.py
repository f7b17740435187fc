"""The keys of a canopen402 connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from drivers.can.settings import CanSettings
from drivers.canopen402.protocol.objects import MODE_CYCLIC_POSITION, MODE_PROFILE_POSITION
from drivers.connection_settings import ConnectionSettings, read_settings, refused
from drivers.core.clock import STALL_LIMIT

Mode = Literal["position", "profile", "none"]
MODES: Mapping[Mode, int | None] = {"position": MODE_CYCLIC_POSITION, "profile": MODE_PROFILE_POSITION, "none": None}
"""Key `mode` → mode of operation; None where the drives are never enabled."""
HIGHEST_ID = 127
"""Largest node id of CiA 301."""
HEARTBEATS_MISSED = 3
"""Periods without a heartbeat after which its producer, a drive or dynid, counts as gone."""
SHORTEST_PATIENCE, LONGEST_PATIENCE = 2.0 * STALL_LIMIT, 3.0
"""For a motion: how long [s] drives wait for dynid beyond one period, at least (twice the stall that a motion may
survive), and from its last sign of life on, at most."""
SMALLEST, LARGEST = 1e-9, 1e12
"""Range of a positive number."""


class TemperatureSource(ConnectionSettings):
    """A drive's own object with a temperature: value · scale + offset [°C]."""

    index: int = Field(ge=0x1000, le=0xFFFF, description="an object index, 0x1000 to 0xFFFF")
    subindex: int = Field(0, ge=0, le=255)
    scale: float = Field(1.0, ge=-1e6, le=1e6, description="[°C per count], other than 0")
    offset: float = Field(0.0, ge=-1e6, le=1e6, description="[°C]")
    signed: bool = Field(True, description="whether the count may be negative")

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, scale: float) -> float:
        if scale == 0.0:
            raise refused("0 makes every temperature the same")
        return scale


class NodeSettings(ConnectionSettings):
    """One joint's drive."""

    id: int = Field(ge=1, le=HIGHEST_ID, description="the node id")
    counts_per_turn: float | None = Field(
        None, ge=SMALLEST, le=LARGEST, description="[position counts per joint revolution]; default: the drive's"
    )
    direction: int = Field(1, description="1 or -1, the sign of the drive's position, velocity, torque and current")
    zero: float = Field(0.0, ge=-1e3, le=1e3, description="[rad], the joint position at count 0")
    rated_current: float | None = Field(None, ge=SMALLEST, le=LARGEST, description="[A]; default: the drive's")
    rated_torque: float | None = Field(None, ge=SMALLEST, le=LARGEST, description="[N·m]; default: the drive's")
    serial: int | None = Field(None, ge=0, le=2**32 - 1, description="the serial number that the drive must have")
    velocity: float | None = Field(
        None, ge=SMALLEST, le=LARGEST, description="[rad/s] in mode 'profile'; default: the drive's"
    )
    acceleration: float | None = Field(
        None, ge=SMALLEST, le=LARGEST, description="[rad/s²] in mode 'profile'; default: the drive's"
    )
    temperature: TemperatureSource | None = Field(
        None, description="a mapping such as {index: 0x2031, subindex: 1, scale: 0.1}"
    )

    @field_validator("direction")
    @classmethod
    def _sign(cls, direction: int) -> int:
        if direction not in {1, -1}:
            raise refused(f"{direction} is not a sign")
        return direction


class Guarding(ConnectionSettings):
    """Node guarding, for drives without a heartbeat."""

    period: float = Field(0.1, ge=0.01, le=10, description="[s] between two requests to a drive")
    factor: int = Field(
        3,
        ge=3,  # a lost answer makes the next one invalid, too
        le=255,
        description="requests in a row that may stay without an answer, and periods that a drive waits for a request",
    )


class CanopenSettings(CanSettings):
    """A bus with one CiA 402 drive per joint."""

    bitrate: int = Field(1_000_000, ge=10_000, le=1_000_000, description="[bit/s]")
    sync_rate: float = Field(250.0, ge=1, le=1000, description="[Hz] of SYNC, and so of the joints' samples")
    mode: Mode = Field("position", description="how the arm is moved, if at all")
    timeout: float = Field(5.0, ge=0.1, le=300, description="[s] for the configuration, and for enabling the drives")
    sdo_timeout: float = Field(0.3, ge=0.01, le=60, description="[s] that a drive may take to answer an SDO request")
    heartbeat: float = Field(0.1, ge=0.01, le=10, description="[s], period of the drives' heartbeat and of dynid's")
    guarding: Guarding | None = Field(
        None, description="a mapping such as {period: 0.1, factor: 3}, for drives without a heartbeat"
    )
    drives: dict[str, NodeSettings] = Field(alias="nodes", description="a mapping of joint → {id: …}")
    reset_faults: bool = Field(
        False, description="whether opening resets the faults of drives; they stay without power"
    )
    own_id: int = Field(
        0, ge=1, le=HIGHEST_ID, description="dynid's own node id; default: the highest that no drive has"
    )

    @property
    def nodes(self) -> tuple[NodeSettings, ...]:
        """One per joint, in the joints' order."""
        return tuple(self.drives.values())

    @field_validator("drives")
    @classmethod
    def _one_per_joint(cls, drives: dict[str, NodeSettings], info: ValidationInfo) -> dict[str, NodeSettings]:
        joints: Sequence[str] = (info.context or {})["joints"]
        for joint in drives:
            if joint not in joints:
                raise refused(f"'{joint}' is not a joint", f"allowed: {', '.join(joints)}")
        missing = [joint for joint in joints if joint not in drives]
        if missing:
            raise refused(f"no drive for {', '.join(missing)}", f"add nodes: {missing[0]}: {{id: …}}")
        holder: dict[int, str] = {}
        for joint in joints:
            if (other := holder.setdefault(drives[joint].id, joint)) != joint:
                raise refused(
                    f"nodes.{joint}.id is {drives[joint].id}, as {other}'s is already",
                    "every drive needs a node id of its own",
                )
        if len(holder) >= HIGHEST_ID:
            raise refused(f"{len(holder)} drives", f"at most {HIGHEST_ID - 1}, for dynid needs a node id, too")
        return {joint: drives[joint] for joint in joints}

    @model_validator(mode="after")
    def _check(self) -> Self:
        if "heartbeat" in self.model_fields_set and self.guarding is not None:
            raise refused(
                "keys 'heartbeat' and 'guarding' exclude each other",
                "write 'guarding' only where drives have no heartbeat (object 0x1017)",
            )
        if self.mode != "none":
            self._require_timely_loss()
        holder = {node.id: joint for joint, node in self.drives.items()}
        if self.own_id in holder:
            raise refused(
                f"key 'own_id' is {self.own_id}, which is the node id of {holder[self.own_id]}'s drive",
                "choose a free node id",
            )
        if self.own_id:
            return self
        return self.model_copy(update={"own_id": max(set(range(1, HIGHEST_ID + 1)) - set(holder))})

    def _require_timely_loss(self) -> None:
        """Refuse periods with which drives stop after a stall that a motion survives, or long after dynid has died."""
        key, period, factor = "heartbeat", self.heartbeat, HEARTBEATS_MISSED
        if self.guarding is not None:
            key, period, factor = "guarding", self.guarding.period, self.guarding.factor
        patience = factor * period
        if patience - period >= SHORTEST_PATIENCE - 1e-9 and patience <= LONGEST_PATIENCE + 1e-9:
            return
        lowest, highest = SHORTEST_PATIENCE / (factor - 1), LONGEST_PATIENCE / factor
        allowed = f"{lowest:.3g} to {highest:.3g} s" if lowest <= highest else "a smaller factor"
        raise refused(
            f"key '{key}': with {period:g} s the drives stop {patience:.3g} s after they last heard of dynid",
            f"to move the arm, mode '{self.mode}' needs a period of {allowed}: longer than a computer stalls, yet "
            "short enough to stop an arm; with 'mode: none' any will do",
        )


def parse_settings(connection: Mapping[str, object], joints: Sequence[str]) -> CanopenSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names every key that is wrong, what was found and what is allowed.
    """
    return read_settings(CanopenSettings, connection, "canopen402", {"joints": joints})
