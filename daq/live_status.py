"""The line on stderr that tells how a recording goes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

StatusCall = Callable[[Mapping[str, int], Mapping[str, int]], None]


@contextmanager
def live_status(*, shown: bool) -> Iterator[StatusCall | None]:
    """What a session tells its samples and losses; None where nothing is to be shown."""
    if not shown:
        yield None
        return
    from rich.console import Console

    with Console(stderr=True, highlight=False).status("recording") as line:

        def tell(samples: Mapping[str, int], lost: Mapping[str, int]) -> None:
            counts = ", ".join(f"{name} {count} ({lost.get(name, 0)} lost)" for name, count in samples.items())
            line.update(f"recording: {counts}; Ctrl-C stops")

        yield tell
