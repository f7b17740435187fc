"""MATLAB files (v4 to v7 through SciPy, v7.3 through h5py) and other people's HDF5 files."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.formats.npz import table_of_arrays
from daq.importers.table import ForeignTable, check_count, parsing
from daq.recording.hdf5_bounds import MOST_ENTRIES, Hdf5Bounds
from drivers.core.errors import ImportFileError
from drivers.core.files import ARRAY_FILE, HDF5_SIGNATURE, check_input, open_input, size_text

_USER_BLOCK = 512
_MAT5_HEADER = 128
_COMPRESSED = 15  # miCOMPRESSED
_READ_BYTES = 1 << 20
DEEPEST = 5
"""Structs within structs that are opened."""


def read_mat(path: Path, joints: Sequence[str], choices: ImportChoices) -> ForeignTable:
    """Read a .mat file of any version; a struct's fields appear as `struct.field`, those of structs in it too.

    Raises:
        ImportFileError: not a .mat file, or arrays that do not fit; with the variable.
    """
    with parsing(path, "a MATLAB file"), open_input(path, ARRAY_FILE, ImportFileError) as file:
        head = file.read(_USER_BLOCK + len(HDF5_SIGNATURE))
    if head.endswith(HDF5_SIGNATURE) or head.startswith(HDF5_SIGNATURE):
        return read_hdf5(path, joints, choices)
    from scipy.io import loadmat, whosmat

    arrays: dict[str, npt.NDArray[Any]] = {}
    opaque: list[str] = []
    with parsing(path, "a MATLAB file"):
        _check_unpacked_size(path)
        check_count(sum(math.prod(shape) for _, shape, _ in whosmat(str(path), appendmat=False)), path)
        content = loadmat(str(path), appendmat=False)
        for name, value in content.items():
            if not name.startswith("__"):
                _add_variable(name, value, arrays, opaque)
    return table_of_arrays("MATLAB file (up to v7)", arrays, joints, choices, str(path), unreadable=opaque)


def _check_unpacked_size(path: Path) -> None:
    """Refuse a file whose compressed variables would fill the memory (MATLAB's MAT-file format, level 5, 1-3).

    Each element of the file is its type and its length in bytes, four bytes each, then its bytes.
    """
    size = 0
    with path.open("rb") as file:
        header = file.read(_MAT5_HEADER)
        order: Literal["little", "big"] = "big" if header.endswith(b"MI") else "little"
        if header[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
            return  # level 4, which is not compressed
        while len(tag := file.read(8)) == 8:
            kind, length = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            end = file.tell() + length
            inflate = zlib.decompressobj() if kind == _COMPRESSED else None
            while inflate is not None and not inflate.eof and (chunk := file.read(min(_READ_BYTES, end - file.tell()))):
                while chunk:
                    size += len(inflate.decompress(chunk, _READ_BYTES))
                    chunk = inflate.unconsumed_tail
                    if size > ARRAY_FILE.largest:
                        raise ImportFileError(f"unpacks to more than {size_text(ARRAY_FILE.largest)}", where=str(path))
            file.seek(end)


def _add_variable(name: str, value: Any, arrays: dict[str, npt.NDArray[Any]], opaque: list[str]) -> None:
    if not isinstance(value, np.ndarray):
        opaque.append(name)
    elif value.dtype.names is not None and value.size == 1:
        for field in value.dtype.names:
            if name.count(".") < DEEPEST:
                _add_variable(f"{name}.{field}", value.reshape(-1)[0][field], arrays, opaque)
            else:
                opaque.append(f"{name}.{field}")
    elif _is_cell_of_texts(value):  # the joint names
        arrays[name] = np.array(["".join(cell.flat) for cell in value.flat], dtype=np.str_)
    elif value.dtype.kind in "OV":
        opaque.append(name)
    else:
        arrays[name] = value


def _is_cell_of_texts(value: npt.NDArray[Any]) -> bool:
    return value.dtype.kind == "O" and all(
        isinstance(cell, np.ndarray) and cell.dtype.kind == "U" for cell in value.flat
    )


def read_hdf5(path: Path, joints: Sequence[str], choices: ImportChoices) -> ForeignTable:
    """Read datasets of an HDF5 file, those in groups as `group.dataset`, those of groups in it too.

    MATLAB v7.3 stores matrices transposed and marks them with the attribute MATLAB_class; they are transposed back.

    Raises:
        ImportFileError: not HDF5, a dynid recording, or arrays that do not fit; with the dataset.
    """
    arrays: dict[str, npt.NDArray[Any]] = {}
    opaque: list[str] = []
    matlab = False
    check_input(path, ARRAY_FILE, ImportFileError)
    bounds = Hdf5Bounds(path, ImportFileError)
    with parsing(path, "an HDF5 or MATLAB v7.3 file"), h5py.File(path, "r") as file:
        if "dynid_schema" in file.attrs:
            raise ImportFileError("is a dynid recording already", where=str(path), hint="use it as it is")
        for label, dataset in _datasets(file, "", set(), bounds):
            if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
                opaque.append(label)
                continue
            bounds.check_dataset(dataset)
            matlab = matlab or "MATLAB_class" in dataset.attrs
            _add_dataset(label, dataset, file, arrays, opaque, bounds)
    kind = "MATLAB file (v7.3)" if matlab else "HDF5 file"
    return table_of_arrays(kind, arrays, joints, choices, str(path), unreadable=opaque)


def _datasets(group: Any, prefix: str, opened: set[tuple[int, int]], bounds: Hdf5Bounds) -> Iterator[tuple[str, Any]]:
    """Content of a group by dotted name; each group within it is opened once, since links may form cycles."""
    for name, item in bounds.items(group).items():
        if not prefix and name.startswith("#"):  # MATLAB's own store of cells
            continue
        label = f"{prefix}{name}"
        about = h5py.h5o.get_info(item.id)
        if isinstance(item, h5py.Group) and prefix.count(".") < DEEPEST and (about.fileno, about.addr) not in opened:
            opened.add((about.fileno, about.addr))
            yield from _datasets(item, f"{label}.", opened, bounds)
        else:
            yield label, item


def _add_dataset(
    label: str, dataset: Any, file: Any, arrays: dict[str, npt.NDArray[Any]], opaque: list[str], bounds: Hdf5Bounds
) -> None:
    matlab_class = dataset.attrs.get("MATLAB_class", b"")
    matlab_class = matlab_class.decode("ascii", "replace") if isinstance(matlab_class, bytes) else str(matlab_class)
    if matlab_class == "cell" and dataset.dtype == h5py.ref_dtype:
        if dataset.size > MOST_ENTRIES:
            opaque.append(label)
            return
        cells = [file[reference] for reference in np.asarray(dataset[()]).flat]
        for cell in cells:
            if isinstance(cell, h5py.Dataset):
                bounds.check_dataset(cell)
        if all(isinstance(cell, h5py.Dataset) and cell.dtype == np.uint16 for cell in cells):
            arrays[label] = np.array(["".join(map(chr, np.asarray(cell[()]).flat)) for cell in cells], dtype=np.str_)
            return
    if matlab_class == "char" and dataset.dtype == np.uint16:
        arrays[label] = np.array("".join(map(chr, np.asarray(dataset[()]).flat)))
        return
    if h5py.check_string_dtype(dataset.dtype) is not None:
        arrays[label] = bounds.texts(dataset)
    elif dataset.dtype.kind in "iuf":
        arrays[label] = np.asarray(dataset[()]).T if matlab_class else np.asarray(dataset[()])
    else:
        opaque.append(label)
