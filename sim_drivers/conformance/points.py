"""The points that every driver has to keep, one function each; `POINTS` names them.

A point is tried on a `Bench`, in simulated time, and raises `ConformanceError` where the driver does not keep it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from unittest.mock import patch

import numpy as np

from drivers.base import Driver, Identifying, Limiting
from drivers.core.arrays import FloatArray
from drivers.core.clock import Clock
from drivers.core.errors import ConnectionFailedError, ConnectionLostError, DynidError
from sim_drivers.conformance.bench import Bench, Obeying
from sim_drivers.conformance.listening import Received, listen, listen_for, move
from sim_drivers.conformance.requirement import ConformanceError, one_line, refused, require

SAMPLES = 25
"""Samples of its first stream by which a driver is judged."""
PATIENCE = 20.0
"""Longest time [s] for what must happen."""
REST = 2e-3
"""How far [rad or m] a joint at rest may move in a tenth of a second."""
TRAVEL = 0.04
"""How far [rad or m] joints are moved."""


def life_cycle(bench: Bench) -> None:
    """States follow the contract of `drivers.base`, and after `close` everything begins anew."""
    with bench.device():
        driver = bench.driver()
        try:
            require(not driver.notices(), "it has a notice before it is open")
            actions: list[Callable[[], object]] = [driver.identify] if isinstance(driver, Identifying) else []
            actions += [driver.device_limits] if isinstance(driver, Limiting) else []
            for action in (driver.streams, driver.start, lambda: driver.read(0.0), driver.take_control, *actions):
                refused(action, "before it is open")
            for _ in range(2):
                driver.open()
                refused(driver.open, "while it is open")
                refused(lambda: driver.read(0.0), "before start")
                refused(driver.take_control, "before start")
                layouts = driver.streams()
                require(bool(layouts), "it lists no stream once open")
                for _ in range(2):
                    driver.start()
                    refused(driver.start, "while it runs")
                    heard = listen(bench, driver, samples=3)
                    require(heard.samples() >= 3, f"after start no samples came within {PATIENCE:g} s")
                    require(driver.streams() == layouts, "its streams change while it runs")
                    driver.stop()
                    refused(lambda: driver.read(0.0), "after stop")
                driver.close()
                driver.close()
                refused(driver.start, "after close")
        finally:
            driver.close()


def time_stamps(bench: Bench) -> None:
    """Stamps rise, at the rate that the driver names; arrivals are the host's clock; blocks are as announced."""
    with _running(bench) as (driver, _):
        begun = bench.clock.now()
        heard = listen(bench, driver, samples=SAMPLES)
        layouts = {layout.name: layout for layout in driver.streams()}
        for block in heard.blocks:
            require(block.stream in layouts, f"a block of '{block.stream}', which streams() does not list")
            layout = layouts[block.stream]
            shapes = {channel.quantity: (len(block.time), len(channel.columns)) for channel in layout.channels}
            shape_of = {quantity: values.shape for quantity, values in block.values.items()}
            require(shape_of == shapes, f"a block of '{block.stream}' holds {shape_of}, announced were {shapes}")
        for name, layout in layouts.items():
            stamps, arrivals = heard.stamps(name), heard.arrivals(name)
            require(bool(np.isfinite(stamps).all()), f"{name}: a time stamp is not finite")
            require(bool((np.diff(stamps) > 0.0).all()), f"{name}: time stamps do not rise")
            require(bool((np.diff(arrivals) >= 0.0).all()), f"{name}: arrivals go back in time")
            inside = bool(((arrivals >= begun - 1.0) & (arrivals <= bench.clock.now())).all())
            require(inside, f"{name}: host_time is not DriverSettings.clock's")
            if layout.rate > 0.0 and len(stamps) >= SAMPLES:
                rate = 1.0 / float(np.median(np.diff(stamps)))
                agrees = abs(rate / layout.rate - 1.0) < 0.05
                require(agrees, f"{name}: stamped at {rate:.4g} Hz, but streams() says {layout.rate:.4g} Hz")
                span, passed = stamps[-1] - stamps[0], arrivals[-1] - arrivals[0]
                true = abs(span - passed) < 0.05 * passed + 2.0 / layout.rate
                require(true, f"{name}: {span:.3f} s by the stamps are {passed:.3f} s of the host")


def gaps(bench: Bench) -> None:
    """Samples that are lost are counted, or a notice tells of the gap; none is invented."""
    with _running(bench) as (driver, device):
        heard = listen(bench, driver, samples=SAMPLES)
        device.obey(bench.lose)
        heard += listen_for(bench, driver, 1.0)
        first = driver.streams()[0]
        lost = heard.lost(first.name)
        require(lost > 0 or bool(heard.notices), "lost samples are neither counted (Batch.lost) nor a notice")
        if first.rate > 0.0 and lost > 0:
            missing = float(np.sum(np.round(np.diff(heard.stamps(first.name)) * first.rate) - 1.0))
            require(missing == lost, f"the stamps lack {missing:g} samples, Batch.lost counts {lost}")


def units_and_signs(bench: Bench) -> None:
    """Every sample is what the device's sensors hold, in dynid's units; a command moves the joint that it names."""
    with _running(bench) as (driver, _):
        heard = listen(bench, driver, samples=SAMPLES)
        _agrees(bench, heard)
        before = heard.newest("position")
        if driver.command_rate() <= 0.0 or before is None:
            return
        way = TRAVEL * np.where(np.arange(len(before)) % 2, -1.0, 1.0)
        heard = move(bench, driver, before, before + way, 0.8, hold=0.4)
        after = heard.newest("position")
        require(after is not None, "no position while the arm is moved")
        moved = np.asarray(after) - before
        require(bool((moved * way > 0.5 * way**2).all()), f"commanded to move by {way}, it moved by {moved}")
        require(bool(((bench.truth()["position"] - before) * way > 0.0).all()), "it reports a motion that is not made")
        speeds = [block.values["velocity"] for block in heard.blocks if "velocity" in block.values]
        if speeds:
            mean = np.concatenate(speeds).mean(axis=0)
            require(bool((mean * way > 0.0).all()), f"moved by {way}, the mean velocity is {mean}")
        _agrees(bench, heard.last(0.1), controlled=True)


def stop(bench: Bench) -> None:
    """`stop` is safe in every state and twice, brings a moving arm to rest, and ends the command of it."""
    with bench.device():
        driver = bench.driver()
        try:
            driver.stop()
            driver.open()
            driver.stop()
            driver.start()
            driver.stop()
            driver.stop()
            driver.start()
            heard = listen(bench, driver, samples=3)
            position = heard.newest("position")
            if position is not None and driver.command_rate() > 0.0:
                far = position + 5.0 * TRAVEL
                move(bench, driver, position, far, 1.0, part=0.5)
                begun = bench.clock.now()
                driver.stop()
                require(bench.clock.now() - begun < PATIENCE, "stop lasts too long")
                bench.clock.sleep(1.0)
                before = bench.truth()["position"]
                bench.clock.sleep(0.1)
                require(bool((np.abs(bench.truth()["position"] - before) < REST).all()), "the arm moves after stop")
                require(bool((np.abs(before - far) > TRAVEL).all()), "stop lets the motion run to its end")
                refused(lambda: driver.command(position), "after stop", to="be commanded")
        finally:
            driver.close()
        driver.stop()
    with _running(bench) as (driver, _):
        listen(bench, driver, samples=3)
    driver = bench.driver()
    with bench.device():
        driver.open()
        driver.start()
    driver.stop()  # of a device that is gone
    driver.close()


def silence(bench: Bench) -> None:
    """Nobody there, or a device that falls silent, is an error of one line within a time limit."""
    driver, begun = bench.driver(), bench.clock.now()
    try:
        driver.open()
    except ConnectionFailedError as error:
        one_line(error)
        require(bench.clock.now() - begun < PATIENCE, f"open without a device lasts more than {PATIENCE:g} s")
    else:
        require(False, "open without a device raises no ConnectionFailedError")
    finally:
        driver.close()
    with _running(bench) as (driver, device):
        listen(bench, driver, samples=SAMPLES)
        device.obey(bench.fall_silent)
        begun = bench.clock.now()
        heard = listen_for(bench, driver, PATIENCE, until_error=True)
        reported = heard.error is not None or any(notice.level == "error" for notice in heard.notices)
        if not driver.streams()[0].essential:
            reported = reported or bool(heard.notices)
        require(reported, f"a device silent for {PATIENCE:g} s is neither ConnectionLostError nor a notice")


def garbage(bench: Bench) -> None:
    """Nonsense on the bus is never a sample, and never an error of Python."""
    with _running(bench) as (driver, device):
        listen(bench, driver, samples=SAMPLES)
        device.obey(bench.babble)
        heard = listen_for(bench, driver, 1.0)
        _agrees(bench, heard)
        _goes_on(bench, driver, heard, "nonsense")


def restart(bench: Bench) -> None:
    """A device that is switched off and on again does not go unnoticed, and is recorded again."""
    driver = bench.driver()
    try:
        with bench.device():
            driver.open()
            driver.start()
            heard = listen(bench, driver, samples=SAMPLES)
        heard += listen_for(bench, driver, 0.3)
        with bench.device():
            if heard.error is None:
                heard += listen_for(bench, driver, 5.0, samples=SAMPLES)
            noticed = heard.error is not None or bool(heard.notices) or any(block.lost for block in heard.blocks)
            require(noticed, "the device was off, and neither an error, a notice nor Batch.lost tells")
            for layout in driver.streams():
                rising = bool((np.diff(heard.stamps(layout.name)) > 0.0).all())
                require(rising, f"{layout.name}: time stamps do not rise over a restart")
            _goes_on(bench, driver, heard, "a restart")
    finally:
        driver.close()


def clock(bench: Bench) -> None:
    """It waits, and makes threads, by `DriverSettings.clock` alone; `read` waits no longer than it is asked to."""

    def real(*_: object, **__: object) -> None:
        raise ConformanceError("it waits, or starts a thread, by the computer's clock instead of DriverSettings.clock")

    started: list[threading.Thread] = []

    def watch(thread: threading.Thread) -> None:
        started.append(thread)
        start_thread(thread)

    start_thread = threading.Thread.start
    with ExitStack() as patched:
        for owner, name in ((time, "sleep"), *((Clock, name) for name in ("now", "sleep_until", "_select", "thread"))):
            patched.enter_context(patch.object(owner, name, real))
        patched.enter_context(patch.object(threading.Thread, "start", watch))
        driver, device = patched.enter_context(_running(bench))
        listen(bench, driver, samples=3)
        device.obey(bench.fall_silent)
        listen_for(bench, driver, 0.05)
        begun = bench.clock.now()
        with suppress(ConnectionLostError):
            driver.read(0.05)
            waited = bench.clock.now() - begun
            require(waited < 0.5, f"read(0.05) waits {waited:.2f} s")
    foreign = [thread.name for thread in started if not bench.clock.made(thread)]
    require(not foreign, f"threads that DriverSettings.clock did not make: {', '.join(foreign)}")


POINTS: Mapping[str, Callable[[Bench], None]] = {
    point.__name__: point
    for point in (life_cycle, time_stamps, gaps, units_and_signs, stop, silence, garbage, restart, clock)
}


def check_point(name: str, bench: Bench) -> None:
    """Try one of `POINTS`.

    Raises:
        ConformanceError: the driver does not keep it; the message begins with the point's name.
    """
    try:
        POINTS[name](bench)
    except ConformanceError as error:
        raise ConformanceError(f"{name}: {error}") from error
    except DynidError as error:
        raise ConformanceError(f"{name}: {type(error).__name__}: {error}") from error
    except Exception as error:
        raise ConformanceError(f"{name}: the driver lets {type(error).__name__} through: {error}") from error


@contextmanager
def _running(bench: Bench) -> Iterator[tuple[Driver, Obeying]]:
    """A driver that runs, and its device."""
    with bench.device() as device:
        driver = bench.driver()
        try:
            driver.open()
            driver.start()
            yield driver, device
            driver.stop()
        finally:
            driver.close()


def _goes_on(bench: Bench, driver: Driver, heard: Received, after: str) -> None:
    """True samples come again; of a driver that ended with an error, when it was opened anew."""
    if heard.error is not None:
        driver.stop()
        driver.close()
        driver.open()
        driver.start()
    again = listen(bench, driver, samples=SAMPLES)
    require(again.samples() >= SAMPLES, f"after {after} no samples came within {PATIENCE:g} s")
    _agrees(bench, again)


def _agrees(bench: Bench, heard: Received, *, controlled: bool = False) -> None:
    """The median of all samples of an arm at rest, and each sample of a position, is the truth."""
    for quantity, true in bench.truth().items():
        samples: FloatArray | None = heard.all(quantity)
        if samples is None or not (controlled or quantity in bench.idle):
            continue
        require(samples.shape[-1] == len(true), f"{quantity}: {samples.shape[-1]} columns instead of {len(true)}")
        noisy = np.median(samples, axis=0) if quantity != "position" else samples
        error = float(np.nanmax(np.abs(noisy - true), initial=0.0))
        limit = bench.tolerances.get(quantity, math.inf)
        worst = samples[np.argmax(np.nanmax(np.abs(samples - true), axis=1))]
        require(error <= limit, f"{quantity} is {worst}, but in truth {true}: a unit, a sign or an order is wrong")
