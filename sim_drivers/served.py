"""What every simulated device is to `dynid sim`, whatever its bus."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Protocol, Self


class Served(Protocol):
    """A simulated device on any bus; entering its context starts it, leaving stops it.

    Attributes:
        messages: for the terminal, oldest first.
        failure: the error that ended it; None while it runs.
    """

    messages: deque[str]

    @property
    def failure(self) -> BaseException | None: ...  # noqa: D102

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def ready(self) -> Mapping[str, object]:
        """Address for clients; known once started."""

    def live_line(self) -> str:
        """Its state in one line."""

    def obey(self, line: str) -> None:
        """Cause a fault as a person types it.

        Raises:
            UsageError: not a fault.
        """
