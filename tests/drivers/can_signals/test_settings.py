from __future__ import annotations

import builtins
import copy
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.bus import EXTENDED
from drivers.can_signals.settings import parse_settings
from drivers.can_signals.table.bits import BitField
from drivers.can_signals.table.dbc import load_dbc
from drivers.can_signals.table.signals import FixedFrame
from drivers.core.errors import UsageError

HERE = Path(__file__).parent
JOINTS = ("shoulder", "elbow")


def position(joint: str, identifier: int = 0x181, start: int = 0, **more: object) -> dict[str, Any]:
    keys = {"quantity": "position", "joint": joint, "id": identifier, "start": start, "length": 16, "signed": True}
    return {**keys, "scale": 0.01, "unit": "deg", **more}


def connection(**more: object) -> dict[str, Any]:
    signals = [position("shoulder"), position("elbow", start=16)]
    return {"interface": "virtual", "channel": "c", "rate": 200, "signals": signals, **more}


def moving(**more: object) -> dict[str, Any]:
    signals = [
        {key: value for key, value in position(joint, 0x201, 16 * n).items() if key != "quantity"}
        for n, joint in enumerate(JOINTS)
    ]
    return connection(
        start=[{"id": 0x200, "data": "01"}], stop=[{"id": 0x200, "data": "00"}], command={"signals": signals}, **more
    )


def test_a_connection_is_read() -> None:
    extra = {"quantity": "temperature", "joint": "elbow", "id": 0x18FF0001, "extended": True, "start": 7, "length": 8}
    given_keys = moving(
        bitrate=500_000,
        options={"hop_limit": 0},
        cycle=0x80,
        poll={"id": 0x100, "data": "01 00", "period": 0.005},
        begin=[{"id": 1}],
        end=[{"id": 2, "data": "ff", "extended": True}],
        **{"with": ["thermometer"]},
    )
    given_keys["signals"] += [
        {**extra, "byte_order": "big", "unit": "K", "multiplexer": {"start": 15, "length": 4, "value": 9}},
        {"quantity": "counter", "id": 0x181, "start": 32, "length": 8},
    ]
    read = parse_settings(given_keys, JOINTS)
    assert (read.keys.interface, read.keys.channel, read.keys.bitrate, read.keys.rate) == (
        "virtual",
        "c",
        500_000,
        200.0,
    )
    assert read.keys.marker == 0x80
    assert read.poll is not None
    assert read.poll.frames == (FixedFrame(0x100, b"\1\0"),)
    assert read.begin == (FixedFrame(1, b""),)
    assert read.end == (FixedFrame(2 | EXTENDED, b"\xff"),)
    assert read.streams == ("joints", "thermal")
    assert read.identifiers == {0x181, 0x18FF0001 | EXTENDED, 0x80}
    shoulder, _, warm, _ = read.signals
    assert shoulder.gain == pytest.approx(0.01 * math.pi / 180)
    assert (warm.gain, warm.bias, warm.selector) == (1.0, -273.15, 9)
    assert warm.multiplexer == BitField(15, 4, "big")
    assert read.command is not None
    assert [part.identifier for part in read.command.layouts] == [0x201]


@each(
    ("change", "path", "words"),
    [
        ({"rate": 0}, "rate", "is 0"),
        ({"rate": math.nan}, "rate", "is nan"),
        ({"rate": True}, "rate", "is True"),
        ({"rate": None}, "rate", "is missing"),
        ({"speed": 1}, "speed", "unknown key"),
        ({"interface": 3}, "interface", "is 3"),
        ({"channel": None}, "channel", "is missing"),
        ({"options": [1]}, "options", ""),
        ({"bitrate": 3_000_000}, "bitrate", ""),
        ({"signals": []}, "signals", ""),
        ({"signals": None}, "signals", "is missing"),
        ({"signals": [3]}, "signals[0]", "is 3 (allowed: a list of mappings"),
        ({"signals": [{}]}, "signals[0].quantity", "is missing"),
        ({"signals": [position("shoulder", quantity="speed")]}, "signals[0].quantity", "'speed' is not a quantity"),
        ({"signals": [position("wrist")]}, "signals[0].joint", "'wrist' is not a joint"),
        ({"signals": [position("shoulder", unit="km")]}, "signals[0]", "unit 'km' of position"),
        ({"signals": [position("shoulder", unit="")]}, "signals[0]", "no unit of position"),
        ({"signals": [position("shoulder", unit=3)]}, "signals[0].unit", "is 3"),
        ({"signals": [position("shoulder", length=70)]}, "signals[0].length", "is 70"),
        ({"signals": [position("shoulder", start=60)]}, "signals[0]", "leave the frame"),
        ({"signals": [position("shoulder", start=-1)]}, "signals[0].start", "is -1"),
        ({"signals": [position("shoulder", float=True, length=20)]}, "signals[0]", "16, 32 or 64 bits"),
        ({"signals": [position("shoulder", byte_order="middle")]}, "signals[0].byte_order", ""),
        ({"signals": [position("shoulder", signed="yes")]}, "signals[0].signed", ""),
        ({"signals": [position("shoulder", scale=0)]}, "signals[0]", "scale 0 "),
        ({"signals": [position("shoulder", scale=math.inf)]}, "signals[0].scale", "is inf"),
        ({"signals": [position("shoulder", scale=10**400)]}, "signals[0].scale", ""),
        ({"signals": [position("shoulder", 0x800)]}, "signals[0].id", "with 'extended: true'"),
        ({"signals": [position("shoulder", id="0x181")]}, "signals[0].id", "not in quotes"),
        ({"signals": [position("shoulder", endian="big")]}, "signals[0].endian", "unknown key"),
        ({"signals": [position("shoulder", stream="a/b")]}, "signals[0].stream", ""),
        ({"signals": [position("shoulder", multiplexer=1)]}, "signals[0].multiplexer", "allowed: a mapping of keys"),
        (
            {"signals": [position("shoulder", multiplexer={"start": 32, "length": 2, "value": 4})]},
            "signals[0]",
            "multiplexer.value is 4 (allowed: 0 to 3",
        ),
        ({"signals": [position("shoulder", signal="A")]}, "signals[0].id", "unknown key"),
        ({"signals": [{"quantity": "position", "joint": "elbow", "signal": "A"}]}, "signals[0]", "no 'dbc'"),
        ({"signals": [position("shoulder"), position("shoulder", start=16)]}, "signals", "appears twice"),
        ({"signals": [position("shoulder"), position("elbow", start=8)]}, "signals", "overlap in frame 0x181"),
        ({"signals": [position("shoulder")]}, "signals", "no position of joint 'elbow'"),
        ({"cycle": 0x181}, "cycle", "has signals of its own"),
        ({"poll": {"data": "00"}}, "poll", "either 'id' and 'data'"),
        ({"poll": {"frames": []}}, "poll", "at least one frame"),
        ({"poll": {"id": 1, "period": 0.01}}, "poll.period", "contradicts the rate"),
        ({"poll": {"id": 1, "data": "xy"}}, "poll.data", "hexadecimal"),
        ({"poll": {"id": 1, "data": 10}}, "poll.data", "in quotes"),
        ({"poll": {"id": 1, "data": "00" * 9}}, "poll.data", "up to 8 bytes"),
        ({"stop": "00"}, "stop", ""),
        ({"stop": [5]}, "stop[0]", "is 5 (allowed: a list of frames"),
        ({"start": [{"id": 1}]}, "start", "none that command it"),
        ({"timeout": -1}, "timeout", ""),
        ({"dbc": 5}, "dbc", ""),
        ({"dbc": "nowhere.dbc"}, "nowhere.dbc", "no such file"),
        ({"dbc": "a\0b"}, "a\0b", "cannot be read"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(change: dict[str, object], path: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_settings({key: value for key, value in (connection() | change).items() if value is not None}, JOINTS)
    said = str(caught.value)
    assert words in said
    assert f"'{path}'" in said or said.startswith(f"{path}: ")  # the latter of a DBC file
    assert "\n" not in str(caught.value)


@each(
    ("change", "words"),
    [
        ({"stop": None}, "must also define how it is halted"),
        ({"command": []}, "a mapping of keys"),
        ({"command": {"quantity": "torque"}}, "dynid commands positions only"),
        ({"command": {"signals": []}}, "key 'command.signals'"),
        ({"command": {"signals": [position("elbow")]}}, "no position of joint 'shoulder'"),
        ({"command": {"signals": [position("elbow"), position("elbow")]}}, "no position of joint 'shoulder'"),
        ({"command": {"signals": [position("shoulder"), position("elbow")]}}, "overlap"),
        ({"command": {"signals": [position("elbow", quantity="torque", unit="Nm")]}}, "or counter of the commands"),
    ],
)
def test_command_tables_that_cannot_be(change: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_settings({key: value for key, value in (moving() | change).items() if value is not None}, JOINTS)
    assert words in str(caught.value)


def test_everything_that_is_wrong_is_said_at_once() -> None:
    keys = connection(rate=True, poll={"id": 1, "data": "xy"}, tiemout=3)
    keys["signals"][1] |= {"length": 70, "unit": 5}
    with pytest.raises(UsageError, match="5 keys of the can_frames connection are wrong") as caught:
        parse_settings(keys, JOINTS)
    for words in (
        "'rate' is True (allowed: a number from 0.1 to 10000 [Hz]",
        "'signals[1].length' is 70 (allowed: an integer from 1 to 64 [bit])",
        "'signals[1].unit' is 5",
        "'poll.data': 'xy' is not hexadecimal",
        "unknown key 'tiemout' (allowed: interface, ",
        "did you mean 'timeout'?",
    ):
        assert words in caught.value.message


def test_command_frames_need_signals() -> None:
    keys = moving()
    keys["command"]["frames"] = [{"id": 0x205, "data": "00"}]
    with pytest.raises(UsageError, match="no signal is in frame 0x205"):
        parse_settings(keys, JOINTS)


@each(
    ("extra", "words"),
    [
        (
            [{"quantity": "current", "joint": "elbow", "id": 2, "start": 0, "length": 8, "unit": "A"}],
            "no signal for joint",
        ),
        ([{"quantity": "counter", "id": 2, "start": 0, "length": 1}], "begins anew after 2 rows"),
        ([{"quantity": "counter", "id": 2, "start": 0, "length": 8, "scale": 2}], "too coarse"),
        ([{"quantity": "counter", "id": 2, "start": 0, "length": 8, "scale": -1}], "decreases"),
        ([{"quantity": "counter", "joint": "elbow", "id": 2, "start": 0, "length": 8}], "belongs to the whole arm"),
        (
            [{"quantity": "counter", "id": 2, "start": 0, "length": 8, "stream": "slow"}],
            "belongs to the stream 'joints'",
        ),
        ([{"quantity": "time", "id": 2, "start": 0, "length": 16, "unit": "s"}], "too coarse"),
        (
            [
                {"quantity": "time", "id": 2, "start": 0, "length": 16, "unit": "ms"},
                {"quantity": "counter", "id": 2, "start": 16, "length": 8},
            ],
            "both time and counter",
        ),
    ],
)
def test_tables_whose_signals_do_not_go_together(extra: list[dict[str, object]], words: str) -> None:
    keys = connection()
    keys["signals"] += extra
    with pytest.raises(UsageError) as caught:
        parse_settings(keys, JOINTS)
    assert words in str(caught.value)


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.binary(max_size=4) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=3),
    max_leaves=5,
)


def places(section: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    entries = section.items() if isinstance(section, dict) else enumerate(section) if isinstance(section, list) else ()
    for key, value in entries:
        found += places(value, (*path, key))
    return found


FULL = moving(poll={"id": 0x100, "data": "01", "period": 0.005}, cycle=0x80, timeout=2.0, options={}, bitrate=500_000)
FULL["signals"].append(
    {"quantity": "temperature", "joint": "elbow", "id": 3, "start": 8, "length": 8, "unit": "degC", "offset": 1.0}
    | {"multiplexer": {"start": 0, "length": 4, "value": 2, "byte_order": "little"}, "stream": "warmth"}
)


@settings(max_examples=100)
@given(st.sampled_from(places(FULL)), JUNK)
def test_whatever_stands_in_a_place_is_taken_or_refused_with_words(path: tuple[Any, ...], junk: Any) -> None:
    keys = copy.deepcopy(FULL)
    section: Any = keys
    for step in path[:-1]:
        section = section[step]
    section[path[-1]] = junk
    with suppress(UsageError):
        parse_settings(keys, JOINTS)


DBC_HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: X\n\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.dbc"
    path.write_text(DBC_HEAD + text)
    return path


def test_signals_are_picked_from_a_dbc_file(tmp_path: Path) -> None:
    write(
        tmp_path,
        'BO_ 385 A: 8 X\n SG_ Angle1 : 0|16@1- (0.01,0) [0|0] "deg" X\n'
        ' SG_ Angle2 : 23|16@0- (0.01,0) [0|0] "deg" X\n\n'
        'BO_ 2566848513 B: 8 X\n SG_ Angle1 : 0|32@1- (1,0) [0|0] "rad" X\n\nSIG_VALTYPE_ 2566848513 Angle1 : 1;\n',
    )
    entries = [
        {"quantity": "position", "joint": "shoulder", "signal": "Angle1", "message": "B"},
        {"quantity": "position", "joint": "elbow", "signal": "Angle2"},
    ]
    read = parse_settings(connection(dbc="arm.dbc", signals=entries), JOINTS, tmp_path)
    shoulder, elbow = read.signals
    assert shoulder.identifier == 0x18FF0001 | EXTENDED
    assert shoulder.field == BitField(0, 32, signed=True, floating=True)
    assert elbow.field == BitField(23, 16, "big", signed=True)
    for change, words in (
        ({"message": None}, "one of those that have 'Angle1': A, B"),
        ({"signal": "Angle3"}, "did you mean 'Angle"),
        ({"length": 3}, "unknown key 'signals[0].length'"),
        ({"unit": "A"}, "unit 'A' of position"),
    ):
        wrong = [{**entries[0], **change}, entries[1]]
        wrong = [{key: value for key, value in entry.items() if value is not None} for entry in wrong]
        with pytest.raises(UsageError) as caught:
            parse_settings(connection(dbc="arm.dbc", signals=wrong), JOINTS, tmp_path)
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'BO_ 1 M: 8 X\n SG_ Qa : 0|16@1- (1,0) [0|0] "" X\n SG_ Qb : 8|16@1- (1,0) [0|0] "" X\n',
            "The signals Qb and Qa are overlapping in message M",
        ),
        ('BO_ 1 M: 1 X\n SG_ Qa : 0|16@1- (1,0) [0|0] "" X\n', "Qa does not fit in message M"),
        ("BO_ nonsense\n", "not a usable DBC file"),
        ('BO_ 1 M: 8 X\n SG_ Qa : 0|16@1- (1,0) [0|0] "" X\n', "no signal of the DBC file is named after"),
    ],
)
def test_dbc_files_that_cannot_be_used(tmp_path: Path, text: str, words: str) -> None:
    path = write(tmp_path, text)
    keys = connection(dbc=str(path))
    del keys["signals"]
    with pytest.raises(UsageError) as caught:
        parse_settings(keys, JOINTS)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_of_a_dbc_file_is_not_supported_is_said_where_it_is_asked_for(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        'BO_ 1 M: 8 X\n SG_ mode M : 0|8@1+ (1,0) [0|0] "" X\n SG_ Qa m0 : 8|16@1- (1,0) [0|0] "" X\n\n'
        'BO_ 2 Long: 64 X\n SG_ Qb : 0|16@1- (1,0) [0|0] "rad" X\n\nSG_MUL_VAL_ 1 Qa mode 0-1, 3-3;\n',
    )
    found = load_dbc(path)
    assert set(found.unusable) == {"Qa", "Qb"}
    assert "not supported" in found.unusable["Qa"]
    assert "CAN FD" in found.unusable["Qb"]
    entry = {"quantity": "position", "joint": "elbow", "signal": "Qb"}
    with pytest.raises(UsageError, match=r"signal 'Qb' cannot be used: .*CAN FD"):
        parse_settings(connection(dbc=str(path), signals=[entry]), JOINTS)


@settings(max_examples=50)
@given(st.binary(max_size=200))
def test_rubbish_is_no_dbc_file(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("dbc") / "arm.dbc"
    path.write_bytes(DBC_HEAD.encode() + content)
    with suppress(UsageError):
        load_dbc(path)


def test_without_cantools_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    importing = builtins.__import__

    def without(name: str, *more: Any, **keys: Any) -> Any:
        if name.startswith("cantools"):
            raise ImportError(name)
        return importing(name, *more, **keys)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UsageError, match="needs the package cantools") as caught:
        load_dbc(HERE / "aubo_i5.dbc")
    assert "pip install 'dynid[dbc]'" in caught.value.hint
