"""Whatever comes on the drives' identifiers: samples and temperatures go on, or a drive is named; no thread breaks."""

from __future__ import annotations

import can
import numpy as np
import pytest
from canopen_bench import bench
from hostile_frames import hostile_frames
from hypothesis import given, settings
from hypothesis import strategies as st

TEMPERATURE: dict[str, object] = {"index": 0x2031, "subindex": 1, "scale": 0.1}
NODES = {joint: {"temperature": TEMPERATURE} for joint in ("pan", "lift", "elbow")}
ANSWERS = [0x581, 0x582, 0x583]
OTHERS = [0x080, 0x081, 0x701, 0x702, 0x601, 0x000, 0x100, 0x184, 0x7FF]


@settings(max_examples=6, deadline=None)
@given(frames=hostile_frames([*ANSWERS, *OTHERS]), pauses=st.floats(1e-4, 0.05))
def test_samples_and_temperatures_go_on(frames: list[can.Message], pauses: float) -> None:
    with bench(nodes=NODES, sdo_timeout=0.05) as one:

        def speak() -> None:
            for frame in frames:
                one.clock.sleep(pauses)
                one.bus.bus.send(frame)

        one.read(lambda: one.blocks["thermal"])
        speaker = one.clock.thread(speak, "hostile node")
        speaker.start()
        one.read(lambda: not speaker.is_alive())
        one.blocks["thermal"].clear()
        one.read(lambda: len(one.blocks["thermal"]) > 1)
        assert np.allclose(one.blocks["thermal"][-1].values["temperature"], 31.2)
        assert one.lost == 0
        assert one.clock.breakdowns() == []


@pytest.mark.parametrize("length", range(8))
def test_a_short_sdo_answer_does_not_end_the_temperatures(length: int) -> None:
    with bench(nodes=NODES, sdo_timeout=0.05) as one:
        for _ in range(200):
            one.bus.send(0x581, bytes(length))
            one.read_rows(1)
        assert sum(len(block.time) for block in one.blocks["thermal"]) >= 8
        assert any(" 0x581 not understood" in text for text in one.said("warning"))
