"""Whatever comes on the bus: a table's driver and its simulated arm go on, and no thread breaks."""

from __future__ import annotations

import can
from hostile_frames import hostile_frames
from hypothesis import given, settings
from simulated_clock import simulated_time
from table_arm_bench import connection_of, opened, read_for, served

from drivers.can.bus import close_bus, open_bus

OTHERS = [0x000, 0x080, 0x123, 0x581, 0x7FF]


@settings(max_examples=5, deadline=None)
@given(frames=hostile_frames(OTHERS))
def test_driver_and_simulated_arm_survive(frames: list[can.Message]) -> None:
    with simulated_time() as clock, served(clock) as server:
        table = sorted(server.settings.identifiers)
        connection = connection_of(server)
        bus = open_bus("virtual", connection["channel"], 1_000_000, {})
        with opened(connection, clock) as driver:
            driver.start()
            for number, frame in enumerate(frames):
                if number % 3 == 0:  # some of them on the table's own identifiers
                    frame.arbitration_id = table[number % len(table)]
                bus.send(frame)
                read_for(driver, clock, 0.003)
            rows = read_for(driver, clock, 0.2)
            assert sum(len(block.time) for block in rows) >= 30
        close_bus(bus)
        assert clock.breakdowns() == []
        assert server.failure is None
