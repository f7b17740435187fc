"""A method of `--method`: its options, its equations and how its estimator is built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from pydantic import AfterValidator

from drivers.core.ranges import Range
from ident.estimators.estimator import Equations, Estimator, Setup

Options = TypeVar("Options")


@dataclass(frozen=True)
class NoOptions:
    """Options of a method that has none."""


@dataclass(frozen=True)
class Method(Generic[Options]):
    """A method; every module of `ident.estimators.methods` holds one as METHOD and is named after it."""

    summary: str  # what it does, in one line
    equations: Equations  # that it solves
    # frozen dataclass; each field has a type that pydantic validates, a description and a default
    options: type[Options]
    estimator: Callable[[Options, Setup], Estimator]  # builds it for the data
    # names of papers for some of its options, as `--method` takes them
    aliases: Mapping[str, str] = field(default_factory=dict)


def within(allowed: Range) -> AfterValidator:
    """Validator of an option: refuses numbers out of a range."""

    def check(value: float | None) -> float | None:
        if value is not None and not allowed.holds(value):
            raise ValueError(f"{value:g} is not within {allowed}")
        return value

    return AfterValidator(check)
