"""The keys of a canopen402 connection in a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Literal, cast

from drivers.canopen402.objects import MODE_CYCLIC_POSITION, MODE_PROFILE_POSITION
from drivers.connection_keys import ConnectionKeys
from drivers.errors import UsageError

Mode = Literal["position", "profile", "none"]
MODES: Mapping[Mode, int | None] = {
    "position": MODE_CYCLIC_POSITION,
    "profile": MODE_PROFILE_POSITION,
    "none": None,
}
"""Key `mode` → mode of operation; None where the drives are never enabled."""
HIGHEST_ID = 127
"""Of the node ids of CiA 301."""
_KEYS = ConnectionKeys("the canopen402 connection")


@dataclass(frozen=True)
class TemperatureSource:
    """A drive's own object with a temperature: value · scale + offset [°C].

    Attributes:
        index, subindex: of the object.
        scale: [°C per count].
        offset: [°C].
        signed: whether the count may be negative.
    """

    index: int
    subindex: int = 0
    scale: float = 1.0
    offset: float = 0.0
    signed: bool = True


@dataclass(frozen=True)
class NodeSettings:
    """One joint's drive.

    Attributes:
        id: node id, 1 to 127.
        counts_per_turn: position counts a joint revolution; None to read it from the drive.
        direction: sign of all that the drive says and is told, 1 or -1.
        zero: joint position at count 0 [rad].
        rated_current: [A]; None to read it from the drive.
        rated_torque: [N·m]; None to read it from the drive.
        serial: serial number that the drive must have; None where any will do.
        velocity: in mode "profile" [rad/s]; None to leave the drive's own.
        acceleration: in mode "profile" [rad/s²]; None to leave the drive's own.
        temperature: where the drive says its temperature; None where it does not.
    """

    id: int
    counts_per_turn: float | None = None
    direction: int = 1
    zero: float = 0.0
    rated_current: float | None = None
    rated_torque: float | None = None
    serial: int | None = None
    velocity: float | None = None
    acceleration: float | None = None
    temperature: TemperatureSource | None = None


@dataclass(frozen=True)
class Guarding:
    """Node guarding, for drives without a heartbeat.

    Attributes:
        period: how often each drive is asked [s].
        factor: requests in a row that may stay without an answer; also how many periods a drive waits for a request.
    """

    period: float = 0.1
    factor: int = 3


@dataclass(frozen=True)
class CanopenSettings:
    """A bus with one CiA 402 drive a joint.

    Attributes:
        interface, channel, bitrate, options: see `drivers.can.bus.open_bus`.
        sync_rate: of SYNC, and so of the joints' samples [Hz].
        mode: how the arm is moved, if at all.
        timeout: for the configuration, and for enabling the drives [s].
        heartbeat: period of the drives' heartbeat, and of dynid's own [s].
        guarding: in place of heartbeats; None for heartbeats.
        own_id: node id under which dynid sends its own heartbeat.
        nodes: one a joint, in the joints' order.
    """

    interface: str
    channel: str | int
    nodes: tuple[NodeSettings, ...]
    bitrate: int = 1_000_000
    options: Mapping[str, object] = field(default_factory=dict)
    sync_rate: float = 250.0
    mode: Mode = "position"
    timeout: float = 5.0
    heartbeat: float = 0.1
    guarding: Guarding | None = None
    own_id: int = HIGHEST_ID


def parse_settings(connection: Mapping[str, object], joints: Sequence[str]) -> CanopenSettings:
    """Check a connection's keys.

    Raises:
        UsageError: names the key, what was found and what is allowed.
    """
    own = {key: value for key, value in connection.items() if key != "with"}  # other connections, not ours to know
    _check_keys(own, [one.name for one in fields(CanopenSettings)], "")
    interface = connection.get("interface")
    if not isinstance(interface, str) or not interface.strip():
        raise _KEYS.wrong(
            "interface", interface, "a python-can interface: socketcan, slcan, pcan, udp_multicast, virtual, …"
        )
    channel = connection.get("channel")
    if isinstance(channel, bool) or not isinstance(channel, str | int) or not str(channel).strip():
        raise _KEYS.wrong("channel", channel, "what the interface calls a bus: can0, /dev/ttyACM0, 239.74.163.2, …")
    options = connection.get("options", {})
    if not isinstance(options, Mapping) or not all(isinstance(key, str) for key in options):
        raise _KEYS.wrong("options", options, "a mapping of further arguments of the interface")
    mode = connection.get("mode", "position")
    if not isinstance(mode, str) or mode not in MODES:
        raise _KEYS.wrong("mode", mode, ", ".join(MODES))
    if connection.get("heartbeat") is not None and connection.get("guarding") is not None:
        raise UsageError(
            "keys 'heartbeat' and 'guarding' of the canopen402 connection exclude each other",
            hint="write 'guarding' only where drives have no heartbeat (object 0x1017)",
        )
    nodes = _nodes(connection.get("nodes"), joints)
    return CanopenSettings(
        interface=interface.strip(),
        channel=channel.strip() if isinstance(channel, str) else channel,
        nodes=nodes,
        bitrate=_KEYS.whole(
            "bitrate", connection.get("bitrate", 1_000_000), 10_000, 1_000_000, "10000 to 1000000 bit/s"
        ),
        options=dict(options),
        sync_rate=_KEYS.number(
            "sync_rate", connection.get("sync_rate", 250.0), 1.0, 1000.0, "a number from 1 to 1000 Hz"
        ),
        mode=cast("Mode", mode),
        timeout=_KEYS.number("timeout", connection.get("timeout", 5.0), 0.1, 300.0, "a number from 0.1 to 300 s"),
        heartbeat=_KEYS.number("heartbeat", connection.get("heartbeat", 0.1), 0.01, 10.0, "a number from 0.01 to 10 s"),
        guarding=_guarding(connection.get("guarding")),
        own_id=_own_id(connection.get("own_id"), dict(zip(joints, nodes, strict=True))),
    )


def _nodes(value: object, joints: Sequence[str]) -> tuple[NodeSettings, ...]:
    if not isinstance(value, Mapping):
        raise _KEYS.wrong("nodes", value, "a mapping of joint → {id: …}")
    for joint in value:
        if joint not in joints:
            raise UsageError(
                f"key 'nodes' of the canopen402 connection names '{joint}', which is no joint",
                hint=f"allowed: {', '.join(joints)}",
            )
    missing = [joint for joint in joints if joint not in value]
    if missing:
        raise UsageError(
            f"key 'nodes' of the canopen402 connection has no drive for {', '.join(missing)}",
            hint=f"add nodes: {missing[0]}: {{id: …}}",
        )
    nodes = tuple(_node(value[joint], f"nodes.{joint}") for joint in joints)
    holder: dict[int, str] = {}
    for joint, node in zip(joints, nodes, strict=True):
        if node.id in holder:
            raise UsageError(
                f"key 'nodes.{joint}.id' of the canopen402 connection is {node.id}, as {holder[node.id]}'s is already",
                hint="every drive needs a node id of its own",
            )
        holder[node.id] = joint
    return nodes


def _node(value: object, key: str) -> NodeSettings:
    if not isinstance(value, Mapping):
        raise _KEYS.wrong(key, value, "a mapping such as {id: 1, counts_per_turn: 524288}")
    _check_keys(value, [one.name for one in fields(NodeSettings)], f"{key}.")

    def positive(name: str, unit: str) -> float | None:
        if value.get(name) is None:
            return None
        return _KEYS.number(f"{key}.{name}", value[name], 1e-9, 1e12, f"a positive number [{unit}]")

    direction = _KEYS.whole(f"{key}.direction", value.get("direction", 1), -1, 1, "1 or -1")
    if direction == 0:
        raise _KEYS.wrong(f"{key}.direction", 0, "1 or -1")
    serial = value.get("serial")
    return NodeSettings(
        id=_KEYS.whole(f"{key}.id", value.get("id"), 1, HIGHEST_ID, f"a whole number from 1 to {HIGHEST_ID}"),
        counts_per_turn=positive("counts_per_turn", "counts a joint revolution"),
        direction=direction,
        zero=_KEYS.number(f"{key}.zero", value.get("zero", 0.0), -1e3, 1e3, "a number [rad]"),
        rated_current=positive("rated_current", "A"),
        rated_torque=positive("rated_torque", "N·m"),
        serial=None
        if serial is None
        else _KEYS.whole(f"{key}.serial", serial, 0, 2**32 - 1, "a whole number, 32 bits"),
        velocity=positive("velocity", "rad/s"),
        acceleration=positive("acceleration", "rad/s²"),
        temperature=_temperature(value.get("temperature"), f"{key}.temperature"),
    )


def _guarding(value: object) -> Guarding | None:
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise _KEYS.wrong("guarding", value, "a mapping such as {period: 0.1, factor: 3}")
    _check_keys(value, [one.name for one in fields(Guarding)], "guarding.")
    allowed = "a whole number from 3 to 255, for a lost answer makes the next one invalid, too"
    return Guarding(
        period=_KEYS.number("guarding.period", value.get("period", 0.1), 0.01, 10.0, "a number from 0.01 to 10 s"),
        factor=_KEYS.whole("guarding.factor", value.get("factor", 3), 3, 255, allowed),
    )


def _own_id(value: object, nodes: Mapping[str, NodeSettings]) -> int:
    holder = {node.id: joint for joint, node in nodes.items()}
    if value is None:
        free = [number for number in range(1, HIGHEST_ID + 1) if number not in holder]
        if not free:
            raise _KEYS.wrong(
                "nodes", f"{len(holder)} drives", f"at most {HIGHEST_ID - 1}, for dynid needs a node id, too"
            )
        return free[-1]
    own = _KEYS.whole("own_id", value, 1, HIGHEST_ID, f"a whole number from 1 to {HIGHEST_ID}")
    if own in holder:
        raise UsageError(
            f"key 'own_id' of the canopen402 connection is {own}, which is the node id of {holder[own]}'s drive",
            hint="choose a node id that no device on the bus has",
        )
    return own


def _temperature(value: object, key: str) -> TemperatureSource | None:
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise _KEYS.wrong(key, value, "a mapping such as {index: 0x2031, subindex: 1, scale: 0.1}")
    _check_keys(value, [one.name for one in fields(TemperatureSource)], f"{key}.")
    scale = _KEYS.number(f"{key}.scale", value.get("scale", 1.0), -1e6, 1e6, "a number other than 0")
    if scale == 0.0:
        raise _KEYS.wrong(f"{key}.scale", 0, "a number other than 0")
    signed = value.get("signed", True)
    if not isinstance(signed, bool):
        raise _KEYS.wrong(f"{key}.signed", signed, "true or false")
    return TemperatureSource(
        index=_KEYS.whole(f"{key}.index", value.get("index"), 0x1000, 0xFFFF, "an object index, 0x1000 to 0xFFFF"),
        subindex=_KEYS.whole(f"{key}.subindex", value.get("subindex", 0), 0, 255, "a whole number from 0 to 255"),
        scale=scale,
        offset=_KEYS.number(f"{key}.offset", value.get("offset", 0.0), -1e6, 1e6, "a number [°C]"),
        signed=signed,
    )


def _check_keys(given: Mapping[object, object] | Mapping[str, object], known: Sequence[str], prefix: str) -> None:
    for key in given:
        if key not in known:
            raise UsageError(f"a canopen402 connection has no key '{prefix}{key}'", hint=f"allowed: {', '.join(known)}")
