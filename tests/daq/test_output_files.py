"""What may be written, and that it is written whole."""

from __future__ import annotations

import errno
import itertools
import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from each import each
from file_faults import deaths, fault_at

from daq.output_files import (
    check_output_folder,
    check_outputs,
    intended_name,
    left_to_others,
    outputs_of_a_command,
    replace_files,
    strange_files,
    take_place,
    unfinished_files,
    unfinished_name,
    was_changed,
    with_hashes,
    write_folder,
    written_together,
)
from drivers.core.errors import DiskError, UsageError
from drivers.core.files import held_lock


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


def test_files_of_several_steps_are_written_at_their_end_or_not_at_all(tmp_path: Path):
    first, second = tmp_path / "arm.urdf", tmp_path / "arm.c"

    def half() -> None:
        with written_together():
            replace_files({first: "new"})
            raise UsageError("is no covariance")

    with pytest.raises(UsageError, match="no covariance"):
        half()
    assert list(tmp_path.iterdir()) == []
    with written_together():
        replace_files({first: "new"})
        replace_files({second: "new"})
        assert list(tmp_path.iterdir()) == []
    assert contents(tmp_path) == {"arm.urdf": "new", "arm.c": "new"}
    replace_files({first: "newer"})
    assert first.read_text() == "newer"


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()} if folder.is_dir() else {}


TEXTS = {"result.json": "new result", "report.html": "new report"}
STATES = [{}, {"result.json": "old result"}, {"report.html": "old report"}, {name: f"old {name}" for name in TEXTS}]


@pytest.mark.parametrize("fault", [OSError(errno.EIO, os.strerror(errno.EIO)), KeyboardInterrupt()])
@pytest.mark.parametrize("state", [None, *STATES])
def test_files_of_a_folder_appear_together_or_not_at_all(
    tmp_path: Path, state: dict[str, str] | None, fault: BaseException
):
    """Whatever step fails; an error of the system that is no refusal of the user's."""

    def fail() -> None:
        raise fault

    ends = set()
    for number in itertools.count():
        folder = tmp_path / str(number) / "run"
        if state is not None:
            folder.mkdir(parents=True)
            replace_files({folder / name: text for name, text in state.items()} | {folder / "mine": "my own"})
        before = contents(folder)
        with fault_at(number, fail, ("mkdir", "fsync", "link", "replace", "rename")) as steps:
            try:
                write_folder(folder, TEXTS)
            except (DiskError, KeyboardInterrupt):
                assert contents(folder) == before
                ends.add("old")
            else:
                assert contents(folder) == before | TEXTS
                ends.add("new")
        assert [path for path in tmp_path.rglob("*") if ".unfinished-" in path.name] == []
        if len(steps) <= number:
            break
    assert ends == {"old", "new"}


@pytest.mark.parametrize("state", [None, *STATES])
def test_a_death_leaves_whole_files_and_others_that_say_what_they_are(tmp_path: Path, state: dict[str, str] | None):
    folder = tmp_path / "run"
    before = {} if state is None else state

    def prepare() -> None:
        for other in tmp_path.iterdir():
            assert other == folder or ".unfinished-" in other.name
            shutil.rmtree(other)
        if state is not None:
            folder.mkdir()
            for name, text in state.items():
                (folder / name).write_text(text)

    prepare()
    ends = set()
    for _ in deaths(lambda: write_folder(folder, TEXTS)):
        found = {name: text for name, text in contents(folder).items() if ".unfinished-" not in name}
        assert found in (before, before | {"report.html": "new report"}, before | TEXTS)
        if state is None:  # a new folder appears with all its files
            assert found in ({}, TEXTS)
        ends.add(tuple(sorted(found.values())))
        prepare()
    assert len(ends) > (state is not None)
    assert contents(folder) == before | TEXTS


def test_files_of_two_generations_are_told_and_the_next_writer_heals_them(tmp_path: Path):
    folder = tmp_path / "model"
    old, new = ({"result.json": f'{{"of": "{age}"}}', "report.html": age} for age in ("old", "new"))

    def strange() -> list[str]:
        path = folder / "result.json"
        return strange_files(path, json.loads(path.read_text()))

    write_folder(folder, old)
    told = set()
    for _ in deaths(lambda: write_folder(folder, new)):
        generations = json.loads((folder / "result.json").read_text())["of"], (folder / "report.html").read_text()
        assert strange() == ([] if len(set(generations)) == 1 else [str(folder / "report.html")])
        told.add(generations)
        write_folder(folder, old)
        assert strange() == []
        assert sorted(contents(folder)) == ["report.html", "result.json"]
    assert told == {("old", "old"), ("old", "new"), ("new", "new")}
    (folder / "report.html").unlink()  # not copied along
    assert strange() == []
    os.mkfifo(folder / "report.html")
    assert strange() == []


def javascript(number: str) -> float:
    """As `JSON.parse` and `JSON.stringify` give it back: whole numbers without a point, no negative zero."""
    value = float(number)
    return int(value) if value.is_integer() else value


def test_a_result_saved_again_is_the_same_and_one_with_another_value_is_not():
    text = json.dumps({"b": [1.0, -0.0, 0.1, 1e300, 1e-7, 3], "a": {"é\ud800": True, "z": None}, "1": "1.0"})
    written = with_hashes(text, {"report.html": "page"})
    content = json.loads(written, parse_float=javascript)
    backwards = dict(reversed(content.items()))
    for order, ascii_only, own in itertools.product((False, True), (False, True), (json.loads(written), backwards)):
        again = json.loads(json.dumps(own, sort_keys=order, ensure_ascii=ascii_only))
        assert not was_changed(again)
        for change in ({"b": content["b"][::-1]}, {"1": 1.0}, {"a": {}}, {"c": 0}, {"sha256": None}):
            assert was_changed(again | change), change
    assert not was_changed(json.loads(text))


def test_an_output_that_another_program_writes_is_refused_until_that_is_dead(tmp_path: Path):
    path, other = tmp_path / "new" / "result.json", tmp_path / "other"
    held, held_end = os.pipe()
    process = os.fork()
    if process == 0:
        with outputs_of_a_command():
            check_output_folder(path.parent, [path.name], overwrite=True)
            os.write(held_end, b"x")
            signal.pause()
    os.read(held, 1)
    for write in (
        lambda: check_output_folder(path.parent, [path.name], overwrite=True),
        lambda: check_output_folder(path.parent, ["friction.json"], overwrite=True),
        lambda: write_folder(path.parent, {path.name: "{}"}),
    ):
        with pytest.raises(UsageError, match="is being written by another dynid command"), outputs_of_a_command():
            write()
    assert not path.parent.exists()
    replace_files({other: "mine"})
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    with outputs_of_a_command():
        check_outputs([other], overwrite=True)
        write_folder(path.parent, {path.name: "{}"})
        replace_files({other: "its own"})
    assert other.read_text() == "its own"


def test_a_file_takes_its_place_without_replacing_one_that_came_meanwhile(tmp_path: Path, monkeypatch):
    def unsupported(*_: object, **__: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    path = tmp_path / "run.h5"
    for _ in range(2):  # with hard links, and on a file system without them
        beside = unfinished_name(path)
        beside.write_text("new")
        take_place(beside, path, overwrite=False)
        assert contents(tmp_path) == {"run.h5": "new"}
        later = unfinished_name(path)
        later.write_text("later")
        with pytest.raises(FileExistsError):
            take_place(later, path, overwrite=False)
        assert contents(tmp_path) == {"run.h5": "new", later.name: "later"}
        take_place(later, path, overwrite=True)
        assert contents(tmp_path) == {"run.h5": "later"}
        path.unlink()
        monkeypatch.setattr(os, "link", unsupported)


@each("name", ["run.h5", "run", "a.b.h5", "[x]*?.h5", "ü" * 120 + ".h5", ".h5"])
def test_an_unfinished_file_says_whose_place_it_was_to_take(tmp_path: Path, name: str):
    path = tmp_path / name
    found = [unfinished_name(path) for _ in range(2)]
    for beside in found:
        beside.touch()
    (tmp_path / f"other{path.suffix}").touch()
    unfinished_name(tmp_path / f"other{path.suffix}").touch()
    assert unfinished_files(path) == sorted(found)
    assert intended_name(path) == path
    if len(name) < 48:
        assert {intended_name(beside) for beside in found} == {path}


def test_what_a_command_leaves_to_another_one_can_be_written_by_it(tmp_path: Path) -> None:
    """`dynid demo` leaves its recordings to the `dynid record` that it starts."""
    with outputs_of_a_command():
        with left_to_others():
            check_outputs([tmp_path / "run.h5"], overwrite=False)
        check_outputs([tmp_path / "report.html"], overwrite=False)
        for name, free in (("run.h5", True), ("report.html", False)):
            with held_lock(f"output {os.path.realpath(tmp_path / name)}") as held:
                assert held == free
