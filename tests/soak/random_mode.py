"""pytest plugin of `make soak`: the suite's property tests in random order, each with many new examples, for a time.

    python -m pytest -p random_mode --hypothesis-profile=soak --hypothesis-seed=SEED --soak=SECONDS --soak-counts=FILE

Hypothesis keeps the examples that fail in .hypothesis/examples and tries them first in the next soak.
"""

from __future__ import annotations

import json
import random
import time
from pathlib import Path

import pytest
from hypothesis import is_hypothesis_test, settings

MORE = 10
"""So many times a test's own number of examples."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the line above."""
    parser.addoption("--soak", type=float, required=True, help="seconds; the test that runs then is the last")
    parser.addoption("--soak-counts", type=Path, required=True, help="JSON: tests that ran, tests that failed")


def pytest_configure(config: pytest.Config) -> None:
    """Begin."""
    config.pluginmanager.register(RandomMode(config), "random mode")


class RandomMode:
    """Choice and order of the tests, the end of the session and its counts."""

    def __init__(self, config: pytest.Config) -> None:
        self._end = time.monotonic() + config.getoption("--soak")
        self._counts = config.getoption("--soak-counts")
        self._order = random.Random(config.getoption("--hypothesis-seed"))
        self._ran = 0
        self._failed: list[str] = []

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep and shuffle the property tests; Hypothesis has no public way to change a test's number of examples."""
        items[:] = [item for item in items if isinstance(item, pytest.Function) and is_hypothesis_test(item.obj)]
        self._order.shuffle(items)
        for test in {getattr(item.obj, "__func__", item.obj) for item in items}:
            own = test._hypothesis_internal_use_settings
            test._hypothesis_internal_use_settings = settings(own, max_examples=MORE * own.max_examples)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count."""
        self._ran += report.when == "call" and not report.skipped
        if report.failed:
            self._failed.append(report.nodeid)

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        """End the session once the time is up."""
        if time.monotonic() > self._end:
            item.session.shouldstop = "the time is up"

    def pytest_sessionfinish(self) -> None:
        """Write the counts."""
        self._counts.write_text(json.dumps({"tests": self._ran, "failed": self._failed}))
