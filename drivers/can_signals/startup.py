"""What an opening waits for: that every frame of the joints is heard, and which of them begins a cycle."""

from __future__ import annotations

from drivers.can.receiver import Receiver
from drivers.can_signals.rows.cycle_order import CycleOrder, Order
from drivers.can_signals.settings import CanFramesSettings
from drivers.can_signals.table.signals import identifier_text
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError


def hear_all(settings: CanFramesSettings, receiver: Receiver, clock: Clock = SYSTEM_CLOCK) -> Order:
    """Wait until every frame of the joints has come, and see which begins a cycle.

    Raises:
        ConnectionFailedError: names what did not come.
        ConnectionLostError: the adapter is gone.
    """
    layouts, marker = settings.frame_layouts("joints"), settings.cycle
    order = CycleOrder(layouts)
    end = clock.now() + settings.timeout
    heard: set[int] = set()
    while not order.enough or (marker is not None and marker not in heard):
        if (left := end - clock.now()) <= 0:
            break
        frames = receiver.take(left, at_least=len(layouts))
        heard.update(identifier for _, identifier, _ in frames)
        order.take(frames)
    missing = [layout.label for layout in order.never_seen()]
    if marker is not None and marker not in heard:
        missing.append(f"frame {identifier_text(marker)} that begins a cycle")
    if missing:
        only = ", ".join(identifier_text(identifier) for identifier in sorted(heard)) or "none of the table's frames"
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise ConnectionFailedError(
            f"no {missing[0]}{more} within {settings.timeout:g} s; heard: {only}",
            where=f"{settings.interface} {settings.channel}",
            hint="is the arm on, and are bit rate, identifiers, lengths and 'poll' right?",
        )
    return order.result()
