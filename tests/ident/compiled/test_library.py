"""Building and loading the compiled kernels; a program that copies the library takes the compiler's place."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from ident.compiled import library

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners of files here")

fresh = library.kernels.__wrapped__


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache folder, and a compiler that copies what stands already."""
    built = tmp_path / "built.so"
    found = library.kernels().said.split(", by ")
    if len(found) == 2:
        shutil.copy(found[0], built)
    else:
        built.write_bytes(b"no library")
    compiler = tmp_path / "cc"
    compiler.write_text(f'#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done\ncp "{built}" "$2"\n')
    compiler.chmod(0o700)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(library.SETTING, raising=False)
    return tmp_path / "cache" / "dynid"


needs_library = pytest.mark.skipif(library.kernels().quick is None, reason=library.kernels().said)


@needs_library
def test_many_builders_at_once_leave_one_library_and_remove_what_a_killed_one_left(cache) -> None:
    killed, running = cache / "build-killed", cache / "build-running"
    for left in (killed, running):
        left.mkdir(parents=True)
    os.utime(killed, (0, 0))
    cache.chmod(0o700)
    with ThreadPoolExecutor(4) as threads:
        loaded = list(threads.map(lambda _: fresh(), range(4)))
    assert all(one.quick is not None and one.said.startswith(str(cache)) for one in loaded)
    assert sorted(path.name for path in cache.iterdir())[0] == "build-running"
    assert len(list(cache.iterdir())) == 2


@needs_library
def test_what_another_user_could_have_written_is_not_loaded(cache) -> None:
    path = next(path for path in [fresh()] and cache.iterdir())
    for shared, mode in ((path, 0o722), (cache, 0o770), (cache.parent, 0o777)):
        before = shared.stat().st_mode
        shared.chmod(mode)
        refused = fresh()
        assert refused.quick is None
        assert refused.said == f"none: another user could write to {shared}"
        shared.chmod(before)
    moved = path.rename(path.with_suffix(".moved"))
    path.symlink_to(moved)
    assert fresh().quick is None
    path.unlink()
    moved.rename(path)
    assert fresh().quick is not None


def test_without_a_compiler_or_with_a_bad_one_there_is_no_library(cache, monkeypatch) -> None:
    (cache.parents[1] / "built.so").write_bytes(b"no library")
    assert fresh().quick is None
    shutil.rmtree(cache)
    (cache.parents[1] / "cc").write_text("#!/bin/sh\nexit 1\n")
    assert "could not build it" in fresh().said
    monkeypatch.setenv("PATH", "")
    assert fresh().said == "none, since there is no C compiler (cc, gcc, clang)"
    monkeypatch.setenv(library.SETTING, "0")
    assert fresh().said == "off (DYNID_COMPILED=0)"


def test_a_locale_that_is_not_utf_8_keeps_no_command_from_starting() -> None:
    ascii_locale = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = "from ident.compiled.library import kernels; kernels()"
    done = subprocess.run([sys.executable, "-c", code], env=ascii_locale, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
