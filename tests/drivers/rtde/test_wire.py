from __future__ import annotations

import contextlib
import itertools
import struct

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.errors import ConnectionLostError
from drivers.rtde import protocol as wire

KINDS = st.sampled_from([ord(letter) for letter in "VvMUOISP"])
PACKAGES = st.lists(st.builds(wire.encode_package, KINDS, st.binary(max_size=60)), max_size=12)
RECIPE_TYPES = st.lists(st.sampled_from(sorted(wire.NUMPY_TYPES)), min_size=1, max_size=12)
STRUCT_LETTER = {"?": "?", "u1": "B", ">u4": "I", ">u8": "Q", ">i4": "i", ">f8": "d"}
SIZES = {
    "BOOL": 1,
    "UINT8": 1,
    "UINT32": 4,
    "UINT64": 8,
    "INT32": 4,
    "DOUBLE": 8,
    "VECTOR3D": 24,
    "VECTOR6D": 48,
    "VECTOR6INT32": 24,
    "VECTOR6UINT32": 24,
}


def chop(stream: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({cut % (len(stream) + 1) for cut in cuts} | {0, len(stream)})
    return [stream[a:b] for a, b in itertools.pairwise(places)] or [stream]


def split(chunks: list[bytes]) -> tuple[list[bytes], bool]:
    splitter = wire.PackageSplitter()
    found: list[bytes] = []
    try:
        for chunk in chunks:
            found.extend(package.raw for package in splitter.feed(chunk))
    except ConnectionLostError:
        return found, True
    return found, False


@given(PACKAGES, st.lists(st.integers(0, 10_000)), st.binary(max_size=2))
def test_any_chopping_gives_the_same_packages(packages: list[bytes], cuts: list[int], unfinished: bytes) -> None:
    assert split(chop(b"".join(packages) + unfinished, cuts)) == (packages, False)


@given(PACKAGES, st.lists(st.integers(0, 10_000)), st.integers(0, 2), KINDS)
def test_an_impossible_size_is_refused_after_what_came_before(
    packages: list[bytes], cuts: list[int], size: int, kind: int
) -> None:
    stream = b"".join(packages) + struct.pack(">HB", size, kind)
    assert split(chop(stream, cuts)) == (packages, True)


def test_a_broken_stream_stays_broken() -> None:
    splitter = wire.PackageSplitter()
    for chunk in (b"\0\0\0", b"", wire.encode_package(wire.START)):
        with pytest.raises(ConnectionLostError):
            list(splitter.feed(chunk))


@given(PACKAGES, st.integers(0, 255), st.integers(3, 0xFFFF), st.lists(st.integers(0, 10_000)))
def test_an_unknown_type_is_refused_at_its_header(packages: list[bytes], kind: int, size: int, cuts: list[int]) -> None:
    known = chr(kind) in "VvMUOISP"
    found, refused = split(chop(b"".join(packages) + struct.pack(">HB", size, kind), cuts))
    assert found[: len(packages)] == packages
    assert refused is not known


@given(st.lists(st.binary(max_size=300), max_size=8))
def test_garbage_ends_in_packages_or_one_error(chunks: list[bytes]) -> None:
    found, _ = split(chunks)
    assert b"".join(found) == b"".join(chunks)[: sum(map(len, found))]


@given(st.binary(max_size=80), st.lists(st.sampled_from(["a", "b", "c"]), max_size=4))
def test_payload_decoders_raise_nothing_but_their_error(payload: bytes, variables: list[str]) -> None:
    recipe = wire.Recipe(1, (("timestamp", "DOUBLE"),))
    for decode in (
        wire.decode_accepted,
        wire.decode_control_version,
        wire.decode_text_message,
        lambda data: wire.decode_recipe_answer(data, variables),
        lambda data: wire.decode_data(recipe, data),
    ):
        with contextlib.suppress(ConnectionLostError):
            decode(payload)


@given(RECIPE_TYPES, st.integers(0, 255), st.integers(1, 5), st.data())
def test_batches_decode_as_single_packages_do(kinds: list[str], number: int, count: int, data: st.DataObject) -> None:
    recipe = wire.Recipe(number, tuple((f"v{index}", kind) for index, kind in enumerate(kinds)))
    layout = ">" + "".join(f"{wire.NUMPY_TYPES[k][1]}{STRUCT_LETTER[wire.NUMPY_TYPES[k][0]]}" for k in kinds)
    assert recipe.dtype.itemsize == 4 + sum(SIZES[kind] for kind in kinds) == 4 + struct.calcsize(layout)
    size = struct.calcsize(layout)
    # No NaN and no odd truth values: the bytes must compare equal once decoded.
    payloads = [bytes(byte & 1 for byte in data.draw(st.binary(min_size=size, max_size=size))) for _ in range(count)]
    rows = wire.decode_data(
        recipe, b"".join(wire.encode_package(wire.DATA_PACKAGE, bytes([number]) + payload) for payload in payloads)
    )
    for row, payload in zip(rows, payloads, strict=True):
        flat = np.concatenate([np.atleast_1d(row[name]).astype(object) for name in recipe.variables])
        assert flat.tolist() == list(struct.unpack(layout, payload))


def test_a_batch_with_a_foreign_package_is_refused() -> None:
    recipe = wire.Recipe(3, (("timestamp", "DOUBLE"),))
    good = wire.encode_package(wire.DATA_PACKAGE, b"\3" + bytes(8))
    foreign = wire.encode_package(wire.DATA_PACKAGE, b"\4" + bytes(8))
    with pytest.raises(ConnectionLostError, match="package 2 of 3"):
        wire.decode_data(recipe, good + foreign + good)


def test_requests_are_those_of_the_guide() -> None:
    assert wire.encode_protocol_request() == b"\x00\x05V\x00\x02"
    assert wire.encode_package(wire.START) == b"\x00\x03S"
    request = wire.encode_output_recipe(["timestamp", "actual_q"], 125.0)
    assert request == struct.pack(">HBd", len(request), ord("O"), 125.0) + b"timestamp,actual_q"


@each("variables", [[], [""], ["a,b"], ["ä"]])
def test_a_list_that_would_split_otherwise_is_refused(variables: list[str]) -> None:
    with pytest.raises(ValueError):
        wire.encode_output_recipe(variables, 500.0)


def test_a_package_must_fit_its_size() -> None:
    assert len(wire.encode_package(wire.DATA_PACKAGE, bytes(0xFFFC))) == 0xFFFF
    with pytest.raises(ValueError):
        wire.encode_package(wire.DATA_PACKAGE, bytes(0xFFFD))


@pytest.mark.parametrize("comma", [b"", b","])
def test_recipe_answers_with_and_without_the_last_comma(comma: bytes) -> None:
    answer = wire.decode_recipe_answer(b"\1DOUBLE,NOT_FOUND,IN_USE" + comma, ["a", "b", "c"])
    assert answer == wire.RecipeAnswer(1, ("DOUBLE", "NOT_FOUND", "IN_USE"))


@given(st.text(max_size=50), st.text(max_size=50), st.integers(0, 255))
def test_text_messages(text: str, source: str, level: int) -> None:
    encoded = [part.encode() for part in (text, source)]
    payload = b"".join(bytes([len(part)]) + part for part in encoded) + bytes([level])
    message = wire.decode_text_message(payload)
    assert (message.text, message.source) == (text, source)
    assert message.level == wire.MESSAGE_LEVELS[min(level, 3)]


def test_the_maximum_rate_follows_the_generation() -> None:
    rates = {major: wire.ControlVersion(major, 0, 0, 0).maximum_rate for major in (3, 5, 10)}
    assert rates == {3: 125.0, 5: 500.0, 10: 500.0}
