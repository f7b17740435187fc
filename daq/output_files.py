"""Files that commands write: judged before anything is computed for them, written in one step."""

from __future__ import annotations

import errno
import glob
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from drivers.core.errors import DiskError, DynidError, DynidWarning, UsageError
from drivers.core.files import held_lock

RESULT_FILE = "result.json"
"""Name of a result in the folder that `identify` writes."""
REPORT_FILE = "report.html"
"""Name of the page beside it, and beside those of other experiments."""

DISK_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})
"""What a disk that is full, or fails, answers to a write that nothing else is wrong with."""

GENERATION_KEY = "files"
"""Key of a result's JSON object: the SHA-256 of each file that was written with it."""

OWN_HASH = "sha256"
"""Key of the object's own SHA-256, of what it says beside these two keys."""

_UNFINISHED = ".unfinished-"
_LARGEST_PAGE = 100_000_000  # bytes, far above any page that dynid writes
_LONGEST_STEM = 48  # characters, so that the name is not too long for any file system


_own: set[str] = set()
"""Outputs whose locks this process holds."""
_until_the_command_ends: ExitStack | None = None


@contextmanager
def outputs_of_a_command() -> Iterator[None]:
    """Until the context ends, the outputs that are checked in it are its own: no other program writes them."""
    global _until_the_command_ends
    with ExitStack() as stack:
        _until_the_command_ends = stack
        try:
            yield
        finally:
            _until_the_command_ends = None


@contextmanager
def only_writer(files: Iterable[Path]) -> Iterator[None]:
    """Hold the locks of outputs, those apart that this process holds already; its death releases them.

    Raises:
        UsageError: another program writes one of them.
    """
    with ExitStack() as stack:
        for path in files:
            key = os.path.realpath(path) if "\0" not in str(path) else ""
            if not key or key in _own:
                continue
            if not stack.enter_context(held_lock(f"output {key}")):
                raise UsageError(
                    "is being written by another dynid command",
                    where=str(path),
                    hint="wait until it has ended, or choose another name",
                )
            _own.add(key)
            stack.callback(_own.discard, key)
        yield


@contextmanager
def left_to_others() -> Iterator[None]:
    """Outputs that are checked in this context are not this process's own: a command that it starts writes them."""
    global _until_the_command_ends
    own, _until_the_command_ends = _until_the_command_ends, None
    try:
        yield
    finally:
        _until_the_command_ends = own


def _claim(files: Iterable[Path]) -> None:
    if _until_the_command_ends is not None:
        _until_the_command_ends.enter_context(only_writer(files))


def check_outputs(files: Iterable[Path | None], inputs: Iterable[Path | None] = (), *, overwrite: bool) -> None:
    """Check that files may be written, before anything is computed for them; a command's are its own from here on.

    Args:
        files: to be written; None for one that was not asked for.
        inputs: files that the same command reads, under whatever name or link; of a folder all files in it.
        overwrite: whether they may exist already.

    Raises:
        UsageError: one exists already, is an input or another output, is a link or no regular file, its folder
            is missing or not the user's, or another program writes it.
    """
    outputs = [path for path in files if path is not None]
    read = [file for path in inputs if path for file in (path.iterdir() if path.is_dir() else [path])]
    _claim(outputs)  # first: a file that another command writes may not exist yet
    for number, path in enumerate(outputs):
        exists = _regular_file(path)
        if any(_same(path, other) for other in outputs[:number]):
            raise UsageError("two outputs name the same file", where=str(path), hint="choose another name")
        if any(_same(path, other) for other in read):
            raise UsageError("is an input of this command", where=str(path), hint="choose another name for the output")
        if exists and not overwrite:
            raise UsageError(
                "exists already",
                where=str(path),
                hint="choose another name, or overwrite it: --force, in Python overwrite=True",
            )


def check_output_folder(
    folder: Path, names: Sequence[str], inputs: Iterable[Path | None] = (), *, overwrite: bool
) -> None:
    """Check that files of these names may be written into a folder, which is made where it does not exist.

    Raises:
        UsageError: the folder is a file, or as `check_outputs` does of the files.
    """
    _claim([folder])
    if folder.is_dir():
        check_outputs([folder / name for name in names], inputs, overwrite=overwrite)
        return
    if os.path.lexists(folder):
        raise UsageError("is a file; a folder is needed", where=str(folder))
    above = next(parent for parent in folder.absolute().parents if os.path.lexists(parent))
    _check_folder(above, str(above))
    _claim(folder / name for name in names)


def _same(path: Path, other: Path) -> bool:
    """Return whether two names lead to one file, by symbolic or hard links, whether it exists or not."""
    try:
        return path.samefile(other)
    except OSError:
        return os.path.realpath(path) == os.path.realpath(other)


def _regular_file(path: Path) -> bool:
    """Return whether a file exists; an error where its name cannot become a regular file."""
    where = str(path)
    try:
        mode = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        _check_folder(path.parent, str(path.parent))
        return False
    except (OSError, ValueError) as error:  # too long a name; a NUL in it
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(f"cannot be written: {reason}", where=where, hint="choose another name") from error
    if stat.S_ISDIR(mode):
        raise UsageError("is a folder; a file is needed", where=where, hint="name a file in it")
    if stat.S_ISLNK(mode):
        raise UsageError("is a link, which is not written through", where=where, hint="name the file itself")
    if not stat.S_ISREG(mode):
        raise UsageError("is not a regular file", where=where, hint="choose another name")
    _check_folder(path.parent, str(path.parent))
    return True


def _check_folder(folder: Path, where: str) -> None:
    if not folder.is_dir():
        said = "is not a folder" if os.path.lexists(folder) else "there is no such folder"
        raise UsageError(said, where=where, hint="create it, or choose another one")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError("is not writable by you", where=where, hint="choose another place")


def unfinished_name(path: Path) -> Path:
    """A name beside a file that is not foreseeable, and says whose it is: `run.unfinished-0f3a….h5` for `run.h5`.

    Create it exclusively, and let it take the file's place when it is whole.
    """
    return path.with_name(f"{_beginning(path)}{secrets.token_hex(8)}{path.suffix}")


def unfinished_files(path: Path) -> list[Path]:
    """Return what was to take a file's place and lies beside it: it is being written, or its writer was killed."""
    token = "[0-9a-f]" * 16
    return sorted(path.parent.glob(f"{glob.escape(_beginning(path))}{token}{glob.escape(path.suffix)}"))


def intended_name(path: Path) -> Path:
    """The file whose place an unfinished one was to take; any other file itself."""
    parts = re.fullmatch(rf"(.+){re.escape(_UNFINISHED)}[0-9a-f]{{16}}(\.[^.]+)?", path.name)
    return path.with_name(parts[1] + (parts[2] or "")) if parts else path


def _beginning(path: Path) -> str:
    return path.stem[:_LONGEST_STEM] + _UNFINISHED


def take_place(unfinished: Path, path: Path, *, overwrite: bool) -> None:
    """Give a file that is whole and on the disk its name; at every moment there is the old one or the new one.

    Raises:
        FileExistsError: there is one of that name by now, and it may not be overwritten.
        OSError: the system refuses; the file keeps its unfinished name.
    """
    if overwrite:
        unfinished.replace(path)
        return
    try:
        os.link(unfinished, path, follow_symlinks=False)  # unlike a renaming, it never replaces anything
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        unfinished.rename(path)
    else:
        unfinished.unlink()


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write text files by their names into a folder, which is made where it does not exist; all of them or none.

    A new folder appears with all its files at once, even where the writer is killed; in one that exists already the
    files are replaced as by `replace_files`. The first text, a JSON object, takes its place last, with the hashes of
    the others.

    Raises:
        UsageError: it is a file, cannot be written, or another program writes it.
        DiskError: the disk is full or fails.
    """
    first, *others = texts
    if others:
        texts = {**texts, first: with_hashes(texts[first], {name: texts[name] for name in others})}
    with only_writer([folder, *(folder / name for name in texts)]):
        if folder.is_dir():
            replace_files({folder / name: text for name, text in texts.items()})
        else:
            _new_folder(folder, texts)


def with_hashes(text: str, others: Mapping[str, str]) -> str:
    """The text of a JSON object with its SHA-256 and those of the files written with it, for `strange_files`."""
    if not text.startswith("{"):
        return text
    hashes = {OWN_HASH: content_hash(json.loads(text)), GENERATION_KEY: hashes_of(others)}
    return text.replace("{", f"{{\n {json.dumps(hashes)[1:-1]},", 1)


def content_hash(content: Mapping[str, object]) -> str:
    """SHA-256 of a JSON object without the hashes in it, the same for any order of its keys, and for 1, 1.0 and 1e0."""
    text = json.dumps({key: value for key, value in content.items() if key not in (OWN_HASH, GENERATION_KEY)})
    own = json.loads(text, parse_int=_number, parse_float=_number)
    return _hash(json.dumps(own, sort_keys=True).encode())


def _number(text: str) -> float:
    return float(text) + 0.0  # -0.0 becomes 0.0, which JavaScript writes for it


def was_changed(content: Mapping[str, object]) -> bool:
    """Whether a JSON object is another than dynid wrote; without its hash, it is taken as it is."""
    return OWN_HASH in content and content[OWN_HASH] != content_hash(content)


def hashes_of(texts: Mapping[str, str]) -> dict[str, str]:
    """Name → SHA-256 of a text as it is written."""
    return {name: _hash(content.encode()) for name, content in texts.items()}


def warn_of_strange_files(path: Path, content: Mapping[str, object]) -> None:
    """Warn (`DynidWarning`) of the files that `strange_files` finds."""
    for strange in strange_files(path, content):
        warnings.warn(
            f"{strange} was not written with {path.name}, or was changed: the command that wrote both may have been "
            "killed; run it again with --force",
            DynidWarning,
            stacklevel=3,
        )


def strange_files(path: Path, content: Mapping[str, object]) -> list[str]:
    """Files beside a JSON file that were not written with it: a writer was killed in between, or one was edited."""
    hashes = content.get(GENERATION_KEY)
    strange = []
    for name, written in hashes.items() if isinstance(hashes, dict) else ():
        file = path.with_name(Path(str(name)).name or "-")
        with suppress(OSError, ValueError):  # it was not copied along; a NUL in its name
            if file.is_file() and (file.stat().st_size > _LARGEST_PAGE or _hash(file.read_bytes()) != written):
                strange.append(str(file))
    return strange


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _new_folder(folder: Path, texts: Mapping[str, str]) -> None:
    beside = unfinished_name(folder)
    path = folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _remove_unfinished(folder)
        beside.mkdir()
        try:
            for name, text in texts.items():
                path = folder / name
                _write_new(beside / name, text)
            beside.rename(folder)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise
    except (FileExistsError, NotADirectoryError) as error:
        raise UsageError("is a file; a folder is needed", where=str(error.filename2 or error.filename)) from error
    except OSError as error:
        raise _refused(error, path) from error


_together: dict[Path, str] | None = None


@contextmanager
def written_together() -> Iterator[dict[Path, str]]:
    """Let the files that `replace_files` is given within the context be written at its end: all, or none on an error.

    The context is given their texts, path → text, the first one that which takes its place last.

    Raises:
        UsageError, DiskError: as `replace_files`, at the end.
    """
    global _together
    _together = {}
    try:
        yield _together
        texts, _together = _together, None
        if texts:
            replace_files(texts)
    finally:
        _together = None


def replace_files(texts: Mapping[Path, str]) -> None:
    """Write text files as UTF-8, all of them or none: an error before the end leaves the old ones.

    They are written beside their places and renamed when all are on the disk, the first one last; a link is replaced,
    not followed. A process killed between two renamings leaves the last files new and the first ones old; what it
    leaves unfinished, the next writer removes.

    Raises:
        UsageError: one cannot be written, or another program writes it.
        DiskError: the disk is full or fails.
    """
    for path in texts:
        if path.is_dir():
            raise UsageError("cannot be written: it is a folder", where=str(path))
    if _together is not None:
        _together.update(texts)
        return
    unfinished: dict[Path, Path] = {}
    path = next(iter(texts))
    with only_writer(texts):
        try:
            for path, text in texts.items():
                _remove_unfinished(path)
                beside = unfinished_name(path)
                unfinished[path] = beside
                _write_new(beside, text)
            with _old_files_kept(list(texts)[1:]):  # the one that is renamed last needs no way back
                for path in reversed(list(texts)):
                    unfinished[path].replace(path)
        except OSError as error:
            raise _refused(error, path) from error
        finally:
            for beside in unfinished.values():
                beside.unlink(missing_ok=True)


def _remove_unfinished(path: Path) -> None:
    """Remove what killed writers of this file or folder left; the holder of its lock is the only writer."""
    for beside in unfinished_files(path):
        if intended_name(beside) == path:  # a long name is cut, and may be another's
            if beside.is_dir() and not beside.is_symlink():
                shutil.rmtree(beside, ignore_errors=True)
            else:
                beside.unlink(missing_ok=True)


def _write_new(path: Path, text: str) -> None:
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


@contextmanager
def _old_files_kept(paths: Sequence[Path]) -> Iterator[None]:
    """Put files back where the context fails: the old ones, or none where there was none."""
    kept: dict[Path, Path | None] = {}
    try:
        for path in paths:
            kept[path] = None
            if os.path.lexists(path):
                beside = unfinished_name(path)
                kept[path] = beside
                try:
                    os.link(path, beside, follow_symlinks=False)
                except OSError:  # a file system without hard links
                    shutil.copy2(path, beside, follow_symlinks=False)
        try:
            yield
        except BaseException:
            for path, old in kept.items():
                if old is None:
                    path.unlink(missing_ok=True)
                else:
                    old.replace(path)
            raise
    finally:
        for old in kept.values():
            if old is not None:
                old.unlink(missing_ok=True)


def _refused(error: OSError, path: Path) -> DynidError:
    said = f"cannot be written: {error.strerror}"
    if error.errno in DISK_ERRORS:
        return DiskError(said, where=str(path))
    return UsageError(said, where=str(path), hint="name an existing folder that you may write to")
