"""A study's seeds one after the other, or on the workers of a Dask cluster: `SCHEDULER=tcp://host:8786`.

Workers are started in this repository's folder, where they find the study. Results come in the order of the cases, and
do not depend on the number of workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from drivers.core.cluster import cluster_executor

_Result = TypeVar("_Result")


def of_cases(function: Callable[..., _Result], cases: Sequence[tuple[Any, ...]]) -> Iterator[_Result]:
    """The function's result for the arguments of each case; with a scheduler both are pickled."""
    if scheduler := os.environ.get("SCHEDULER"):
        with cluster_executor(scheduler) as executor:
            yield from executor.map(function, *zip(*cases, strict=True))
    else:
        yield from (function(*case) for case in cases)
