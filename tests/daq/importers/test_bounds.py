"""Foreign files that would fill the memory, wait for ever or lead elsewhere are refused by their headers."""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from pathlib import Path

import h5py
import lz4.frame
import numpy as np
import pytest
import scipy.io
from huge_files import mcap_of_one_chunk, write_hdf5
from kinematic_arm import ROBOT_FILE

from daq.importers import table as table_module
from daq.importers.choices import ImportChoices
from daq.importers.formats import mat as mat_module
from daq.importers.import_file import SUPPORTED, import_file
from daq.recording import hdf5_bounds
from drivers.core import reading_process
from drivers.core.errors import ImportFileError
from drivers.core.files import InputKind

SUFFIXES = [suffix for suffix in SUPPORTED if suffix.startswith(".")]


def refusal(path: Path) -> str:
    with pytest.raises(ImportFileError) as caught:
        import_file(path, ROBOT_FILE, ImportChoices())
    assert caught.value.where.startswith(str(path))
    return caught.value.message


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("target", ["/dev/zero", "fifo"])
def test_a_device_or_a_fifo_is_not_opened(tmp_path: Path, suffix: str, target: str) -> None:
    os.mkfifo(tmp_path / "fifo")
    path = tmp_path / f"run{suffix}"
    path.symlink_to(target)
    assert "is not a regular file" in refusal(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_huge_file_is_not_opened(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    path.touch()
    os.truncate(path, 10**12)
    assert "is larger than" in refusal(path)


def npy(shape: str, held: int) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return np.lib.format.MAGIC_PREFIX + b"\x01\x00" + struct.pack("<H", len(header)) + header + bytes(held)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ("(10000000000,)", "declares the shape (10000000000,), more than it holds"),
        ("(10000000000, 0)", "has no array with a recognised name"),
        ("(2000,)", "holds 0.002 million numbers; at most 0.001 million can be read"),
    ],
)
def test_an_archive_is_judged_by_its_headers(tmp_path: Path, monkeypatch, shape: str, words: str) -> None:
    monkeypatch.setattr(table_module, "MOST_VALUES", 1000)
    path = tmp_path / "run.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", npy(shape, 16_000))
    assert words in refusal(path)


def compressed_element(unpacked: int) -> bytes:
    body = zlib.compress(bytes(unpacked), 9)
    return struct.pack("<II", 15, len(body)) + body


def test_a_compressed_mat_file_is_unpacked_only_up_to_its_limit(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(mat_module, "ARRAY_FILE", InputKind("a file of samples", 10**7))
    scipy.io.savemat(tmp_path / "small.mat", {"t": np.zeros(3)})
    header = (tmp_path / "small.mat").read_bytes()[:128]
    path = tmp_path / "run.mat"
    path.write_bytes(header + 3 * compressed_element(4_000_000))
    assert path.stat().st_size < 20_000
    assert refusal(path) == "unpacks to more than 10 MB"


def test_a_mat_file_is_judged_by_the_shapes_that_it_declares(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(table_module, "MOST_VALUES", 1000)
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": np.zeros(600), "q": np.zeros(600)}, do_compression=True)
    assert "numbers; at most" in refusal(path)


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("raw", "its values are in another file"),
        ("link", "'t' is a link into another file"),
        ("virtual", "its values are in another file"),
        ("large", "declares 1e+05 million numbers that are not in the file; at most 64 million"),
        ("sparse", "declares 400 MB, of which 0 MB are in the file"),
        ("attribute", "its attribute 'joints' has 2000 entries"),
        ("texts", "has 200000 texts; at most 100000"),
        ("objects", "holds more than 20 groups and datasets"),
    ],
)
def test_hdf5_is_read_only_as_far_as_the_file_can_hold_it(tmp_path: Path, monkeypatch, what: str, words: str) -> None:
    monkeypatch.setattr(hdf5_bounds, "MOST_OBJECTS", 20)
    path = tmp_path / "run.h5"
    write_hdf5(path, what)
    assert words in refusal(path)


def test_a_soft_link_is_followed_within_the_file_only(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")  # HDF5 would wait for ever to open it
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["a/x"] = np.zeros(4)
        file["b"] = h5py.SoftLink("/nowhere")
        file["c"] = h5py.SoftLink("/a/x")
        file["a/d"] = h5py.SoftLink("x")
    assert "it has: a.d (4), a.x (4), c (4)" in refusal(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "a") as file:
        file["a/out"] = h5py.ExternalLink("fifo", "/")
        file["e"] = h5py.SoftLink("/a/out/t")
    assert "'out' is a link into another file" in refusal(tmp_path / "run.h5")


@pytest.mark.reads_apart
@pytest.mark.parametrize("suffix", [".mcap", ".csv"])
def test_what_unpacks_to_more_than_memory_is_refused(tmp_path: Path, monkeypatch, suffix: str) -> None:
    """Only the process that reads the file sees how large it becomes."""
    monkeypatch.setattr(reading_process, "MEMORY_LIMIT", 2 * 10**8)
    path = tmp_path / f"run{suffix}"
    if suffix == ".mcap":
        frame = lz4.frame.compress(bytes(4 * 10**8), compression_level=3)
        path.write_bytes(mcap_of_one_chunk("lz4", frame, 4 * 10**8))
    else:
        path.write_text("t,q1\n" + 4_000_000 * "1,2\n")
    assert refusal(path) == "takes more than 200 MB of memory to read; it is damaged or too large"
