from __future__ import annotations

import copy
from typing import Any

import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen402.settings import Guarding, TemperatureSource, parse_settings
from drivers.core.errors import UsageError

JOINTS = ("j1", "j2")
GOOD: dict[str, Any] = {
    "interface": "virtual",
    "channel": "bench",
    "nodes": {"j1": {"id": 1}, "j2": {"id": 2, "counts_per_turn": 524288, "direction": -1, "zero": 0.5}},
}


def changed(path: str, value: object) -> dict[str, Any]:
    connection = copy.deepcopy(GOOD)
    *way, last = path.split(".")
    connection |= {"guarding": {}} if way == ["guarding"] else {}
    place = connection
    for key in way:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return connection


def test_defaults_and_order_of_the_joints() -> None:
    settings = parse_settings({**GOOD, "nodes": dict(reversed(GOOD["nodes"].items())), "with": ["thermometer"]}, JOINTS)
    assert [node.id for node in settings.nodes] == [1, 2]
    assert settings.nodes[1].direction == -1
    assert settings.nodes[1].counts_per_turn == 524288
    assert settings.nodes[0].temperature is None
    assert (settings.bitrate, settings.mode, settings.timeout, settings.heartbeat) == (1_000_000, "position", 5.0, 0.1)


def test_a_temperature_object() -> None:
    connection = changed("nodes.j1.temperature", {"index": 0x2031, "subindex": 1, "scale": 0.1, "offset": -3})
    assert parse_settings(connection, JOINTS).nodes[0].temperature == TemperatureSource(
        index=0x2031, subindex=1, scale=0.1, offset=-3.0
    )


@each(
    ("path", "value"),
    [
        ("interface", ...),
        ("interface", 3),
        ("channel", ...),
        ("channel", True),
        ("channel", " "),
        ("bitrate", 1.5),
        ("bitrate", 5_000_000),
        ("options", [1]),
        ("options", {1: 2}),
        ("sync_rate", 0),
        ("sync_rate", 1001),
        ("sync_rate", float("nan")),
        ("sync_rate", "fast"),
        ("mode", "velocity"),
        ("mode", 8),
        ("timeout", float("inf")),
        ("heartbeat", 0),
        ("guarding", 0.1),
        ("guarding.period", 0.001),
        ("guarding.factor", 2),
        ("guarding.factor", 256),
        ("guarding.factor", 2.5),
        ("guarding.life", 3),
        ("own_id", 0),
        ("own_id", 128),
        ("own_id", 2),
        ("nodes", ...),
        ("nodes", [1, 2]),
        ("nodes.j1", 1),
        ("nodes.j1.id", ...),
        ("nodes.j1.id", 0),
        ("nodes.j1.id", 128),
        ("nodes.j1.id", True),
        ("nodes.j1.id", 2),
        ("nodes.j1.direction", 0),
        ("nodes.j1.direction", -2),
        ("nodes.j1.direction", True),
        ("nodes.j1.direction", 1.0),
        ("nodes.j1.counts_per_turn", 0),
        ("nodes.j1.counts_per_turn", -5),
        ("nodes.j1.zero", "pi"),
        ("nodes.j1.rated_current", float("nan")),
        ("nodes.j1.rated_torque", -1),
        ("nodes.j1.serial", -1),
        ("nodes.j1.serial", "A17"),
        ("nodes.j1.velocity", 0),
        ("nodes.j1.temperature", 0x2031),
        ("nodes.j1.temperature", {}),
        ("nodes.j1.temperature", {"index": 3}),
        ("nodes.j1.temperature", {"index": 0x2031, "scale": 0}),
        ("nodes.j1.temperature", {"index": 0x2031, "signed": 1}),
        ("nodes.j1.temperature", {"index": 0x2031, "unit": "K"}),
        ("nodes.j1.unit", "deg"),
        ("nodes.j3", {"id": 3}),
        ("nodes.j2", ...),
        ("host", "127.0.0.1"),
    ],
)
def test_wrong_keys_are_named_with_what_is_allowed(path: str, value: object) -> None:
    with pytest.raises(UsageError) as caught:
        parse_settings(changed(path, value), JOINTS)
    assert caught.value.hint
    assert path.rsplit(".", 1)[-1] in caught.value.message
    assert "\n" not in str(caught.value)


def test_guarding_takes_the_place_of_heartbeats() -> None:
    assert parse_settings(GOOD, JOINTS).guarding is None
    assert parse_settings({**GOOD, "guarding": {}}, JOINTS).guarding == Guarding(period=0.1, factor=3)
    slow = {"period": 1, "factor": 5}
    assert parse_settings({**GOOD, "mode": "none", "guarding": slow}, JOINTS).guarding == Guarding(period=1.0, factor=5)
    with pytest.raises(UsageError, match=r"'heartbeat' and 'guarding'.*exclude each other"):
        parse_settings({**GOOD, "guarding": {}, "heartbeat": 0.1}, JOINTS)


@each(
    ("keys", "allowed"),
    [
        ({"heartbeat": 0.05}, ""),
        ({"heartbeat": 1}, ""),
        ({"heartbeat": 0.01}, "0.05 to 1 s"),
        ({"heartbeat": 10}, "0.05 to 1 s"),
        ({"guarding": {"period": 0.05}}, ""),
        ({"guarding": {"period": 0.01}}, "0.05 to 1 s"),
        ({"guarding": {"period": 0.6, "factor": 6}}, "0.02 to 0.5 s"),
        ({"guarding": {"period": 10, "factor": 255}}, "0.000394 to 0.0118 s"),
    ],
)
def test_to_move_an_arm_drives_must_miss_dynid_neither_too_soon_nor_too_late(keys: object, allowed: str) -> None:
    connection = {**GOOD, **keys}  # type: ignore[dict-item]
    parse_settings({**connection, "mode": "none"}, JOINTS)
    if not allowed:
        parse_settings(connection, JOINTS)
        return
    with pytest.raises(UsageError, match=f"mode 'position' needs a period of {allowed}"):
        parse_settings(connection, JOINTS)


def test_dynids_own_id_is_one_that_no_drive_has() -> None:
    assert parse_settings(GOOD, JOINTS).own_id == 127
    assert parse_settings(GOOD | {"nodes": {"j1": {"id": 127}, "j2": {"id": 126}}}, JOINTS).own_id == 125
    assert parse_settings({**GOOD, "own_id": 64}, JOINTS).own_id == 64
    with pytest.raises(UsageError, match=r"'own_id' is 1, which is the node id of j1's drive"):
        parse_settings({**GOOD, "own_id": 1}, JOINTS)
    many = tuple(f"j{number}" for number in range(1, 128))
    with pytest.raises(UsageError, match="127 drives"):
        parse_settings({**GOOD, "nodes": {name: {"id": n} for n, name in enumerate(many, start=1)}}, many)


def test_two_joints_with_one_node_id_are_both_named() -> None:
    with pytest.raises(UsageError, match=r"nodes\.j2\.id.*1.*j1"):
        parse_settings(changed("nodes.j2.id", 1), JOINTS)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text() | st.integers(), inner, max_size=3),
    max_leaves=6,
)
PATHS = (
    "guarding",
    "own_id",
    "interface",
    "channel",
    "options",
    "sync_rate",
    "mode",
    "nodes",
    "nodes.j1",
    "nodes.j1.id",
    "nodes.j1.zero",
)


@given(st.sampled_from((*PATHS, "nodes.j1.temperature", "nodes.j1.serial")), anything)
def test_hostile_values_are_refused_or_taken_but_never_crash(path: str, value: object) -> None:
    try:
        settings = parse_settings(changed(path, value), JOINTS)
    except UsageError:
        return
    assert len(settings.nodes) == 2
    assert len({node.id for node in settings.nodes}) == 2


def test_everything_that_is_wrong_is_said_at_once() -> None:
    connection = changed("nodes.j1.zero", "pi") | {"sync_rat": 400, "mode": "velocity"}
    with pytest.raises(UsageError, match="3 keys of the canopen402 connection are wrong") as caught:
        parse_settings(connection, JOINTS)
    for words in (
        "'mode' is 'velocity' (allowed: position or profile or none",
        "'nodes.j1.zero' is 'pi' (allowed: a number from -1000 to 1000 [rad]",
        "unknown key 'sync_rat' (allowed: interface, ",
        "did you mean 'sync_rate'?",
    ):
        assert words in caught.value.message
