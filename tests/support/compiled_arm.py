"""C code of an arm, compiled by the system's C compiler and called from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion")


def compile_c(source: Path, output: Path, *options: str, compiler: str = "cc") -> None:
    """Compile with every warning an error; skips where there is no compiler."""
    if shutil.which(compiler) is None:
        pytest.skip(f"no C compiler: '{compiler}' is not there")
    strict = STRICT if compiler == "cc" else ("-Wall", "-Wextra", "-Werror", "-pedantic")
    done = subprocess.run(
        [compiler, *strict, *options, str(source), "-o", str(output), "-lm"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def self_test(source: Path, prefix: str) -> subprocess.CompletedProcess[str]:
    """Build and run the self-test of a source file."""
    program = source.with_suffix(".test")
    compile_c(source, program, f"-D{prefix.upper()}_SELF_TEST")
    return subprocess.run([str(program)], capture_output=True, text=True)


class CompiledArm:
    """The functions of a source file, on arrays (N, n)."""

    def __init__(self, source: Path, prefix: str, real: type = np.float64) -> None:
        library = source.with_suffix(".so")
        compile_c(source, library, "-shared", "-fPIC")
        self._library, self._prefix, self._real = ctypes.CDLL(str(library)), prefix, real

    def __call__(self, function: str, inputs: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
        """Outputs (N, *shape)."""
        call = getattr(self._library, f"{self._prefix}_{function}")
        call.restype = None
        rows = [np.ascontiguousarray(values, dtype=self._real) for values in inputs]
        outputs = np.full((len(rows[0]), *shape), np.nan, dtype=self._real)
        for sample, output in enumerate(outputs):
            call(
                *(row[sample].ctypes.data_as(ctypes.c_void_p) for row in (*rows,)),
                output.ctypes.data_as(ctypes.c_void_p),
            )
        return outputs

    def in_place(self, inputs: Sequence[np.ndarray], target: int) -> np.ndarray:
        """Torque of one state (n,), written over input number `target`."""
        rows = [np.array(values, dtype=self._real) for values in inputs]
        call = getattr(self._library, f"{self._prefix}_torque")
        call.restype = None
        call(*(row.ctypes.data_as(ctypes.c_void_p) for row in (*rows, rows[target])))
        return rows[target]
