"""`dynid record` against a simulated arm that speaks a table of CAN frames, with faults typed into the arm."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest
from can_record_bench import Arm, Outcome, an_arm, assert_stopped, recorder, simulated, swing

from daq.recording import read_recording
from drivers.can_bus import close_bus, open_bus

pytestmark = pytest.mark.slow

POSITIONS = (0x181, 0x182, 0x183)
"""Frames with two positions of 24 bits each, 2^-20 of a turn a count."""
COUNTS_PER_RADIAN = 2**20 / 6.283185307179586


class Listener:
    """Hears the positions that the arm says."""

    def __init__(self, arm: Arm) -> None:
        self._bus = open_bus("udp_multicast", arm.group, 1_000_000, {"port": arm.port})

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *_: object) -> None:
        close_bus(self._bus)

    def travelled(self, seconds: float, enough: float = float("inf")) -> float:
        """How far any joint moves within a while [rad]; ends where it is more than `enough`."""
        while self._bus.recv(0.0) is not None:
            pass
        lowest: dict[tuple[int, int], int] = {}
        highest: dict[tuple[int, int], int] = {}
        end, most = time.monotonic() + seconds, 0
        while time.monotonic() < end and most < enough * COUNTS_PER_RADIAN:
            frame = self._bus.recv(0.1)
            if frame is None or frame.arbitration_id not in POSITIONS or len(frame.data) < 6:
                continue
            for place in (0, 3):
                (counts,) = struct.unpack("<i", b"\0" + bytes(frame.data[place : place + 3]))
                key, counts = (frame.arbitration_id, place), counts >> 8
                lowest[key] = min(counts, lowest.get(key, counts))
                highest[key] = max(counts, highest.get(key, counts))
                most = max(most, highest[key] - lowest[key])
        return most / COUNTS_PER_RADIAN if lowest else float("nan")


def with_fault(folder: Path, fault: str, duration: float | None = None) -> Outcome:
    """Record, type a fault once the arm moves (or it has been recorded for a second), and see what comes of it."""
    arm, out = an_arm(folder), folder / "run.h5"
    moved = ["--trajectory", str(swing(folder, 8.0))]
    arguments = moved if duration is None else ["--duration", str(duration)]
    with simulated(arm, "can") as (_, process), Listener(arm) as listener:
        with recorder(arm, "can", out, *arguments) as program:
            while not out.exists() and program.poll() is None:
                time.sleep(0.01)
            if duration is None:
                assert listener.travelled(10.0, enough=0.05) >= 0.05
            else:
                time.sleep(1.0)
            assert process.stdin is not None
            print(fault, file=process.stdin, flush=True)
            begun = time.monotonic()
            errors = program.communicate(timeout=40)[1]
            seconds = time.monotonic() - begun
        time.sleep(1.0)
        rest = listener.travelled(0.4)
    return Outcome(program.returncode, errors, read_recording(out) if out.exists() else None, seconds, rest, ())


SILENT = "stale data of stream joints"


@pytest.mark.parametrize("fault", ["freeze 1", "bus-off 1", "mute 0x182 1", "over-temperature 3"])
def test_an_arm_silent_or_in_fault_comes_to_rest(tmp_path: Path, fault: str) -> None:
    outcome = with_fault(tmp_path, fault)
    assert_stopped(outcome, SILENT, "fault of elbow_joint: 2")
    assert outcome.moved < 1e-3


def test_a_frame_that_stays_away_while_only_recorded_ends_the_session(tmp_path: Path) -> None:
    outcome = with_fault(tmp_path, "mute 0x182 2", 10.0)
    assert_stopped(outcome, "no complete row of the joints for 0.5 s: frame 0x182 (position of elbow_joint, ")


# Without a motion: there the rows lost and a stall of a busy computer together pass 50 ms, and rightly stop the arm.
@pytest.mark.parametrize("fault", ["truncate 8", "garbage 50"])
def test_damaged_frames_cost_their_rows_and_end_nothing(tmp_path: Path, fault: str) -> None:
    outcome = with_fault(tmp_path, fault, 3.0)
    assert outcome.status == 0, outcome.errors
    assert outcome.recording is not None
    assert outcome.recording.complete
    told = [event for event in outcome.events() if "frame(s) too short for the table" in event]
    assert bool(told) is fault.startswith("truncate")
    # The arm's motion, or its rest: no value of a damaged frame.
    position = outcome.recording.streams["joints"].channels["position"].values
    assert np.max(np.abs(np.diff(position, axis=0))) < 0.05
