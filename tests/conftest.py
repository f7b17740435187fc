"""Fixtures that all tests share."""

from __future__ import annotations

import functools
import gc
import hashlib
import importlib.metadata
import math
import os
import pickle
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from _pytest.assertion import rewrite
from hypothesis import HealthCheck, settings
from hypothesis.database import DirectoryBasedExampleDatabase
from hypothesis.internal.conjecture import providers
from simulated_clock import SimulatedClock, simulated_time

from drivers.core import reading_process
from drivers.core.clock import Clock

if TYPE_CHECKING:
    import typer

    from drivers.core.arrays import FloatArray
    from ident.model.regressor import RegressorKernel

FrictionSearch = dict[str, Callable[..., bool]]
"""The methods of an identification's choices that begin the search for friction terms and pre-sliding, by name."""

REPOSITORY = Path(__file__).resolve().parents[1]
READ_APART = ("drivers/core", "found")
"""Rooms whose tests read files in a process of their own; elsewhere, those that are marked `reads_apart`."""

# "ci", the default, draws the same examples in every run; "soak" (`make soak`) new ones, and keeps those that fail.
# A busy computer makes any single example slow: time is no property that a test of values may fail by.
UNTIMED = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("ci", derandomize=True, database=None, max_examples=25, **UNTIMED)
settings.register_profile(
    "soak",
    derandomize=False,
    database=DirectoryBasedExampleDatabase(REPOSITORY / ".hypothesis" / "examples"),
    **UNTIMED,
)
settings.load_profile("ci")

# Which packages are installed changes in no test: to ask takes 8 ms, and each command and each connection asks.
importlib.metadata.entry_points = functools.cache(importlib.metadata.entry_points)

# Collection makes millions of objects and loses none: looking for garbage takes a third of its time.
gc.disable()

# A shell's background job ignores Ctrl-C, and so would all programs that tests start and end by it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Keep Hypothesis from drawing constants of the modules imported so far: examples would depend on earlier tests."""
    if config.getoption("--hypothesis-profile") != "soak":
        providers._get_local_constants = lambda: providers._local_constants


def pytest_collection(session: pytest.Session) -> None:
    """In a fresh clone, let the second worker begin with the last module, while the first one collects.

    To rewrite asserts takes half of a first collection; what a worker has written the other one only reads.
    """
    if os.environ.get("PYTEST_XDIST_WORKER") != "gw1" or sys.dont_write_bytecode:
        return
    for path in sorted(REPOSITORY.glob("tests/**/test_*.py"), reverse=True):
        folder = rewrite.get_cache_dir(path)
        if not (cached := folder / f"{path.stem}{rewrite.PYC_TAIL}").exists() and rewrite.try_makedirs(folder):
            source, code = rewrite._rewrite_test(path, session.config)
            rewrite._write_pyc(session.config.stash[rewrite.assertstate_key], code, source, cached)


def pytest_collection_finish() -> None:
    """Look for garbage again, but never among the tests: 0.4 s each time, also in each process that a reader forks.

    A recorder unfreezes when it ends, and would so unfreeze the tests, too.
    """
    gc.freeze()
    gc.unfreeze = lambda: None
    gc.enable()
    gc.set_threshold(
        50_000, 20, 50
    )  # objects; after each 700, and through all after each 70,000, takes 3 % of all time


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Read files in a process of their own where that is what is tested, and any file that is drawn anew.

    To copy the process that has imported everything takes both of them 50 ms, once or twice for each command.
    """
    drawn = item.config.getoption("--hypothesis-profile") == "soak"
    marked = item.get_closest_marker("reads_apart") is not None
    reading_process.APART = drawn or marked or any(item.nodeid.startswith(f"tests/{room}/") for room in READ_APART)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings (`DYNID_DATA`, default ../shared/data); skips where it is missing."""
    folder = Path(os.environ.get("DYNID_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}; set DYNID_DATA")
    return folder


@dataclass(frozen=True)
class Simulated:
    """How much of the held-out motion an identification simulates: the longest stretch [s], and the windows."""

    longest: float
    windows: int


@pytest.fixture(scope="session", autouse=True)
def short_simulations() -> Iterator[Simulated]:
    """Simulate little after each identification, or it takes most of its time; what dynid itself simulates."""
    from ident.simulation import open_loop, tracking

    with pytest.MonkeyPatch.context() as patch:
        whole = Simulated(tracking.LONGEST, open_loop.WINDOWS)
        patch.setattr(tracking, "LONGEST", 0.5)
        patch.setattr(open_loop, "WINDOWS", 1)
        yield whole


@pytest.fixture(scope="session", autouse=True)
def motions_judged_once() -> Iterator[None]:
    """Judge each random motion of an arm once: tests draw the same ones, which takes most of a simulated recording."""
    from sim_drivers.synthetic import measurement

    factor, condition = measurement.motion_factor, measurement.scaled_condition
    known: dict[bytes, float] = {}

    def once(kernel: RegressorKernel, *motion: FloatArray) -> float:
        key = hashlib.sha256(pickle.dumps((kernel.model, kernel.columns, motion))).digest()
        if key not in known:
            known[key] = condition(factor(kernel, *motion))
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measurement, "motion_factor", once)
        patch.setattr(measurement, "scaled_condition", lambda judged: judged)
        yield


@pytest.fixture(scope="session", autouse=True)
def command_line_built_once() -> Iterator[None]:
    """Put the command line together once for all tests that call it in this process: 40 ms each time otherwise."""
    from typer import main

    from dynid import command

    build, built = command.build_app, functools.cache(main.get_command)
    apps: dict[tuple[object, ...], typer.Typer] = {}

    def build_once(word: str = "") -> typer.Typer:
        entries = tuple(command.entry_points(group=command.COMMANDS_GROUP))
        if entries not in apps:
            apps[entries] = build()
        return apps[entries]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "build_app", build_once)
        patch.setattr(main, "get_command", built)
        yield


@pytest.fixture
def whole_simulations(short_simulations: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate as much as dynid does."""
    from ident.simulation import open_loop, tracking

    monkeypatch.setattr(tracking, "LONGEST", short_simulations.longest)
    monkeypatch.setattr(open_loop, "WINDOWS", short_simulations.windows)


def _leave_out_checks(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("ident.identify.identify.identification_checks", lambda *_: [])
    patch.setattr("ident.identify.held_out.track_longest", lambda *_: (None, "left out by this test"))
    patch.setattr("ident.identify.held_out.open_loop", lambda *_: None)


@pytest.fixture(scope="module")
def estimates_alone() -> Iterator[None]:
    """Identify without what follows the estimate and takes half of the time: the checks, and the simulated motion.

    For a module whose tests look at parameters, their errors and torques only; `with_checks` takes it back.
    """
    with pytest.MonkeyPatch.context() as patch:
        _leave_out_checks(patch)
        yield


@pytest.fixture
def estimate_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do the same as `estimates_alone` for a single test."""
    _leave_out_checks(monkeypatch)


@pytest.fixture
def with_checks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Identify as dynid does, in a module of `estimates_alone`."""
    from ident.identify.checks.checks import identification_checks
    from ident.simulation.open_loop import open_loop
    from ident.simulation.tracking import track_longest

    monkeypatch.setattr("ident.identify.identify.identification_checks", identification_checks)
    monkeypatch.setattr("ident.identify.held_out.track_longest", track_longest)
    monkeypatch.setattr("ident.identify.held_out.open_loop", open_loop)


@pytest.fixture(scope="module")
def not_simulated() -> Iterator[None]:
    """Identify without the simulated motion: for a module whose tests look at the checks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ident.identify.held_out.track_longest", lambda *_: (None, "left out by this test"))
        patch.setattr("ident.identify.held_out.open_loop", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def mistakes_not_sought() -> Iterator[None]:
    """Identify without the search for wrong signs, columns, gains and lengths, a third to most of what is left then.

    For a module whose tests look at other checks, or at what is made of a result.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ident.identify.checks.checks._mistake_checks", lambda _: [])
        yield


@pytest.fixture(scope="module")
def stated_friction() -> Iterator[FrictionSearch]:
    """Identify with the friction that the robot file has; the search for more takes two fifths of an estimate's time.

    For a module in which other terms, and pre-sliding, are not what is tested; `with_friction_search` takes it back.
    """
    from ident.identify.identification import IdentifyChoices

    with pytest.MonkeyPatch.context() as patch:
        whole: FrictionSearch = {
            "chooses_friction": IdentifyChoices.chooses_friction,
            "finds_travels": IdentifyChoices.finds_travels,
        }
        patch.setattr(IdentifyChoices, "chooses_friction", lambda self, _: self.model.friction == "auto")
        patch.setattr(IdentifyChoices, "finds_travels", lambda *_: False)
        yield whole


@pytest.fixture
def with_friction_search(stated_friction: FrictionSearch, monkeypatch: pytest.MonkeyPatch) -> None:
    """Choose friction as dynid does, in a module of `stated_friction`."""
    from ident.identify.identification import IdentifyChoices

    for name, function in stated_friction.items():
        monkeypatch.setattr(IdentifyChoices, name, function)


@pytest.fixture
def clock() -> Iterator[SimulatedClock]:
    """Simulated time, see tests/support/simulated_clock.py."""
    with simulated_time() as clock:
        yield clock


@pytest.fixture
def run_dynid(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Calls the command with arguments in this process: exit status, standard output, standard error."""
    import command_line

    return functools.partial(command_line.run, monkeypatch, capsys)


@pytest.fixture(autouse=True)
def no_progress_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standard error has no line about a step that is slow because this computer is busy."""
    monkeypatch.setattr("daq.commands.console.SLOW_STEP", math.inf)


@pytest.fixture(autouse=True)
def no_real_time(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse to wait in real time, or to start a thread there, in a test that is not marked `realtime`."""
    if request.node.get_closest_marker("realtime") is not None:
        return

    def refuse(*_: object) -> None:
        raise AssertionError("this test waits in real time: give a simulated clock to all that takes one")

    for name in ("sleep_until", "thread", "_select"):
        monkeypatch.setattr(Clock, name, refuse)
