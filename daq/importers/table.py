"""Output of every reader of a foreign file: arrays by name, before any check or conversion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from daq.recording.recording import Level
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError, ImportFileError
from drivers.core.files import MOST_VALUES
from drivers.core.text import first_few


@dataclass(frozen=True)
class Note:
    """Something to record as an event; `sample` is the row that it happened at, None for the whole file."""

    level: Level
    message: str
    sample: int | None = None


@dataclass(frozen=True)
class QuantityColumns:
    """One quantity as the file has it."""

    values: FloatArray  # (N, n), in the file's units
    labels: tuple[str, ...]  # (n) the file's names of the columns
    units: tuple[str, ...]  # (n) the units that the file states; empty texts where it states none
    joints: tuple[str, ...] | None  # (n) names of the joints; None where the file has only an order
    magnitude: bool = False  # whether the file says that the values have lost their sign


@dataclass(frozen=True)
class ForeignTable:
    """A foreign file's content."""

    source: str  # kind of the file, in words
    time: FloatArray | None  # (N,) stamps in `time_unit`; None where the file has none
    time_unit: str  # as the file states it; empty where it doesn't
    quantities: Mapping[str, QuantityColumns]  # one of `ALIASES` of `daq.importers.naming` → its columns
    notes: tuple[Note, ...] = ()  # assumptions of the reader
    lines: npt.NDArray[np.int64] | None = None  # (N,) line number of each sample in a text file; None otherwise
    # (M,) stamps of the commands in `target_time_unit`; None where they have those of the samples
    target_time: FloatArray | None = None
    target_time_unit: str = ""  # as the file states it; empty where it doesn't
    unused: tuple[str, ...] = ()  # names of what was not understood


def printable(name: object, limit: int = 80) -> str:
    """A foreign name, fit for messages and HDF5 texts: control characters, NUL and lone surrogates become �."""
    text = "".join(character if character.isprintable() else "�" for character in str(name))
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def listed(names: object, limit: int = 12) -> str:
    """Names for a message, comma-separated, the tail counted instead of shown."""
    return first_few([printable(name) for name in names], limit)  # type: ignore[attr-defined]


def check_count(values: int, path: Path) -> None:
    """Refuse a file of more numbers than fit into memory, before they are read.

    Raises:
        ImportFileError: there are more than `MOST_VALUES`.
    """
    if values > MOST_VALUES:
        raise ImportFileError(
            f"holds {values / 1e6:.3g} million numbers; at most {MOST_VALUES / 1e6:g} million can be read",
            where=str(path),
            hint="split it into several files, or omit arrays that are not needed",
        )


@contextmanager
def parsing(path: Path, kind: str, hint: str = "") -> Iterator[None]:
    """Turn any exception of a library on a damaged file into an ImportFileError.

    The libraries behind the formats raise nearly anything on bytes that they don't expect (struct.error, KeyError,
    AssertionError, zlib.error, …); so keep to their calls and the least around them in this block.

    Raises:
        ImportFileError: in place of every exception but our own and MemoryError.
    """
    try:
        yield
    except (DynidError, MemoryError):
        raise
    except Exception as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error).strip()
        # `where` names the file already; without its path the reason fits on a line.
        for spelled in (repr(str(path)), str(path)):
            reason = reason.replace(spelled, "the file")
        first_line = printable(reason.splitlines()[0], limit=200) if reason else type(error).__name__
        raise ImportFileError(
            f"cannot be read as {kind}: {first_line}",
            where=str(path),
            hint=hint or "the file is damaged, truncated or of another kind; copy it again from its source",
        ) from error
