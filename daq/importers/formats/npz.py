"""NumPy archives: `t`, `q`, `torque`, … as (N, n) arrays or `q1`, `q2`, … as vectors; never unpickled."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.importers.choices import ImportChoices
from daq.importers.collecting import MOST_UNUSED, collect
from daq.importers.roles import assign_roles
from daq.importers.table import ForeignTable, Note, check_count, listed, parsing, printable
from drivers.core.errors import ImportFileError
from drivers.core.files import ARRAY_FILE, check_input, size_text
from drivers.core.text import parsed_json

JOINT_NAME_KEYS = ("joints", "joint_names")
MOST_ARRAYS = 10_000
"""Arrays of an archive."""


def read_npz(path: Path, joints: Sequence[str], choices: ImportChoices) -> ForeignTable:
    """Read an .npz; a JSON text under `meta` may state `units`, `joints` or `joint_names` may name the columns.

    Raises:
        ImportFileError: not an .npz, pickled objects, or arrays that do not fit; with the key.
    """
    where = str(path)
    check_input(path, ARRAY_FILE, ImportFileError)
    arrays: dict[str, npt.NDArray[Any]] = {}
    pickled: list[str] = []
    with parsing(path, "an .npz archive"):
        if not zipfile.is_zipfile(path):
            with path.open("rb") as file:
                if file.read(len(np.lib.format.MAGIC_PREFIX)) == np.lib.format.MAGIC_PREFIX:
                    raise ImportFileError(
                        "holds a single array, not an .npz archive", where=where, hint="save it with numpy.savez"
                    )
        _check_sizes(path)
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                try:
                    entry = archive[name]
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    entry = b""
                if isinstance(entry, np.ndarray):
                    arrays[name] = entry
                else:  # pickled, or the bytes of a file that is no array
                    pickled.append(name)
    return table_of_arrays("NumPy archive", arrays, joints, choices, where, unreadable=pickled)


def _check_sizes(path: Path) -> None:
    """Refuse what would fill the memory, by the sizes that the archive and the headers of its arrays declare."""
    values = 0
    with zipfile.ZipFile(path) as archive:
        if len(archive.infolist()) > MOST_ARRAYS:
            raise ImportFileError(f"holds more than {MOST_ARRAYS} arrays", where=str(path))
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if member.file_size > ARRAY_FILE.largest:
                raise ImportFileError(
                    f"unpacks to more than {size_text(ARRAY_FILE.largest)}", where=f"{path}: {printable(name)}"
                )
            with archive.open(member) as file:
                if file.read(len(np.lib.format.MAGIC_PREFIX)) != np.lib.format.MAGIC_PREFIX:
                    continue  # no array: NumPy hands out its bytes
                file.seek(0)
                version = np.lib.format.read_magic(file)
                read_header = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = read_header(file)
                if not dtype.hasobject and math.prod(shape) * dtype.itemsize > member.file_size - file.tell():
                    raise ImportFileError(
                        f"declares the shape {shape}, more than it holds", where=f"{path}: {printable(name)}"
                    )
            values += math.prod(shape)
            check_count(values, path)


def table_of_arrays(
    source: str,
    arrays: Mapping[str, npt.NDArray[Any]],
    joints: Sequence[str],
    choices: ImportChoices,
    where: str,
    unreadable: Sequence[str] = (),
) -> ForeignTable:
    """A table from named arrays.

    Args:
        source: kind of the file, in words.
        arrays: name → array; texts under `meta`, `joints` and `joint_names` are understood too.
        joints: the robot's joint names.
        choices: `columns` maps names without a meaning.
        where: the file, for messages.
        unreadable: names of entries of the file that are not arrays (pickled objects, cells, functions).

    Raises:
        ImportFileError: nothing usable in it, or arrays that do not fit.
    """
    notes: list[Note] = []
    named = next((key for key in JOINT_NAME_KEYS if key in arrays and arrays[key].dtype.kind in "US"), None)
    array_joints = tuple(_text(name) for name in arrays[named].reshape(-1)) if named is not None else None
    aside = {"meta", *JOINT_NAME_KEYS}
    names = [name for name in arrays if name not in aside]
    shown = [f"{printable(name)} {_shape(arrays[name])}" for name in names] + [printable(name) for name in unreadable]
    roles = assign_roles([*names, *unreadable], joints, choices.columns, where)
    for role in roles:
        if role.name in unreadable:
            raise ImportFileError(
                "is a pickled or otherwise opaque object, which is not opened",
                where=f"{where}: {printable(role.name)}",
                hint="store it as a plain array of numbers",
            )
    if not roles:
        raise ImportFileError(
            f"has no array with a recognised name; it has: {listed(shown, limit=MOST_UNUSED) or 'nothing'}",
            where=where,
            hint="name them t, q, qd, torque or current, or map them: --column q=NAME",
        )
    used = {role.name for role in roles}
    units = (
        _stated_units(arrays["meta"], {role.name: role.quantity for role in roles}, notes) if "meta" in arrays else {}
    )
    return collect(
        source,
        roles,
        arrays,
        joints,
        where,
        array_joints=array_joints,
        units=units,
        unused=[text for name, text in zip((*names, *unreadable), shown, strict=True) if name not in used],
        notes=notes,
    )


def _shape(array: npt.NDArray[Any]) -> str:
    """Shape and kind of an array, to show a user what can be mapped: `(2000 × 6)`."""
    if array.dtype.kind in "US":
        return "(text)"
    return f"({' × '.join(map(str, array.shape)) or 'a number'})"


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value).strip()


def _stated_units(meta: npt.NDArray[Any], quantities: Mapping[str, str], notes: list[Note]) -> dict[str, str]:
    """Units in `meta`: either one angle unit ("deg") or a mapping of the file's names to units."""
    if meta.dtype.kind not in "US" or meta.size != 1:
        return {}
    try:
        content = parsed_json(_text(meta.reshape(-1)[0]))
    except ValueError:
        notes.append(Note("info", "'meta' is not JSON text and was ignored"))
        return {}
    units = content.get("units") if isinstance(content, dict) else None
    if isinstance(units, str):
        angles = {"position": units, "velocity": f"{units}/s"}
        return {name: angles[quantity] for name, quantity in quantities.items() if quantity in angles}
    if isinstance(units, dict):
        return {name: str(units[name]) for name in quantities if isinstance(units.get(name), str)}
    return {}
