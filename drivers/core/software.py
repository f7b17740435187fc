"""Versions of the software that writes a file."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version


def software_versions() -> dict[str, str]:
    """Versions of Python, dynid and its numerical libraries; 'unknown' for one that is not installed as a package."""
    return dict(_versions())


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    versions = [("python", platform.python_version())]
    for package in ("dynid", "numpy", "scipy", "h5py", "pin"):
        try:
            versions.append((package, version(package)))
        except PackageNotFoundError:
            versions.append((package, "unknown"))
    return tuple(versions)
