"""Files that declare or unpack to more than they hold, or lead to other files."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np


def write_hdf5(path: Path, what: str) -> None:
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["t"] = np.arange(10.0)
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        if what == "raw":
            file.create_dataset("t", (4,), "f8", external=[(path.with_name("secret.txt"), 0, 32)])
        elif what == "link":
            group["t"] = h5py.ExternalLink("other.h5", "t")
        elif what == "virtual":
            layout = h5py.VirtualLayout((10,), "f8")
            layout[:] = h5py.VirtualSource(path.with_name("other.h5"), "t", (10,))
            file.create_virtual_dataset("t", layout)
        elif what == "large":
            file.create_dataset("t", (10**11,), "f8", chunks=True)
        elif what == "sparse":
            file.create_dataset("t", (5 * 10**7,), "f8", chunks=True)
        elif what == "attribute":
            file.create_dataset("t", (4,), "f8").attrs["joints"] = ["x"] * 2000
        elif what == "texts":
            file.create_dataset("t", (200_000,), h5py.string_dtype())
        elif what == "objects":
            for number in range(30):
                group[str(number)] = 1.0


def mcap_of_one_chunk(compression: str, packed: bytes, unpacked: int) -> bytes:
    def record(kind: int, *fields: bytes) -> bytes:
        return struct.pack("<BQ", kind, sum(map(len, fields))) + b"".join(fields)

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    magic = b"\x89MCAP0\r\n"
    chunk = record(
        6, struct.pack("<QQQI", 0, 1, unpacked, 0), text(compression), struct.pack("<Q", len(packed)), packed
    )
    return b"".join([magic, record(1, text("ros2"), text("")), chunk, record(2, bytes(20)), magic])
