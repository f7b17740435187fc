"""What of an HDF5 file may be read: nothing outside it, nothing that it declares beyond what it can hold."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from drivers.core.errors import InputError
from drivers.core.files import MB, MOST_VALUES

MOST_OBJECTS = 10_000
"""Groups and datasets of a file."""
MOST_ROWS = 100_000
"""Texts of a dataset: events, names."""
MOST_TEXT = 50 * MB
"""Characters of all events together, and bytes of one attribute."""
MOST_ENTRIES = 1000
"""Entries of one attribute: names of joints and references of dimension scales."""
SPARSE = 64 * MB
"""A dataset up to this size [B] need not be in the file: rows that were announced, but not written."""
MOST_COMPRESSION = 100
"""A dataset's size over that of its chunks in the file; sampled signals are compressed by 10 at most."""


class Hdf5Bounds:
    """Counts what is read of one HDF5 file, and refuses what leads out of it or declares too much."""

    def __init__(self, path: Path, refusal: type[InputError]) -> None:
        self._path = path
        self._refusal = refusal
        self._values = 0
        self._objects = 0

    def items(self, group: Any) -> dict[str, Any]:
        """Name → group or dataset, of a group; a soft link that leads nowhere, or to another link, is left out.

        Raises:
            InputError: a link into another file, or more objects than `MOST_OBJECTS`.
        """
        self._objects += len(group)
        if self._objects > MOST_OBJECTS:
            raise self._refused(group, f"holds more than {MOST_OBJECTS} groups and datasets")
        items = {}
        for name in group:
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise self._refused(group, f"'{name}' is a link into another file, which is not followed")
            if not isinstance(link, h5py.SoftLink):
                items[name] = group[name]
            elif self._stays_within(group, link.path):
                items[name] = group[link.path]
        return items

    def _stays_within(self, group: Any, path: str) -> bool:
        """Return whether a path leads to something without passing another link."""
        place = group.file if path.startswith("/") else group
        for step in path.split("/"):
            if step in ("", "."):
                continue
            if not isinstance(place, h5py.Group) or not isinstance(place.get(step, getlink=True), h5py.HardLink):
                return False
            place = place[step]
        return True

    def check_dataset(self, dataset: Any) -> None:
        """Check that a dataset's values stand in this file, and fit into memory with those before them.

        Raises:
            InputError: they stand in another file, or it declares more than the file can hold.
        """
        plist = dataset.id.get_create_plist()
        if plist.get_external_count() or dataset.is_virtual:
            raise self._refused(dataset, "its values are in another file, which is not read")
        self.check_attributes(dataset)
        count = math.prod(dataset.shape or ())
        stored = dataset.id.get_storage_size()
        self._values += max(0, count - stored // np.dtype(np.float64).itemsize)
        if self._values > MOST_VALUES:
            raise self._refused(
                dataset,
                f"declares {_count(self._values)} numbers that are not in the file; at most {_count(MOST_VALUES)} are "
                "read",
            )
        size = count * dataset.dtype.itemsize
        if size > SPARSE and size > MOST_COMPRESSION * stored:
            raise self._refused(
                dataset, f"declares {size / MB:.0f} MB, of which {stored / MB:.3g} MB are in the file; it is damaged"
            )

    def check_attributes(self, owner: Any) -> None:
        """Check that the attributes of a group or dataset fit into memory.

        Raises:
            InputError: one is larger than `MOST_TEXT`, or has more than `MOST_ENTRIES`.
        """
        for name in owner.attrs:
            about = owner.attrs.get_id(name)
            entries = math.prod(about.shape or ())
            if entries > MOST_ENTRIES:
                raise self._refused(owner, f"its attribute '{name}' has {entries} entries; at most {MOST_ENTRIES}")
            if entries * about.dtype.itemsize > MOST_TEXT:
                raise self._refused(owner, f"its attribute '{name}' is larger than {MOST_TEXT // MB} MB")

    def rows(self, dataset: Any) -> Iterator[Any]:
        """Rows of a dataset of texts, or with texts; a file may let many of them refer to one long text.

        Raises:
            InputError: more than `MOST_ROWS` rows, or more than `MOST_TEXT` characters.
        """
        if math.prod(dataset.shape) > MOST_ROWS:
            raise self._refused(dataset, f"has {math.prod(dataset.shape)} texts; at most {MOST_ROWS} are read")
        # No text is longer than the file.
        step = max(1, min(1000, MOST_TEXT // max(1, self._path.stat().st_size)))
        length = 0
        for start in range(0, len(dataset), step):
            for row in dataset[start : start + step]:
                length += len(str(row))
                if length > MOST_TEXT:
                    raise self._refused(dataset, f"its texts have more than {MOST_TEXT // MB} million characters")
                yield row

    def texts(self, dataset: Any) -> npt.NDArray[np.str_]:
        """The texts of a dataset of any shape.

        Raises:
            InputError: as `rows`.
        """
        values = [value for row in self.rows(dataset) for value in np.ravel(row)] if dataset.shape else [dataset[()]]
        texts = [value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value) for value in values]
        return np.array(texts, dtype=np.str_).reshape(dataset.shape)

    def _refused(self, place: Any, message: str) -> InputError:
        return self._refusal(message, where=f"{self._path}: {place.name}")


def text_length(level: str, source: str, message: str) -> int:
    """Characters of an event as `Hdf5Bounds.rows` counts them, at most."""
    return sum(len(repr(text.encode())) for text in (level, source, message)) + 64


def _count(values: int) -> str:
    return f"{values / 1e6:.3g} million"


_SYSTEM_REASON = re.compile(r"error message = '([^']+)'")  # how HDF5 wraps what the system said


def hdf5_reason(error: BaseException) -> str:
    """The first sentence of an HDF5 or system error."""
    text = str(getattr(error, "strerror", None) or error).strip().strip("'\"")
    system = _SYSTEM_REASON.search(text)
    if system is not None:
        return system[1]
    return text.splitlines()[0] if text else type(error).__name__
