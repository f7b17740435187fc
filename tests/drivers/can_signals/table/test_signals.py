from __future__ import annotations

import math
from typing import Any

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.can.bus import EXTENDED
from drivers.can_signals.table import signals as table
from drivers.can_signals.table.bits import BitField, stack
from drivers.can_signals.table.signal_keys import FACTORS, to_si

BYTES = 8


@st.composite
def fields(draw: st.DrawFn) -> BitField:
    order = draw(st.sampled_from(["little", "big"]))
    floating = draw(st.booleans()) and draw(st.booleans())
    length = draw(st.sampled_from([16, 32, 64]) if floating else st.integers(1, 64))
    place = draw(st.integers(0, 64 - length))
    start = place
    if order == "big":
        highest = 63 - place  # counted from the end of the frame
        start = 8 * (BYTES - 1 - highest // 8) + highest % 8
    signed = draw(st.booleans()) and not floating and length > 1
    return BitField(start, length, order, signed, floating)


def as_cantools(name: str, field: BitField, scale: float, offset: float, **more: Any) -> Signal:
    return Signal(
        name,
        field.start,
        field.length,
        byte_order=f"{field.byte_order}_endian",
        is_signed=field.signed,
        conversion=BaseConversion.factory(scale, offset, None, field.floating),
        **more,
    )


def gathered(chosen: list[BitField]) -> list[BitField]:
    """Those of some fields that do not overlap one before."""
    kept: list[BitField] = []
    for field in chosen:
        if all(not field.bits & other.bits for other in kept):
            kept.append(field)
    return kept


@given(st.data())
def test_frames_are_decoded_as_cantools_decodes_them(data: st.DataObject) -> None:
    chosen = gathered(data.draw(st.lists(fields(), min_size=1, max_size=6)))
    scales = [data.draw(st.sampled_from([1.0, 0.1, -0.25, 1e-4, 360.0])) for _ in chosen]
    offsets = [data.draw(st.sampled_from([0.0, -40.0, 0.5])) for _ in chosen]
    parts = list(zip(chosen, scales, offsets, strict=True))
    message = Message(0x181, "M", BYTES, [as_cantools(f"s{n}", *part) for n, part in enumerate(parts)], strict=True)
    payloads = data.draw(st.lists(st.binary(min_size=BYTES, max_size=BYTES), min_size=1, max_size=5))
    for number, (field, scale, offset) in enumerate(parts):
        ours = table.Signal("position", "j", 0x181, field, scale, offset).values(stack(payloads))
        with np.errstate(invalid="ignore"):
            theirs = [float(message.decode(payload, scaling=True)[f"s{number}"]) for payload in payloads]  # type: ignore[arg-type, call-overload]
        assert np.allclose(ours, theirs, rtol=1e-12, atol=1e-9 * abs(scale), equal_nan=True)


@given(st.data())
def test_cantools_encodes_what_we_encode(data: st.DataObject) -> None:
    chosen = [field for field in gathered(data.draw(st.lists(fields(), min_size=1, max_size=6))) if not field.floating]
    if not chosen:
        return
    numbers = [data.draw(st.integers(*(int(bound) for bound in _bounds(field)))) for field in chosen]
    message = Message(0x181, "M", BYTES, [as_cantools(f"s{n}", field, 1, 0) for n, field in enumerate(chosen)])
    theirs = message.encode({f"s{n}": number for n, number in enumerate(numbers)}, strict=False)
    signals = [table.Signal("position", str(n), 0x181, field) for n, field in enumerate(chosen)]
    (part,) = table.frame_layouts(signals)
    assert table.encode(part, [float(number) for number in numbers], bytes(BYTES)) == theirs


def _bounds(field: BitField) -> tuple[int, int]:
    """What a double holds exactly of a field's numbers."""
    low, high = field.range
    return math.ceil(max(low, -(2.0**53))), math.floor(min(high, 2.0**53))


@given(fields(), st.sampled_from([1.0, 0.1, -0.25, 1e-4]), st.sampled_from([0.0, -40.0]), st.floats(0.0, 1.0))
def test_a_value_comes_back_within_half_a_step(field: BitField, scale: float, offset: float, share: float) -> None:
    if field.floating:
        return
    signal = table.Signal("position", "j", 0x181, field, scale, offset)
    low, high = signal.limits
    value = low + share * (high - low)
    back = signal.values(stack([signal.encode(value).to_bytes(BYTES, "little")]))[0]
    assert abs(back - value) <= 0.5 * abs(scale) * (1 + 1e-9) + 1e-12 * abs(value) + 2**-52 * (high - low)
    beyond = high + abs(scale) * 0.51 + 1e-9 * (high - low)
    with pytest.raises(ValueError, match="fit"):
        signal.encode(beyond)
    with pytest.raises(ValueError, match="fit"):
        signal.encode(math.nan)


@given(st.sampled_from([16, 32, 64]), st.sampled_from(["little", "big"]), st.floats(-6e4, 6e4, width=16))
def test_floats_come_back(length: int, order: Any, value: float) -> None:
    field = BitField(0 if order == "little" else 7, length, order, floating=True)
    assert field.decode(stack([field.encode(value).to_bytes(BYTES, "little")]))[0] == value


def test_frames_of_a_multiplexer_are_told_apart_as_cantools_does() -> None:
    selecting = BitField(0, 8)
    places = [BitField(8, 16, signed=True), BitField(15, 16, "big", signed=True)]
    signals = [
        table.Signal("temperature", f"j{2 * value + n}", 0x381, place, 0.1, 0.0, selecting, value)
        for value in range(3)
        for n, place in enumerate([places[value % 2], BitField(32, 16)])
    ]
    theirs = Message(
        0x381,
        "M",
        BYTES,
        [
            as_cantools("pair", selecting, 1, 0, is_multiplexer=True),
            *(
                as_cantools(
                    f"{s.joint}", s.field, s.gain, s.bias, multiplexer_ids=[s.selector], multiplexer_signal="pair"
                )
                for s in signals
            ),
        ],
    )
    generator = np.random.default_rng(1)
    frames = [(float(n), 0x381, bytes([n % 4]) + generator.bytes(7)) for n in range(40)]
    batch = table.batches(frames)[0x381]
    for part in table.frame_layouts(signals):
        order, values, short = table.decode(part, batch)
        assert order.tolist() == [n for n in range(40) if n % 4 == part.selector]
        assert short == 0
        for which, row in zip(order, values, strict=True):
            known = theirs.decode(frames[which][2])
            assert row == pytest.approx([known[signal.joint] for signal in part.signals])  # type: ignore[index]
        data = table.encode(part, values[0].tolist())
        assert data == frames[int(order[0])][2][: part.size] or part.size < BYTES
        assert table.decode(part, table.batches([(0.0, 0x381, data)])[0x381])[1][0] == pytest.approx(values[0])


def test_frames_that_are_too_short_hold_nothing() -> None:
    (part,) = table.frame_layouts([table.Signal("position", "j", 0x181, BitField(16, 16))])
    frames = [(0.0, 0x181, bytes(size)) for size in range(9)]
    order, values, short = table.decode(part, table.batches(frames)[0x181])
    assert order.tolist() == [4, 5, 6, 7, 8]
    assert values.shape == (5, 1)
    assert short == 4


def test_a_template_gives_the_other_bits_and_the_length() -> None:
    (part,) = table.frame_layouts([table.Signal("position", "j", 0x201, BitField(0, 16))])
    assert table.encode(part, [258.0], bytes.fromhex("ffffff0102")) == bytes.fromhex("0201ff0102")
    assert table.encode(part, [258.0]) == bytes.fromhex("0201")
    with pytest.raises(ValueError, match=r"position of j, 70000, does not fit into its 16 bits, which hold 0 to 65535"):
        table.encode(part, [70000.0])


@each(
    ("start", "length", "order", "message"),
    [
        (64, 1, "little", "start 64"),
        (-1, 8, "little", "start -1"),
        (0, 0, "little", "length 0"),
        (0, 65, "little", "length 65"),
        (57, 8, "little", "leave the frame"),
        (0, 64, "big", "leave the frame"),
        (56, 2, "big", "leave the frame"),
    ],
)
def test_fields_outside_the_frame_are_refused(start: int, length: int, order: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        BitField(start, length, order)


def test_overlaps_are_named() -> None:
    one = table.Signal("position", "a", 0x181, BitField(0, 16))
    other = table.Signal("velocity", "b", 0x181, BitField(7, 8, "big"))
    with pytest.raises(ValueError, match="position of a and velocity of b overlap in frame 0x181, bit 0"):
        table.check_overlaps([one, other])
    selecting = BitField(56, 8)
    muxed = [table.Signal("position", n, 1, BitField(0, 16), 1, 0, selecting, k) for k, n in enumerate("ab")]
    table.check_overlaps(muxed)
    with pytest.raises(ValueError, match="overlap"):
        table.check_overlaps([*muxed, table.Signal("current", "a", 1, BitField(8, 8))])
    with pytest.raises(ValueError, match="overlaps the multiplexer"):
        table.check_overlaps([*muxed, table.Signal("current", "a", 1, BitField(60, 4))])
    with pytest.raises(ValueError, match="different multiplexers"):
        table.check_overlaps([*muxed, table.Signal("current", "a", 1, BitField(16, 8), 1, 0, BitField(48, 8), 1)])


def test_identifiers_are_written_as_people_do() -> None:
    assert table.identifier_text(0x81) == "0x081"
    assert table.identifier_text(0x181 | EXTENDED) == "0x00000181"


@each(
    ("quantity", "unit", "value", "expected"),
    [
        ("position", "deg", 180.0, math.pi),
        ("position", "°", 90.0, math.pi / 2),
        ("position", "rev", 0.5, math.pi),
        ("velocity", "rpm", 30.0, math.pi),
        ("velocity", "1/min", 30.0, math.pi),
        ("velocity", "deg/s", 180.0, math.pi),
        ("current", "mA", 1500.0, 1.5),
        ("torque", "mN·m", 1500.0, 1.5),
        ("torque", "N*m", 1.5, 1.5),
        ("temperature", "K", 300.0, 26.85),
        ("temperature", "°F", 212.0, 100.0),
        ("temperature", "°C", 40.0, 40.0),
        ("time", "µs", 5.0, 5e-6),
        ("counter", "", 7.0, 7.0),
        ("acceleration", "rad/s²", 7.0, 7.0),
    ],
)
def test_units(quantity: str, unit: str, value: float, expected: float) -> None:
    factor, offset = to_si(quantity, unit)
    assert factor * value + offset == pytest.approx(expected)


@each("quantity", list(FACTORS))
def test_units_of_another_quantity_are_refused(quantity: str) -> None:
    with pytest.raises(ValueError, match=r"unit 'furlong' of .* cannot be converted; allowed: "):
        to_si(quantity, "furlong")


def test_cantools_knows_our_numbering_of_a_real_file() -> None:
    text = 'VERSION ""\n\nBO_ 385 M: 8 X\n SG_ A : 7|16@0- (1,0) [0|0] "" X\n SG_ B : 16|16@1- (1,0) [0|0] "" X\n'
    message = cantools.database.load_string(text, database_format="dbc").messages[0]
    payload = bytes.fromhex("fffe0180aabbccdd")
    ours = [BitField(7, 16, "big", signed=True), BitField(16, 16, signed=True)]
    assert [field.decode(stack([payload]))[0] for field in ours] == [-2.0, -32767.0]
    assert list(message.decode(payload).values()) == [-2, -32767]  # type: ignore[union-attr]
