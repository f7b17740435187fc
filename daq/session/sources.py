"""Several sources in one session: the arm's own connection and those recorded beside it, behind one driver."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeVar

from drivers.base import Attributing, Driver, Notice, ReportingSafety
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from drivers.streams import Batch, StreamLayout

_Result = TypeVar("_Result")


@dataclass
class _Source:
    """One of the sources."""

    name: str  # of its connection
    driver: Driver  # its driver
    # the driver's name of a stream → the session's; known once open
    streams: dict[str, str] = field(default_factory=dict)
    host_ahead: float = math.nan  # the host's clock less the source's at its last batch [s]; nan before the first


class Sources:
    """A driver made of several; implements `drivers.base.Driver`.

    The main one moves the arm and is waited for; the others are polled. The main one's streams keep
    their names; another's only stream has the name of its connection, several are called `connection_stream`.
    """

    def __init__(self, name: str, main: Driver, others: Mapping[str, Driver]) -> None:
        self._main = _Source(name, main)
        self._others = [_Source(other, driver) for other, driver in others.items()]
        self._failure: DynidError | None = None
        self._notices: deque[Notice] = deque()

    def open(self) -> None:
        """Open all, the main one first; those that are open already are closed again where one fails."""
        opened: list[_Source] = []
        try:
            for source in self._all:
                opened.append(source)  # it may fail half-way, and close is safe in every state
                _named(source, source.driver.open)
            self._name_streams()
        except BaseException:
            for source in reversed(opened):
                with suppress(Exception):  # the error on its way is the one to tell
                    source.driver.close()
            raise

    def streams(self) -> tuple[StreamLayout, ...]:
        """The streams of all, under distinct names."""
        return tuple(
            replace(layout, name=source.streams[layout.name])
            for source in self._all
            for layout in source.driver.streams()
        )

    def start(self) -> None:
        """Make the samples of all flow, the main one's last."""
        self._failure = None
        for source in self._all:
            source.host_ahead = math.nan
        try:
            for source in (*self._others, self._main):
                _named(source, source.driver.start)
        except BaseException:
            self.stop()
            raise

    def read(self, timeout: float) -> Sequence[Batch]:
        """Blocks of all, waiting at most `timeout` [s] for the main one's, which come before another's error."""
        if self._failure is not None:
            raise self._failure
        batches = list(_renamed(self._main, _named(self._main, self._main.driver.read, timeout)))
        for source in self._others:
            try:
                batches.extend(_renamed(source, _named(source, source.driver.read, 0.0)))
            except DynidError as error:
                self._failure = self._failure or error
        return batches

    def notices(self) -> Sequence[Notice]:
        """Notices of all since the last call, the source's name first; stamps are on the main one's clock."""
        notices = list(self._notices)
        self._notices.clear()
        for source in self._all:
            for notice in source.driver.notices():
                shift = 0.0 if source is self._main else source.host_ahead - self._main.host_ahead
                notices.append(
                    Notice(notice.time + shift, notice.level, f"{source.name}: {notice.message}", notice.hint)
                )
        return notices

    def silence(self, stream: str, limit: float) -> str:
        """Cause of a missing stream, from its source; empty where unknown (see `drivers.base`)."""
        return next((driver.silence(own, limit) for driver, own in self._attributing(stream)), "")

    def losses(self, stream: str) -> str:
        """Cause of lost samples of a stream, from its source; empty where unknown (see `drivers.base`)."""
        return next((driver.losses(own) for driver, own in self._attributing(stream)), "")

    def _attributing(self, stream: str) -> Iterator[tuple[Attributing, str]]:
        """The drivers that can say why a stream fails, and its name there."""
        for source in self._all:
            for own, name in source.streams.items():
                if name == stream and isinstance(source.driver, Attributing):
                    yield source.driver, own

    def unreported(self) -> Sequence[str]:
        """Return what the main one does not report of its safety status."""
        return self._main.driver.unreported() if isinstance(self._main.driver, ReportingSafety) else ()

    def command_rate(self) -> float:
        """The main one's."""
        return self._main.driver.command_rate()

    def take_control(self) -> None:
        """Take control of the main one's arm."""
        self._main.driver.take_control()

    def command(self, position: FloatArray) -> None:
        """Send a joint position to the main one."""
        self._main.driver.command(position)

    def stop(self) -> None:
        """Halt the arm, then end the samples of the others; never raises."""
        for source in self._all:
            try:
                source.driver.stop()
            except Exception as error:  # against the contract, but the others must be stopped all the same
                said = f"{source.name}: could not be stopped: {type(error).__name__}: {error}"
                self._notices.append(Notice(math.nan, "error" if source is self._main else "warning", said))

    def close(self) -> None:
        """Close all connections; safe in every state.

        Raises:
            Exception: the first that a driver raised, against its contract; all are closed before.
        """
        failure: Exception | None = None
        for source in self._all:
            try:
                source.driver.close()
            except Exception as error:
                failure = failure or error
        if failure is not None:
            raise failure

    @property
    def main(self) -> Driver:
        """The driver of the arm."""
        return self._main.driver

    @property
    def _all(self) -> tuple[_Source, ...]:
        return (self._main, *self._others)

    def _name_streams(self) -> None:
        main = [layout.name for layout in self._main.driver.streams()]
        self._main.streams = dict(zip(main, main, strict=True))
        used = set(main)
        for source in self._others:
            names = [layout.name for layout in source.driver.streams()]
            base = source.name.replace("/", "_").strip(".") or "source"  # it becomes the name of an HDF5 group
            source.streams = {name: _free(base if len(names) == 1 else f"{base}_{name}", used) for name in names}


def _free(wanted: str, used: set[str]) -> str:
    name, suffix = wanted, 2
    while name in used:
        name, suffix = f"{wanted}_{suffix}", suffix + 1
    used.add(name)
    return name


def _renamed(source: _Source, batches: Iterable[Batch]) -> list[Batch]:
    renamed = []
    for batch in batches:
        if len(batch.time):
            source.host_ahead = float(batch.host_time[-1] - batch.time[-1])
        renamed.append(replace(batch, stream=source.streams[batch.stream]))
    return renamed


def _named(source: _Source, call: Callable[..., _Result], *arguments: object) -> _Result:
    """Call, and put the source's name before the place of an error."""
    try:
        return call(*arguments)
    except DynidError as error:
        error.where = f"{source.name}: {error.where}" if error.where else source.name
        raise
