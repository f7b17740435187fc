"""Packets of both protocols: what is written is read again, whatever lies between, and nothing else."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.serial_servos.dynamixel import MARK, DynamixelProtocol, crc16
from drivers.serial_servos.feetech import FeetechProtocol
from drivers.serial_servos.packets import Packet, ServoProtocol

PROTOCOLS: tuple[ServoProtocol, ...] = (FeetechProtocol(), DynamixelProtocol())
DATA = st.lists(st.sampled_from([0x00, 0xFD, 0xFF, 0x55, 0x01]), max_size=12).map(bytes)
ANSWERS = st.lists(st.tuples(st.integers(0, 252), st.integers(0, 255), DATA), min_size=1, max_size=4)


def test_packets_of_the_manuals():
    feetech, dynamixel = PROTOCOLS
    # Feetech, SCS protocol manual: PING of 1, READ of two bytes at 0x38 of 1, SYNC READ of 1 and 2.
    assert feetech.request(1, 0x01) == bytes.fromhex("FF FF 01 02 01 FB")
    assert feetech.read(1, 0x38, 2) == bytes.fromhex("FF FF 01 04 02 38 02 BE")
    assert feetech.sync_read(0x38, 8, [1, 2]) == bytes.fromhex("FF FF FE 06 82 38 08 01 02 36")
    # ROBOTIS e-manual, protocol 2.0: PING of 1; READ of four bytes at 132 of 1; its answer with 166.
    assert dynamixel.request(1, 0x01) == bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E")
    assert dynamixel.read(1, 132, 4) == bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
    answer = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
    assert dynamixel.answer(1, 0, bytes([0xA6, 0, 0, 0])) == answer
    assert dynamixel.answers(bytearray(answer)) == ([Packet(1, 0, bytes([0xA6, 0, 0, 0]))], 0)


@given(answers=ANSWERS, noise=st.binary(max_size=6), cut=st.integers(1, 30), which=st.sampled_from(PROTOCOLS))
def test_answers_are_read_again_however_they_come(answers, noise, cut, which):
    noise = bytes(value for value in noise if value != 0xFF)  # what looks like a header waits for its end
    sent = noise + b"".join(which.answer(*answer) for answer in answers)
    buffer, found, strange = bytearray(), [], 0
    for start in range(0, len(sent), cut):
        buffer += sent[start : start + cut]
        packets, more = which.answers(buffer)
        found += packets
        strange += more
    assert found == [Packet(*answer) for answer in answers]
    assert strange == len(noise)


@given(
    answer=st.tuples(st.integers(0, 252), st.integers(0, 255), DATA), place=st.integers(0, 200), bit=st.integers(0, 7)
)
def test_a_damaged_answer_is_none(answer, place, bit):
    for which in PROTOCOLS:
        sent = bytearray(which.answer(*answer))
        sent[place % len(sent)] ^= 1 << bit
        assert Packet(*answer) not in which.answers(sent + which.answer(9, 0))[0]


@given(data=DATA, motor=st.integers(0, 252))
def test_stuffing_hides_headers(data, motor):
    packet = DynamixelProtocol().answer(motor, 0, data)
    assert MARK + b"\x00" not in packet[4:]


def test_fast_answers_of_several_servos():
    dynamixel = DynamixelProtocol()
    rows = [(1, 0, b"\x01\x02"), (7, 0x80, MARK[:2])]
    sent = dynamixel.fast_answer(rows)
    assert len(sent) == dynamixel.fast_answer_size(2, 2)
    packets, strange = dynamixel.answers(bytearray(sent))
    assert strange == 0
    assert dynamixel.fast_answers(packets[0], 2) == [Packet(1, 0, b"\x01\x02"), Packet(7, 0x80, b"\xff\xff")]
    # Each servo's sum is that of all bytes before it.
    first = sent.index(b"\x01\x02") + 2
    assert int.from_bytes(sent[first : first + 2], "little") == crc16(sent[:first])


def test_feetech_has_no_fast_sync_read():
    with pytest.raises(ValueError, match="no fast sync read"):
        FeetechProtocol().sync_read(0, 1, [1], fast=True)
