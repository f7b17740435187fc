"""The toy driver of docs/drivers.md keeps every point; spoilt in one way, it fails that point by name."""

from __future__ import annotations

import re
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daq.robot.loader import parse_robot
from drivers import declaration
from dynid import command
from dynid.testing import POINTS, Bench, ConformanceError, DriverConformance, check_point, declared_bench
from sim_drivers import new_driver
from sim_drivers.new_driver.write import driver_files

PAGE = Path(__file__).resolve().parents[3] / "docs" / "drivers.md"
SKELETON = Path(new_driver.__file__).with_name("skeleton")


@pytest.fixture(autouse=True, scope="module")
def toy() -> Iterator[SimpleNamespace]:
    """The skeleton as it is written, importable, its driver not installed but declared."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SKELETON))
        patch.setattr(sys, "dont_write_bytecode", True)
        driver, declares = import_module("toy_bus.driver"), import_module("toy_bus.declaration")
        install(patch, declares.DECLARATION)
        yield SimpleNamespace(driver=driver, declaration=declares.DECLARATION)


def install(patch: pytest.MonkeyPatch, declared: declaration.DriverDeclaration) -> None:
    entry = SimpleNamespace(name="toy_bus", value="toy_bus", load=lambda: declared)
    patch.setattr(declaration, "entry_points", lambda group: [entry])


def bench() -> AbstractContextManager[Bench]:
    text = (SKELETON / "toy_bus" / "arm.yaml").read_text().replace("udp_multicast", "virtual")
    return declared_bench(parse_robot(text, where="toy", folder=None), "toy_bus")


class TestToyBus(DriverConformance):
    def bench(self) -> AbstractContextManager[Bench]:
        return bench()


def spoilt(toy: SimpleNamespace) -> list[tuple[str, type]]:  # noqa: C901 — a class per spoilt driver
    """Drivers that do not keep a point: its name, and one of them."""
    base = toy.driver.ToyBusDriver

    class ReadsWhenStopped(base):
        def read(self, timeout):
            return super().read(timeout) if self._state == "running" else ()

    class CoarseStamps(base):
        def read(self, timeout):
            return [replace(batch, time=np.round(batch.time, 1)) for batch in super().read(timeout)]

    class CountsNothing(base):
        def read(self, timeout):
            return [replace(batch, lost=0) for batch in super().read(timeout)]

    class Degrees(base):
        def read(self, timeout):
            return [
                replace(batch, values={**batch.values, "position": np.degrees(batch.values["position"])})
                for batch in super().read(timeout)
            ]

    class Mirrored(base):
        def read(self, timeout):
            return [
                replace(batch, values={**batch.values, "velocity": -batch.values["velocity"]})
                for batch in super().read(timeout)
            ]

    class TakesTheOtherJoint(base):
        def command(self, position):
            start = self._newest if self._start is None else self._start
            self._start = start
            super().command(start + (position - start)[::-1])

        _start = None

    class IgnoresStop(base):
        def stop(self):
            if self._newest is None:
                super().stop()

    class WaitsForEver(base):
        def read(self, timeout):
            self._heard = self._clock.now()
            return super().read(timeout)

    class TakesAllFrames(base):
        def _take(self, arrived, identifier, data):
            assert self._joints[identifier - toy.driver.SAMPLE]
            return super()._take(arrived, identifier, data)

    class StartsAnew(base):
        def _take(self, arrived, identifier, data):
            batches = super()._take(arrived, identifier, data)
            return [replace(batch, time=np.array([self._last / self._settings.rate])) for batch in batches]

    class Sleeps(base):
        def read(self, timeout):
            time.sleep(0.0)
            return super().read(timeout)

    return [
        ("life_cycle", ReadsWhenStopped),
        ("time_stamps", CoarseStamps),
        ("gaps", CountsNothing),
        ("units_and_signs", Degrees),
        ("units_and_signs", Mirrored),
        ("units_and_signs", TakesTheOtherJoint),
        ("stop", IgnoresStop),
        ("silence", WaitsForEver),
        ("garbage", TakesAllFrames),
        ("restart", StartsAnew),
        ("clock", Sleeps),
    ]


@pytest.mark.parametrize("point", POINTS)
def test_a_spoilt_driver_fails_the_point_by_name(
    point: str, toy: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = [kind for spoils, kind in spoilt(toy) if spoils == point]
    assert kinds
    for kind in kinds:
        install(monkeypatch, replace(toy.declaration, driver=kind))
        with pytest.raises(ConformanceError, match=f"^{point}: "), bench() as one:
            check_point(point, one)


def test_the_suite_has_a_test_for_each_point() -> None:
    assert {name.removeprefix("test_") for name in vars(DriverConformance) if name.startswith("test_")} == set(POINTS)


def test_a_package_of_another_name_has_no_toy_in_it() -> None:
    files = driver_files("my_2nd_bus")
    assert set(files) == {
        path.relative_to(SKELETON).as_posix().replace("toy_bus", "my_2nd_bus")
        for path in SKELETON.rglob("*.*")
        if "__pycache__" not in path.parts
    }
    assert not [path for path, text in files.items() if "toy" in text.lower()]
    for path, text in files.items():
        if path.endswith(".py"):
            compile(text, path, "exec")
    assert struct.calcsize("<ihH") == 8  # a frame of classic CAN


def test_the_page_shows_the_package_that_is_tested_here() -> None:
    page = PAGE.read_text(encoding="utf-8")
    shown = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    files = ["toy_bus/declaration.py", "toy_bus/driver.py", "toy_bus/simulated.py"]
    texts = [(SKELETON / file).read_text(encoding="utf-8") for file in files]
    assert shown == [texts[0]]
    assert all(f"`{file}`" in page for file in files[1:])
    lines = sum(text.count("\n") for text in texts[:2])
    assert lines <= 150
    assert f"declaration are {lines} lines" in page
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == {
        *POINTS,
        *(entry.name for entry in fields(declaration.DriverDeclaration)),
    }


def test_the_command_writes_the_package_once_and_refuses_names_that_are_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments, status, said in (
        (["driver", "new", "my_bus"], 0, "pip install -e dynid_my_bus"),
        (["driver", "new", "my_bus"], 2, "dynid_my_bus: exists already"),
        (["driver", "new", "toy_bus"], 2, "a driver is called 'toy_bus' already"),
        (["driver", "new", "json"], 2, "a Python module is called 'json' already"),
        (["driver", "new", "My-Bus"], 2, "'My-Bus' cannot be the name of a driver"),
        (["driver", "new", "class"], 2, "'class' cannot be the name of a driver"),
        (["driver", "--json"], 0, '"simulated": "toy_bus"'),
    ):
        monkeypatch.setattr(sys, "argv", ["dynid", *arguments])
        with pytest.raises(SystemExit) as left:
            command.main()
        captured = capsys.readouterr()
        assert (left.value.code or 0, said in captured.out + captured.err) == (status, True), captured
    written = {path.relative_to(tmp_path / "dynid_my_bus").as_posix() for path in tmp_path.rglob("*.*")}
    assert set(driver_files("my_bus")) <= written
