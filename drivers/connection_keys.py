"""Checking the keys of a connection in a robot file: every refusal says what was found and what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

from drivers.errors import UsageError


@dataclass(frozen=True)
class ConnectionKeys:
    """The checks of one kind of connection.

    Attributes:
        connection: how a refusal names it, such as "the RTDE connection".
    """

    connection: str

    def number(self, key: str, value: object, low: float, high: float, allowed: str) -> float:
        """A number from `low` to `high`; `allowed` says so in words.

        Raises:
            UsageError: it is something else.
        """
        if not is_number(value, low, high):
            raise self.wrong(key, value, allowed)
        return float(value)

    def whole(self, key: str, value: object, low: int, high: int, allowed: str) -> int:
        """A whole number from `low` to `high`; `allowed` says so in words.

        Raises:
            UsageError: it is something else.
        """
        if not is_whole(value, low, high):
            raise self.wrong(key, value, allowed)
        return value

    def wrong(self, key: str, value: object, allowed: str) -> UsageError:
        """The error of a key with a value that it cannot have; None for a key that is missing."""
        found = "is missing" if value is None else f"is {value!r}"
        return UsageError(f"key '{key}' of {self.connection} {found}", hint=f"allowed: {allowed}")


def is_number(value: object, low: float, high: float) -> TypeGuard[int | float]:
    """Whether it is a number, not a truth value, from `low` to `high`; what is not a number is in no range."""
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def is_whole(value: object, low: int, high: int) -> TypeGuard[int]:
    """Whether it is a whole number, not a truth value, from `low` to `high`."""
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
