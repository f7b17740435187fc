"""Statuswords against the standard's own table of patterns; error codes in words."""

from __future__ import annotations

from canopen.sdo.exceptions import SdoAbortedError
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen402.protocol.emcy import decode_emergency, describe_abort, describe_error
from drivers.canopen402.protocol.state_machine import ENABLING, DriveState, drive_state, supports_mode

# CiA 402-2, statusword: bits 6 5 3 2 1 0, x where any.
PATTERNS = {
    DriveState.NOT_READY: "0x0000",
    DriveState.SWITCH_ON_DISABLED: "1x0000",
    DriveState.READY: "010001",
    DriveState.SWITCHED_ON: "010011",
    DriveState.ENABLED: "010111",
    DriveState.QUICK_STOP: "000111",
    DriveState.FAULT_REACTION: "0x1111",
    DriveState.FAULT: "0x1000",
}
BITS = (6, 5, 3, 2, 1, 0)


def test_every_statusword_is_read_as_the_table_says() -> None:
    for word in range(0x80):
        shown = "".join(str(word >> bit & 1) for bit in BITS)
        fitting = [
            state
            for state, pattern in PATTERNS.items()
            if all(p in ("x", s) for p, s in zip(pattern, shown, strict=True))
        ]
        assert len(fitting) <= 1
        expected = fitting[0] if fitting else DriveState.UNKNOWN
        for others in (0x0000, 0x0200, 0x1280, 0xFF80, 0x0010):  # bits that say nothing of the state
            assert drive_state(word & ~0x10 | others) is expected


def test_enabling_goes_through_the_states_in_the_standards_order() -> None:
    assert [(word & 0x0F, goal.value) for word, goal in ENABLING] == [
        (0x0, "switch on disabled"),
        (0x6, "ready to switch on"),
        (0x7, "switched on"),
        (0xF, "operation enabled"),
    ]
    assert all(not word & 0x80 for word, _ in ENABLING)  # none resets a fault


@each(("supported", "mode", "yes"), [(0x81, 8, True), (0x81, 1, True), (0x7F, 8, False), (0, 1, False)])
def test_supported_modes(supported: int, mode: int, yes: bool) -> None:
    assert supports_mode(supported, mode) is yes


@each(
    ("code", "words"),
    [
        (0x4210, "device temperature too high"),
        (0x4310, "drive temperature too high"),
        (0x8611, "following error"),
        (0x8130, "heartbeat or life guarding missed"),
        (0x3211, "over-voltage of the DC link"),
        (0x2399, "current on the device's output side"),
        (0x4FFF, "temperature"),
        (0xFF17, "manufacturer's own error 17"),
        (0xB000, "unknown error"),
        (0x0000, "error cleared"),
        (0x0500, "unknown error"),
    ],
)
def test_error_codes_in_words(code: int, words: str) -> None:
    assert describe_error(code) == words


def test_an_emergency_in_words() -> None:
    said = decode_emergency(bytes.fromhex("10 43 09 01 02 00 00 00"))
    assert str(said) == (
        "drive temperature too high (EMCY 0x4310, register: generic, temperature, manufacturer's bytes 01 02 00 00 00)"
    )
    cleared = decode_emergency(bytes(8))
    assert cleared is not None
    assert cleared.cleared


@given(st.binary(max_size=8))
def test_an_emergency_of_any_bytes_has_words(data: bytes) -> None:
    emergency = decode_emergency(data)
    assert (emergency is None) == (len(data) != 8)
    if emergency is not None:
        assert f"0x{emergency.code if not emergency.cleared else 0:04X}" in str(emergency)


def test_every_abort_code_that_canopen_knows_has_words_and_a_hint() -> None:
    unknown = describe_abort(0x12345678)[0].split(" (")[0]
    for code in SdoAbortedError.CODES:
        words, hint = describe_abort(code)
        assert hint
        assert f"0x{code:08X}" in words
        assert not words.startswith(unknown) or code in (0x05040002, 0x05040003, 0x05040004, 0x06090036), hex(code)
