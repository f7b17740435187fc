"""Damage: single bytes, blocks, numbers, values; the same of the same generator."""

from __future__ import annotations

import contextlib
import io
import json
import random
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

MOST_EDITS = 6
NUMBERS = (
    "0", "-1", "1e308", "-1e308", "1e-300", "1e19", "1e9", "nan", "inf", "-inf", ".nan", ".inf", "null", "true", "''",
    "9" * 5000, "0x7fffffffffffffff", "1_000", "1e", "1:30:00", "[]", "{}", "[1, 2]", "!!python/object:os.system x",
    "&a [*a]", "2026-99-99", "1e12", "300", "-0.0", "5e-324", "π", "\x1b[31m", "\0", "../../etc/passwd", "/dev/zero",
)  # fmt: skip
INTEGERS = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
DOUBLES = (0.0, -0.0, 1e308, -1e308, 1e-300, 5e-324, float("nan"), float("inf"), -float("inf"), 1e12, -1.0)

Edit = Callable[[random.Random, bytearray], None]


def damaged(path: Path, kind: str, rng: random.Random) -> bytes:
    """The file's bytes with some damage."""
    structured = _STRUCTURED.get(kind)
    if structured is not None and rng.random() < 0.5:
        with contextlib.suppress(Exception):  # the library does not write such a file
            return structured(path, rng)
    content = bytearray(path.read_bytes())
    edits = (_TEXT_EDITS if kind in _TEXTS else ()) * 3 + _BYTE_EDITS
    for _ in range(rng.choice((1, 1, 1, 2, MOST_EDITS))):  # one mostly: what is refused at once tells little
        rng.choice(edits)(rng, content)
        if not content:
            break
    return bytes(content)


def _place(rng: random.Random, content: bytearray) -> int:
    # Headers, indices and directories stand at the ends.
    size = len(content)
    return min(
        size - 1,
        rng.choice((rng.randrange(size), rng.randrange(min(size, 2048)), size - 1 - rng.randrange(min(size, 2048)))),
    )


def _flip(rng: random.Random, content: bytearray) -> None:
    content[_place(rng, content)] ^= 1 << rng.randrange(8)


def _set_byte(rng: random.Random, content: bytearray) -> None:
    content[_place(rng, content)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))


def _set_integer(rng: random.Random, content: bytearray) -> None:
    start, width = _place(rng, content), rng.choice((2, 4, 8))
    value = rng.choice(INTEGERS) % 2 ** (8 * width)
    content[start : start + width] = value.to_bytes(width, rng.choice(("little", "big")))


def _set_double(rng: random.Random, content: bytearray) -> None:
    start = _place(rng, content)
    content[start : start + 8] = struct.pack("<d", rng.choice(DOUBLES))


def _truncate(rng: random.Random, content: bytearray) -> None:
    del content[_place(rng, content) :]


def _block(rng: random.Random, content: bytearray) -> slice:
    start = _place(rng, content)
    return slice(start, start + rng.choice((1, 8, 64, 512, 4096)))


def _delete(rng: random.Random, content: bytearray) -> None:
    del content[_block(rng, content)]


def _repeat(rng: random.Random, content: bytearray) -> None:
    block = _block(rng, content)
    content[block.start : block.start] = content[block] * rng.choice((1, 2, 16))


def _swap(rng: random.Random, content: bytearray) -> None:
    first, second = sorted((_block(rng, content), _block(rng, content)), key=lambda block: block.start)
    width = min(first.stop - first.start, second.stop - second.start, second.start - first.start)
    one, two = slice(first.start, first.start + width), slice(second.start, second.start + width)
    content[one], content[two] = content[two], content[one]


def _zero(rng: random.Random, content: bytearray) -> None:
    block = _block(rng, content)
    content[block] = bytes(len(content[block]))


def _insert(rng: random.Random, content: bytearray) -> None:
    start = _place(rng, content)
    content[start:start] = rng.randbytes(rng.choice((1, 4, 64)))


_BYTE_EDITS: tuple[Edit, ...] = (
    _flip, _flip, _set_byte, _set_byte, _set_integer, _set_integer, _set_double, _truncate, _delete, _repeat, _swap,
    _zero, _insert,
)  # fmt: skip


def _token(pattern: bytes, replacement: Callable[[random.Random, bytes], bytes]) -> Edit:
    expression = re.compile(pattern)

    def edit(rng: random.Random, content: bytearray) -> None:
        found = list(expression.finditer(content))
        if found:
            match = rng.choice(found)
            content[match.start() : match.end()] = replacement(rng, match.group())

    return edit


def _lines(rng: random.Random, content: bytearray) -> None:
    lines = content.splitlines(keepends=True)
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            lines[first], lines[second] = lines[second], lines[first]
        case 1:
            lines.insert(first, lines[second])
        case 2:
            del lines[first]
        case _:
            lines[first:first] = [lines[second]] * rng.choice((2, 50))
    content[:] = b"".join(lines)


_NUMBER = rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?"
_TEXT_EDITS: tuple[Edit, ...] = (
    _token(_NUMBER, lambda rng, old: rng.choice(NUMBERS).encode()),
    _token(_NUMBER, lambda rng, old: b"%g" % (float(old) * rng.choice((-1, 0, 0.5, 1.01, 2, 10, 1e3, 1e-3)))),
    _token(
        rb"\w+", lambda rng, old: rng.choice((*NUMBERS, "shoulder", "elbow", "base", "name", "joint", "x")).encode()
    ),
    _lines,
)
_TEXTS = frozenset({"robot file", "URDF", "trajectory", "result", "limits", "DBC", "CSV"})


def _json(path: Path, rng: random.Random) -> bytes:
    """Values of a JSON text replaced, moved, repeated or removed."""
    tree = json.loads(path.read_text())
    for _ in range(rng.randint(1, 3)):
        places: list[tuple[Any, Any]] = []
        _collect(tree, places)
        holder, key = rng.choice(places)
        match rng.randrange(5):
            case 0:
                del holder[key]
            case 1:
                other, other_key = rng.choice(places)
                holder[key] = json.loads(json.dumps(other[other_key]))
            case 2 if isinstance(holder[key], list):
                holder[key] = holder[key] * rng.choice((0, 2, 40))
            case _:
                holder[key] = rng.choice(
                    (None, True, 0, -1, 1e308, -1e308, 1e-300, 10**30, 1e90, "", "x" * 10_000, "\x1b[2J", [], {}, [[]])
                )
    return json.dumps(tree).encode()


def _collect(node: Any, places: list[tuple[Any, Any]]) -> None:
    keys = node.keys() if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    for key in keys:
        places.append((node, key))
        _collect(node[key], places)


def _odd(values: Any, rng: random.Random) -> Any:
    """An array with other values, of another shape or type."""
    values = np.array(values)
    match rng.randrange(8):
        case 0:
            return values * 10.0 ** rng.choice((-300, -12, -6, 3, 6, 12, 300))
        case 1:
            flat = values.reshape(-1)
            flat[rng.randrange(len(flat)) :: rng.choice((1, 7, 100))] = rng.choice(DOUBLES)
            return values
        case 2:
            return values[:: rng.choice((-1, 2, 50))]
        case 3:
            return values[: rng.choice((0, 1, 2, 5, 30))]
        case 4:
            return values.astype(rng.choice(("f4", "i8", "u1", "c16", "S5", ">f8", "f2", "?")))
        case 5:
            return np.repeat(values, rng.choice((2, 3)), axis=rng.randrange(values.ndim))
        case 6:
            return values + rng.choice((1e6, 1e12, -1e12, 1e300))
        case _:
            return rng.choice((values.T, values[None], values.reshape(-1), np.zeros_like(values), np.array(1.0)))


def _npz(path: Path, rng: random.Random) -> bytes:
    with np.load(path) as archive:
        arrays = dict(archive)
    name = rng.choice(list(arrays))
    arrays[rng.choice((name, name, "q1", "torque", "joints", "meta"))] = _damaged_values(arrays[name], rng)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _mat(path: Path, rng: random.Random) -> bytes:
    content = scipy.io.loadmat(path, simplify_cells=True)
    arrays = content.get("log", {key: value for key, value in content.items() if not key.startswith("__")})
    name = rng.choice([key for key in arrays if key != "joints"])
    arrays[rng.choice((name, name, "q1", "torque"))] = _damaged_values(arrays[name], rng)
    out = io.BytesIO()
    scipy.io.savemat(out, arrays, do_compression=rng.random() < 0.5)
    return out.getvalue()


def _damaged_values(values: Any, rng: random.Random) -> Any:
    return _odd(values, rng) if np.issubdtype(np.asarray(values).dtype, np.number) else np.asarray("x")


def _hdf5(path: Path, rng: random.Random) -> bytes:
    """Datasets and attributes of an HDF5 file replaced by others, removed, or linked in circles."""
    out = io.BytesIO(path.read_bytes())
    with h5py.File(out, "r+") as file:
        datasets: list[str] = []
        file.visititems(lambda name, item: datasets.append(name) if isinstance(item, h5py.Dataset) else None)
        for _ in range(rng.randint(1, 3)):
            name = rng.choice(datasets)
            if name not in file:
                continue
            dataset = file[name]
            match rng.randrange(8):
                case 0:
                    del file[name]
                case 1:
                    del file[name]
                    file[name] = rng.choice((h5py.SoftLink("/"), h5py.SoftLink(name), h5py.ExternalLink("x.h5", "/")))
                case 2:
                    owner = rng.choice((file, dataset))
                    key = rng.choice([*owner.attrs, "joints", "unit"])
                    owner.attrs[key] = rng.choice(
                        (1, "x", "\x1b[2J", np.nan, [1.0, 2.0], "x" * 60_000, 10**18, ["a"] * 3)
                    )
                case 3 if dataset.maxshape != dataset.shape:
                    dataset.resize(rng.choice((0, 1, 10**6, 10**9)), axis=0)
                case _ if np.issubdtype(dataset.dtype, np.number) and dataset.size:
                    values, attributes = _odd(dataset[()], rng), dict(dataset.attrs)
                    del file[name]
                    file[name] = values
                    for key, value in attributes.items():
                        if key not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME"):
                            file[name].attrs[key] = value
    return out.getvalue()


_STRUCTURED: dict[str, Callable[[Path, random.Random], bytes]] = {
    "result": _json,
    "npz": _npz,
    "mat": _mat,
    "recording": _hdf5,
    "HDF5": _hdf5,
}
