"""What a point of conformance asks for, and how it says that it does not get it."""

from __future__ import annotations

from collections.abc import Callable

from drivers.core.errors import DriverStateError, DynidError


class ConformanceError(AssertionError):
    """A driver does not keep a point."""


def require(kept: bool, otherwise: str) -> None:
    """Raise ConformanceError with these words unless something is kept."""
    if not kept:
        raise ConformanceError(otherwise)


def refused(action: Callable[[], object], when: str, to: str = "") -> None:
    """Require that an action raises DriverStateError in this state."""
    name = to or getattr(action, "__name__", "read").replace("<lambda>", "read")
    try:
        action()
    except DriverStateError as error:
        one_line(error)
    else:
        raise ConformanceError(f"{name} {when} raises no DriverStateError")


def one_line(error: DynidError) -> None:
    """Require that an error is one line for people."""
    require(bool(error.message) and "\n" not in str(error), f"its message is not one line: {error!s}")
    require(len(str(error)) < 400, f"its message is too long: {error!s}")
