"""Listening to a driver on a bench as a session does, while another thread may command it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from drivers.base import Driver, Notice
from drivers.core.arrays import FloatArray
from drivers.core.errors import ConnectionLostError, DynidError
from drivers.streams import Batch
from sim_drivers.conformance.bench import Bench
from sim_drivers.conformance.requirement import one_line, require

READ = 0.02
"""How long [s] a reading waits."""
LIMIT = 20.0
"""How long [s] samples are waited for."""
TURNS = 5000
"""Readings without samples and without any time in between, after which `read` counts as one that never waits."""


@dataclass
class Received:
    """What came."""

    blocks: list[Batch] = field(default_factory=list)  # in their order
    notices: list[Notice] = field(default_factory=list)  # in their order
    error: ConnectionLostError | None = None  # that ended it; None where none did

    def __iadd__(self, later: Received) -> Received:
        """Go on with what came later."""
        self.blocks += later.blocks
        self.notices += later.notices
        self.error = self.error or later.error
        return self

    def samples(self) -> int:
        """Number of samples of the stream with the most."""
        return max((len(self.stamps(block.stream)) for block in self.blocks), default=0)

    def stamps(self, stream: str) -> FloatArray:
        """(N,) of a stream [s]."""
        return np.concatenate([block.time for block in self.blocks if block.stream == stream] or [np.empty(0)])

    def arrivals(self, stream: str) -> FloatArray:
        """(N,) of a stream [s]."""
        return np.concatenate([block.host_time for block in self.blocks if block.stream == stream] or [np.empty(0)])

    def lost(self, stream: str) -> int:
        """Samples that the driver counts as lost."""
        return sum(block.lost for block in self.blocks if block.stream == stream)

    def all(self, quantity: str) -> FloatArray | None:
        """(N, n) of a quantity; None where it does not come."""
        values = [block.values[quantity] for block in self.blocks if len(block.values.get(quantity, ()))]
        return np.concatenate(values) if values else None

    def last(self, seconds: float) -> Received:
        """Return what arrived within the last so many seconds."""
        end = max((block.host_time[-1] for block in self.blocks if len(block.host_time)), default=0.0)
        recent = [block for block in self.blocks if len(block.host_time) and block.host_time[0] >= end - seconds]
        return Received(recent, self.notices, self.error)

    def newest(self, quantity: str) -> FloatArray | None:
        """(n,) the newest sample of a quantity; None where none came."""
        every = self.all(quantity)
        return None if every is None else every[-1]


def listen(bench: Bench, driver: Driver, samples: int) -> Received:
    """Read until so many samples of a stream have come, `LIMIT` at most.

    Raises:
        ConnectionLostError: the connection broke.
    """
    heard, end = Received(), bench.clock.now() + LIMIT
    while heard.samples() < samples and bench.clock.now() < end:
        heard += listen_for(bench, driver, READ)
        if heard.error is not None:
            raise heard.error
    return heard


def listen_for(
    bench: Bench, driver: Driver, seconds: float, *, samples: float = math.inf, until_error: bool = False
) -> Received:
    """Read for so long [s], or until the connection breaks, or so many samples of a stream have come.

    `until_error`: or until a notice tells of an error.
    """
    heard, end = Received(), bench.clock.now() + seconds
    idle = 0
    while bench.clock.now() < end and heard.samples() < samples:
        before = bench.clock.now()
        try:
            blocks = driver.read(min(READ, end - before))
        except ConnectionLostError as error:
            one_line(error)
            heard.notices += driver.notices()
            heard.error = error
            return heard
        heard.blocks += blocks
        heard.notices += driver.notices()
        idle = 0 if blocks or bench.clock.now() > before else idle + 1
        require(idle < TURNS, "read returns at once without a sample, however long it may wait")
        if until_error and any(notice.level == "error" for notice in heard.notices):
            return heard
    return heard


def move(
    bench: Bench,
    driver: Driver,
    start: FloatArray,
    end: FloatArray,
    seconds: float,
    part: float = 1.0,
    hold: float = 0.0,
) -> Received:
    """Take control and command a ramp, or its first part, and hold so long [s], while this thread reads.

    Raises:
        DynidError: what the driver raised in the other thread.
    """
    raised: list[BaseException] = []

    def play() -> None:
        try:
            driver.take_control()
            period = 1.0 / driver.command_rate()
            begun = bench.clock.now()
            steps = int((part * seconds + hold) / period)
            for number in range(1, steps + 1):
                share = min(number * period / seconds, part)
                smooth = share**2 * (3.0 - 2.0 * share)
                driver.command(start + smooth * (end - start))
                bench.clock.sleep_until(begun + number * period)
        except (DynidError, ArithmeticError, LookupError, TypeError, ValueError) as error:
            raised.append(error)

    thread = bench.clock.thread(play, "commands")
    thread.start()
    heard = Received()
    limit = bench.clock.now() + LIMIT + seconds
    while thread.is_alive() and bench.clock.now() < limit and heard.error is None:
        heard += listen_for(bench, driver, READ)
    require(not thread.is_alive(), f"taking control and commanding last more than {LIMIT:g} s")
    for error in (*raised, heard.error):
        if error is not None:
            raise error
    return heard
