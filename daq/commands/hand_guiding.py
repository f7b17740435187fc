"""The person who leads an arm by hand, at a terminal: what will happen, a question, and a key that is held."""

from __future__ import annotations

import os
import select
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Self, TextIO

from daq.commands.confirmation import answer_of, ask_on, tell
from daq.session.guiding import HAND_SPEED
from drivers.core.clock import Clock
from drivers.core.errors import UsageError

KEY = b" "
REPEATED = 0.3
"""[s] after which a key that does not repeat counts as released; keyboards repeat 10 to 30 times a second."""


class KeyAtTerminal:
    """Asks, and sees whether the space bar is held; a `daq.session.guiding.Hand` that restores its terminal at the end.

    Raises:
        UsageError: this computer's terminals tell no single keys.
    """

    def __init__(self, terminal: tuple[TextIO, TextIO], clock: Clock, *, asks: bool) -> None:
        try:
            import termios
        except ImportError as error:  # Windows
            raise UsageError("leading an arm by hand needs a terminal that reports single keys") from error
        self._terminal, self._asks, self._clock = terminal, asks, clock
        self._descriptor = terminal[0].fileno()
        self._before = termios.tcgetattr(self._descriptor)
        self._last = float("-inf")
        self._begun = self._over = False
        self._to_mind: Sequence[str] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        import termios

        with suppress(termios.error, OSError):
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def mind(self, cautions: Sequence[str]) -> None:
        """Take what the arm does meanwhile and at the end, one line each."""
        self._to_mind = cautions

    def ask(self) -> None:
        """Say what will happen, then ask."""
        lines = [
            *self._to_mind,
            f"it is stopped as soon as a joint moves faster than {HAND_SPEED:g} rad/s (m/s) or leaves its range, a "
            "limit is passed, or samples or the connection fail",
        ]
        tell("the arm will be released, to be led by hand:", lines, self._terminal[1])
        if self._asks:
            ask_on(self._terminal, "Release the arm while you hold the space bar? [y/N] ")

    def answer(self) -> bool | None:
        """Answer as `daq.commands.confirmation.answer_of`; then single keys are read."""
        said = answer_of(self._terminal) if self._asks else True
        if said:
            import tty

            tty.setcbreak(self._descriptor)
            print("hold the space bar; releasing it ends the recording", file=self._terminal[1], flush=True)
        return said

    def held(self) -> bool:
        """Whether the space bar repeats; False for ever once it ceased, another key came, or the terminal is gone."""
        now, typed = self._clock.now(), self._typed()
        count = len(typed)
        self._over = self._over or typed.strip(KEY) != b""
        if count:
            self._begun = self._begun or count > 1 or now - self._last <= REPEATED
            self._last = now
        self._over = self._over or (self._begun and now - self._last > REPEATED)
        return self._begun and not self._over

    def _typed(self) -> bytes:
        try:
            if not select.select([self._descriptor], [], [], 0.0)[0]:
                return b""
            read = os.read(self._descriptor, 1024)
        except (OSError, ValueError):
            read = b""
        self._over = self._over or not read
        return read
