"""The C sources of this folder as a library, built once per computer where there is a C compiler.

It lies in the user's cache folder under a name that follows from the sources, the compiler, its options and the
processor. A build appears there by renaming alone, so that neither a second builder nor a killed one leaves half a
library. A library, or a folder above it, that another user could have written is never loaded. Without a library the
callers compute the same with NumPy and Pinocchio, equal but for rounding.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import stat
from contextlib import suppress
from ctypes import c_void_p
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray

SETTING = "DYNID_COMPILED"
"""Environment variable; 0 turns the library off."""

COMPILERS = ("cc", "gcc", "clang")

SOURCES = ("arm.h", "bodies.h", "dry_friction.h", "loops.h", "vectors.h", "rows.c", "servo.c", "stepping.c")

OPTIONS = ("-std=gnu11", "-O3", "-fno-math-errno", "-march=native", "-fPIC", "-shared", "-w")

LONGEST_BUILD = 120.0
"""[s]"""

ABANDONED = 3600.0
"""Age [s] at which a folder of a build that was killed is removed."""


@dataclass(frozen=True)
class Kernels:
    """The library, or why there is none."""

    quick: Any  # for calls of microseconds, which keep the interpreter's lock; None without a library
    long: Any  # for calls that let other threads run; None without a library
    said: str  # where it lies, or why there is none, for `dynid --version --verbose`


def address(array: np.ndarray[Any, Any]) -> int:
    """Return where an array's data begin; the caller keeps the array."""
    return int(array.ctypes.data)


@cache
def kernels() -> Kernels:
    """The library of this computer, built at the first call where it does not stand yet: a second or two."""
    if os.environ.get(SETTING) == "0":
        return Kernels(None, None, f"off ({SETTING}=0)")
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        return Kernels(None, None, f"none, since there is no C compiler ({', '.join(COMPILERS)})")
    if not hasattr(os, "getuid"):
        return Kernels(None, None, "none on this system")
    try:
        path = cache_folder() / f"kernels-{_fingerprint(compiler)}.so"
        if not path.exists():
            _build(compiler, path)
        _refuse_shared(path)
        return Kernels(ctypes.PyDLL(str(path)), ctypes.CDLL(str(path)), f"{path}, by {compiler}")
    except (OSError, RuntimeError) as error:  # of no consequence but for speed
        return Kernels(None, None, f"none: {error}")


def cache_folder() -> Path:
    """The folder of dynid in the user's cache folder, made where it is missing.

    Raises:
        OSError: it cannot be made, or another user could write to it or above it.
    """
    above = os.environ.get("XDG_CACHE_HOME", "")
    folder = (Path(above) if os.path.isabs(above) else Path.home() / ".cache").resolve() / "dynid"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    for place in (folder, *folder.parents):
        _refuse_shared(place)
    return folder


def _refuse_shared(path: Path) -> None:
    """Raise where another user, root aside, could write or replace a file or what a folder holds."""
    info = path.lstat()
    private = path.name == "dynid" or not stat.S_ISDIR(info.st_mode)
    theirs = info.st_uid != os.getuid() and (private or info.st_uid != 0)
    shared = info.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and (private or not info.st_mode & stat.S_ISVTX)
    if theirs or shared or stat.S_ISLNK(info.st_mode):
        raise OSError(f"another user could write to {path}")


def _fingerprint(compiler: str) -> str:
    import hashlib

    built_by = os.stat(compiler)
    parts = [os.path.realpath(compiler), str(built_by.st_size), str(built_by.st_mtime_ns), *OPTIONS, _processor()]
    parts += [Path(__file__).with_name(name).read_text(encoding="utf-8") for name in SOURCES]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]


def _processor() -> str:
    """Return what the instructions of a build depend on: a home folder may be that of several computers."""
    import platform

    with suppress(OSError), open("/proc/cpuinfo", encoding="utf-8") as lines:
        keys = ("flags", "Features", "model", "CPU part", "CPU implementer", "vendor_id", "cpu family")
        first = [line for line in iter(lines.readline, "\n") if line.split("\t")[0].strip() in keys]
        return platform.machine() + "".join(first)
    return platform.machine() + platform.processor()


def _build(compiler: str, path: Path) -> None:
    import subprocess
    import tempfile

    with tempfile.TemporaryDirectory(prefix="build-", dir=path.parent) as folder:
        now = os.stat(folder).st_mtime
        for left in path.parent.glob("build-*"):
            with suppress(OSError):
                if now - left.lstat().st_mtime > ABANDONED:
                    shutil.rmtree(left, ignore_errors=True)
        built = Path(folder) / path.name
        sources = [str(Path(__file__).with_name(name)) for name in SOURCES if name.endswith(".c")]
        try:
            subprocess.run(
                [compiler, *OPTIONS, "-o", str(built), *sources, "-lm"],
                check=True,
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=LONGEST_BUILD,
            )
        except subprocess.SubprocessError as error:
            raise RuntimeError(f"{compiler} could not build it ({error})") from error
        built.chmod(0o700)
        with open(built, "rb") as file:
            os.fsync(file.fileno())
        built.replace(path)


class Call:
    """Arrays of a call of the library, which live until it has ended."""

    def __init__(self) -> None:
        """Begin without arrays."""
        self._kept: list[Any] = []

    def given(self, array: FloatArray | IndexArray | None, kind: Any = np.float64) -> c_void_p:
        """The address of an array, which is copied if C could not read it; that of None is NULL."""
        if array is None:
            return c_void_p(None)
        self._kept.append(np.ascontiguousarray(array, dtype=kind))
        return c_void_p(address(self._kept[-1]))
