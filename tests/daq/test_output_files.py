"""What may be written, and that it is written whole."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from daq.output_files import check_output_folder, check_outputs, replace_files, write_folder
from drivers.errors import DiskError, UsageError


def hard_link(path: Path, other: Path) -> None:
    path.hardlink_to(other)


def through_a_linked_folder(path: Path, other: Path) -> None:
    path.parent.rmdir()
    path.parent.symlink_to(other.parent)
    other.rename(other.with_name(path.name))


def itself(path: Path, other: Path) -> None:
    other.rename(path)


@pytest.mark.parametrize("make", [hard_link, through_a_linked_folder, itself])
@pytest.mark.parametrize("overwrite", [False, True])
def test_an_input_is_no_output_under_any_name(tmp_path: Path, make: Callable[[Path, Path], None], overwrite: bool):
    source, path = tmp_path / "in" / "run.h5", tmp_path / "out" / "other.h5"
    for file in (source, path):
        file.parent.mkdir()
    source.write_text("samples")
    make(path, source)
    known = next(file for file in (source, source.with_name(path.name), path) if file.exists())
    with pytest.raises(UsageError, match="is an input of this command"):
        check_outputs([path], [None, known], overwrite=overwrite)
    with pytest.raises(UsageError, match="is an input of this command"):
        check_outputs([path], [known.parent], overwrite=overwrite)


def test_what_exists_stays_unless_it_may_be_overwritten(tmp_path: Path):
    path = tmp_path / "a.yaml"
    check_outputs([path, None], overwrite=False)
    path.write_text("mine")
    with pytest.raises(UsageError, match=r"exists already.*--force"):
        check_outputs([path], overwrite=False)
    check_outputs([path], [tmp_path / "missing"], overwrite=True)


def fifo(path: Path) -> None:
    os.mkfifo(path)


def dangling(path: Path) -> None:
    path.symlink_to("nothing")


def linked(path: Path) -> None:
    path.with_name("there").write_text("mine")
    path.symlink_to("there")


@pytest.mark.parametrize(
    ("make", "said"),
    [(fifo, "not a regular file"), (dangling, "is a link"), (linked, "is a link"), (Path.mkdir, "is a folder")],
)
def test_only_regular_files_are_written(tmp_path: Path, make: Callable[[Path], None], said: str):
    make(tmp_path / "a")
    for overwrite in (False, True):
        with pytest.raises(UsageError, match=said):
            check_outputs([tmp_path / "a"], overwrite=overwrite)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nowhere/a", "nowhere: there is no such folder"),
        ("file/a", "file: is not a folder"),
        ("a" * 300, "cannot be written"),
        ("a\0b", "cannot be written"),
    ],
)
def test_a_place_that_does_not_exist(tmp_path: Path, name: str, said: str):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=said):
        check_outputs([tmp_path / name], overwrite=True)


def test_two_outputs_are_two_files(tmp_path: Path):
    (tmp_path / "link").symlink_to(tmp_path)
    with pytest.raises(UsageError, match="same file"):
        check_outputs([tmp_path / "a", tmp_path / "link" / "a"], overwrite=True)


def test_a_folder_is_judged_by_the_files_that_it_will_hold(tmp_path: Path):
    folder = tmp_path / "new" / "deeper"
    check_output_folder(folder, ["a", "b"], overwrite=False)
    write_folder(folder, {"a": "1", "b": "2"})
    with pytest.raises(UsageError, match="exists already"):
        check_output_folder(folder, ["b"], overwrite=False)
    with pytest.raises(UsageError, match="is an input"):
        check_output_folder(folder, ["a"], [folder / "a"], overwrite=True)
    check_output_folder(folder, ["c"], overwrite=False)
    for file in (folder / "a", folder / "a" / "deeper"):
        with pytest.raises(UsageError, match=r"is a file; a folder is needed|is not a folder"):
            check_output_folder(file, ["c"], overwrite=True)
        with pytest.raises(UsageError, match="is a file; a folder is needed"):
            write_folder(file, {"c": ""})


def test_all_files_are_written_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("old")
    synced = []

    def full(descriptor: int) -> None:
        synced.append(descriptor)
        if len(synced) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DiskError, match="second: cannot be written: No space left on device"):
        replace_files({first: "new", second: "new"})
    assert first.read_text() == "old"
    assert sorted(tmp_path.iterdir()) == [first]


def test_neither_a_link_nor_a_second_name_is_written_through(tmp_path: Path):
    mine, link, second = tmp_path / "mine", tmp_path / "link", tmp_path / "second"
    mine.write_text("mine")
    link.symlink_to(mine)
    second.hardlink_to(mine)
    replace_files({link: "new", second: "new"})
    assert mine.read_text() == "mine"
    assert link.read_text() == second.read_text() == "new"
    assert not link.is_symlink()
