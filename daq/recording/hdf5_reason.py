"""The reason of an HDF5 failure, in one sentence."""

from __future__ import annotations

import re

_SYSTEM_REASON = re.compile(r"error message = '([^']+)'")  # how HDF5 wraps what the system said


def hdf5_reason(error: BaseException) -> str:
    """The first sentence of an HDF5 or system error."""
    text = str(getattr(error, "strerror", None) or error).strip().strip("'\"")
    system = _SYSTEM_REASON.search(text)
    if system is not None:
        return system[1]
    return text.splitlines()[0] if text else type(error).__name__
