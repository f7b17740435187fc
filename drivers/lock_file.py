"""A lock that one program on this computer holds at a time; the system releases it when the program dies."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def held_lock(key: str) -> Iterator[bool]:
    """Hold the lock of a name; false where it is held already. Computers without `flock` have no locks.

    Args:
        key: what is locked; programs with one folder for temporary files share it.

    Raises:
        OSError: there is no place for temporary files.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield True
        return
    name = hashlib.sha256(key.encode(errors="surrogateescape")).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"dynid-{name}.lock"
    while True:
        descriptor = _opened(path)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            yield False
            return
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                break
        os.close(descriptor)  # its last holder has removed it meanwhile
    try:
        yield True
    finally:
        with suppress(OSError):  # another user's, in a folder where such files stay
            path.unlink()
        os.close(descriptor)


def _opened(path: Path) -> int:
    with suppress(PermissionError):  # another user's, in a folder where such files are not created over
        return os.open(path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
    return os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
